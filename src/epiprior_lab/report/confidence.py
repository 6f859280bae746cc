"""The confidence: how well it tells right F from wrong ones and from pairs that share nothing, and whether it holds.

Rows of `KindRecord`; a true pair is ``right`` or ``wrong`` by the error of its F, or ``without F``. The scores of peers
are on the same estimates: number and share of inliers; COLMAP's verification is an estimator of its own.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from sklearn.metrics import roc_auc_score, roc_curve

from epiprior.types import Geometry, Status
from epiprior.verification.cascade import FLAT as FLAT_GEOMETRIES
from epiprior_lab.evaluation.kinds import COLMAP, TRUE
from epiprior_lab.evaluation.records import CASCADE
from epiprior_lab.measures import calibration_bins
from epiprior_lab.report.page import Table
from epiprior_lab.report.style import MUTED, axis_legend, styled
from epiprior_lab.report.text import ALL, Look, input_title, number, order_of, share

RIGHT, WRONG, WITHOUT_F, STRANGERS = "right", "wrong", "without F", "unrelated"
FLAT = ("plane", "rotation", "copy")
ACCEPTED = 0.01
SCORES: Mapping[str, Look] = {
    "confidence": Look("confidence", "#d55e00", "-"),
    "inliers": Look("number of inliers", "#0072b2", "--"),
    "inlier_share": Look("share of inliers", "#8b919b", ":"),
    COLMAP: Look("COLMAP's verification", "#009e73", "-."),
}


def labelled(kinds: pd.DataFrame, success_px: float) -> pd.DataFrame:
    """Return the records with the scores as columns, and true pairs under the kinds `RIGHT`, `WRONG`, `WITHOUT_F`."""
    true, error = kinds["kind"] == TRUE, kinds["error_px"]
    kind = kinds["kind"].mask(true & error.isna(), WITHOUT_F).mask(true & (error < success_px), RIGHT)
    return kinds.assign(
        kind=kind.mask(true & (error >= success_px), WRONG),
        confidence=kinds["confidence"].fillna(0.0),
        **dict.fromkeys(("inliers", COLMAP), kinds["support"].astype(float)),
        inlier_share=kinds["support"] / kinds["matches"].clip(lower=1),
        told=kinds["geometry"].isin(FLAT_GEOMETRIES),
    )


def _groups(table: pd.DataFrame) -> Iterator[tuple[str, str, pd.DataFrame]]:
    """Yield estimator, input and rows: of each, and of all but the cascade and COLMAP's verification."""
    for (estimator, name), part in table.groupby(["estimator", "input"], sort=False):
        yield str(estimator), str(name), part
    yield ALL, ALL, table[(table["estimator"] != COLMAP) & (table["input"] != CASCADE)]


def kind_table(kinds: pd.DataFrame, success_px: float) -> pd.DataFrame:
    """Return, per estimator, input and kind: ``estimates``, mean ``confidence``, and shares by verdict.

    ``accepted`` have the status ``ok``; ``told`` are related by a homography, of these ``identical`` as copies.
    """
    rows = []
    for estimator, name, own in _groups(labelled(kinds, success_px)):
        for kind, part in own.groupby("kind", sort=False):
            row: dict[str, Any] = {"estimator": estimator, "input": name, "kind": kind, "estimates": len(part)}
            row |= {"confidence": part["confidence"].mean(), "accepted": (part["status"] == Status.OK).mean()}
            row |= {"told": part["told"].mean(), "identical": (part["geometry"] == Geometry.IDENTICAL).mean()}
            rows.append(row)
    return pd.DataFrame(rows)


