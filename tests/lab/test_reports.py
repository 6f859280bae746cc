"""Reports from a made-up study: numbers equal those computed here, files are whole and stable."""

import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure

from epiprior_lab import overhead
from epiprior_lab.params import ReportParams
from epiprior_lab.reports import report, study, style, tables
from synthetic_study import ESTIMATORS, FAMILIES, INPUTS, write_study

PARAMS = ReportParams(seed=1, success_px=10.0, strict_px=3.0, bootstrap_draws=200, contact_sheet_pairs=2)


def read(root: Path) -> study.Study:
    return study.Study.read(
        root / "data",
        root / "data" / "hand_over" / "search.csv",
        families=FAMILIES,
        presets=("paper", "default"),
    )


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    root = tmp_path_factory.mktemp("study")
    write_study(root)
    (root / "reports" / "figures").mkdir(parents=True)
    with style.styled(1, 1, (2, 1)) as (figure, _):
        style.save(figure, root / "reports" / "figures" / "contact_sheet.jpg")
    return root


@pytest.fixture(scope="module")
def written(root):
    sheet = root / "reports" / "figures" / "contact_sheet.jpg"
    return report.write_report(read(root), {"contact_sheet": sheet, "example": sheet}, root / "reports", PARAMS)


def results_of(root):
    frames = [pd.read_csv(root / "data" / "evaluation" / f / "results.csv") for f in FAMILIES]
    return pd.concat(frames)


def naive_successes(results, threshold):
    """Number of successful pairs per seed."""
    counts = dict.fromkeys(sorted(set(results["seed"])), 0)
    for row in results.itertuples():
        if row.status == "ok" and row.error_px < threshold:
            counts[row.seed] += 1
    return list(counts.values())


@pytest.mark.parametrize("threshold", [3.0, 10.0])
def test_performance_equals_counts_by_hand(root, written, threshold):
    table = pd.read_csv(root / "reports" / "performance.csv")
    table = table[table["threshold_px"] == threshold].set_index(["family", "estimator"])
    assert len(table) == (len(FAMILIES) + 1) * len(ESTIMATORS)
    results = results_of(root)
    for family in (*FAMILIES, "all"):
        chosen = results if family == "all" else results[results["family"] == family]
        for estimator in ESTIMATORS:
            row = table.loc[(family, estimator)]
            counts = {
                name: naive_successes(chosen[(chosen["estimator"] == estimator) & (chosen["input"] == name)], threshold)
                for name in INPUTS
            }
            for name in INPUTS:
                assert row[name] == pytest.approx(np.mean(counts[name]), rel=1e-5)
                assert row[f"{name}_sd"] == pytest.approx(np.std(counts[name], ddof=1), rel=1e-4, abs=1e-9)
            without, with_step = np.mean(counts["standard"]), np.mean(counts["default"])
            assert row["default_over_standard"] == pytest.approx((with_step - without) / without, rel=1e-4)
            assert row["default_minus_standard"] == pytest.approx(with_step - without, rel=1e-4, abs=1e-9)
            low, high = row["default_over_standard_low"], row["default_over_standard_high"]
            assert low < row["default_over_standard"] < high
            assert row["pairs"] == (24 if family == "all" else 12)


def test_a_failed_status_is_a_failure_whatever_its_error(root):
    results = results_of(root).assign(status="no_model")
    rates, scenes = study.success_rates(results, 10.0, estimator="usac", input="snn")
    assert not rates.any()
    assert len(rates) == len(scenes) == 24


def test_markdown_has_every_row(root, written):
    text = (root / "reports" / "performance.md").read_text()
    table = pd.read_csv(root / "reports" / "performance.csv")
    rows = [line for line in text.splitlines() if line.startswith(tuple(f"| {e} |" for e in ESTIMATORS))]
    assert len(rows) == len(table)
    first = table.iloc[0]
    assert f"| {first['default']:.1f} ± {first['default_sd']:.1f} |" in rows[0]
    assert tables.percent(first["default_over_standard"]) in rows[0]


def test_percent():
    assert [tables.percent(v) for v in (0.448, -0.012, 0.0, 0.001, 2.39, np.inf)] == [
        "+45 %",
        "-1 %",
        "0 %",
        "0 %",
        "+239 %",
        "new",
    ]


def test_ranking_and_calibration_tables(root, written):
    rankings = pd.concat(pd.read_csv(root / "data" / "evaluation" / f / "rankings.csv") for f in FAMILIES)
    table = pd.read_csv(root / "reports" / "rankings.csv").set_index(["preset", "family", "ranking"])
    chosen = (rankings["preset"] == "default") & (rankings["ranking"] == "final")
    assert table.loc[("default", "all", "final"), "precision_100"] == pytest.approx(
        rankings[chosen]["precision_100"].mean(), rel=1e-5
    )
    bins = pd.read_csv(root / "data" / "evaluation" / "open" / "calibration.csv")
    bins = bins[bins["preset"] == "paper"].groupby("bin").sum(numeric_only=True)
    error = sum(abs(b.probability - b.right) for b in bins.itertuples()) / bins["count"].sum()
    row = pd.read_csv(root / "reports" / "calibration.csv").set_index(["preset", "family"]).loc[("paper", "open")]
    assert row["expected_calibration_error"] == pytest.approx(error, rel=1e-5)
    assert row["brier_score"] == pytest.approx(bins["squared_error"].sum() / bins["count"].sum(), rel=1e-5)


