"""The sections of a report: how well it works, how it was measured, what falls short."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from epiprior_lab.evaluation.learned import LEARNED
from epiprior_lab.evaluation.records import CASCADE
from epiprior_lab.pairsets.changed import EVERY
from epiprior_lab.report import text
from epiprior_lab.report.bounds import bound_table
from epiprior_lab.report.cascade import rule_in_words
from epiprior_lab.report.confidence import kind_rows, score_rows
from epiprior_lab.report.figures import MIN_BAR
from epiprior_lab.report.material import Material, summary_table
from epiprior_lab.report.page import Block, Table, say
from epiprior_lab.report.pictures import case_blocks
from epiprior_lab.report.tables import ENOUGH_IN_BIN, ENOUGH_RIGHT, PRECISIONS
from epiprior_lab.report.text import ALL, OURS, group_title, input_title, interval, number, order_of, share, signed

_SETTINGS = ("max_distance_ratio", "top_k", "one_to_one", "threshold_px", "refine", "collect")


def summary(m: Material) -> Iterator[Block]:
    """Yield the small table and the curve of successes."""
    yield say("summary")
    cascaded, ranked = (m.tables.get(name) for name in (CASCADE, "rankings"))
    yield summary_table(m.tables["successes"], cascaded, ranked, (ALL, *m.results.hard), m.thresholds)
    yield m.picture("successes", seeds=m.results.tables.runs["seed"].nunique())


def successes(m: Material) -> Iterator[Block]:
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


def _compact(at: pd.DataFrame, m: Material) -> Table:
    """Return one row per estimator; per group the successes on every input, the best bold; then shares per scene."""
    records = at.set_index(["estimator", "group", "input"]).to_dict("index")
    groups = order_of(at["group"])
    by_scene = [group for group in groups if group in (*m.results.hard, ALL)]
    rows = []
    for estimator in order_of(at["estimator"]):
        cells = [_side_by_side(m, records, (estimator, group), "successes", 1, 1) for group in groups]
        cells.append(interval(records.get((estimator, ALL, OURS), {}), "gain"))
        cells += [_side_by_side(m, records, (estimator, group), "scene_share") for group in by_scene]
        rows.append([estimator, *cells])
    pairs = at.drop_duplicates("group").set_index("group")["pairs"]
    names = " / ".join(map(input_title, _compared(m)))
    head = [f"{names}, below {m.params.success_px:g} px", *(group_title(g, int(pairs[g])) for g in groups)]
    return Table(head=[*head, "ours over X_L", *(f"{g}, % per scene" for g in by_scene)], rows=rows)


def _side_by_side(
    m: Material, records: Mapping[Any, text.Row], place: tuple[str, str], column: str, digits: int = 0, unit: int = 100
) -> str:
    """Return a measure of an estimator in a group, on all inputs of `_compared` in one cell, the best bold."""
    without = m.results.inputs(place[0])[0]
    names = [without if name in text.BASELINES else name for name in _compared(m)]
    values = (unit * records.get((*place, name), {}).get(column, np.nan) for name in names)
    return " / ".join(cell or "–" for cell in text.best_bold(values, digits))


def _compared(m: Material) -> list[str]:
    """Return the inputs whose numbers stand side by side in one cell; the first is the one without preprocessing."""
    return [name for name in m.results.inputs_of_all if name not in ("generalized", "paper")]


def changed(m: Material) -> Iterator[Block]:
    """Yield turned and shrunk photographs beside the same pairs as they are."""
    table = m.tables["changed"]
    yield say("changed", every=EVERY)
    for threshold, at in table.groupby("threshold_px", sort=False):
        rows = []
        for name, part in at.groupby("input", sort=False):
            first, counts = part.iloc[0], (number(count, 1) for count in part["successes"])
            rows.append([input_title(str(name)), first["estimator"], number(first["unchanged"], 1), *counts])
        head = ["matches", "estimator", f"as they are ({int(at['pairs'].iloc[0])})", *order_of(at["group"])]
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


def duels(m: Material) -> Iterator[Block]:
    """Yield the champion against every other estimator."""
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


def poses(m: Material) -> Iterator[Block]:
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
    rows = [
        [estimator, *(_side_by_side(m, records, (estimator, group), f"auc_{t:g}") for group, t in places)]
        for estimator in order_of(at["estimator"])
    ]
    cameras = at.drop_duplicates("group").set_index("group")["cameras"].to_dict()
    head = [" / ".join(map(input_title, _compared(m)))]
    head += (f"{group_title(g, cameras.get(g, 0))}, {t:g}°" for g, t in places)
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


def rankings(m: Material) -> Iterator[Block]:
    """Yield precision of the rankings."""
    yield say("rankings")
    yield m.picture("rankings")
    rows: list[list[str]] = []
    for group, part in m.groups_of("rankings"):
        rows.append([group_title(group, int(part["pairs"].max()))])
        for row in part.to_dict("records"):
            title = input_title(row["input"])
            title += "" if row["ranking"] == "final" else f", {text.RANKINGS[row['ranking']].label}"
            cells = [f"{number(row[c])} / {number(row[f'scene_{c}'])}" for c in PRECISIONS]
            cells += [f"{row[name]:.0f}" for name in ("features", "matches", "right")] + [share(row["enough"])]
            rows.append([title, *cells, interval(row, "gain", lambda value: signed(value, 2))])
    head = ["ranking", "top 10", "top 100", "top 500", "average precision", "features", "matches", "right"]
    yield Table(head=[*head, f"pairs with {ENOUGH_RIGHT} right", "gain, top 100"], rows=rows)


def calibration(m: Material) -> Iterator[Block]:
    """Yield how far probabilities can be believed."""
    sentences, rows = [say("calibration")], []
    for group, part in m.groups_of("calibration"):
        records: Sequence[text.Row] = part.to_dict("records")
        title = group_title(group)
        for row in records:
            if row["input"] == OURS and not np.isnan(row.get("gap_stated", np.nan)):
                name = "calibration of all" if group == ALL else "calibration of a group"
                sentences.append(say(name, title=title[0].upper() + title[1:], **row))
            cells = [input_title(row["input"]), title, f"{row['matches']:,}", f"{row['right']:,}"]
            cells += (number(row[name], 4) for name in ("brier_score", "expected_calibration_error"))
            rows.append([*cells, share(row["lowest_share"]), number(row["upper_error"], 4)])
    yield " ".join(sentences)
    yield m.picture("calibration", enough=ENOUGH_IN_BIN)
    head = ("matches", "pairs", "ranked", "right", "Brier score", "calibration error", "in lowest bin", "others")
    yield Table(head=head, rows=rows, texts=2)


def cascade(m: Material) -> Iterator[Block]:
    """Yield what the cascade loses against always preprocessing."""
    table, success_px = m.tables[CASCADE], m.params.success_px
    losses = []
    for threshold, part in table[table["group"] == ALL].groupby("threshold_px", sort=False):
        worst = max(part.to_dict("records"), key=lambda row: float(row["lost"]))
        losses.append(f"{worst['estimator']}, {worst['lost']:.1f} of {worst['pairs']} pairs below {threshold:g} px")
    rule = "" if m.rule is None else rule_in_words(m.rule)
    yield say(CASCADE, rule=rule, success_px=success_px, losses="; ".join(losses))
    rows: list[list[str]] = []
    counts = ("first", "always", "cascade", "lost", "won")
    for group, part in m.groups_of(CASCADE):
        rows.append([group_title(group, int(part["pairs"].iloc[0]))])
        for row in part[part["threshold_px"] == success_px].to_dict("records"):
            cells = [*(number(row[name], 1) for name in counts), interval(row, "change", signed)]
            rows.append([row["estimator"], *cells, share(row["preprocessed"])])
    yield Table(head=("estimator", "snn", *counts[1:], "cascade over always", "runs preprocessed"), rows=rows)
    yield m.picture(CASCADE)


def pairs(m: Material) -> Iterator[Block]:
    """Yield the pair sets."""
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


def method(m: Material) -> Iterator[Block]:
    """Yield how it was measured, and what stands behind each estimator."""
    inputs = m.results.inputs_of_all
    learned, rankers = ([input_title(n) for n in inputs if n in some] for some in (LEARNED, text.RANKERS))
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


def hand_over(m: Material) -> Iterator[Block]:
    """Yield the chosen hand-overs."""
    yield say("hand_over")
    table = m.tables["hand_over"]
    rows = [
        [row["estimator"], input_title(row["input"]), *(text.setting(row[name]) for name in _SETTINGS if name in row)]
        + [f"{row['successes_10']:.1f} of {row['pairs']}"]
        for row in table[table["chosen"]].to_dict("records")
    ]
    head = ["estimator", "input", *(name.replace("_", " ") for name in _SETTINGS if name in table.columns)]
    yield Table(head=[*head, "validation pairs below 10 px"], rows=rows, texts=2)
    yield m.picture("hand_over")


def classifiers(m: Material) -> Iterator[Block]:
    """Yield the families of classifiers."""
    yield say("classifiers")
    rows = []
    for (preset, target, family), part in m.tables["classifiers"].groupby(["preset", "target", "family"], sort=False):
        both = part.set_index("metric")[["grouped", "ungrouped"]].reindex(list(text.METRIC_TITLES))
        cells = [" ".join(filter(None, (number(value, 3) for value in pair))) for pair in both.to_numpy(np.float64)]
        rows.append([str(preset), text.TARGET_TITLES.get(str(target), str(target)), str(family), *cells])
    yield Table(head=("preset", "what is classified", "classifier", *text.METRIC_TITLES.values()), rows=rows, texts=3)
    yield m.picture("classifiers")


def confidence(m: Material) -> Iterator[Block]:
    """Yield the confidence: curves, scores, kinds of pairs."""
    yield say("confidence", success_px=m.params.success_px)
    yield m.picture("confidence")
    yield score_rows(m.tables["confidence"])
    yield say("kinds")
    yield kind_rows(m.tables["kinds"])


def statuses(m: Material) -> Iterator[Block]:
    """Yield the statuses of right and wrong F."""
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


def limits(m: Material) -> Iterator[Block]:
    """Yield where the champion fails, and who else solves these pairs."""
    records: Sequence[text.Row] = m.tables["limits"].to_dict("records")
    known = {"champion": m.params.champion, "success_px": m.params.success_px}
    name = "limits" if records[0]["failing"] else "no limits"
    yield say(name, **records[0], **known, nobody=records[0]["failing"] - records[0]["anyone"])
    titles = {"group": "hard pairs of", "pairs": "pairs", "failing": "failing"}
    titles |= {"precision_failing": "top 100, failing", "precision_solved": "top 100, solved"}
    titles |= {"other_input": "solved by it on another input", "other_estimator": "by another on ours"}
    titles["anyone"] = "by any on any input"
    rows = [[number(row[n]) if n.startswith("precision") else str(row[n]) for n in titles] for row in records]
    yield Table(head=list(titles.values()), rows=rows)


def gallery(m: Material) -> Iterator[Block]:
    """Yield the cases of the gallery."""
    shown, kept = m.params.gallery, m.gallery
    if shown is not None and kept is not None and m.cases:
        yield say("gallery", estimator=shown.estimator, kept=(kept / "index.html").as_posix())
        yield from case_blocks(m.cases, "gallery", "png")


def bounds(m: Material) -> Iterator[Block]:
    """Yield what was wanted of the results."""
    yield say("bounds")
    yield bound_table(m.tables["bounds"])
