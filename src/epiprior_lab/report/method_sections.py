"""Sections on how it was measured and what falls short: pairs, hand-over, classifiers, confidence, limits, bounds."""

from collections.abc import Iterator

import numpy as np
import pandas as pd

from epiprior_lab.evaluation.learned import LEARNED
from epiprior_lab.report import text
from epiprior_lab.report.bounds import bound_rows
from epiprior_lab.report.confidence import kind_rows, score_rows
from epiprior_lab.report.figures import MIN_BAR
from epiprior_lab.report.gallery import case_blocks
from epiprior_lab.report.material import Material
from epiprior_lab.report.page import Block, Table, say
from epiprior_lab.report.result_sections import named
from epiprior_lab.report.text import ALL, group_title, input_title, number, share

_SETTINGS = ("max_distance_ratio", "top_k", "one_to_one", "threshold_px", "refine", "collect")


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
    learned = [input_title(name) for name in m.results.inputs_of_all if name in LEARNED]
    rankers = [input_title(n) for n in m.results.inputs_of_all if n in text.RANKERS]
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
        for row in table[table["chosen"].astype(str).str.lower() == "true"].to_dict("records")
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
    records = m.tables["limits"].to_dict("records")
    known = {"champion": m.params.champion, "success_px": m.params.success_px}
    name = "limits" if records[0]["failing"] else "no limits"
    yield say(name, **named(records[0]), **known, nobody=records[0]["failing"] - records[0]["anyone"])
    titles = {"pairs": "pairs", "failing": "failing"}
    titles |= {"precision_failing": "top 100, failing", "precision_solved": "top 100, solved"}
    titles |= {"other_input": "solved by it on another input", "other_estimator": "by another on ours"}
    titles["anyone"] = "by any on any input"
    rows = [
        [str(row["group"]), *(number(row[n]) if n.startswith("precision") else str(row[n]) for n in titles)]
        for row in records
    ]
    yield Table(head=("hard pairs of", *titles.values()), rows=rows)


def gallery(m: Material) -> Iterator[Block]:
    """Yield the cases of the gallery."""
    gallery, kept, cases = m.params.gallery, m.extras.gallery, m.extras.cases
    if gallery is not None and cases:
        yield say("gallery", estimator=gallery.estimator, kept="" if kept is None else (kept / "index.html").as_posix())
        yield from case_blocks(cases, "gallery", "png")


def bounds(m: Material) -> Iterator[Block]:
    """Yield what was wanted of the results."""
    yield say("bounds")
    yield Table(head=("bound", "found", "met"), rows=bound_rows(m.tables["bounds"]), texts=3)
