"""Tables of the report on photographs: sets, successes, poses and distances, rankings, calibration, every pair."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from epiprior.types import BoolArray, FloatArray, Status
from epiprior_lab.compute.seeds import child_seed
from epiprior_lab.evaluation.photographs.truth import SPLITS, UNLABELLED
from epiprior_lab.evaluation.statistics import (
    CalibrationBins,
    Interval,
    bootstrap_mean,
    paired_bootstrap,
    success_curve,
)
from epiprior_lab.pairsets import known_sets
from epiprior_lab.report.performance import interval_cells
from epiprior_lab.report.photographs.results import (
    OURS,
    Photographs,
    Runs,
    distance_runs,
    error_runs,
    pose_runs,
    scene_mean,
)
from epiprior_lab.report.study import order_of
from epiprior_lab.report.tables import calibration_sums
from epiprior_lab.report.verdicts import verdict_table

LOWE = "standard"
RANKING_MEASURES = ("matches", "right", "precision_10", "precision_100", "precision_500", "average_precision")
SCENE_MEASURES = ("precision_10", "precision_100", "precision_500", "average_precision")
_ENOUGH = 20  # the share of right ones among fewer matches says nothing


@dataclass(frozen=True, kw_only=True)
class Tables:
    """The tables of the report; each field becomes one CSV file of the field's name."""

    sets: pd.DataFrame
    bounds: pd.DataFrame
    limits: pd.DataFrame
    successes: pd.DataFrame
    geometry: pd.DataFrame
    rankings: pd.DataFrame
    calibration: pd.DataFrame
    cascade: pd.DataFrame
    estimators: pd.DataFrame
    verdicts: pd.DataFrame


def set_table(photographs: Photographs) -> pd.DataFrame:
    """Return one row per known set, the paper's first, then others that were evaluated.

    Returns
    -------
    DataFrame
        ``set, title, paper, state`` (``evaluated``, ``apart`` or ``not present``), ``pairs`` (as published where not
        present), ``scenes``, ``labels`` (what decides that a match is right), ``points``, and pairs of each split.
    """
    known = {known.name: known for known in known_sets()}
    rows = []
    for name in (*known, *(name for name in photographs.sets if name not in known)):
        title, paper = (known[name].title, known[name].paper) if name in known else (name, False)
        row: dict[str, Any] = {"set": name, "title": title, "paper": paper}
        if name not in photographs.sets:
            rows.append(row | {"state": "not present", "pairs": known[name].pairs})
            continue
        part = photographs.pairs[photographs.pairs["set"] == name]
        row |= {"state": "apart" if name in photographs.apart else "evaluated", "pairs": len(part)}
        row |= {"scenes": part["scene"].nunique(), "labels": " + ".join(sorted(set(part["labels"])))}
        row |= {"points": " + ".join(sorted(set(part["points"])))}
        row |= {split: int((part["split"] == split).sum()) for split in (*SPLITS, UNLABELLED)}
        rows.append(row)
    counts = ["scenes", *SPLITS, UNLABELLED]
    return pd.DataFrame(rows).astype(dict.fromkeys(counts, "Int64"))


def success_table(photographs: Photographs, *, thresholds_px: Sequence[float], draws: int, seed: int) -> pd.DataFrame:
    """Return successes by threshold, group, estimator and input.

    Parameters
    ----------
    photographs : Photographs
        Results.
    thresholds_px : sequence of float
        Of success, pixels.
    draws, seed : int
        Of the bootstrap, which draws whole scenes.

    Returns
    -------
    DataFrame
        ``threshold_px, group, estimator, input, pairs, scenes``; ``successes`` (pairs, mean over seeds) and their
        deviation ``successes_sd``; ``successes_ok``, those whose verdict is `ok`; ``scene_share``, the share of
        successes per scene, mean over scenes. Against the input without preprocessing: ``gain``, the paper's
        contribution, and ``scene_gain``, the difference of scene shares, with the ends of their 95 % intervals,
        ``_low`` and ``_high``; NaN for that input itself. A group of one scene has no interval, since whole scenes are
        drawn: the ends are NaN.
    """
    errors, scenes = error_runs(photographs), np.array(photographs.scenes)
    accepted = Runs(photographs, lambda table: table["error_px"].where(table["status"] == Status.OK))
    rows = []
    for threshold in thresholds_px:
        for group, member in photographs.groups.items():
            of_group = scenes[member].tolist()
            for estimator in photographs.estimators:
                names = photographs.inputs(estimator)
                base = (errors.of(estimator, names[0])[member] < threshold).mean(axis=1)
                child = child_seed(seed, group, estimator, str(threshold))
                for name in names:
                    own = errors.of(estimator, name)[member]
                    mean, deviation = success_curve(own, [threshold])
                    rates = (own < threshold).mean(axis=1)
                    row: dict[str, Any] = {"threshold_px": threshold, "group": group, "estimator": estimator}
                    row |= {"input": name, "pairs": len(own), "scenes": len(set(of_group))}
                    row |= {"successes": mean[0], "successes_sd": deviation[0]}
                    ok = accepted.of(estimator, name)[member] < threshold
                    row["successes_ok"] = float(ok.sum(axis=0).mean())
                    row["scene_share"] = scene_mean(rates, of_group)
                    if name != names[0]:
                        row |= _gains(base, rates, of_group, draws, child)
                    rows.append(row)
    return pd.DataFrame(rows)


