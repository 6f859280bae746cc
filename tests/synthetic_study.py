"""A small study made up of random numbers, in the files that the stages write."""

from pathlib import Path

import numpy as np
import pandas as pd

FAMILIES = ("open", "rolled")
INPUTS = {
    "usac": ("standard", "snn", "paper", "default"),
    "prosac": ("standard", "snn", "default"),
    "generalized-ransac": ("generalized", "snn", "default"),
    "epiprior": ("standard", "snn", "default"),
}
ESTIMATORS = tuple(INPUTS)
EASE = {"standard": 0.35, "generalized": 0.3, "snn": 0.5, "paper": 0.55, "default": 0.75}
RANKINGS = {"lowe": 0.3, "blogs": 0.35, "2keypoint": 0.5, "sfm": 0.6, "final": 0.8}


def write_study(root: Path, *, pairs: int = 12, seeds: int = 3) -> None:
    """Write ``data/`` below `root`."""
    rng = np.random.default_rng(0)
    for f, family in enumerate(FAMILIES):
        out = root / "data" / "evaluation" / family
        out.mkdir(parents=True)
        keys = [(family, f"{family}-test-{i:04d}", f"scene-{f}-{i // 2}") for i in range(pairs)]
        for name, rows in (
            ("results", _results(rng, keys, seeds)),
            ("rankings", _rankings(rng, keys)),
            ("ranking_curves", _curves(rng, keys)),
            ("roll", _roll(rng, keys)),
            ("calibration", _calibration(rng, keys)),
        ):
            pd.DataFrame(rows).to_csv(out / f"{name}.csv", index=False)
    _training(rng, root / "data" / "training")
    (root / "data" / "hand_over").mkdir(parents=True)
    pd.DataFrame(_hand_over(rng)).to_csv(root / "data" / "hand_over" / "search.csv", index=False)


def _key(key):
    return dict(zip(("family", "pair_id", "scene"), key, strict=True))


def _results(rng, keys, seeds):
    rows = []
    for key in keys:
        hardness = rng.random()
        for estimator in ESTIMATORS:
            for name in INPUTS[estimator]:
                for seed in range(seeds):
                    ease = EASE[name] + 0.2 * (estimator == "epiprior")
                    works = hardness + rng.normal(0, 0.1) < ease
                    none = not works and rng.random() < 0.3
                    error = rng.gamma(1.5, 1.2) if works else 10 * rng.lognormal(1, 0.6)
                    rows.append(
                        _key(key)
                        | {
                            "estimator": estimator,
                            "input": name,
                            "seed": seed,
                            # The verdict knows nothing of the truth here.
                            "status": "no_model" if none else "degenerate" if int(1e6 * error) % 9 == 0 else "ok",
                            "support": 0 if none else 50,
                            "spread": 0 if none else 30,
                            "plausibility": np.nan if none else 0.95,
                            "iterations": 100,
                            "error_px": np.nan if none else error,
                            "median_error_px": np.nan if none else 0.8 * error,
                        }
                    )
    return rows


def _rankings(rng, keys):
    return [
        _key(key)
        | {
            "preset": preset,
            "ranking": ranking,
            "matches": 3000,
            "right": 400,
            "precision_10": quality * rng.random(),
            "precision_100": quality * rng.random(),
            "precision_500": quality * rng.random(),
            "average_precision": quality * rng.random(),
        }
        for key in keys
        for preset in ("paper", "default")
        for ranking, quality in RANKINGS.items()
    ]


def _curves(rng, keys):
    ranks = np.unique(np.rint(10 ** np.linspace(0, 4, 25)).astype(int))
    rows = []
    for key in keys:
        for preset in ("paper", "default"):
            for ranking, quality in RANKINGS.items():
                right = np.cumsum(rng.random(10_000) < quality / (1 + np.arange(10_000) / 800))
                rows += [
                    _key(key) | {"preset": preset, "ranking": ranking, "rank": r, "right": right[r - 1]} for r in ranks
                ]
    return rows


def _roll(rng, keys):
    angle = np.arange(0, 360, 2.0)
    rows = []
    for key in keys:
        true = rng.uniform(-180, 180) if key[0] == "rolled" else 0.0
        density = 0.4 + 3 * np.exp((np.cos(np.deg2rad(angle - true)) - 1) * 60) + 0.1 * rng.random(len(angle))
        density /= density.sum() * 2
        rows += [
            _key(key) | {"true_roll_deg": true, "expected_roll_deg": true, "angle_deg": a, "density": d}
            for a, d in zip(angle, density, strict=True)
        ]
    return rows


def _calibration(rng, keys):
    rows = []
    for key in keys:
        for preset in ("paper", "default"):
            for b in range(20):
                count = int(rng.integers(20, 40) * (1 + 100 * np.exp(-b)))
                p = (b + 0.5) / 20
                right = int(rng.binomial(count, min(1, 0.85 * p)))
                rows.append(
                    _key(key)
                    | {"preset": preset, "bin": b, "count": count, "right": right}
                    | {
                        "probability": count * p,
                        "squared_error": right * (1 - p) ** 2 + (count - right) * p**2,
                    }
                )
    return rows


def _training(rng, out):
    for preset in ("paper", "default"):
        rows = []
        for target in ("two_keypoint", "match"):
            for k, family in enumerate(("tree", "forest", "svm", "lightgbm")):
                for grouped in (True, False):
                    for metric in (
                        "precision_top_100",
                        "average_precision",
                        "accuracy",
                        "precision",
                        "brier_score",
                    ):
                        value = 0.5 + 0.05 * k + 0.08 * (not grouped)
                        row = {"target": target, "family": family, "grouped": grouped, "metric": metric}
                        rows.append(row | {"fold": "all", "value": value})
                        rows += [row | {"fold": f, "value": value + rng.normal(0, 0.03)} for f in range(10)]
        (out / preset).mkdir(parents=True)
        pd.DataFrame(rows).to_csv(out / preset / "metrics.csv", index=False)


def _hand_over(rng):
    rows = []
    base = {
        "one_to_one": True,
        "top_k": None,
        "min_probability": None,
        "max_distance_ratio": None,
        "spread": None,
    }
    base |= {"threshold_px": 1.5, "collect": False, "refine": False, "pairs": 32}
    values = {
        "max_distance_ratio": (0.7, 0.75, 0.8, 0.85, 0.9),
        "top_k": (200, 300, 500, 1000, None),
        "min_probability": (0.1, 0.3),
        "threshold_px": (1.0, 2.0),
        "refine": (True,),
    }
    for estimator in ESTIMATORS:
        for name in INPUTS[estimator]:
            trials = []
            for step, levels in values.items():
                baseline = name in ("standard", "snn")
                if (step == "max_distance_ratio" and not baseline) or (step == "min_probability" and baseline):
                    continue
                for level in levels:
                    score = int(32 * EASE[name] + rng.integers(-3, 4))
                    row = {"estimator": estimator, "input": name, "step": step} | base | {step: level}
                    trials.append(row | {"successes_10": score, "successes_3": score - 4, "area": 0.5, "chosen": False})
            max(trials, key=lambda t: t["successes_10"])["chosen"] = True
            rows += trials
    return rows
