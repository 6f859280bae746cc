"""Figures of the report: one per idea, for rendered scenes and photographs alike; each function writes one PNG file."""

from collections.abc import Mapping, Sequence
from itertools import chain, product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FixedLocator, MaxNLocator, NullLocator
from scipy import stats

from epiprior.types import FloatArray
from epiprior_lab.evaluation.records import RANKS, right_column
from epiprior_lab.report import style, text
from epiprior_lab.report.results import Results, where
from epiprior_lab.report.style import DOTS, GRID, INK, MUTED, SERIES, label_grid, legend, looks_of, styled
from epiprior_lab.report.tables import calibration_sums, reliability
from epiprior_lab.report.text import ALL, METRIC_TITLES, Look, group_title, input_title, order_of, setting

MIN_BAR = 30  # a share of fewer runs says little
FEW_RUNS = 5
DRAWN_METRICS = ("precision_top_100", "average_precision", "accuracy", "precision")
_DECIDED = {"better": "#d55e00", "open": "#8b919b", "worse": "#0072b2"}
_MARKERS = ("o", "s", "^", "D", "v", "P", "X", "<", ">", "p", "h", "*")
_SETTINGS = {
    "max_distance_ratio": "distance ratio,\nat most",
    "top_k": "best matches,\nat most",
    "threshold_px": "inlier\nthreshold, px",
    "one_to_one": "one-to-one\nmatches",
    "refine": "F refined",
    "collect": "support\ncollected",
}


def _names(axis: Axes, names: Sequence[str]) -> FloatArray:
    """Put names along the y axis, the first on top, and return their heights."""
    y = np.arange(len(names), dtype=np.float64)[::-1]
    for between in y[1:] + 0.5:
        axis.axhline(between, color=GRID, lw=0.8)
    axis.set_yticks(y, list(names))
    axis.tick_params(axis="y", labelsize=8.5, labelcolor=INK)
    axis.set_ylim(-0.6, len(names) - 0.4)
    axis.grid(axis="y", visible=False)
    return y


def success_figure(successes: pd.DataFrame, groups: Sequence[str], thresholds_px: Sequence[float], path: Path) -> None:
    """Draw successes, a dot per estimator and input: a row per threshold, a column per group."""
    estimators, looks = order_of(successes["estimator"]), looks_of(order_of(successes["input"]))
    size = (2.6 * len(groups) + 0.8, (0.27 * len(estimators) + 0.75) * len(thresholds_px) + 0.4)
    with styled(path, len(thresholds_px), len(groups), size, sharey=True) as (figure, axes):
        for axis, (threshold, group) in zip(chain(*axes), product(thresholds_px, groups), strict=True):
            part = where(successes, group=group, threshold_px=threshold)
            y, pairs = _names(axis, estimators), int(part["pairs"].max())
            for k, (name, look) in enumerate(looks.items()):
                own = part[part["input"] == name].set_index("estimator").reindex(estimators)
                height = y + 0.12 * ((len(looks) - 1) / 2 - k)  # equal numbers must not hide each other
                how: Any = {"color": look.colour, "ms": 6 if look.marker == "o" else 4.5, "lw": 0.9, **DOTS}
                axis.errorbar(own["successes"], height, xerr=own["successes_sd"], fmt=look.marker, **how)
            axis.set(xlim=(-0.03 * pairs, 1.03 * pairs), xlabel=f"pairs of {pairs} below {threshold:g} px")
            axis.xaxis.set_major_locator(MaxNLocator(6, integer=True))  # pairs are whole
        label_grid(axes, columns=[group_title(group) for group in groups])
        legend(figure, list(looks.values()), markers=True)