def confidence_table(kinds: pd.DataFrame, success_px: float) -> pd.DataFrame:
    """Return, per estimator, input and score (`SCORES`), how well the score tells right F from the others.

    ``auc``: area under the ROC of right F against wrong ones and those on unrelated pairs; ``kept``: the share of right
    F above the value that `ACCEPTED` of the unrelated ones exceed; of the confidence also ``calibration_error`` over
    the same rows, ``flat_told``, ``copies_told`` and ``false_flat``: the share of planes and rotations, of copies, and
    of right F that are told to be related by a homography.
    """
    rows = []
    for estimator, name, own in _groups(labelled(kinds, success_px)):
        part = own[own["kind"].isin((RIGHT, WRONG, STRANGERS))]
        right, strangers = (part["kind"] == RIGHT).to_numpy(), (part["kind"] == STRANGERS).to_numpy()
        if not right.any() or right.all():
            continue
        for score in (score for score in SCORES if (score == COLMAP) == (estimator == COLMAP)):
            values = part[score].to_numpy(np.float64)
            row: dict[str, Any] = {"estimator": estimator, "input": name, "score": score, "estimates": len(part)}
            row["auc"] = float(roc_auc_score(right, values))
            reached = np.quantile(values[strangers], 1 - ACCEPTED, method="higher") if strangers.any() else 0.0
            row["kept"] = float(np.mean(values[right] > reached))
            if score == "confidence":
                row["calibration_error"] = calibration_bins(values, right, 10).expected_calibration_error
                flat, copies = (own.loc[own["kind"].isin(names), "told"] for names in (FLAT[:2], FLAT[2:]))
                false = own.loc[own["kind"] == RIGHT, "told"].mean()
                row |= {"flat_told": flat.mean(), "copies_told": copies.mean(), "false_flat": false}
            rows.append(row)
    return pd.DataFrame(rows)


def confidence_figure(kinds: pd.DataFrame, success_px: float, path: Path) -> None:
    """Draw the ROC of every score, the reliability of the confidence, and wrong F over answered pairs."""
    table = labelled(kinds[kinds["input"] != CASCADE], success_px)
    table = table[table["kind"].isin((RIGHT, WRONG, STRANGERS))]
    with styled(path, 1, 3, (12.0, 4.0)) as (figure, ((roc, reliability, risk),)):
        for score, look in SCORES.items():
            part = table[(table["estimator"] == COLMAP) == (score == COLMAP)]
            right, values = (part["kind"] == RIGHT).to_numpy(), part[score].to_numpy(np.float64)
            if not right.any() or right.all():
                continue
            how: dict[str, Any] = {"color": look.colour, "ls": look.line}
            roc.plot(*roc_curve(right, values)[:2], label=look.label, **how)
            order = np.argsort(-values, kind="stable")
            answered = np.arange(1, len(order) + 1)
            risk.plot(answered / len(order), np.cumsum(~right[order]) / answered, **how)
            if score == "confidence":
                reliability.plot([0, 1], [0, 1], color=MUTED, lw=1, ls=(0, (2, 2)))
                reliability.plot(*calibration_bins(values, right, 10).curve[:, :2].T, marker="o", ms=4, **how)
        roc.set(xlabel="share of wrong F and unrelated pairs", ylabel="share of right F", ylim=(0, 1))
        roc.set_xscale("symlog", linthresh=0.01)
        roc.set_xlim(0, 1)
        reliability.set(xlabel="confidence", ylabel="share of right F", xlim=(0, 1), ylim=(0, 1))
        risk.set(xlabel="share of estimates answered", ylabel="share of them wrong", xlim=(0, 1), ylim=(0, None))
        axis_legend(figure, roc)


def kind_rows(table: pd.DataFrame) -> Table:
    """Return the table of kinds for the page: per estimator and input shares accepted and told, over the kinds."""
    kinds, numbers = order_of(table["kind"]), ["accepted", "told", "estimates"]
    rows = []
    for (estimator, name), part in table.groupby(["estimator", "input"], sort=False):
        at = part.set_index("kind").reindex(kinds)[numbers].to_numpy(np.float64).tolist()
        cells = ["" if np.isnan(n) else f"{share(a)} / {share(t)} of {n:.0f}" for a, t, n in at]
        rows.append([*_who(str(estimator), str(name)), *cells])
    return Table(head=("estimator", "input", *kinds), rows=rows, texts=2)


def _who(estimator: str, name: str) -> tuple[str, str]:
    return "all" if estimator == ALL else estimator, "" if name == ALL else input_title(name)


def score_rows(table: pd.DataFrame) -> Table:
    """Return the table of scores for the page."""
    names = ("auc", "kept", "calibration_error", "flat_told", "copies_told", "false_flat")
    rows = [
        [*_who(row["estimator"], row["input"]), SCORES[row["score"]].label, *(number(row[n], 3) for n in names)]
        for row in table.to_dict("records")
    ]
    head = ("estimator", "input", "score", "area under ROC", "right kept at 1 %", "calibration error")
    return Table(head=(*head, "planes, rotations told", "copies told", "right told flat"), rows=rows, texts=3)
