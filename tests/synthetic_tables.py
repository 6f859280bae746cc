"""The four tables of a small study and of a small benchmark of photographs, made up of seeded random numbers."""

import numpy as np

from epiprior_lab.evaluation.records import (
    RANKINGS,
    RANKS,
    CalibrationRecord,
    PairRecord,
    RankingRecord,
    RunRecord,
    Tables,
    TimingRecord,
    to_frame,
)

SEEDS = (0, 1, 2)
EASE = {
    "standard": 0.35, "generalized": 0.3, "snn": 0.5, "paper": 0.55, "default": 0.75, "adalam": 0.55, "gms": 0.45,
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
    "usac": ("standard", "snn", "default", "adalam", "gms"),
    "magsac++": ("standard", "snn", "default", "adalam", "gms"),
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
    yield PairRecord(
        **key,
        features1=2000,
        features2=1800,
        labels="control_points" if labelled else "",
        points="cameras" if apart else "control_points",
        right_share={"easy": 0.7, "medium": 0.3, "hard": 0.1, "": np.nan}[difficulty] + 0.001 * rng.random(),
        difficulty=difficulty,
        true_roll_deg=roll,
        expected_roll_deg=roll % 360 if cameras else 0.0,
    )
    yield from _runs(rng, key, inputs, cameras=cameras, labelled=labelled)
    used = dict.fromkeys(name for names in inputs.values() for name in names)
    if not labelled:
        return
    for name in used:
        for ranking in RANKINGS if name in ("paper", "default") else ("final",):
            quality = QUALITY[ranking] if name in ("paper", "default") else EASE[name]
            right = np.cumsum(rng.random(10_000) < quality / (1 + np.arange(10_000) / 800))
            yield RankingRecord(
                **key,
                input=name,
                ranking=ranking,
                matches=10_000,
                right=int(right[-1]),
                average_precision=float(quality * rng.random()),
                right_at=tuple(int(right[rank - 1]) for rank in RANKS),
            )
        if name in ("paper", "default"):
            yield from _calibration(rng, key, name)


def _runs(rng, key, inputs, *, cameras, labelled):
    hardness = rng.random()
    for estimator, names in inputs.items():
        for name in names:
            for seed in SEEDS:
                works = hardness + rng.normal(0, 0.1) < EASE[name] + 0.2 * (estimator == "epiprior")
                found = works or rng.random() < 0.7
                error = float(rng.gamma(1.5, 1.2) if works else 10 * rng.lognormal(1, 0.6))
                ok = found and int(1e6 * error) % 9 != 0  # the status knows nothing of the truth here
                yield RunRecord(
                    **key,
                    estimator=estimator,
                    input=name,
                    seed=seed,
                    status="ok" if ok else "degenerate" if found else "no_model",
                    support=120 if ok else 0,
                    matches=200,
                    spread=60 if ok else 0,
                    plausibility=0.97 if found else np.nan,
                    iterations=None if estimator == "prosac" else 100,
                    error_px=error if found else np.nan,
                    median_error_px=0.8 * error if found else np.nan,
                    distance=error / 100 if found and labelled else np.nan,
                    rotation_deg=error if found and cameras else np.nan,
                    translation_deg=2 * error if found and cameras else np.nan,
                )


def _calibration(rng, key, name):
    for b in range(20):
        count, p = int(rng.integers(20, 40) * (1 + 100 * np.exp(-b))), (b + 0.5) / 20
        right = int(rng.binomial(count, min(1, 0.85 * p)))
        error = right * (1 - p) ** 2 + (count - right) * p**2
        yield CalibrationRecord(
            **key, input=name, bin=b, count=count, right=right, probability=count * p, squared_error=error
        )


def timing_table(tables, *, pairs_per_group=2, seed=0):
    """Return timings of the first pairs of each group, of runs that the tables hold and of their cascade."""
    rng = np.random.default_rng(seed)
    shown = tables.pairs.groupby("group", sort=False).head(pairs_per_group)
    runs = tables.runs.merge(shown[["group", "pair_id"]], on=["group", "pair_id"])
    records = []
    for run in runs.itertuples():
        if run.input in ("adalam", "gms"):
            continue
        ranked = run.input in ("paper", "default")
        for name in (run.input, "cascade") if run.input in ("standard", "generalized") else (run.input,):
            again = name == "cascade" and run.error_px > 10
            parts = 0.5, 0.1 + 0.6 * (ranked or again), float(rng.uniform(0.05, 0.5))
            records.append(
                TimingRecord(
                    group=run.group,
                    pair_id=run.pair_id,
                    scene=run.scene,
                    estimator=run.estimator,
                    input=name,
                    seed=run.seed,
                    seconds_features=parts[0],
                    seconds_matching=parts[1],
                    seconds_estimator=parts[2],
                    seconds_total=sum(parts),
                    preprocessed=ranked or again,
                    error_px=run.error_px,
                )
            )
    return to_frame(TimingRecord, records)