def curve_figure(results: Results, path: Path) -> None:
    """Draw successful pairs over the threshold: a row per estimator, a column per group.

    Bars are one standard deviation over seeds, as in the paper's figure of results. Inputs of peers are left out.
    """
    looks = {name: look for name, look in looks_of(results.inputs_of_all).items() if name not in text.PEERS}
    groups = results.main[:-1] or results.main
    size = (2.55 * len(groups) + 0.4, 1.4 * len(results.estimators) + 0.9)
    with styled(path, len(results.estimators), len(groups), size, sharex=True, sharey="col") as (figure, axes):
        for axis, (estimator, group) in zip(chain(*axes), product(results.estimators, groups), strict=True):
            member = results.masks[group]
            errors = {n: results.errors[estimator, n][member] for n in results.inputs(estimator)}
            style.draw_curves(axis, looks, errors, np.arange(2.5, style.CURVE_LIMIT_PX, 2.5))
            axis.set_ylim(0, 1.03 * member.sum())
            axis.yaxis.set_major_locator(MaxNLocator(5, integer=True))
        titles = [group_title(group) for group in groups]
        label_grid(axes, rows=results.estimators, columns=titles, below="threshold, px")
        figure.supylabel("successful pairs", fontsize=9, color=MUTED)
        legend(figure, list(looks.values()))


def duel_figure(duels: pd.DataFrame, champion: str, groups: Sequence[str], path: Path) -> None:
    """Draw how many pairs one estimator is ahead of every other: a row per threshold, a column per group and input."""
    thresholds, rivals = list(dict.fromkeys(duels["threshold_px"])), order_of(duels["estimator"])
    places = [(group, name) for group in groups for name in order_of(duels["input"])]
    size = (2.5 * len(places) + 1.0, (0.25 * len(rivals) + 0.85) * len(thresholds) + 0.3)
    with styled(path, len(thresholds), len(places), size, sharey=True, sharex=True) as (figure, axes):
        for axis, (threshold, (group, name)) in zip(chain(*axes), product(thresholds, places), strict=True):
            part = where(duels, group=group, input=name, threshold_px=threshold).set_index("estimator").reindex(rivals)
            y = _names(axis, rivals)
            axis.axvline(0, color=MUTED, lw=0.9, zorder=1)
            for decided, colour in _DECIDED.items():
                chosen = (part["decided"] == decided).to_numpy()
                at = part[chosen]
                spans = [at["difference"] - at["difference_low"], at["difference_high"] - at["difference"]]
                axis.errorbar(at["difference"], y[chosen], xerr=spans, fmt="o", color=colour, ms=5, lw=1.3, **DOTS)
        columns = [f"{group_title(group)}\n{input_title(name)}" for group, name in places]
        label_grid(axes, rows=[f"below {t:g} px" for t in thresholds], columns=columns, below="pairs ahead")
        titles = {"better": f"{champion} is better", "open": "not decided", "worse": f"{champion} is worse"}
        legend(figure, [Look(title, _DECIDED[decided]) for decided, title in titles.items()], markers=True)


