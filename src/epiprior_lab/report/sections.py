"""The sections of a report: prose, tables and figures, made of the report's tables alone; empty ones vanish."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from epiprior.verification.cascade import CascadeRule
from epiprior_lab.pairsets import KnownSet
from epiprior_lab.pairsets.changed import EVERY
from epiprior_lab.params import ReportParams
from epiprior_lab.report import text
from epiprior_lab.report.bounds import Bound, bound_rows
from epiprior_lab.report.cascade import rule_in_words
from epiprior_lab.report.confidence import kind_rows, score_rows
from epiprior_lab.report.figures import MIN_BAR
from epiprior_lab.report.gallery import Case, case_blocks
from epiprior_lab.report.page import Block, Picture, Section, Table
from epiprior_lab.report.prose import picture, say
from epiprior_lab.report.results import Results
from epiprior_lab.report.tables import ENOUGH_IN_BIN, ENOUGH_RIGHT, PRECISIONS
from epiprior_lab.report.text import ALL, OURS, group_title, input_title, interval, number, order_of, share, signed

CASCADE = "cascade"
_SETTINGS = ("max_distance_ratio", "top_k", "one_to_one", "threshold_px", "refine", "collect")


@dataclass(frozen=True, kw_only=True)
class Extras:
    """What a report shows beside the results; each may be left out.

    `known_sets` are listed even where they are not present. `classifiers` are from `read_classifiers`, `hand_over` is
    the search on validation scenes, `kinds` are the records of pairs of other kinds. `pictures`, by the names of the
    prose, and those of the `cases` are in the report's folder already; `gallery` is the folder of the cases on
    photographs: its page is written too.
    """

    rule: CascadeRule | None = None
    bounds: Sequence[Bound] = ()
    known_sets: Sequence[KnownSet] = ()
    classifiers: pd.DataFrame | None = None
    hand_over: pd.DataFrame | None = None
    kinds: pd.DataFrame | None = None
    pictures: Mapping[str, Path] = field(default_factory=dict)
    cases: Sequence[Case] = ()
    gallery: Path | None = None


@dataclass(frozen=True, kw_only=True)
class Material:
    """Everything that a report shows.

    `tables` are by the names of their CSV files, `figures` paths relative to the page; those that there are. `kind` is
    one of `report.TITLES`.
    """

    results: Results
    params: ReportParams
    tables: Mapping[str, pd.DataFrame]
    figures: Mapping[str, str]
    kind: str
    extras: Extras

    def picture(self, name: str, **values: Any) -> tuple[Picture, ...]:
        """Return a figure; empty where there is none."""
        return (picture(name, self.figures[name], **values),) if name in self.figures else ()

    def groups_of(self, name: str) -> Iterator[tuple[str, pd.DataFrame]]:
        """Yield the rows of each main group of a table; nothing where there is no such table."""
        table = self.tables.get(name)
        if table is not None:
            yield from ((str(g), p) for g, p in table.groupby("group", sort=False) if g in self.results.main)


_Maker = Callable[[Material], Iterator[Block | tuple[()]]]


def all_sections(material: Material) -> list[Section]:
    """Return the sections in the order of the page: how well, how measured, what falls short, and bounds last.

    A section that needs a table which is not there is left out.
    """
    makers: dict[str, _Maker] = {
        "How well it works": _summary,
        "A rescued pair": _plain("example", "example"),
        "Successes": _successes,
        "Against every other estimator": _duels,
        "Poses and distances": _poses,
        "Rankings": _rankings,
        "Calibration": _calibration,
        "Cascade": _cascade,
        "Turned and shrunk photographs": _changed,
        "Time": _plain("time", "decision", "overhead", "estimators"),
        "Pairs": _pairs,
        "How it was measured": _method,
        "Hand-over": _hand_over,
        "Classifiers": _classifiers,
        "Roll": _plain("roll", "roll"),
        "Analysis": _plain("analysis", "steps", "ablations", "limits"),
        "Confidence": _confidence,
        "Verification": _statuses,
        "What limits the results": _limits,
        "Gallery": _gallery,
        "Bounds": _bounds,
    }
    needs: dict[_Maker, str] = {_duels: "duels", _cascade: CASCADE, _hand_over: "hand_over"}
    needs |= {_classifiers: "classifiers", _confidence: "confidence", _limits: "limits", _bounds: "bounds"}
    needs |= {_changed: "changed"}
    return [
        Section(title=title, blocks=[block for block in make(material) if block])
        for title, make in makers.items()
        if make not in needs or needs[make] in material.tables
    ]


def summary_table(
    successes: pd.DataFrame,
    cascade: pd.DataFrame | None,
    groups: Sequence[str],
    px: Sequence[float],
    features: Mapping[str, float] | None = None,
) -> Table:
    """Return the small table: per input shares of pairs that succeed, a column per threshold `px` and group.

    Every input has the estimator that serves it best over all pairs below the first threshold. `features` are their
    numbers per image, by input; without them there is no such column.
    """
    columns = ["threshold_px", "group", "estimator", "pairs", "input", "successes"]
    table = successes[columns]
    if cascade is not None:
        own = cascade.assign(input=CASCADE, successes=cascade[CASCADE])
        table = pd.concat([table, own[columns]], ignore_index=True)
    whole = table[(table["group"] == ALL) & (table["threshold_px"] == px[0])]
    sizes = table.drop_duplicates("group").set_index("group")["pairs"]
    names = [name for name in order_of(whole["input"]) if name != "generalized"]
    who, values = [], []
    order = [*text.BASELINES, "snn", *text.PEER_TITLES, "paper", CASCADE, OURS]
    for name in sorted(names, key=lambda n: order.index(n) if n in order else 2):
        of_input = whole[whole["input"] == name].sort_values("successes", ascending=False, kind="stable")
        best = str(of_input["estimator"].iloc[0])
        own = table[(table["input"] == name) & (table["estimator"] == best)].set_index(["group", "threshold_px"])
        count = number((features or {}).get(OURS if name == CASCADE else name, np.nan), 0)
        title = "cascade of X_L and ours" if name == CASCADE else input_title(name)
        who.append([title, best, *([count] if features else [])])
        values.append([100 * own["successes"][g, t] / sizes[g] for t in px for g in groups])
    texts = zip(*(text.best_bold(column) for column in zip(*values, strict=True)), strict=True)
    head = ["matches", "estimator", *(["features"] if features else [])]
    head += [f"{group_title(g, int(sizes[g]))}, {t:g} px" for t in px for g in groups]
    return Table(head=head, rows=[[*names, *cells] for names, cells in zip(who, texts, strict=True)], texts=2)


def _plain(name: str, *pictures: str) -> _Maker:
    """Return what makes a section of prose and pictures alone."""
    return lambda m: iter([say(name), *(m.picture(one) for one in pictures)])


def _summary(m: Material) -> Iterator[Block]:
    px = list(dict.fromkeys((m.params.success_px, m.params.strict_px)))
    yield say("summary")
    ranked = m.tables.get("rankings")
    counts = {} if ranked is None else ranked[ranked["group"] == ALL].groupby("input")["features"].first().to_dict()
    features = {str(name): float(count) for name, count in counts.items()}
    yield summary_table(m.tables["successes"], m.tables.get(CASCADE), (ALL, *m.results.hard), px, features)
    yield m.picture("successes", seeds=m.results.tables.runs["seed"].nunique())


def _successes(m: Material) -> Iterator[Block]:
    """Yield successes of every estimator on every input, with contributions: the paper's Table 2."""
    table, success_px, main = m.tables["successes"], m.params.success_px, m.results.main
    yield say("successes")
    at = table[(table["threshold_px"] == success_px) & (table["group"] == ALL)]
    own = at[at["estimator"] == m.params.champion].set_index("input")
    if OURS in own.index:
        ours, without = own.loc[OURS], own[own["gain"].isna()].iloc[0]
        lost = (at["successes"] - at["successes_ok"])[at["input"] == OURS]
        values = {"champion": m.params.champion, "success_px": success_px, "least": lost.min(), "most": lost.max()}
        values |= {"ours": ours["successes"], "ours_ok": ours["successes_ok"]}
        yield say("ok only", without=without["successes"], without_ok=without["successes_ok"], **values)
    yield _compact(table[(table["threshold_px"] == success_px) & table["group"].isin(main)], m)
    for threshold in m.params.thresholds_px:
        at = table[(table["threshold_px"] == threshold) & table["group"].isin(main)]
        yield _success_block(at, f"Below {threshold:g} px")
    at = table[(table["threshold_px"] == success_px) & ~table["group"].isin(main)]
    if len(at):
        yield _success_block(at, f"Every set, below {success_px:g} px")
    yield m.picture("curves")


