"""Tables of the report, one row per group of pairs and whatever is compared; each becomes a CSV file of its name."""

from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np
import pandas as pd

from epiprior.estimators import find_estimator
from epiprior.types import FloatArray, Status
from epiprior_lab.evaluation.records import right_column
from epiprior_lab.evaluation.statistics import Interval, success_curve
from epiprior_lab.measures import CalibrationBins
from epiprior_lab.pairsets.changed import CHANGES
from epiprior_lab.report.results import PAIR, ROUNDING, ReportError, Results
from epiprior_lab.report.text import ALL, BASELINES, DIFFICULTIES, OURS, baseline_of, order_of

SNN = "snn"
DEPTHS = (10, 100, 500)
PRECISIONS = (*(f"precision_{depth}" for depth in DEPTHS), "average_precision")
ENOUGH_RIGHT = 15  # right matches from which an F can be found, if the order is good
ENOUGH_IN_BIN = 20  # the share of right ones among fewer matches says nothing
TURNED_DOWN = (Status.NO_MODEL, Status.DEGENERATE)

Cells = dict[str, Any]


def success_table(results: Results, thresholds_px: Sequence[float]) -> pd.DataFrame:
    """Return successes by threshold, group, estimator and input.

    Columns: ``threshold_px, group, estimator, input, pairs, scenes``; ``successes`` (pairs, mean over seeds) with
    their deviation ``successes_sd``; ``successes_ok``, those whose status is `ok`; ``scene_share``, the share of
    successes per scene, mean over scenes. Against the input without preprocessing ``gain``, the paper's contribution,
    and ``scene_gain``, the difference of scene shares; against `SNN` the contribution ``snn_gain``; each with the ends
    of its 95 % interval, ``_low`` and ``_high``; NaN for that input itself.
    """
    rows = []
    for threshold, (group, member), estimator in product(thresholds_px, results.groups(), results.estimators):
        names, key = results.inputs(estimator), (group, estimator, str(threshold))
        rates = {name: results.errors.of(estimator, name, threshold) for name in names}
        shares = {name: results.per_scene(rates[name], member) for name in names}
        for name in names:
            mean, deviation = success_curve(results.errors[estimator, name][member], [threshold])
            row: Cells = {"threshold_px": threshold, "group": group, "estimator": estimator, "input": name}
            row |= {"pairs": int(member.sum()), "scenes": len(set(results.scenes[member]))}
            row |= {"successes": mean[0], "successes_sd": deviation[0]}
            row["successes_ok"] = float(results.accepted.of(estimator, name, threshold)[member].sum())
            row["scene_share"] = float(shares[name].mean())
            base = baseline_of(name, names)
            if name != base:
                gain = results.compare(rates[base], rates[name], member, *key).contribution
                scene_gain = results.compare_scenes(shares[base], shares[name], *key).difference
                row |= results.interval("gain", gain, member) | results.interval("scene_gain", scene_gain, member)
            if name == OURS and SNN in names:
                snn_gain = results.compare(rates[SNN], rates[name], member, *key).contribution
                row |= results.interval("snn_gain", snn_gain, member)
            rows.append(row)
    return pd.DataFrame(rows)


def duel_table(results: Results, champion: str, thresholds_px: Sequence[float]) -> pd.DataFrame:
    """Return one estimator against every other on the same input, pair by pair.

    One row per threshold, main group, input (`OURS`, `SNN`) and other estimator: ``pairs``; successful pairs of the
    ``champion`` and of the ``other``; their ``difference`` with the ends of its 95 % interval; ``decided``: ``better``
    or ``worse`` where the interval excludes zero by more than rounding, else ``open``.
    """
    if champion not in results.estimators:
        raise ReportError(f"no results of {champion}, only of {', '.join(results.estimators)}")
    asked = [name for name in (OURS, SNN) if name in results.inputs(champion)]
    rows = []
    for threshold, (group, member), name in product(thresholds_px, results.groups(results.main), asked):
        own, n = results.errors.of(champion, name, threshold), int(member.sum())
        for estimator in (e for e in results.estimators if e != champion and name in results.inputs(e)):
            other = results.errors.of(estimator, name, threshold)
            got = results.compare(other, own, member, "duel", group, estimator, name, str(threshold))
            row: Cells = {"threshold_px": threshold, "group": group, "input": name, "estimator": estimator}
            row |= {"pairs": n, "champion": got.with_step.value * n, "other": got.without.value * n}
            row |= results.interval("difference", got.difference, member, n)
            rows.append(row | {"decided": decided(got.difference)})
    return pd.DataFrame(rows)