def ranking_figure(results: Results, path: Path) -> None:
    """Draw the share of right matches over the rank, mean over labelled pairs: a column per group.

    The first row compares the inputs, each in its own order; below, a row per ranked input compares its rankings.
    """
    table = results.tables.rankings
    ranked = [name for name in order_of(table["input"]) if table.loc[table["input"] == name, "ranking"].nunique() > 1]
    inputs = looks_of([name for name in results.inputs_of_all if (table["input"] == name).any()])
    rankings = looks_of(order_of(table["ranking"]), text.RANKINGS)
    kinds: list[tuple[str, dict[tuple[str, str], Look]]] = [
        ("inputs", {(name, "final"): look for name, look in inputs.items()}),
        *((input_title(n), {(n, r): look for r, look in rankings.items()}) for n in ranked),
    ]
    groups = [(name, results.rows_of(table, member)) for name, member in results.groups(results.main)]
    groups = [(name, part) for name, part in groups if len(part)]
    columns = [right_column(rank) for rank in RANKS]
    size = (2.75 * len(groups) + 2.2, 2.3 * len(kinds) + 0.4)
    with styled(path, len(kinds), len(groups), size, sharex=True, sharey=True) as (_, axes):
        for axis, ((_, looks), (_, of_group)) in zip(chain(*axes), product(kinds, groups), strict=True):
            for (name, ranking), look in looks.items():
                part = where(of_group, input=name, ranking=ranking)
                if len(part):
                    curve = part[columns].to_numpy(np.float64).mean(axis=0) / np.array(RANKS)
                    axis.plot(RANKS, curve, color=look.colour, ls=look.line, label=look.label)
            axis.set(xscale="log", ylim=(0, 1.02), xlim=(1, 10_000))
            axis.set_xticks([1, 10, 100, 1000, 10_000], ["1", "10", "100", "1,000", "10,000"])
        for *_, last in axes:
            last.legend(loc="center left", bbox_to_anchor=(1, 0.5))
        names = [f"{title}\nshare of right matches" for title, _ in kinds]
        titles = [group_title(group, len(part[["group", "pair_id"]].drop_duplicates())) for group, part in groups]
        label_grid(axes, rows=names, columns=titles, below="matches, best first")


