"""Results on photographs, made up of random numbers, in the files that the stages write."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

SETS = {"strecha": ("easy", "medium"), "fox": ("hard",), "scannet15": ("hard",)}
APART = ("scannet15",)
INPUTS = {
    "usac": ("standard", "snn", "default", "gms"),
    "generalized-ransac": ("generalized", "snn", "default"),
    "epiprior": ("standard", "snn", "default"),
}
EASE = {"standard": 0.4, "generalized": 0.35, "snn": 0.5, "default": 0.8, "gms": 0.45}
SEEDS = (0, 1, 2)
PAIRS = 6


def write_photographs(data: Path) -> None:
    """Write ``<set>/*.csv`` below `data`; the last pair of each set but one has no labels."""
    rng = np.random.default_rng(0)
    for name, splits in SETS.items():
        tables: dict[str, list[dict[str, object]]] = {
            kind: [] for kind in ("pairs", "results", "rankings", "ranking_curves", "calibration")
        }
        for k in range(PAIRS):
            # Ids look like numbers: they must stay text.
            key = {"set": name, "pair_id": f"{k:04d}", "scene": f"0{k // 2}"}
            labelled = k < PAIRS - 1 or name == "fox"
            split = splits[k % len(splits)] if labelled else "unlabelled"
            share = {"easy": 0.7, "medium": 0.3, "hard": 0.1, "unlabelled": np.nan}[split] + 0.001 * k
            about = {"labels": "epipolar" if labelled else "none", "split": split, "right_share": share}
            about |= {"points": "cameras" if name in APART else "control_points", "standard_matches": 400}
            tables["pairs"].append(key | about)
            tables["results"] += [key | row for row in _runs(rng, cameras=name != "strecha", true_f=labelled)]
            if labelled:
                tables["rankings"] += [key | row for row in _rankings(rng)]
                tables["ranking_curves"] += [key | row for row in _curves()]
                tables["calibration"] += [key | row for row in _calibration(rng)]
        (data / name).mkdir(parents=True)
        for kind, rows in tables.items():
            pd.DataFrame(rows).to_csv(data / name / f"{kind}.csv", index=False)


def _runs(rng, *, cameras, true_f):
    hardness = rng.random()
    for estimator, names in INPUTS.items():
        for name in names:
            for seed in SEEDS:
                works = hardness + rng.normal(0, 0.15) < EASE[name]
                found = works or rng.random() < 0.6
                error = rng.gamma(1.5, 1.2) if works else 12 * rng.lognormal(1, 0.5)
                row = {"estimator": estimator, "input": name, "seed": seed, "iterations": 100, "matches": 200}
                turned_down = int(1e6 * error) % 9 == 0  # by a verdict that knows nothing of the truth
                status = "no_model" if not found else "degenerate" if turned_down else "ok"
                row |= {"status": status, "support": 120 if status == "ok" else 0}
                row |= {"spread": 60 if status == "ok" else 0, "plausibility": 0.97 if found else np.nan}
                row |= {"error_px": error if found else np.nan, "median_error_px": error / 2 if found else np.nan}
                row |= {"distance": error / 100 if found and true_f else np.nan}
                posed = found and cameras
                row |= {"rotation_deg": error if posed else np.nan, "translation_deg": 2 * error if posed else np.nan}
                yield row


def _rankings(rng):
    for name in ("standard", "snn", "default", "gms"):
        yield {"ranking": name, "matches": 300, "right": 100, "average_precision": 0.5 * EASE[name]} | {
            f"precision_{depth}": EASE[name] * rng.random() for depth in (10, 100, 500)
        }


def _curves():
    for name in ("standard", "snn", "default", "gms"):
        for rank in (1, 10, 100, 1000, 10_000):
            yield {"ranking": name, "rank": rank, "right": int(min(100, EASE[name] * rank))}


def _calibration(rng):
    for b in range(20):
        count, p = int(rng.integers(20, 60)), (b + 0.5) / 20
        right = int(rng.binomial(count, p))
        error = right * (1 - p) ** 2 + (count - right) * p**2
        yield {"preset": "default", "bin": b, "count": count, "right": right, "probability": count * p} | {
            "squared_error": error
        }
