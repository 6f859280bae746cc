"""What was wanted of the results (``benchmarks/bounds.yaml``), and what the tables say of it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml

from epiprior_lab.evaluation.records import CASCADE
from epiprior_lab.report.page import Table, say
from epiprior_lab.report.results import ROUNDING, ReportError, Results, where
from epiprior_lab.report.text import ALL, OURS, Row, baseline_of, group_title, input_title, interval, percent, signed

EVERY = "every"
BOUNDS = Path("benchmarks/bounds.yaml")
Tables = Mapping[str, pd.DataFrame]
COLUMNS = "measure group threshold_px estimator input against wanted found low high possible kept of met"


@dataclass(frozen=True, kw_only=True)
class Bound:
    """One bound; the head of ``benchmarks/bounds.yaml`` tells what the fields mean."""

    pipeline: str
    measure: str
    group: str
    estimator: str = ""
    input: str = OURS
    against: str = ""
    threshold_px: float = float("nan")
    at_least: float = float("nan")
    at_most: float = float("nan")
    note: str = ""


def load_bounds(path: Path, pipeline: str) -> list[Bound]:
    """Read the bounds of one pipeline, ``study`` or ``photographs``; a ReportError names what is wrong in the file."""
    try:
        found = [Bound(**entry) for entry in yaml.safe_load(path.read_text(encoding="utf-8"))]
    except (OSError, yaml.YAMLError, TypeError) as error:
        known = ", ".join(field.name for field in fields(Bound))
        raise ReportError(f"{path}: cannot be read as a list of bounds with {known}: {error}") from error
    unknown = [bound.measure for bound in found if bound.measure not in _MEASURES]
    if unknown:
        raise ReportError(f"{path}: no measure {unknown[0]!r}, only {', '.join(_MEASURES)}")
    return [bound for bound in found if bound.pipeline == pipeline]


def judge(bounds: Sequence[Bound], tables: Tables, results: Results | None = None) -> pd.DataFrame:
    """Return every bound that the given tables allow to judge, and whether it is met.

    Those of time need `overhead` among the tables (`timing.overhead_table`), all others those of `results`.

    Columns: ``measure, group, threshold_px, estimator, input, against``: the bound, with whom the numbers are about;
    ``wanted, found, low, high`` (95 % interval over scenes); ``possible``, what would be found if every pair
    succeeded; ``kept`` of how many estimators ``of`` keep to the bound; ``met``: by the value, of a difference by an
    interval that excludes the bound for everyone, never without such pairs. ReportError where an estimator has none.
    """
    rows = []
    for bound in (bound for bound in bounds if ("time" in bound.measure) == ("overhead" in tables)):
        row: dict[str, Any] = dict.fromkeys(COLUMNS.split(), np.nan)
        row |= {"wanted": bound.at_most if np.isnan(bound.at_least) else bound.at_least, "met": False}
        row |= {name: value for name, value in vars(bound).items() if name in row}
        if results is None or bound.group in dict(results.groups()):
            row |= _MEASURES[bound.measure](bound, results, tables)
        rows.append(row)
    return pd.DataFrame(rows, columns=COLUMNS.split())


def _contribution(bound: Bound, results: Any, tables: Tables) -> dict[str, Any]:
    if bound.against == "best_peer":
        return _best_peer(bound, results)
    at = where(tables["successes"], group=bound.group, threshold_px=bound.threshold_px)
    ours = where(at, input=bound.input, **({} if bound.estimator == EVERY else {"estimator": bound.estimator}))
    if ours.empty:
        raise ReportError(f"no results of {bound.estimator} on {bound.group} below {bound.threshold_px:g} px")
    worst = ours.sort_values("gain", kind="stable").iloc[0]
    own = at[at["estimator"] == worst["estimator"]].set_index("input")["successes"]
    base = own[baseline_of(bound.input, list(own.index))]
    kept = int((ours["gain"] >= bound.at_least - ROUNDING).sum())
    row = {"estimator": worst["estimator"], **_found_in(worst, "gain"), "met": kept == len(ours)}
    row["possible"] = worst["pairs"] / base - 1 if base else np.inf
    return row | ({"kept": kept, "of": len(ours)} if bound.estimator == EVERY else {})


def _found_in(row: Any, name: str) -> dict[str, Any]:
    return {"found": row[name], "low": row[f"{name}_low"], "high": row[f"{name}_high"]}


def _best_peer(bound: Bound, results: Results) -> dict[str, Any]:
    """Compare with the best combination of any estimator, this one included, with any input but ours."""
    member = results.masks[bound.group]
    peers = [(e, name) for e in results.estimators for name in results.inputs(e) if name not in ("paper", OURS)]
    rates = {key: results.errors.of(*key, bound.threshold_px) for key in peers}
    best = max(rates, key=lambda key: float(rates[key][member].sum()))
    own = results.errors.of(bound.estimator, bound.input, bound.threshold_px)
    found = results.compare(rates[best], own, member, "champion", str(bound.threshold_px)).contribution
    share = float(rates[best][member].mean())
    row = {"against": f"{best[0]} on {input_title(best[1])}", "possible": 1 / share - 1 if share else np.inf}
    row |= _found_in(results.interval("found", found, member), "found")
    return row | {"met": found.value >= bound.at_least - ROUNDING}


def _difference(bound: Bound, _: Any, tables: Tables) -> dict[str, Any]:
    at = where(tables["duels"], group=bound.group, input=bound.input, threshold_px=bound.threshold_px)
    if at.empty:
        raise ReportError(f"no duels on {bound.group}, {bound.input}, below {bound.threshold_px:g} px")
    rival = at.sort_values(["difference_low", "difference"], kind="stable").iloc[0]
    kept = int((at["difference_low"] > bound.at_least + ROUNDING).sum())
    row = {"against": rival["estimator"], "possible": rival["pairs"] - rival["other"], **_found_in(rival, "difference")}
    return row | {"kept": kept, "of": len(at), "met": kept == len(at)}


def _precision_gain(bound: Bound, _: Any, tables: Tables) -> dict[str, Any]:
    at = where(tables["rankings"], group=bound.group, input=bound.input, ranking="final")
    if at.empty:
        return {}
    row = at.iloc[0]
    possible, met = 1 - (row["precision_100"] - row["gain"]), row["gain"] >= bound.at_least - ROUNDING
    return _found_in(row, "gain") | {"possible": possible, "met": met}


def _value(bound: Bound, _: Any, tables: Tables) -> dict[str, Any]:
    """Return one of `_VALUES`, over all estimators unless the bound names one; nothing where it was not measured."""
    name, column, values = _VALUES[bound.measure]
    if name not in tables:
        return {}
    at = where(tables[name], estimator=ALL if bound.estimator in ("", EVERY) else bound.estimator, **values)
    at = where(at, group=bound.group) if "group" in at else at
    return {} if at.empty else _reached(bound, float(at[column].iloc[0]))


def _cascade_lost(bound: Bound, _: Any, tables: Tables) -> dict[str, Any]:
    if CASCADE not in tables:
        return {}
    at = where(tables[CASCADE], group=bound.group, threshold_px=bound.threshold_px)
    worst = at.assign(share=at["lost"] / at["pairs"]).sort_values("share", ascending=False, kind="stable").iloc[0]
    return {"estimator": worst["estimator"], **_reached(bound, float(worst["share"]))}


def _reached(bound: Bound, found: float) -> dict[str, Any]:
    met = found <= bound.at_most + ROUNDING if np.isnan(bound.at_least) else found >= bound.at_least - ROUNDING
    return {"found": found, "met": met}


_VALUES: Mapping[str, tuple[str, str, dict[str, str]]] = {  # table, column and row
    "time": ("overhead", "median_overhead", {"input": OURS}),
    "cascade_time": ("overhead", "median_overhead", {"input": CASCADE}),
    "right_kept": ("confidence", "kept", {"score": "confidence"}),
    "calibration": ("confidence", "calibration_error", {"score": "confidence"}),
    **{n: ("confidence", n, {"score": "confidence"}) for n in ("auc", "flat_told", "false_flat", "copies_told")},
}
_MEASURES: Mapping[str, Callable[[Bound, Any, Tables], dict[str, Any]]] = {
    "contribution": _contribution,
    "difference": _difference,
    "precision_gain": _precision_gain,
    "cascade_lost": _cascade_lost,
    **dict.fromkeys(_VALUES, _value),
}


def bound_table(judged: pd.DataFrame) -> Table:
    """Return each judged bound in words: what was wanted, what was found, ``yes`` or ``no``."""
    rows = [[_wanted(row), _found(row), "yes" if row["met"] else "no"] for row in judged.to_dict("records")]
    return Table(head=("bound", "found", "met"), rows=rows, texts=3)


def _wanted(row: Row) -> str:
    loss, group = row["measure"] == "contribution" and row["wanted"] < 0, group_title(row["group"])
    values = {"gain": percent(row["wanted"]), "loss": -100 * row["wanted"], "input": input_title(row["input"])}
    values |= {"group": group, "where": f"{group}, {row['threshold_px']:g} px"}
    values["who"] = row["estimator"] if np.isnan(row["kept"]) else "every estimator"
    values["over"] = "X_L" if row["against"] == "baseline" else "the best peer"
    return say("bound loss" if loss else f"bound {row['measure']}", **{**row, **values})


def _found(row: Row) -> str:
    if np.isnan(row["found"]):
        return "no such pair"
    values = {"found": row["found"], "found_low": row["low"], "found_high": row["high"]}
    kept = f"{row['kept']:.0f} of {row['of']:.0f}"
    match row["measure"]:
        case "difference":
            closest = f"closest is {row['against']}: {interval(values, 'found', signed)} pairs"
            return f"{kept} beaten; {closest}, at most {row['possible']:+.1f} if it solved every pair"
        case "precision_gain":
            text = interval(values, "found", lambda value: f"{value:+.3f}")
            return f"{text}; {row['possible']:+.3f} if all were right"
        case "contribution":
            # A loss of 1 % at most is missed by 1.3 %: whole numbers would not show it.
            text = interval(values, "found", percent if row["wanted"] >= 0 else lambda value: percent(value, 1))
            if not np.isnan(row["kept"]):
                return f"{kept} keep to it; lowest is {row['estimator']}: {text}"
            text += "" if row["against"] == "baseline" else f" over {row['against']}"
            return text + ("" if np.isinf(row["possible"]) else f"; {percent(row['possible'])} if it solved every pair")
        case measure:
            return f"{row['found']:.{2 if 'time' in measure else 3}f}"
