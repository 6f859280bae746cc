"""The four tables of a small study and of a small benchmark of photographs, made up of seeded random numbers."""

import numpy as np

from epiprior_lab.evaluation import records as kept_records
from epiprior_lab.evaluation.records import RANKINGS, RANKS, PairRecord, RankingRecord, RunRecord, Tables

SEEDS = (0, 1, 2)
EASE = {
    "standard": 0.35, "generalized": 0.3, "snn": 0.5, "paper": 0.55, "default": 0.75, "adalam": 0.55, "gms": 0.45,
    "aliked": 0.7,
}  # fmt: skip
QUALITY = dict(zip(RANKINGS, (0.3, 0.35, 0.5, 0.6, 0.8), strict=True))

STUDY_GROUPS = ("facades-easy", "open")
STUDY_INPUTS = {
    "usac": ("standard", "snn", "paper", "default"),
    "prosac": ("standard", "snn", "default"),
    "generalized-ransac": ("generalized", "snn", "default"),
    "epiprior": ("standard", "snn", "default"),
}
SETS = {"strecha": ("easy", "medium"), "fox": ("hard",), "scannet15": ("hard",)}
APART = ("scannet15",)
PHOTOGRAPH_INPUTS = {
    "usac": ("standard", "snn", "default", "adalam", "gms", "aliked"),
    "magsac++": ("standard", "snn", "default", "adalam", "gms", "aliked"),
    "generalized-ransac": ("generalized", "snn", "default", "adalam", "gms"),
    "epiprior": ("standard", "snn", "default", "adalam", "gms"),
}


def study_tables(*, pairs: int = 12, seed: int = 0) -> Tables:
    """Return the tables of a study of two families: all pairs have cameras, control points and labels."""
    rng = np.random.default_rng(seed)
    records = []
    for g, group in enumerate(STUDY_GROUPS):
        for k in range(pairs):
            key = {"group": group, "pair_id": f"{group}-test-{k:04d}", "scene": f"scene-{g}-{k // 2}"}
            records += _pair(rng, key, STUDY_INPUTS, "hard" if group == "open" else "easy")
    return Tables.from_records(records)


def photograph_tables(*, pairs: int = 6, seed: int = 0) -> Tables:
    """Return the tables of three sets: `strecha` has no cameras; the last pair of all sets but `fox` has no labels."""
    rng = np.random.default_rng(seed)
    records = []
    for name, difficulties in SETS.items():
        for k in range(pairs):
            # Ids look like numbers: they must stay text.
            key = {"group": name, "pair_id": f"{k:04d}", "scene": f"0{k // 2}"}
            difficulty = difficulties[k % len(difficulties)] if (k < pairs - 1 or name == "fox") else ""
            records += _pair(rng, key, PHOTOGRAPH_INPUTS, difficulty, cameras=name != "strecha", apart=name in APART)
    return Tables.from_records(records)


def _pair(rng, key, inputs, difficulty, *, cameras=True, apart=False):
    labelled = bool(difficulty)
    roll = float(rng.uniform(-180, 180)) if cameras else np.nan
    about = {"features1": 2000, "features2": 1800, "points": "cameras" if apart else "control_points"}
    about |= {"labels": "control_points" if labelled else "", "difficulty": difficulty, "true_roll_deg": roll}
    share = {"easy": 0.7, "medium": 0.3, "hard": 0.1, "": np.nan}[difficulty] + 0.001 * rng.random()
    yield PairRecord(**key, **about, right_share=share, expected_roll_deg=roll % 360 if cameras else 0.0)
    yield from _runs(rng, key, inputs, cameras=cameras, labelled=labelled)
    if not labelled:
        return
    for name in dict.fromkeys(name for names in inputs.values() for name in names):
        ranked = name in ("paper", "default")
        for ranking in RANKINGS if ranked else ("final",):
            quality = QUALITY[ranking] if ranked else EASE[name]
            right = np.cumsum(rng.random(10_000) < quality / (1 + np.arange(10_000) / 800))
            features = (2048, 2048) if name == "aliked" else (2000, 1800)
            counts = dict(zip(("features1", "features2"), features, strict=True)) | {"matches": 10_000}
            counts |= {"right": int(right[-1]), "right_at": tuple(int(right[rank - 1]) for rank in RANKS)}
            precision = float(quality * rng.random())
            yield RankingRecord(**key, input=name, ranking=ranking, average_precision=precision, **counts)
        if ranked:
            yield from _calibration(rng, key, name)


def _runs(rng, key, inputs, *, cameras, labelled):
    hardness = rng.random()
    runs = ((estimator, name, seed) for estimator, names in inputs.items() for name in names for seed in SEEDS)
    for estimator, name, seed in runs:
        works = hardness + rng.normal(0, 0.1) < EASE[name] + 0.2 * (estimator == "epiprior")
        found = works or rng.random() < 0.7
        error = float(rng.gamma(1.5, 1.2) if works else 10 * rng.lognormal(1, 0.6))
        ok = found and int(1e6 * error) % 9 != 0  # the status knows nothing of the truth here
        status = "ok" if ok else "degenerate" if found else "no_model"
        kind = "general" if ok else "planar" if found else "none"
        counts = {"matches": 200, "iterations": None if estimator == "prosac" else 100}
        counts |= {"support": 120 if found else 0}
        turned = error if cameras else np.nan
        measures = {"error_px": error, "median_error_px": 0.8 * error, "distance": error / 100 if labelled else np.nan}
        measures |= {"confidence": 0.97, "rotation_deg": turned, "translation_deg": 2 * turned}
        measures = measures if found else dict.fromkeys(measures, np.nan)
        about = {"input": name, "seed": seed, "status": status, "geometry": kind}
        yield RunRecord(**key, estimator=estimator, **about, **counts, **measures)


def _calibration(rng, key, name):
    for b in range(20):
        count, p = int(rng.integers(20, 40) * (1 + 100 * np.exp(-b))), (b + 0.5) / 20
        right = int(rng.binomial(count, min(1, 0.85 * p)))
        error = right * (1 - p) ** 2 + (count - right) * p**2
        sums = {"count": count, "right": right, "probability": count * p, "squared_error": error}
        yield kept_records.CalibrationRecord(**key, input=name, bin=b, **sums)


def timing_table(tables, *, pairs_per_group=2, seed=0):
    """Return timings of the first pairs of each group, of runs that the tables hold and of their cascade."""
    rng = np.random.default_rng(seed)
    shown = tables.pairs.groupby("group", sort=False).head(pairs_per_group)
    runs = tables.runs.merge(shown[["group", "pair_id"]], on=["group", "pair_id"])
    kept = ("group", "pair_id", "scene", "estimator", "seed", "error_px")
    records = []
    for run in runs[~runs["input"].isin(["adalam", "gms"])].itertuples():
        ranked = run.input in ("paper", "default")
        about = {column: getattr(run, column) for column in kept}
        for name in (run.input, "cascade") if run.input in ("standard", "generalized") else (run.input,):
            again = name == "cascade" and run.error_px > 10
            parts = {"features": 0.5, "matching": 0.1 + 0.6 * (ranked or again)}
            parts["estimator"] = float(rng.uniform(0.05, 0.5))
            seconds = {f"seconds_{part}": value for part, value in (parts | {"total": sum(parts.values())}).items()}
            about |= {"input": name, "preprocessed": ranked or again}
            records.append(kept_records.TimingRecord(**about, **seconds))
    return kept_records.to_frame(kept_records.TimingRecord, records)