def changed_table(results: Results, thresholds_px: Sequence[float]) -> pd.DataFrame:
    """Return successes on sets of `pairsets.changed.CHANGES`, beside those on the same pairs as they were.

    Columns: ``threshold_px, input``; ``estimator``, that with the most successes over all pairs below the first
    threshold; ``group, pairs``; ``successes`` (mean over seeds) and ``unchanged``, those of the unchanged pairs.
    """
    places = {f"{row.group}-{row.pair_id}": k for k, row in enumerate(results.tables.pairs.itertuples())}
    changed, everyone, rows = [group for group in results.sets if group in CHANGES], results.masks[ALL], []
    for name in results.inputs_of_all if changed else ():
        known = [e for e in results.estimators if name in results.inputs(e)]
        best = max(known, key=lambda e: float(results.errors.of(e, name, thresholds_px[0])[everyone].sum()))
        for threshold, (group, member) in product(thresholds_px, results.groups(changed)):
            rates = results.errors.of(best, name, threshold)
            before = [places[pair_id] for pair_id in results.tables.pairs.loc[member, "pair_id"]]
            row: Cells = {"threshold_px": threshold, "input": name, "estimator": best, "group": group}
            row |= {"pairs": len(before), "successes": float(rates[member].sum())}
            rows.append(row | {"unchanged": float(rates[before].sum())})
    return pd.DataFrame(rows)


def decided(difference: Interval) -> str:
    """Return ``better`` or ``worse`` where the interval excludes zero by more than rounding, else ``open``."""
    if difference.low > ROUNDING:
        return "better"
    return "worse" if difference.high < -ROUNDING else "open"


def geometry_table(results: Results, pose_deg: Sequence[float], recall_at: float, success_px: float) -> pd.DataFrame:
    """Return poses and distances by group, estimator and input.

    Pose errors are the larger of both angles, distances the normalised symmetric geometric ones.

    Columns: ``group, estimator, input``; ``cameras``, pairs with a known pose, ``auc_<limit>`` over these and
    ``scene_auc_<limit>``, averaged over scenes; ``posed_successes``, successful runs of these pairs, and
    ``wrong_poses``, those of them that are off by more than the highest limit; ``true_F``, pairs with a true F,
    ``distance_recall`` and ``median_distance`` over these. A run without F is a failure; NaN without such pairs.
    """
    runs = results.tables.runs
    with_pose, with_F = (
        results.index.isin(pd.MultiIndex.from_frame(runs.loc[runs[column].notna(), PAIR]))
        for column in ("translation_deg", "distance")
    )  # pairs for which any run has a value: those whose truth allows the measure
    rows = []
    for (group, member), estimator in product(results.groups(), results.estimators):
        posed, true = member & with_pose, member & with_F
        for name in results.inputs(estimator):
            angles, distances = results.poses[estimator, name], results.distances[estimator, name]
            row: Cells = {"group": group, "estimator": estimator, "input": name, "cameras": int(posed.sum())}
            for limit in pose_deg if posed.any() else ():
                area = np.clip(1 - angles / limit, 0, 1).mean(axis=1)
                row[f"auc_{limit:g}"] = float(area[posed].mean())
                row[f"scene_auc_{limit:g}"] = float(results.per_scene(area, posed).mean())
            right = results.errors[estimator, name][posed] < success_px
            wrong = right & (angles[posed] > max(pose_deg))
            row |= {"posed_successes": int(right.sum()), "wrong_poses": int(wrong.sum()), "true_F": int(true.sum())}
            if true.any():
                row["distance_recall"] = float((distances[true] < recall_at).mean())
                row["median_distance"] = float(np.minimum(np.median(distances[true]), 1.0))
            rows.append(row)
    return pd.DataFrame(rows)