def _named(row: text.Row) -> dict[str, Any]:
    return {str(name): value for name, value in row.items()}


def _compact(at: pd.DataFrame, m: Material) -> Table:
    """Return one row per estimator; per group the successes on every input, the best bold; then shares per scene."""
    records = at.set_index(["estimator", "group", "input"]).to_dict("index")
    groups = order_of(at["group"])
    by_scene = [group for group in groups if group in (*m.results.hard, ALL)]
    rows = []
    for estimator in order_of(at["estimator"]):

        def side_by_side(group: str, column: str, digits: int, of: str = estimator) -> str:
            found = (records.get((of, group, name), {}) for name in _inputs(m, of))
            values = (row.get(column, np.nan) * (1 if column == "successes" else 100) for row in found)
            return " / ".join(cell or "–" for cell in text.best_bold(values, digits))

        cells = [side_by_side(group, "successes", 1) for group in groups]
        cells.append(interval(records.get((estimator, ALL, OURS), {}), "gain"))
        rows.append([estimator, *cells, *(side_by_side(group, "scene_share", 0) for group in by_scene)])
    pairs = at.drop_duplicates("group").set_index("group")["pairs"]
    head = [f"{_names(m)}, below {m.params.success_px:g} px", *(group_title(g, int(pairs[g])) for g in groups)]
    return Table(head=[*head, "ours over X_L", *(f"{g}, % per scene" for g in by_scene)], rows=rows)