def test_classifier_table_sets_honest_beside_leaking(root, written):
    table = pd.read_csv(root / "reports" / "classifiers.csv")
    table = table.set_index(["preset", "target", "family", "metric"])
    row = table.loc[("default", "match", "svm", "precision_top_100")]
    metrics = pd.read_csv(root / "data" / "training" / "default" / "metrics.csv")
    metrics = metrics[(metrics["target"] == "match") & (metrics["family"] == "svm")]
    metrics = metrics[metrics["metric"] == "precision_top_100"]
    for name, flag in (("grouped", True), ("ungrouped", False)):
        part = metrics[metrics["grouped"] == flag]
        assert row[name] == pytest.approx(part[part["fold"] == "all"]["value"].iloc[0])
        folds = part[part["fold"] != "all"]["value"]
        assert row[f"{name}_sd"] == pytest.approx(folds.std(), rel=1e-5)


class Page(HTMLParser):
    """Ids, links and images of a page, and whether its tags are balanced."""

    VOID = frozenset({"meta", "img", "br", "link", "hr"})

    def __init__(self, text):
        super().__init__()
        self.ids, self.links, self.images, self.open = [], [], [], []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attributes):
        values = dict(attributes)
        self.ids += [values["id"]] if "id" in values else []
        self.links += [values["href"]] if tag == "a" else []
        self.images += [values["src"]] if tag == "img" else []
        assert tag != "img" or values["alt"]
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def test_page_is_whole(root, written):
    text = (root / "reports" / "index.html").read_text()
    page = Page(text)
    assert not page.open
    sections = ["summary", "scenes", "example", "successes", "rankings", "roll", "calibration", "classifiers"]
    sections += ["hand-over", "time", "method"]
    assert page.ids == sections
    inside = [link for link in page.links if link.startswith("#")]
    assert [link[1:] for link in inside] == sections
    # Only timings are outside of the file; the stage that writes them uses these names.
    outside = [link for link in (*page.links, *page.images) if not link.startswith(("#", "data:"))]
    assert outside == ["timings/overhead.csv", "timings/overhead.png"]
    assert sum(image.startswith("data:image/png;base64,") for image in page.images) == 7
    assert sum(image.startswith("data:image/jpeg;base64,") for image in page.images) == 2
    table = pd.read_csv(root / "reports" / "performance.csv")
    for cell in table["default"]:
        assert f"{cell:.1f} ±" in text
    assert not re.search(r"\bnan\b|\bNone\b|Infinity", re.sub(r"base64,[^\"]+", "", text))


def test_everything_exists_and_is_the_same_again(root, written, tmp_path):
    for path in written:
        assert path.stat().st_size > 100
        if path.suffix == ".png":
            assert path.read_bytes().startswith(b"\x89PNG")
    sheet = root / "reports" / "figures" / "contact_sheet.jpg"
    again = report.write_report(read(root), {"contact_sheet": sheet, "example": sheet}, tmp_path, PARAMS)
    assert [p.read_bytes() for p in again] == [p.read_bytes() for p in written]


def test_missing_files_and_columns_are_named(root, tmp_path):
    with pytest.raises(study.ReportError, match=r"nowhere\.csv"):
        study.read_table(tmp_path / "nowhere.csv", "family")
    (tmp_path / "short.csv").write_text("family,pair_id\n")
    with pytest.raises(study.ReportError, match=r"short\.csv.*'scene'"):
        study.read_table(tmp_path / "short.csv", "family pair_id scene")


def test_overhead(root, tmp_path):
    rows = [
        {"family": family, "pair_id": p, "scene": p, "input": name, "estimator": estimator}
        | {"matching_seconds": m * (1 + f), "estimator_seconds": 0.5}
        for f, family in enumerate(FAMILIES)
        for p in "ab"
        for name, m in (("standard", 0.5), ("paper", 1.5), ("default", 2.5))
        for estimator in ESTIMATORS
    ]
    results = results_of(root)
    table = overhead.overhead_table(pd.DataFrame(rows), results, 10.0)
    assert len(table) == 2 * len(FAMILIES) * len(ESTIMATORS)
    row = table.set_index(["preset", "family", "estimator"]).loc[("default", "rolled", "prosac")]
    assert row["overhead"] == pytest.approx((2.5 * 2 + 0.5) / (0.5 * 2 + 0.5))
    part = results[(results["family"] == "rolled") & (results["estimator"] == "prosac")]
    a, b = (np.mean(naive_successes(part[part["input"] == name], 10.0)) for name in ("standard", "default"))
    assert row["contribution"] == pytest.approx((b - a) / a)
    table.loc[0, "contribution"] = np.inf
    assert -1 <= overhead.correlation(table) <= 1
    assert overhead.overhead_figure(table, tmp_path / "overhead.png").stat().st_size > 1000
    monotone = pd.DataFrame({"contribution": [0.1, 0.5, np.inf], "overhead": [4.0, 3.0, 2.0]})
    assert overhead.correlation(monotone) == pytest.approx(-1)


def test_style_leaves_global_settings_alone():
    before = Figure().get_facecolor()
    with style.styled(1, 1, (2, 1)) as (_, axes):
        assert not axes[0][0].spines["top"].get_visible()
    assert Figure().get_facecolor() == before
    assert Figure().subplots().spines["top"].get_visible()