def ranking_table(results: Results) -> pd.DataFrame:
    """Return means over labelled pairs by group, input and ranking.

    Columns: ``group, input, ranking, pairs, features`` (of an image), ``matches, right``; `PRECISIONS` and
    ``scene_<name>`` of each, averaged over scenes; ``enough``, the share of pairs with `ENOUGH_RIGHT` right matches or
    more; ``gain``, the precision at 100 over X_L in the order of the distance ratio, with its 95 % interval.
    """
    ranked = results.tables.rankings
    ranked = ranked.assign(**{f"precision_{depth}": ranked[right_column(depth)] / depth for depth in DEPTHS})
    ranked = ranked.assign(features=ranked[["features1", "features2"]].mean(axis=1))
    parts: dict[tuple[str, str], pd.DataFrame] = {
        (str(name), str(ranking)): results.by_pair(part)
        for (name, ranking), part in ranked.groupby(["input", "ranking"], sort=False)
    }
    keys = sorted(parts, key=lambda key: (key[0] not in BASELINES, key[0] == OURS))
    base = next((parts[key] for key in (("standard", "final"), *keys) if key in parts), None)
    rows = []
    for (group, member), key in product(results.groups(), keys):
        part, has = parts[key], member & parts[key]["right"].notna().to_numpy()
        if base is None or not has.any():
            continue
        row: Cells = {"group": group, "input": key[0], "ranking": key[1], "pairs": int(has.sum())}
        row |= {name: float(part.loc[has, name].mean()) for name in ("features", "matches", "right", *PRECISIONS)}
        for name in PRECISIONS:
            row[f"scene_{name}"] = float(results.per_scene(part[name].to_numpy(np.float64), has).mean())
        row["enough"] = float((part.loc[has, "right"] >= ENOUGH_RIGHT).mean())
        if part is not base:
            both = has & base["right"].notna().to_numpy()
            a, b = (p["precision_100"].to_numpy(np.float64) for p in (base, part))
            found = results.compare(a, b, both, "ranking", group, key[0] if key[1] == "final" else "/".join(key))
            row |= results.interval("gain", found.difference, both)
        rows.append(row)
    return pd.DataFrame(rows)


def calibration_sums(calibration: pd.DataFrame) -> CalibrationBins:
    """Return the sums over all pairs of the rows, bin by bin."""
    sums = calibration.groupby("bin", sort=True)[["count", "right", "probability", "squared_error"]].sum()
    kinds = {"count": np.int64, "right": np.int64, "probability": np.float64, "squared_error": np.float64}
    return CalibrationBins(**{name: sums[name].to_numpy(kind) for name, kind in kinds.items()})


def reliability(sums: CalibrationBins) -> FloatArray:
    """Return mean probability and share of right matches of the bins of `ENOUGH_IN_BIN` matches or more."""
    stated, right, count = sums.curve.T
    return np.stack([stated, right])[:, count >= ENOUGH_IN_BIN]


def calibration_table(results: Results) -> pd.DataFrame:
    """Return how far probabilities are right, by group and ranked input; groups without labels have no row.

    Columns: ``group, input, matches, right, brier_score, expected_calibration_error``; ``lowest_share``, the share of
    the matches in the lowest bin, and ``upper_error``, the calibration error of all others; ``gap_stated, gap_right``,
    mean probability and share of right matches in the bin where they differ most, and ``top_stated, top_right`` in the
    highest one, among bins of `ENOUGH_IN_BIN` matches or more.
    """
    rows = []
    for group, member in results.groups():
        of_group = results.rows_of(results.tables.calibration, member)
        for name in order_of(of_group["input"]):
            sums = calibration_sums(of_group[of_group["input"] == name])
            if not sums.count.any():
                continue
            count, right = int(sums.count.sum()), int(sums.right.sum())
            row: Cells = {"group": group, "input": name, "matches": count, "right": right}
            row |= {"brier_score": sums.brier_score, "expected_calibration_error": sums.expected_calibration_error}
            upper = CalibrationBins(**{column: values[1:] for column, values in vars(sums).items()})
            row |= {"lowest_share": float(sums.count[0] / count), "upper_error": upper.expected_calibration_error}
            stated, truly = reliability(sums)
            if len(stated):
                for place, k in (("gap", int(np.argmax(np.abs(stated - truly)))), ("top", -1)):
                    row |= {f"{place}_stated": float(stated[k]), f"{place}_right": float(truly[k])}
            rows.append(row)
    return pd.DataFrame(rows)


