import pandas as pd
import pytest

from epiprior_lab.report import figures, style
from epiprior_lab.report.pictures import rescued_pair, rolled_pairs


@pytest.fixture
def drawn(monkeypatch):
    """The figures that are drawn, instead of files."""
    found = []
    monkeypatch.setattr(style, "save", lambda figure, path: found.append(figure) or path)
    return found


def test_means_of_few_runs_are_hollow(drawn):
    runs = {"usac": 12, "prosac": 4}
    row = {"input": "snn", "outcome": "success", "mean": 0.02}
    figures.seconds_figure(pd.DataFrame(row | {"estimator": name, "runs": n} for name, n in runs.items()), None)
    axis = drawn[0].axes[0]
    assert [text.get_text() for text in axis.texts] == ["12", "4"]
    marks = {line.get_ydata()[0]: line.get_markerfacecolor() for line in axis.lines if line.get_marker() == "D"}
    assert (marks[1] == "white", marks[0] == "white") == (False, True)  # usac above prosac


def test_shares_of_few_runs_have_no_bar_and_the_tallest_ends_below_the_top(drawn):
    counts = {"right": [29, 30], "right_no_model": [9, 6], "right_degenerate": [9, 9]}
    counts |= {"wrong": [30, 0], "wrong_no_model": [3, 0], "wrong_degenerate": [3, 0]}
    figures.status_figure(pd.DataFrame({"group": ["easy", "hard"], "input": "snn", **counts}), ["easy", "hard"], None)
    right, wrong = drawn[0].axes
    assert sorted(bar.get_y() + bar.get_height() for bar in right.patches) == pytest.approx([0, 0, 30, 50])
    assert 50 < right.get_ylim()[1] < 60
    assert wrong.get_ylim() == (0, 100)


def test_successes_have_a_dot_per_input_and_estimator(study, study_report, drawn):
    table = study_report[0]["successes"]
    figures.success_figure(table, study.results.main[:-1], [10.0, 3.0], None)
    assert len(drawn[0].axes) == 4
    axis = drawn[0].axes[0]
    assert axis.get_title(loc="left") == "facades-easy"
    part = table[(table["group"] == "facades-easy") & (table["threshold_px"] == 10)]
    shown = sorted(x for line in axis.lines if line.get_marker() in "sDov^" for x in line.get_xdata() if x == x)
    assert shown == pytest.approx(sorted(part["successes"]))


def test_pairs_that_are_shown_are_rolled_most_or_gained_most(study):
    pairs = study.results.tables.pairs
    chosen = rolled_pairs(study.results, 4)
    assert len(chosen) == 4
    turns = [abs(roll) for roll in chosen.values()]
    assert turns == sorted(turns, reverse=True)
    assert turns[0] == pytest.approx(pairs["true_roll_deg"].abs().max())
    results, hard = study.results, study.results.masks["open"]
    for px in (10.0, 3.0):
        chosen = (results.tables.pairs["pair_id"] == rescued_pair(results, "open", px))[hard]
        gain = (results.errors.of("usac", "default", px) - results.errors.of("usac", "standard", px))[hard]
        assert gain[chosen] == gain.max()
