"""Pair sets of one's own: X_L as in the paper, `snn` and `default`, each given to the same estimators."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from rich.console import Console
from rich.table import Table

from epiprior.errors import SettingsError
from epiprior.estimators.handover import FILE, HandOver, load_hand_overs
from epiprior.ranking.models import find_model
from epiprior.settings_file import find_settings_file
from epiprior_lab.compute.tasks import default_workers
from epiprior_lab.evaluation.compare import Rates
from epiprior_lab.evaluation.evaluate import evaluate
from epiprior_lab.evaluation.protocol import Protocol
from epiprior_lab.evaluation.records import Tables, right_column
from epiprior_lab.pairsets import read_pair_set

INPUTS = ("standard", "snn", "default")
TITLES = {"standard": "X_L", "snn": "snn", "default": "ours"}
ESTIMATOR = "magsac++"
THRESHOLDS_PX = (10.0, 3.0)
_TOP = 100


def evaluate_folder(
    folder: Path,
    *,
    sets: Sequence[str] | None = None,
    estimators: Sequence[str] = (ESTIMATOR,),
    seeds: int = 3,
    out: Path = Path("data/own-evaluation"),
    store: Path | None = Path("data/.tasks/own"),
    console: Console | None = None,
) -> Tables:
    """Evaluate pair sets, print a table, and write the tables of `evaluate` to the folder `out`.

    `folder` is a pair set in the uniform format or a folder of them; `sets` are their names, all by default. Results
    per pair are kept in `store`, so that a run that was killed continues. SettingsError if `seeds` is below 1, or there
    is no such set or estimator; DatasetError if a set is damaged: nothing is skipped.
    """
    if seeds < 1:
        raise SettingsError(f"seeds is {seeds}, expected at least 1")
    console = console or Console()
    chosen = load_hand_overs()
    unknown = [name for name in estimators if name not in chosen]
    if unknown:
        raise SettingsError(f"unknown estimator {unknown[0]!r}, known: {', '.join(chosen)}")
    inputs = {name: ("generalized", *INPUTS[1:]) if name == "generalized-ransac" else INPUTS for name in estimators}
    # `snn` is a fixed recipe (ratio below 0.85, all of it): cuts that were chosen on rendered scenes do it harm.
    hand_overs = {e: {n: HandOver() if n == "snn" else chosen[e][n] for n in names} for e, names in inputs.items()}
    protocol = Protocol(inputs=inputs, seeds=tuple(range(seeds)), hand_overs=hand_overs)
    model = sorted(path for path in find_model("default").iterdir() if path.is_file())
    found = find_settings_file(FILE)
    files, workers = (*model, *(() if found is None else (found,))), default_workers()
    parts = []
    for root in find_sets(folder, sets):
        pairs, kept = read_pair_set(root).pairs, None if store is None else store / root.name
        parts.append(evaluate(pairs, protocol, group=root.name, workers=workers, store=kept, files=files))
        console.print(summary(parts[-1], title=root.name))
    tables = Tables.join(parts)
    if len(parts) > 1:
        console.print(summary(tables, title="all sets"))
    tables.write(out)
    return tables


def find_sets(folder: Path, names: Sequence[str] | None = None) -> list[Path]:
    """Return the folders of pair sets in the order of `names`, or all by name; `folder` itself where it is one.

    SettingsError if a named set is not there, or there is none at all; the message names it.
    """
    paths = [folder] if (folder / "pairs.csv").is_file() else [p.parent for p in sorted(folder.glob("*/pairs.csv"))]
    known = {path.resolve().name: path for path in paths}
    if not known:
        raise SettingsError(f"{folder}: no pairs.csv in it, nor in a folder of it")
    missing = [name for name in names or () if name not in known]
    if missing:
        raise SettingsError(f"{folder}: no set {missing[0]!r}; there are {', '.join(known)}")
    return [known[name] for name in names or known]


def summarise(tables: Tables) -> pd.DataFrame:
    """Return one row per estimator and input.

    ``precision_100`` is the mean over labelled pairs, ``successes_<threshold>`` counts pairs (mean over seeds), and
    ``scene_share`` is the share of successes at the first threshold per scene, mean over scenes.
    """
    rates = Rates(tables)
    final = tables.rankings[tables.rankings["ranking"] == "final"]
    precision = (final[right_column(_TOP)] / _TOP).groupby(final["input"]).mean()
    rows = []
    for estimator in rates.estimators:
        for name in rates.inputs(estimator):
            row = {"estimator": estimator, "input": name, "pairs": len(tables.pairs)}
            row["precision_100"] = float(precision.get(name, np.nan))
            for threshold in THRESHOLDS_PX:
                row[f"successes_{threshold:g}"] = float(rates.of(estimator, name, threshold).sum())
            first = pd.Series(rates.of(estimator, name, THRESHOLDS_PX[0]))
            rows.append({**row, "scene_share": float(first.groupby(rates.scenes).mean().mean())})
    return pd.DataFrame(rows)


def summary(tables: Tables, *, title: str) -> Table:
    """Return a table for the terminal; the best number of each column is bold."""
    numbers = summarise(tables)
    table = Table(title=f"{title}, {len(tables.pairs)} pairs", title_justify="left")
    table.add_column("estimator")
    table.add_column("input")
    formats = {"precision_100": ("top 100 right", "{:.2f}")}
    formats |= {f"successes_{t:g}": (f"below {t:g} px", "{:.1f}") for t in THRESHOLDS_PX}
    formats["scene_share"] = (f"{THRESHOLDS_PX[0]:g} px, per scene", "{:.0%}")
    for head, _ in formats.values():
        table.add_column(head, justify="right")
    for line in numbers.to_dict("records"):
        cells = []
        for column, (_, style) in formats.items():
            text, best = style.format(line[column]), style.format(numbers[column].max())
            cells.append(f"[bold]{text}[/bold]" if text == best else text)
        table.add_row(line["estimator"], TITLES.get(line["input"], line["input"]), *cells)
    return table