def status_table(results: Results, threshold_px: float) -> pd.DataFrame:
    """Return what the verification makes of right F (error below the threshold) and of wrong F.

    One row per group and input (`ALL` last): ``runs``; ``without_F``, those that gave no F; of the others ``right``
    and ``wrong``, and of these ``<kind>_no_model``, ``<kind>_degenerate`` and the sum of both as a share,
    ``<kind>_turned_down``, NaN where there is none of the kind.
    """
    rows = []
    for group, member in results.groups():
        runs = results.rows_of(results.tables.runs, member)
        names = [name for name in results.inputs_of_all if (runs["input"] == name).any()]
        for name in (*names, *([ALL] if len(names) > 1 else [])):
            part = runs if name == ALL else runs[runs["input"] == name]
            has_F, below = part["error_px"].notna(), part["error_px"] < threshold_px
            row: Cells = {"group": group, "input": name, "runs": len(part), "without_F": int((~has_F).sum())}
            for kind, of_kind in (("right", below), ("wrong", has_F & ~below)):
                counts = {str(s): int((of_kind & (part["status"] == s)).sum()) for s in TURNED_DOWN}
                row |= {kind: int(of_kind.sum()), **{f"{kind}_{s}": count for s, count in counts.items()}}
                row[f"{kind}_turned_down"] = sum(counts.values()) / row[kind] if row[kind] else np.nan
            rows.append(row)
    return pd.DataFrame(rows)


def limits_table(results: Results, champion: str, success_px: float) -> pd.DataFrame:
    """Return where one estimator fails on our matches of hard pairs, and who else solves these pairs.

    Columns: ``group`` (`ALL` hard pairs, then every family or set that has any), ``pairs`` and those ``failing``;
    ``precision_failing, precision_solved``, medians of our precision of the top 100; and of the failing pairs those
    that are solved in hindsight: by the champion on any other input (``other_input``), by any other estimator on our
    matches (``other_estimator``), by any estimator on any input (``anyone``). A pair is solved if most runs succeed.
    """
    hard, none = results.hard_pairs, np.zeros(len(results.scenes), np.bool_)
    if not hard.any() or OURS not in results.inputs(champion):
        return pd.DataFrame()
    solved = {key: results.errors.of(*key, success_px) > 0.5 for key in results.errors}
    by = {
        "other_input": [own for (who, name), own in solved.items() if who == champion and name != OURS],
        "other_estimator": [own for (who, name), own in solved.items() if who != champion and name == OURS],
        "anyone": list(solved.values()),
    }
    failing = hard & ~solved[champion, OURS]
    ranked = results.tables.rankings
    ours = results.by_pair(ranked[(ranked["input"] == OURS) & (ranked["ranking"] == "final")])
    precision = (ours[right_column(100)] / 100).to_numpy(np.float64)
    rows = []
    for group, member in results.groups((ALL, *results.sets)):
        part = hard & member
        if not part.any():
            continue
        lost = part & failing
        row: Cells = {"group": group, "pairs": int(part.sum()), "failing": int(lost.sum())}
        for kind, pairs in (("failing", lost), ("solved", part & ~failing)):
            known = precision[pairs & np.isfinite(precision)]
            row[f"precision_{kind}"] = float(np.median(known)) if len(known) else np.nan
        rows.append(row | {name: int((lost & np.any(own or [none], axis=0)).sum()) for name, own in by.items()})
    return pd.DataFrame(rows)


