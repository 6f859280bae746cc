import re

import pandas as pd
import pytest

from epiprior_lab.evaluation.records import TableError, Tables
from epiprior_lab.report.report import read_classifiers, write_folder_report
from html_reader import Reader
from synthetic_tables import PHOTOGRAPH_INPUTS, SETS, STUDY_INPUTS


@pytest.mark.parametrize("name", ["study_report", "photograph_report"])
def test_pages_are_whole_and_say_the_same(name, request):
    made, out = request.getfixturevalue(name)
    page, text = Reader((out / "index.html").read_text()), (out / "performance.md").read_text()
    assert page.open == []
    for link in page.links:
        assert link[1:] in page.ids if link.startswith("#") else link in ("timings/times.md",), link
    assert all((out / image).is_file() for image in page.images)
    cells = re.findall(r"(?<=\| )[^|\n]*(?= \|)", text)
    plain = [cell.replace("**", "").replace("`", "").strip() for cell in cells if set(cell) - {"-", ":"}]
    assert [cell.strip() for cell in page.cells if cell.strip()] == [cell for cell in plain if cell]
    for table in made:
        assert len(pd.read_csv(out / "tables" / f"{table}.csv")) == len(made[table])
    assert not re.search(r"\{|\bnan\b", text)
    assert text.rindex("\n## ") == text.index("\n## Bounds")


def test_the_small_table_leads_every_group_and_estimator_has_its_rows_and_no_photograph_is_committed(
    study_report, photograph_report, photographs
):
    for (made, out), inputs in ((study_report, STUDY_INPUTS), (photograph_report, PHOTOGRAPH_INPUTS)):
        text = (out / "performance.md").read_text()
        blocks = text[text.index("### Below 10 px") : text.index("## Against")]
        rows = [line for line in blocks.splitlines() if line.startswith(tuple(f"| {name} |" for name in inputs))]
        table = made["successes"].drop_duplicates(["threshold_px", "group", "estimator"])
        assert len(rows) == ((table["threshold_px"] == 10) | ~table["group"].isin(list(SETS))).sum()
        first = made["successes"].iloc[0]
        assert f" {first['successes']:.1f} ± {first['successes_sd']:.1f} |" in rows[0]
    made, out = photograph_report
    text = (out / "performance.md").read_text()
    rows = [line.strip("| ").split(" | ") for line in text.splitlines() if line.startswith("| ")][:8]
    titles = ["X_L", "snn", "AdaLAM", "GMS", "ALIKED + LightGlue", "cascade of snn and ours", "ours"]
    assert [row[0] for row in rows] == ["matches", *titles]
    assert [row[2] for row in rows] == ["features", *["1900"] * 4, "2048", "1900", "1900"]
    names = ("all pairs (12), 10 px", "hard pairs (6), 10 px", "all pairs (12), 3 px", "hard pairs (6), 3 px")
    assert rows[0][3:] == list(names)
    at = made["successes"]
    at = at[(at["group"] == "all") & (at["threshold_px"] == 10) & (at["input"] == "snn")]
    best = at.sort_values("successes", ascending=False, kind="stable").iloc[0]
    assert rows[2][1] == best["estimator"]
    assert float(rows[2][3].strip("*")) == pytest.approx(100 * best["successes"] / 12, abs=0.05)
    out, cases = photograph_report[1], photographs.cases
    page = Reader((out / "index.html").read_text())
    assert sum(image.startswith("gallery/") for image in page.images) == 2 * len(cases) > 0
    assert all(image.endswith(".png") for image in page.images)
    assert not list(out.rglob("*.jpg"))
    kept = photographs.gallery
    page = Reader((kept / "index.html").read_text())
    assert len(page.images) == 2 * len(cases)
    assert all((kept / image).is_file() for image in page.images)


@pytest.mark.slow
def test_a_folder_of_ones_own_has_the_same_bytes_each_time(study, tmp_path):
    keep = vars(study.results.tables)
    runs = keep["runs"]
    runs = runs[(runs["estimator"] == "usac") & (runs["input"] != "paper")]
    for out in (tmp_path / "a", tmp_path / "b"):
        write_folder_report(Tables(**{**keep, "runs": runs}), out)
    page = Reader((tmp_path / "a" / "index.html").read_text())
    assert page.open == []
    assert "how-well-it-works" in page.ids
    assert {"against-every-other-estimator", "bounds"}.isdisjoint(page.ids)
    for path in (tmp_path / "a").rglob("*.*"):
        assert path.read_bytes() == (tmp_path / "b" / path.relative_to(tmp_path / "a")).read_bytes(), path


def test_cross_validation_of_every_preset(tmp_path):
    (tmp_path / "paper").mkdir()
    text = "target,family,grouped,fold,metric,value\nmatch,tree,True,all,accuracy,0.5\n"
    (tmp_path / "paper" / "metrics.csv").write_text(text)
    assert read_classifiers(tmp_path, ["paper"])["preset"].tolist() == ["paper"]
    with pytest.raises(TableError, match="default"):
        read_classifiers(tmp_path, ["paper", "default"])
