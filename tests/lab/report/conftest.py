"""Results of a made-up study and of made-up photographs, and their reports, each written once."""

import itertools
from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest

from epiprior.verification.cascade import CascadeRule
from epiprior_lab.pairsets import known_sets
from epiprior_lab.params import PHOTOGRAPHS, GalleryParams, load_params
from epiprior_lab.report.bounds import BOUNDS, load_bounds
from epiprior_lab.report.material import Material
from epiprior_lab.report.pictures import choose_cases
from epiprior_lab.report.report import write_report
from epiprior_lab.report.results import Results
from synthetic_tables import APART, photograph_tables, study_tables

ROOT = Path(__file__).parents[3]
RULE = CascadeRule(min_confidence=0.95)


def metrics():
    rows = []
    names = ("precision_top_100", "average_precision", "accuracy", "precision")
    for preset, target in (("paper", "two_keypoint"), ("default", "match")):
        for (k, family), grouped, metric in itertools.product(enumerate(("tree", "svm")), (True, False), names):
            row = {"preset": preset, "target": target, "family": family, "grouped": grouped, "metric": metric}
            value = 0.5 + 0.1 * k + 0.08 * (not grouped)
            rows += [row | {"fold": fold, "value": value + 0.01 * fold} for fold in range(4)]
            rows.append(row | {"fold": "all", "value": value})
    return pd.DataFrame(rows)


def search():
    base = {"one_to_one": True, "top_k": None, "max_distance_ratio": None, "threshold_px": 1.5, "refine": False}
    base |= {"pairs": 48, "successes_3": 10, "area": 0.5}
    steps = {"top_k": (300, 500, None), "threshold_px": (1.0, 2.0), "refine": (True,)}
    rows = []
    for estimator, name, step in itertools.product(("usac", "epiprior"), ("standard", "default"), steps):
        row = base | {"estimator": estimator, "input": name, "step": step, "chosen": step == "refine"}
        rows += [row | {step: level, "successes_10": 20 + k} for k, level in enumerate(steps[step])]
    return pd.DataFrame(rows)


@pytest.fixture(scope="session")
def study():
    """What the report of a study shows."""
    params = replace(load_params(ROOT / "params.yaml").report, bootstrap_draws=100, hard_groups=("open",))
    results = Results(study_tables(pairs=8), params)
    bounds = [bound for bound in load_bounds(ROOT / BOUNDS, "study") if bound.group in results.masks]
    bounds = [bound for bound in bounds if bound.estimator in ("usac", "epiprior", "every")]
    cascaded = tuple(results.tables.runs["estimator"].unique())
    how = {"rule": RULE, "cascaded": cascaded, "classifiers": metrics(), "hand_over": search()}
    return Material(results=results, params=params, kind="study", bounds=bounds, **how)


@pytest.fixture(scope="session")
def photographs(tmp_path_factory):
    """The same for photographs; the pictures of the gallery are no pictures."""
    root = tmp_path_factory.mktemp("photographs")
    own = load_params(ROOT / PHOTOGRAPHS).report
    params = replace(own, bootstrap_draws=100, gallery=GalleryParams(estimator="usac", rescued=2, lost=1))
    results = Results(photograph_tables(), params, apart=APART)
    cases = choose_cases(results, "usac", rescued=2, lost=1, success_px=10.0)
    bounds = load_bounds(ROOT / BOUNDS, "photographs")
    how = {"rule": RULE, "cascaded": ("usac", "epiprior"), "gallery": root / "gallery", "cases": cases}
    for folder, suffix in ((root / "out" / "gallery", "png"), (root / "gallery", "jpg")):
        folder.mkdir(parents=True)
        for case in cases:
            for name in case.inputs:
                (folder / f"{case.name}-{name}.{suffix}").write_bytes(b"picture")
    how |= {"bounds": bounds, "known_sets": known_sets()}
    return Material(results=results, params=params, kind="photographs", **how)


@pytest.fixture(scope="session")
def study_report(study, tmp_path_factory):
    out = tmp_path_factory.mktemp("reports")
    return write_report(study, out), out


@pytest.fixture(scope="session")
def photograph_report(photographs):
    out = photographs.gallery.parent / "out"
    return write_report(photographs, out), out