def set_table(results: Results, known: Sequence[Any] = ()) -> pd.DataFrame:
    """Return one row per set or family; sets of `known` (`pairsets.KnownSet`) come first, absent ones included.

    Columns: ``group, title, paper, state`` (``evaluated``, ``apart``, ``not present``), ``pairs`` (as published where
    not present), ``scenes``, ``labels`` (what decides that a match is right), ``points``, and pairs by difficulty.
    """
    by_name = {one.name: one for one in known}
    rows = []
    for name in (*by_name, *(name for name in results.sets if name not in by_name)):
        title, paper = (by_name[name].title, by_name[name].paper) if name in by_name else (name, False)
        row: Cells = {"group": name, "title": title, "paper": paper}
        if name not in results.sets:
            rows.append(row | {"state": "not present", "pairs": by_name[name].pairs})
            continue
        part = results.tables.pairs[results.tables.pairs["group"] == name]
        row |= {"state": "apart" if name in results.apart else "evaluated", "pairs": len(part)}
        row["scenes"] = part["scene"].nunique()
        row |= {key: " + ".join(sorted({str(v) or "none" for v in part[key]})) for key in ("labels", "points")}
        row |= {level: int((part["difficulty"] == level).sum()) for level in DIFFICULTIES}
        rows.append(row | {"unlabelled": int((part["difficulty"] == "").sum())})
    counts = ["scenes", *DIFFICULTIES, "unlabelled"]
    return pd.DataFrame(rows).astype(dict.fromkeys(counts, "Int64"))


def pair_table(results: Results) -> pd.DataFrame:
    """Return one row per pair, estimator and input: every number that the other tables are made of.

    Columns: ``group, pair_id, scene, difficulty, labels, right_share``; ``estimator, input, found`` (runs with an F);
    the errors of all seeds, ``error_px_<seed>``; ``distance`` and ``pose_deg``, means over runs with an F.
    """
    keys = ["group", "pair_id", "scene", "estimator", "input"]
    runs = results.tables.runs
    table = runs.assign(pose_deg=results.pose_deg, found=runs["error_px"].notna())
    grouped = table.groupby(keys, sort=False)
    means = grouped.agg(found=("found", "sum"), distance=("distance", "mean"), pose_deg=("pose_deg", "mean"))
    errors = table.set_index([*keys, "seed"])["error_px"].unstack("seed")
    errors.columns = pd.Index([f"error_px_{seed}" for seed in errors.columns])
    wide = means[["found"]].join(errors).join(means[["distance", "pose_deg"]]).reset_index()
    about = ["difficulty", "labels", "right_share"]
    wide = wide.merge(results.tables.pairs[[*PAIR, *about]], on=PAIR, how="left")
    front = [*keys[:3], *about, *keys[3:]]
    return wide[[*front, *(name for name in wide.columns if name not in front)]]


def estimator_table(results: Results) -> pd.DataFrame:
    """Return what stands behind each name: ``estimator, backend, max_iterations, deterministic, hypotheses``.

    ``max_iterations`` caps the samples of a run, per roll hypothesis; ``hypotheses`` is the median of those of both
    over all runs, where the backend tells.
    """
    found = {name: find_estimator(name) for name in results.estimators}
    table = pd.DataFrame({"estimator": list(found), "backend": [one.version() for one in found.values()]})
    table["max_iterations"] = [one.max_iterations for one in found.values()]
    table["deterministic"] = [bool(getattr(one, "deterministic", False)) for one in found.values()]
    medians = results.tables.runs.groupby("estimator")["iterations"].median().astype(np.float64)
    return table.assign(hypotheses=medians.reindex(list(found)).to_numpy())


def classifier_table(metrics: pd.DataFrame) -> pd.DataFrame:
    """Return each metric of each classifier, with folds by scene and by row.

    Columns: ``preset, target, family, metric``, then over all rows ``grouped``, ``ungrouped`` and ``calibrated``
    (grouped, after calibration), and deviations over folds ``grouped_sd`` and ``ungrouped_sd``; NaN where unknown.
    """
    table = metrics.assign(fold=metrics["fold"].astype(str))
    keys = ["preset", "target", "family", "metric"]
    rows = []
    for key, part in table.groupby(keys, sort=False):
        row: Cells = dict(zip(keys, key, strict=True))
        for name, flag in (("grouped", True), ("ungrouped", False)):
            values = part[part["grouped"] == flag].set_index("fold")["value"]
            folds = values[values.index.str.isdecimal()].dropna()
            row[name] = float(values.get("all", np.nan))
            row[f"{name}_sd"] = float(folds.std())
            if flag:
                row["calibrated"] = float(values.get("calibrated", np.nan))
        rows.append(row)
    return pd.DataFrame(rows)