def _names(m: Material) -> str:
    """Return the inputs side by side, as their numbers stand in one cell."""
    return " / ".join(input_title(n) for n in m.results.inputs_of_all if n not in ("generalized", "paper"))


def _inputs(m: Material, estimator: str) -> list[str]:
    """Return the inputs of `_names`, with what this estimator gets without preprocessing; it may lack some of them."""
    without = m.results.inputs(estimator)[0]
    shown = [name for name in m.results.inputs_of_all if name not in ("generalized", "paper")]
    return [without if name in text.BASELINES else name for name in shown]


def _changed(m: Material) -> Iterator[Block]:
    table = m.tables["changed"]
    yield say("changed", every=EVERY)
    for threshold, at in table.groupby("threshold_px", sort=False):
        records = at.set_index(["input", "group"]).to_dict("index")
        groups, rows = order_of(at["group"]), []
        for name in order_of(at["input"]):
            found = [records[name, group] for group in groups]
            rows.append([input_title(name), found[0]["estimator"], number(found[0]["unchanged"], 1)])
            rows[-1] += [number(row["successes"], 1) for row in found]
        head = ["matches", "estimator", f"as they are ({int(at['pairs'].iloc[0])})", *groups]
        yield f"Pairs below {threshold:g} px:"
        yield Table(head=head, rows=rows, texts=2)


def _success_block(at: pd.DataFrame, title: str) -> Table:
    others = sorted((n for n in order_of(at["input"]) if n not in text.BASELINES), key=lambda name: name == OURS)
    compared = [("paper", "gain", "as printed over X_L")] if "paper" in others else []
    compared += [(OURS, "gain", "ours over X_L"), (OURS, "snn_gain", "ours over snn")]
    rows: list[list[str]] = []
    for group, of_group in at.groupby("group", sort=False):
        rows.append([group_title(str(group), int(of_group["pairs"].iloc[0]))])
        for estimator, part in of_group.groupby("estimator", sort=False):
            cells: dict[str, text.Row] = {str(row["input"]): row for row in part.to_dict("records")}
            without, ours = next(row for name, row in cells.items() if name in text.BASELINES), cells.get(OURS, {})
            found = [without, *(cells.get(name) for name in others)]
            texts = ["" if row is None else f"{row['successes']:.1f} ± {row['successes_sd']:.1f}" for row in found]
            texts += [interval(cells.get(name, {}), column) for name, column, _ in compared]
            texts.append(" → ".join(share(row.get("scene_share", np.nan)) for row in (without, ours)))
            texts.append(interval(ours, "scene_gain", text.points))
            texts.append(" → ".join(number(row.get("successes_ok", np.nan), 1) for row in (without, ours)))
            rows.append([str(estimator), *texts])
    head = ["estimator", "X_L", *(input_title(name) for name in others), *(title for *_, title in compared)]
    return Table(head=[*head, "per scene", "points", "ok only"], rows=rows, fold=title)