def _gains(base: FloatArray, rates: FloatArray, scenes: list[str], draws: int, seed: int) -> dict[str, float]:
    by_pair = paired_bootstrap(base, rates, draws=draws, seed=seed, groups=scenes)
    per_scene = pd.DataFrame({"a": base, "b": rates}).groupby(scenes, sort=True).mean()
    by_scene = paired_bootstrap(per_scene["a"], per_scene["b"], draws=draws, seed=seed)
    return {
        **_cells("gain", by_pair.contribution, scenes),
        **_cells("scene_gain", by_scene.difference, scenes),
    }


def _cells(name: str, interval: Interval, scenes: Sequence[str]) -> dict[str, float]:
    """Return the columns of an interval over scenes; one scene gives a value and no interval."""
    cells = interval_cells(name, interval, 1.0)
    return cells if len(set(scenes)) > 1 else cells | dict.fromkeys((f"{name}_low", f"{name}_high"), np.nan)


def geometry_table(
    photographs: Photographs, *, pose_deg: Sequence[float], recall_at: float, success_px: float
) -> pd.DataFrame:
    """Return poses and distances by group, estimator and input.

    Parameters
    ----------
    photographs : Photographs
        Results.
    pose_deg : sequence of float
        Limits of the area under the curve of pose errors, degrees.
    recall_at : float
        A run is recalled below this normalised symmetric geometric distance.
    success_px : float
        Of success, pixels.

    Returns
    -------
    DataFrame
        ``group, estimator, input``; ``cameras``, pairs with a known pose, and ``auc_<limit>`` over these, then
        ``scene_auc_<limit>``, averaged over scenes; ``posed_successes``, successful runs of these pairs, and
        ``wrong_poses``, those of them whose pose is off by more than the highest limit; ``true_F``, pairs with a true
        F, ``distance_recall`` and ``median_distance`` over these. A run without F counts as a failure; NaN where there
        is no such pair.
    """
    poses, distances, errors = pose_runs(photographs), distance_runs(photographs), error_runs(photographs)
    scenes = np.array(photographs.scenes)
    with_pose, with_F = (_ever(photographs, column) for column in ("translation_deg", "distance"))
    rows = []
    for group, member in photographs.groups.items():
        posed, true = member & with_pose, member & with_F
        for estimator in photographs.estimators:
            for name in photographs.inputs(estimator):
                angle, distance = poses.of(estimator, name)[posed], distances.of(estimator, name)[true]
                row: dict[str, Any] = {"group": group, "estimator": estimator, "input": name}
                row["cameras"] = int(posed.sum())
                for limit in pose_deg if posed.any() else ():
                    area = np.clip(1 - angle / limit, 0, 1).mean(axis=1)
                    row |= {f"auc_{limit:g}": float(area.mean())}
                    row |= {f"scene_auc_{limit:g}": scene_mean(area, scenes[posed].tolist())}
                right = errors.of(estimator, name)[posed] < success_px
                row["posed_successes"] = int(right.sum())
                row["wrong_poses"] = int((right & (angle > max(pose_deg))).sum())
                row["true_F"] = int(true.sum())
                if true.any():
                    row["distance_recall"] = float((distance < recall_at).mean())
                    row["median_distance"] = float(np.minimum(np.median(distance), 1.0))
                rows.append(row)
    return pd.DataFrame(rows)


def _ever(photographs: Photographs, column: str) -> BoolArray:
    """Return the pairs for which any run has a value: those whose truth allows the measure."""
    found = set(photographs.results.loc[photographs.results[column].notna(), "pair"])
    return photographs.pairs["pair"].isin(found).to_numpy(np.bool_)


def ranking_table(photographs: Photographs, *, draws: int, seed: int) -> pd.DataFrame:
    """Return means over labelled pairs by group and ranking.

    Returns
    -------
    DataFrame
        ``group, ranking, pairs``; `RANKING_MEASURES`; ``scene_<name>`` of `SCENE_MEASURES`, averaged over scenes; and
        against Lowe's order ``precision_gain``, the difference of precision at 100, with the ends of its 95 % interval
        over scenes, NaN for a group of one scene.
    """
    rows = []
    member_of = {group: set(photographs.pairs["pair"][member]) for group, member in photographs.groups.items()}
    for group, members in member_of.items():
        part = photographs.rankings[photographs.rankings["pair"].isin(members)]
        names = sorted(order_of(part["ranking"]), key=lambda name: name == OURS)
        tables = {name: part[part["ranking"] == name].set_index("pair").sort_index() for name in names}
        for ranking, table in tables.items():
            row: dict[str, Any] = {"group": group, "ranking": ranking, "pairs": len(table)}
            row |= {name: float(table[name].mean()) for name in RANKING_MEASURES}
            scenes = [str(scene) for scene in table["scene"]]
            row |= {f"scene_{name}": scene_mean(table[name].to_numpy(np.float64), scenes) for name in SCENE_MEASURES}
            if ranking != LOWE:
                gain = table["precision_100"] - tables[LOWE]["precision_100"]
                child = child_seed(seed, "ranking", group, ranking)
                found = bootstrap_mean(gain, draws=draws, seed=child, groups=scenes)
                row |= _cells("precision_gain", found, scenes)
            rows.append(row)
    return pd.DataFrame(rows)