def roll_figure(densities: Mapping[str, tuple[FloatArray, FloatArray, float]], path: Path) -> None:
    """Draw densities on a full turn: by pair its angles, the density, 1/degree, and the true roll, degrees."""
    columns = min(3, len(densities))
    rows = -(-len(densities) // columns)
    with styled(path, rows, columns, (3.4 * columns, 2.1 * rows + 0.4)) as (figure, axes):
        flat = list(chain(*axes))
        for axis, (pair_id, (angles, density, true)) in zip(flat, densities.items(), strict=False):
            angle = (angles + 180) % 360 - 180  # 0 is in the middle
            order = np.argsort(angle, kind="stable")
            axis.fill_between(angle[order], density[order], color="#0072b2", alpha=0.18, lw=0)
            axis.plot(angle[order], density[order], color="#0072b2", label="density over X_L and X_B")
            axis.axvline(true, color="#d55e00", ls=(0, (4, 2)), lw=1.5, label="true roll, from the cameras")
            axis.set(xlim=(-180, 180), ylim=(0, None), title=pair_id)
            axis.set_xticks([-180, -90, 0, 90, 180])
        for axis in flat[len(densities) :]:
            axis.set_visible(False)
        for row in axes:
            row[0].set_ylabel("density, 1/degree")
        label_grid(axes, below="roll of image 2 against image 1, degrees")
        style.axis_legend(figure, flat[0])


def calibration_figure(results: Results, path: Path) -> None:
    """Draw, per ranked input, the share of right matches over the stated probability, and how many state it."""
    table = results.tables.calibration
    names = order_of(table["input"])
    with styled(path, 2, len(names), (4.2 * len(names), 5.2), sharex=True) as (_, axes):
        for k, name in enumerate(names):
            of_input, upper, lower = table[table["input"] == name], axes[0][k], axes[1][k]
            upper.plot([0, 1], [0, 1], color=MUTED, lw=1, ls=(0, (2, 2)))
            for i, (group, member) in enumerate(results.groups(results.main[:-1] or results.main)):
                sums = calibration_sums(results.rows_of(of_input, member))
                upper.plot(*reliability(sums), color=SERIES[i % len(SERIES)], marker="o", ms=3.5, lw=1.4, label=group)
            sums = calibration_sums(results.rows_of(of_input, results.masks[ALL]))
            width = 1 / len(sums.count)
            place = (np.arange(len(sums.count)) + 0.5) * width
            lower.bar(place, sums.count, width * 0.92, color="#c9ced6", label="matches")
            lower.bar(place, sums.right, width * 0.92, color="#0072b2", label="right matches")
            lower.set(yscale="log", xlim=(0, 1), xlabel="stated probability")
            upper.set(title=input_title(name), ylim=(0, 1))
            note = f"Brier {sums.brier_score:.4f}, calibration error {sums.expected_calibration_error:.4f}"
            upper.set_title(note, loc="right", fontsize=8, fontweight="normal")
        axes[0][0].set_ylabel("share of right matches")
        axes[1][0].set_ylabel("matches")
        axes[0][0].legend(loc="upper left")
        axes[1][0].legend(loc="upper right")


def status_figure(statuses: pd.DataFrame, groups: Sequence[str], path: Path) -> None:
    """Draw the shares of right and of wrong F that are turned down, ``no_model`` paler; no bar below `MIN_BAR`."""
    looks = looks_of([name for name in order_of(statuses["input"]) if name != ALL])
    width = 0.8 / max(len(looks), 1)
    panels = (("right", "right F turned down"), ("wrong", "wrong F turned down"))
    with styled(path, 1, 2, (2.2 + 1.7 * len(groups), 3.4)) as (figure, axes):
        for axis, (kind, title) in zip(axes[0], panels, strict=True):
            tallest = 0.0
            for k, (name, look) in enumerate(looks.items()):
                part = statuses[statuses["input"] == name].set_index("group").reindex(list(groups))
                number = part[kind].where(part[kind] >= MIN_BAR)
                bottom, above = (
                    (100 * part[f"{kind}_{status}"] / number).fillna(0.0).to_numpy(np.float64)
                    for status in ("degenerate", "no_model")
                )
                place = np.arange(len(groups)) + (k - (len(looks) - 1) / 2) * width
                axis.bar(place, bottom, 0.9 * width, color=look.colour)
                axis.bar(place, above, 0.9 * width, bottom=bottom, color=look.colour, alpha=0.45)
                tallest = max(tallest, float((bottom + above).max(initial=0.0)))
            axis.set_xticks(range(len(groups)), list(groups), rotation=20 if len(groups) > 3 else 0)
            axis.grid(axis="x", visible=False)
            axis.set(title=title, ylim=(0, 100 if kind == "wrong" or not tallest else min(1.15 * tallest, 100)))
        axes[0][0].set_ylabel("share of the runs, %")
        handles = [Patch(color=look.colour, label=look.label) for look in looks.values()]
        handles += [Patch(color=INK, label="full: degenerate"), Patch(color=INK, alpha=0.45, label="pale: no_model")]
        legend(figure, [], more=handles)


def classifier_figure(table: pd.DataFrame, path: Path) -> None:
    """Draw metrics of each family of classifiers, folds by scene and by row: a row per preset and target."""
    subjects = list(dict.fromkeys(zip(table["preset"], table["target"], strict=True)))
    metrics = [name for name in DRAWN_METRICS if (table["metric"] == name).any()]
    kinds = (
        ("grouped", 0.2, "#0072b2", "folds by scene"),
        ("ungrouped", -0.2, "#e3a76f", "folds by row, as in the paper: optimistic (exported family)"),
    )
    size = (2.7 * len(metrics), 1.7 * len(subjects) + 0.6)
    with styled(path, len(subjects), len(metrics), size, sharex=True) as (figure, axes):
        for axis, ((preset, target), metric) in zip(chain(*axes), product(subjects, metrics), strict=True):
            values = where(table, preset=preset, target=target, metric=metric).set_index("family")
            y, both = np.arange(len(values))[::-1], values["ungrouped"].notna().to_numpy()
            for name, offset, colour, label in kinds:
                at, width = y + np.where(both, offset, 0.0), values[name].to_numpy(np.float64)
                axis.barh(at, width, 0.36, color=colour, label=label)
                deviation = values[f"{name}_sd"].fillna(0.0).to_numpy(np.float64)
                axis.errorbar(width, at, xerr=deviation, fmt="none", ecolor=INK, elinewidth=0.8)
            axis.set_yticks(y, [str(name) for name in values.index])
            axis.grid(axis="y", visible=False)
            axis.tick_params(labelleft=metric == metrics[0])
        axes[0][0].set_xlim(0, 1)
        names = [f"{preset}:\n{text.TARGET_TITLES.get(str(target), str(target))}" for preset, target in subjects]
        label_grid(axes, rows=names, columns=[METRIC_TITLES[metric] for metric in metrics])
        style.axis_legend(figure, axes[0][0])


def hand_over_figure(search: pd.DataFrame, path: Path) -> None:
    """Draw the search for hand-overs: a row per estimator, a column per setting, a line per input.

    The height is what settings were chosen by: the mean of the pairs below 10 px and below 3 px. A ring marks a choice.
    """
    search = search.assign(score=(search["successes_10"] + search["successes_3"]) / 2)
    settings = [name for name in _SETTINGS if (search["step"] == name).any()]
    estimators = order_of(search["estimator"])
    size = (1.6 * len(settings) + 0.9, 1.3 * len(estimators) + 1.1)
    with styled(path, len(estimators), len(settings), size, sharey="row") as (figure, axes):
        for axis, (estimator, name) in zip(chain(*axes), product(estimators, settings), strict=True):
            _sweep(axis, search[search["estimator"] == estimator], name)
        for axis, name in zip(axes[0], settings, strict=True):
            axis.set_title(_SETTINGS[name], fontsize=9)
        for first, *_ in axes:
            first.margins(y=0.14)
            first.yaxis.set_major_locator(MaxNLocator(4, integer=True))
        label_grid(axes, rows=estimators)
        figure.supylabel("validation pairs, mean of those below 10 px and below 3 px", fontsize=9, color=MUTED)
        legend(figure, list(looks_of(order_of(search["input"])).values()), markers=True)


def _sweep(axis: Axes, part: pd.DataFrame, name: str) -> None:
    """Draw the trials of one setting, and the best trial before it, from which they vary."""
    lines = []
    for owner, look in looks_of(order_of(part["input"])).items():
        of_input = part[part["input"] == owner]
        varied = of_input[of_input["step"] == name]
        if len(varied):
            before = of_input.loc[: varied.index[0]].iloc[:-1]
            trials = pd.concat([varied, before.sort_values(["score", "area"], kind="stable").tail(1)])
            lines.append((look, trials, {setting(value) for value in of_input.loc[of_input["chosen"], name]}))
    if not lines:
        axis.set_axis_off()
        return
    values = {setting(value): value for _, trials, _ in lines for value in trials[name]}
    levels = sorted(values, key=lambda name: np.inf if name == "none" else float(values[name]))  # no limit comes last
    for look, trials, final in lines:
        names = [setting(value) for value in trials[name]]
        x, y = np.array([levels.index(level) for level in names]), trials["score"].to_numpy()
        order = np.argsort(x, kind="stable")
        axis.plot(x[order], y[order], color=look.colour, ls=look.line, marker=look.marker, ms=3.2, lw=1.2)
        at = [k for k, level in enumerate(names) if level in final]
        axis.plot(x[at], y[at], "o", ms=8, mfc="none", mec=look.colour, mew=1.1)
    axis.set_xticks(range(len(levels)), levels)
    axis.set_xlim(-0.4, len(levels) - 0.6)


def overhead_figure(overhead: pd.DataFrame, path: Path) -> None:
    """Draw time overhead over contribution: one point per group and estimator, one panel per ranked input."""
    presets, groups = order_of(overhead["input"]), order_of(overhead["group"])
    estimators = order_of(overhead["estimator"])
    with styled(path, 1, len(presets), (4.6 * len(presets) + 1.2, 3.9), sharey=True) as (figure, axes):
        for axis, preset in zip(axes[0], presets, strict=True):
            own = overhead[overhead["input"] == preset]
            part = own[np.isfinite(own["contribution"])]
            # Linear up to a doubling, logarithmic above it: one large contribution must not squeeze all others.
            axis.set_xscale("symlog", linthresh=100, linscale=2)
            for row in part.to_dict("records"):
                colour = SERIES[groups.index(row["group"]) % len(SERIES)]
                marker = _MARKERS[estimators.index(row["estimator"]) % len(_MARKERS)]
                how: Any = {"s": 44, "edgecolor": "white", "linewidth": 0.8, "zorder": 3}
                axis.scatter(100 * row["contribution"], row["overhead"], color=colour, marker=marker, **how)
            # Of ranks, since a contribution is infinite where nothing succeeded without the step.
            varied = min(own["contribution"].nunique(), own["overhead"].nunique()) > 1
            rank = float(stats.spearmanr(own["contribution"], own["overhead"]).statistic) if varied else np.nan
            note = f"rank correlation {rank:+.2f}" if np.isfinite(rank) else "no correlation: no variation"
            if len(own) > len(part):
                note += f"\n{len(own) - len(part)} not shown: nothing succeeded without"
            axis.text(0.98, 0.97, note, transform=axis.transAxes, ha="right", va="top")
            axis.axvline(0, color=MUTED, lw=0.8, ls=(0, (2, 2)), zorder=0)
            axis.xaxis.set_major_locator(FixedLocator((-50, 0, 50, 100, 200, 500, 1000)))
            axis.xaxis.set_major_formatter("{x:g}")
            axis.xaxis.set_minor_locator(NullLocator())
            axis.set(title=input_title(preset), xlabel="contribution, %")
        axes[0][0].set(ylabel="time with the step / without", ylim=(0, overhead["overhead"].max() * 1.25))
        for k, group in enumerate(groups):
            axes[0][0].plot([], [], "o", color=SERIES[k % len(SERIES)], label=group)
        for k, estimator in enumerate(estimators):
            axes[0][0].plot([], [], _MARKERS[k % len(_MARKERS)], color=MUTED, label=estimator)
        figure.legend(loc="outside right center")


def seconds_figure(table: pd.DataFrame, path: Path) -> None:
    """Draw milliseconds per run of each estimator (`timing.seconds_table`), by outcome; hollow for few runs."""
    estimators, looks = order_of(table["estimator"]), looks_of(order_of(table["input"]))
    with styled(path, 1, 2, (9.6, 0.45 * len(estimators) + 1.3), sharex=True, sharey=True) as (figure, axes):
        for axis, outcome in zip(axes[0], ("success", "failure"), strict=True):
            y = _names(axis, estimators)
            for k, (name, look) in enumerate(looks.items()):
                part = where(table, input=name, outcome=outcome).set_index("estimator").reindex(estimators)
                mean, height = 1000 * part["mean"], y + 0.17 * ((len(looks) - 1) / 2 - k)
                few = (part["runs"] < FEW_RUNS).to_numpy()
                axis.plot(mean[~few], height[~few], look.marker, color=look.colour, ms=6, mec="white", mew=0.6)
                axis.plot(mean[few], height[few], look.marker, color=look.colour, ms=5, mfc="white", mew=1.1)
                for at, level, runs in zip(mean, height, part["runs"], strict=True):
                    if np.isfinite(at):
                        how: Any = {"textcoords": "offset points", "va": "center", "fontsize": 5.5}
                        axis.annotate(f"{runs:.0f}", (at, level), (5, 0), color=look.colour, **how)
            label = "milliseconds per run, matching left out"
            axis.set(title=f"runs that end in {outcome}", xlabel=label, xscale="log")
            style.label_logarithmic(axis)
        label = f"fewer than {FEW_RUNS} runs"
        few_runs = Line2D([], [], ls="", marker="o", color=MUTED, mfc="white", mew=1.1, label=label)
        dots = [Look(look.label, look.colour, "", look.marker) for look in looks.values()]
        legend(figure, dots, markers=True, more=[few_runs])