def _duels(m: Material) -> Iterator[Block]:
    yield say("duels", champion=m.params.champion)
    yield m.picture("duels")
    for threshold, at in m.tables["duels"].groupby("threshold_px", sort=False):
        places = [(group, name) for group in order_of(at["group"]) for name in order_of(at["input"])]
        records = at.set_index(["estimator", "group", "input"]).to_dict("index")
        rows = []
        for estimator in order_of(at["estimator"]):
            found = [records.get((estimator, *place), {}) for place in places]
            marks = ("" if row.get("decided", "open") == "open" else "**" for row in found)
            cells = (interval(row, "difference", signed) for row in found)
            rows.append([estimator, *(f"{mark}{cell}{mark}" for mark, cell in zip(marks, cells, strict=True))])
        head = ["against", *(f"{group}, {input_title(name)}" for group, name in places)]
        yield Table(head=head, rows=rows, fold=f"Pairs ahead below {threshold:g} px")


def _poses(m: Material) -> Iterator[Block]:
    """Yield poses under the true calibration, and distances to the true F."""
    table, degrees, champion = m.tables["geometry"], sorted(m.params.pose_deg), m.params.champion
    at = table[(table["cameras"] > 0) & table["group"].isin(m.results.main)]
    ours = at[(at["group"] == ALL) & (at["input"] == OURS) & (at["posed_successes"] > 0)]
    if len(ours):
        wrong = (ours["wrong_poses"] / ours["posed_successes"]).set_axis(ours["estimator"])
        values = {"own": f"{share(wrong[champion])} with {champion}, " if champion in wrong.index else ""}
        values |= {"least": share(wrong.min()), "most": share(wrong.max())}
        yield say("poses", success_px=m.params.success_px, limit=degrees[-1], **values)
    yield say("pose table")
    places = [(group, degrees[len(degrees) // 2]) for group in order_of(at["group"]) if group != ALL]
    places += [(ALL, limit) for limit in degrees]
    records = at.set_index(["estimator", "group", "input"]).to_dict("index")
    rows = []
    for estimator in order_of(at["estimator"]):
        keys = [[(estimator, group, name) for name in _inputs(m, estimator)] for group, _ in places]
        areas = (
            [100 * records.get(key, {}).get(f"auc_{t:g}", np.nan) for key in of_place]
            for of_place, (_, t) in zip(keys, places, strict=True)
        )
        cells = (" / ".join(cell or "–" for cell in text.best_bold(values, 0)) for values in areas)
        rows.append([estimator, *cells])
    cameras = at.drop_duplicates("group").set_index("group")["cameras"].to_dict()
    head = [_names(m), *(f"{group_title(g, cameras.get(g, 0))}, {t:g}°" for g, t in places)]
    yield Table(head=head, rows=rows)
    columns: dict[str, str] = {}
    for limit in degrees:
        columns |= {f"auc_{limit:g}": f"pose, AUC {limit:g}°", f"scene_auc_{limit:g}": "per scene"}
    columns["distance_recall"] = f"distance < {m.params.distance_recall:g}"
    for group, part in m.groups_of("geometry"):
        rows = [
            [row["estimator"], input_title(row["input"]), *(share(row.get(name, np.nan)) for name in columns)]
            + [number(row.get("median_distance", np.nan), 4)]
            for row in part.to_dict("records")
        ]
        posed, true = part[["cameras", "true_F"]].iloc[0]
        title = f"{group_title(group)} ({posed} with cameras, {true} with a true F)"
        head = ["estimator", "input", *columns.values(), "median distance"]
        yield Table(head=head, rows=rows if posed or true else [], texts=2, fold=title)


def _rankings(m: Material) -> Iterator[Block]:
    yield say("rankings")
    yield m.picture("rankings")
    rows: list[list[str]] = []
    for group, part in m.groups_of("rankings"):
        rows.append([group_title(group, int(part["pairs"].max()))])
        for row in part.to_dict("records"):
            ranking = text.RANKING_TITLES.get(row["ranking"], row["ranking"])
            title = input_title(row["input"]) + ("" if row["ranking"] == "final" else f", {ranking}")
            cells = [f"{number(row[c])} / {number(row[f'scene_{c}'])}" for c in PRECISIONS]
            cells += [f"{row[name]:.0f}" for name in ("features", "matches", "right")] + [share(row["enough"])]
            rows.append([title, *cells, interval(row, "gain", lambda value: signed(value, 2))])
    head = ["ranking", "top 10", "top 100", "top 500", "average precision", "features", "matches", "right"]
    yield Table(head=[*head, f"pairs with {ENOUGH_RIGHT} right", "gain, top 100"], rows=rows)


def _calibration(m: Material) -> Iterator[Block]:
    sentences, rows = [say("calibration")], []
    for group, part in m.groups_of("calibration"):
        for row in part.to_dict("records"):
            title = group_title(group)
            if row["input"] == OURS and not np.isnan(row.get("gap_stated", np.nan)):
                name = "calibration of all" if group == ALL else "calibration of a group"
                sentences.append(say(name, title=title[0].upper() + title[1:], **_named(row)))
            rows.append(
                [input_title(row["input"]), title, f"{row['matches']:,}", f"{row['right']:,}"]
                + [number(row["brier_score"], 4), number(row["expected_calibration_error"], 4)]
                + [share(row["lowest_share"]), number(row["upper_error"], 4)]
            )
    yield " ".join(sentences)
    yield m.picture("calibration", enough=ENOUGH_IN_BIN)
    head = ("matches", "pairs", "ranked", "right", "Brier score", "calibration error", "in lowest bin", "others")
    yield Table(head=head, rows=rows, texts=2)


def _cascade(m: Material) -> Iterator[Block]:
    table, success_px = m.tables[CASCADE], m.params.success_px
    losses = []
    for threshold, part in table[table["group"] == ALL].groupby("threshold_px", sort=False):
        worst = max(part.to_dict("records"), key=lambda row: float(row["lost"]))
        losses.append(f"{worst['estimator']}, {worst['lost']:.1f} of {worst['pairs']} pairs below {threshold:g} px")
    rule = "" if m.extras.rule is None else rule_in_words(m.extras.rule)
    yield say(CASCADE, rule=rule, success_px=success_px, losses="; ".join(losses))
    rows: list[list[str]] = []
    counts = ("without", "always", "cascade", "lost", "won")
    for group, part in m.groups_of(CASCADE):
        rows.append([group_title(group, int(part["pairs"].iloc[0]))])
        for row in part[part["threshold_px"] == success_px].to_dict("records"):
            cells = [*(number(row[name], 1) for name in counts), interval(row, "change", signed)]
            rows.append([row["estimator"], *cells, share(row["preprocessed"])])
    yield Table(head=("estimator", *counts, "cascade over always", "runs preprocessed"), rows=rows)
    yield m.picture(CASCADE)


def _pairs(m: Material) -> Iterator[Block]:
    yield say(f"{m.kind} pairs")
    yield m.picture("contact_sheet")
    rows, counts = [], ("scenes", *text.DIFFICULTIES, "unlabelled")
    for row in m.tables["sets"].to_dict("records"):
        title = f"{row['title']} (the paper's)" if row["paper"] else str(row["title"])
        labels = "not present" if row["state"] == "not present" else str(row["labels"])
        labels += ", reported apart" if row["state"] == "apart" else ""
        numbers = ("" if pd.isna(row[name]) else str(row[name]) for name in counts)
        rows.append([title, labels, str(row["pairs"]), *numbers])
    yield Table(head=("set", "labels", "pairs", *counts), rows=rows, texts=2)
    yield say("pairs")


def _method(m: Material) -> Iterator[Block]:
    learned = [input_title(name) for name in m.results.inputs_of_all if name in text.LEARNED_TITLES]
    rankers = [input_title(n) for n in m.results.inputs_of_all if n in text.PEER_TITLES.keys() - text.LEARNED_TITLES]
    peers = f" {text.listed(rankers)}: rankers of others on our features, handed over as they are." if rankers else ""
    peers += f" {text.listed(learned)}: {say('learned')}" if learned else ""
    yield say("method", peers=peers, seeds=m.results.tables.runs["seed"].nunique())
    rows = [
        [row["estimator"], row["backend"], f"{row['max_iterations']:,}"]
        + ["" if np.isnan(row["hypotheses"]) else f"{row['hypotheses']:,.0f}"]
        + ["once" if row["deterministic"] else "per seed"]
        for row in m.tables["estimators"].to_dict("records")
    ]
    yield Table(head=("estimator", "backend", "samples at most", "hypotheses, median", "runs"), rows=rows, texts=2)
    yield say("estimators")


def _hand_over(m: Material) -> Iterator[Block]:
    yield say("hand_over")
    table = m.tables["hand_over"]
    rows = [
        [row["estimator"], input_title(row["input"]), *(text.setting(row[name]) for name in _SETTINGS if name in row)]
        + [f"{row['successes_10']:.1f} of {row['pairs']}"]
        for row in table[table["chosen"].astype(str).str.lower() == "true"].to_dict("records")
    ]
    head = ["estimator", "input", *(name.replace("_", " ") for name in _SETTINGS if name in table.columns)]
    yield Table(head=[*head, "validation pairs below 10 px"], rows=rows, texts=2)
    yield m.picture("hand_over")


def _classifiers(m: Material) -> Iterator[Block]:
    yield say("classifiers")
    rows = []
    for (preset, target, family), part in m.tables["classifiers"].groupby(["preset", "target", "family"], sort=False):
        both = part.set_index("metric")[["grouped", "ungrouped"]].reindex(list(text.METRIC_TITLES))
        cells = [" ".join(filter(None, (number(value, 3) for value in pair))) for pair in both.to_numpy(np.float64)]
        rows.append([str(preset), text.TARGET_TITLES.get(str(target), str(target)), str(family), *cells])
    yield Table(head=("preset", "what is classified", "classifier", *text.METRIC_TITLES.values()), rows=rows, texts=3)
    yield m.picture("classifiers")


def _confidence(m: Material) -> Iterator[Block]:
    yield say("confidence", success_px=m.params.success_px)
    yield m.picture("confidence")
    yield score_rows(m.tables["confidence"])
    yield say("kinds")
    yield kind_rows(m.tables["kinds"])


def _statuses(m: Material) -> Iterator[Block]:
    yield say("statuses", success_px=m.params.success_px)
    rows: list[list[str]] = []
    for group, part in m.groups_of("statuses"):
        rows.append([group_title(group)])
        for row in part.to_dict("records"):
            cells = [str(row["without_F"])]
            for kind in ("right", "wrong"):
                cells += [str(row[name]) for name in (kind, f"{kind}_no_model", f"{kind}_degenerate")]
                cells.append(share(row[f"{kind}_turned_down"], 1))
            rows.append(["all inputs" if row["input"] == ALL else input_title(row["input"]), *cells])
    kinds = ("of these no_model", "degenerate", "turned down")
    yield Table(head=("input", "runs without F", "right F", *kinds, "wrong F", *kinds), rows=rows)
    yield m.picture("statuses", min_bar=MIN_BAR)


def _limits(m: Material) -> Iterator[Block]:
    """Yield where the champion fails, and who else solves these pairs."""
    records = m.tables["limits"].to_dict("records")
    known = {"champion": m.params.champion, "success_px": m.params.success_px}
    name = "limits" if records[0]["failing"] else "no limits"
    yield say(name, **_named(records[0]), **known, nobody=records[0]["failing"] - records[0]["anyone"])
    titles = {"pairs": "pairs", "failing": "failing"}
    titles |= {"precision_failing": "top 100, failing", "precision_solved": "top 100, solved"}
    titles |= {"other_input": "solved by it on another input", "other_estimator": "by another on ours"}
    titles["anyone"] = "by any on any input"
    rows = [
        [str(row["group"]), *(number(row[n]) if n.startswith("precision") else str(row[n]) for n in titles)]
        for row in records
    ]
    yield Table(head=("hard pairs of", *titles.values()), rows=rows)


def _gallery(m: Material) -> Iterator[Block]:
    gallery, kept, cases = m.params.gallery, m.extras.gallery, m.extras.cases
    if gallery is not None and cases:
        yield say("gallery", estimator=gallery.estimator, kept="" if kept is None else (kept / "index.html").as_posix())
        yield from case_blocks(cases, "gallery", "png")


def _bounds(m: Material) -> Iterator[Block]:
    yield say("bounds")
    yield Table(head=("bound", "found", "met"), rows=bound_rows(m.tables["bounds"]), texts=3)