def calibration_table(photographs: Photographs) -> pd.DataFrame:
    """Return how far probabilities are right, by group and preset; groups without labels have no row.

    Returns
    -------
    DataFrame
        ``group, preset, matches, right, brier_score, expected_calibration_error``; ``lowest_share``, the share of the
        matches in the lowest bin, and ``upper_error``, the calibration error of all others; ``gap_stated, gap_right``,
        mean probability and share of right matches in the bin where they differ most, and ``top_stated, top_right`` in
        the highest one, among bins of enough matches.
    """
    rows = []
    for group, member in photographs.groups.items():
        pairs = set(photographs.pairs["pair"][member])
        part = photographs.calibration[photographs.calibration["pair"].isin(pairs)]
        for preset in order_of(part["preset"]):
            sums = calibration_sums(part[part["preset"] == preset])
            row = {"group": group, "preset": preset, "matches": int(sums.count.sum()), "right": int(sums.right.sum())}
            row |= {"brier_score": sums.brier_score, "expected_calibration_error": sums.expected_calibration_error}
            rows.append(row | _bins(sums))
    return pd.DataFrame(rows)


def _bins(sums: CalibrationBins) -> dict[str, float]:
    """Return what single bins say, since the lowest holds most matches and hides the others."""
    found = {"lowest_share": float(sums.count[0] / sums.count.sum())}
    upper = CalibrationBins(**{name: values[1:] for name, values in vars(sums).items()})
    found["upper_error"] = upper.expected_calibration_error
    enough = np.flatnonzero(sums.count >= _ENOUGH)
    if len(enough):
        stated, right = (values[enough] / sums.count[enough] for values in (sums.probability, sums.right))
        for name, k in (("gap", int(np.argmax(np.abs(stated - right)))), ("top", -1)):
            found |= {f"{name}_stated": float(stated[k]), f"{name}_right": float(right[k])}
    return found


def group_verdicts(photographs: Photographs, threshold_px: float) -> pd.DataFrame:
    """Return what the verdict makes of right and of wrong F, by group: see `epiprior_lab.report.verdicts`."""
    results = photographs.results.sort_values("input", key=lambda names: names == OURS, kind="stable")  # ours last
    members = {group: set(photographs.pairs["pair"][member]) for group, member in photographs.groups.items()}
    return verdict_table({group: results[results["pair"].isin(own)] for group, own in members.items()}, threshold_px)


def pair_table(photographs: Photographs) -> pd.DataFrame:
    """Return one row per pair, estimator and input: every number that the other tables are made of.

    Returns
    -------
    DataFrame
        ``set, pair_id, scene, split, labels, right_share``; ``estimator, input, found`` (runs with an F); the errors
        of all seeds, ``error_px_<seed>``; ``distance`` and ``pose_deg``, means over runs with an F.
    """
    keys = ["set", "pair_id", "scene", "estimator", "input"]
    table = photographs.results.assign(
        scene=photographs.results["scene"].str.partition("/")[2],
        pose_deg=photographs.results[["rotation_deg", "translation_deg"]].max(axis=1, skipna=False),
        has_F=photographs.results["error_px"].notna(),
    )
    grouped = table.groupby(keys, sort=False)
    means = grouped.agg(found=("has_F", "sum"), distance=("distance", "mean"), pose_deg=("pose_deg", "mean"))
    errors = table.set_index([*keys, "seed"])["error_px"].unstack("seed")  # a pivot would make room for all products
    errors.columns = pd.Index([f"error_px_{seed}" for seed in errors.columns])
    wide = means[["found"]].join(errors).join(means[["distance", "pose_deg"]]).reset_index()
    about = photographs.pairs[["set", "pair_id", "split", "labels", "right_share"]]
    wide = wide.merge(about, on=["set", "pair_id"], how="left", validate="many_to_one")
    front = ["set", "pair_id", "scene", "split", "labels", "right_share", "estimator", "input"]
    return wide[[*front, *(name for name in wide.columns if name not in front)]]


def write_real_table(table: pd.DataFrame, path: Path) -> Path:
    """Write a table as CSV with five significant digits: the one of all pairs is long."""
    path.parent.mkdir(parents=True, exist_ok=True)
    table.to_csv(path, index=False, float_format="%.5g", lineterminator="\n")
    return path
