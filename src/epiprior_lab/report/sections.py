"""The sections of a report: prose, tables and figures, made of the report's tables alone; empty ones vanish."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from epiprior.verification.cascade import CascadeRule
from epiprior_lab.params import ReportParams
from epiprior_lab.report.bounds import bound_rows
from epiprior_lab.report.cascade import cascade_blocks
from epiprior_lab.report.figures import MIN_BAR
from epiprior_lab.report.gallery import Case, case_blocks
from epiprior_lab.report.page import Block, Picture, Section, Table
from epiprior_lab.report.results import Results
from epiprior_lab.report.style import RANKING_LOOKS
from epiprior_lab.report.tables import ENOUGH_IN_BIN, ENOUGH_RIGHT, PRECISIONS, SNN
from epiprior_lab.report.text import (
    ALL,
    BASELINES,
    DIFFICULTIES,
    METRIC_TITLES,
    OURS,
    TARGET_TITLES,
    Row,
    best_bold,
    group_title,
    input_title,
    interval,
    number,
    order_of,
    points,
    setting,
    share,
    signed,
)

CASCADE_TITLE = "cascade of X_L and ours"


@dataclass(frozen=True, kw_only=True)
class Material:
    """Everything that a report shows.

    Parameters
    ----------
    results, params : Results, ReportParams
        What was found, and what is shown of it.
    tables : mapping of str to DataFrame
        By the names of their CSV files; those that there are.
    figures : mapping of str to str
        Paths of figures and pictures, relative to the page, by their names; those that there are.
    origin : str
        Where pairs and settings come from.
    rule : CascadeRule, optional
        Of the cascade.
    cases : sequence of Case
        Of the gallery; `gallery_kept` tells where the same one on photographs is.
    links : mapping of str to str
        Further sections that are pages or files of other stages: ``time``, ``analysis``.
    """

    results: Results
    params: ReportParams
    tables: Mapping[str, pd.DataFrame]
    figures: Mapping[str, str]
    origin: str
    rule: CascadeRule | None = None
    cases: Sequence[Case] = ()
    gallery_kept: str = ""
    links: Mapping[str, Sequence[Block]] = field(default_factory=dict)

    def picture(self, name: str, alt: str, caption: str = "") -> tuple[Picture, ...]:
        """Return a figure, or nothing where there is none."""
        return (Picture(path=self.figures[name], alt=alt, caption=caption),) if name in self.figures else ()

    def table(self, name: str) -> pd.DataFrame:
        """Return a table, or one without rows where there is none."""
        return self.tables.get(name, pd.DataFrame())

    @property
    def peers(self) -> list[str]:
        """Inputs of peers."""
        return [name for name in self.results.inputs_of_all if name not in (*BASELINES, SNN, "paper", OURS)]


def all_sections(material: Material) -> list[Section]:
    """Return the sections in the order of the page: how well, how measured, what falls short, and bounds last."""
    makers = {
        "How well it works": summary,
        "A rescued pair": example,
        "Successes": successes,
        "Against every other estimator": duels,
        "Poses and distances": poses,
        "Rankings": rankings,
        "Calibration": calibration,
        "Cascade": cascade,
        "Time": lambda m: m.links.get("time", ()),
        "Pairs": pairs,
        "How it was measured": method,
        "Hand-over": hand_over,
        "Classifiers": classifiers,
        "Roll": roll,
        "Analysis": lambda m: m.links.get("analysis", ()),
        "Verification": statuses,
        "What limits the results": limits,
        "Gallery": gallery,
        "Bounds": bounds,
    }
    return [Section(title=title, blocks=list(make(material))) for title, make in makers.items()]


def summary_rows(
    successes: pd.DataFrame, cascade: pd.DataFrame, groups: Sequence[str], thresholds: Sequence[float]
) -> Table:
    """Return the small table: per input, with the estimator that serves it best, shares of pairs that succeed.

    Parameters
    ----------
    successes, cascade : DataFrame
        As from `tables.success_table` and `cascade.cascade_table` (or without rows).
    groups : sequence of str
        Columns, for each of the thresholds.
    thresholds : sequence of float
        The estimator is the best over all pairs below the first, pixels.
    """
    columns = ["threshold_px", "group", "estimator", "pairs", "input", "successes"]
    parts = [successes[columns]]
    if len(cascade):
        parts.append(cascade.assign(input="cascade", successes=cascade["cascade"])[columns])
    table = pd.concat(parts, ignore_index=True)
    whole = table[(table["group"] == ALL) & (table["threshold_px"] == thresholds[0])]
    sizes = table.drop_duplicates("group").set_index("group")["pairs"]
    names = [name for name in order_of(whole["input"]) if name != "generalized"]
    found = []
    for name in sorted(names, key=lambda n: (n not in BASELINES, n == "cascade", n == OURS)):
        best = (
            whole[whole["input"] == name].sort_values("successes", ascending=False, kind="stable")["estimator"].iloc[0]
        )
        own = table[(table["input"] == name) & (table["estimator"] == best)].set_index(["group", "threshold_px"])
        values = [100 * own.loc[(g, t), "successes"] / sizes[g] for t in thresholds for g in groups]
        found.append(([CASCADE_TITLE if name == "cascade" else input_title(name), best], values))
    texts = np.array([best_bold(column) for column in zip(*(values for _, values in found), strict=True)]).T
    head = ["matches", "estimator", *(f"{group_title(g, int(sizes[g]))}, {t:g} px" for t in thresholds for g in groups)]
    return Table(head=head, rows=[[*who, *own] for (who, _), own in zip(found, texts.tolist(), strict=True)], texts=2)


def summary(m: Material) -> Iterator[Block]:
    """What it does and how well, against what a reader would use instead."""
    thresholds = list(dict.fromkeys((m.params.success_px, m.params.strict_px)))
    groups = (ALL, *(group for group in m.results.hard if group != ALL))
    yield (
        "Share of the pairs, in percent, whose fundamental matrix is right: mean error at control points below the "
        "threshold. Every kind of matches is shown with the estimator that serves it best over all pairs. X_L: the "
        "paper's standard matches, nearest neighbours of SIFT by distance ratio. snn: RootSIFT, mutual nearest "
        "neighbours, ratio test. Ours: ranked matches, the probability of each learnt."
    )
    yield summary_rows(m.table("successes"), m.table("cascade"), groups, thresholds)
    seeds = m.results.tables.runs["seed"].nunique()
    yield from m.picture(
        "successes",
        "Successful pairs per group and estimator, a dot per input",
        f"Successful pairs, mean over {seeds} seeds. Bars are one standard deviation over seeds, not the uncertainty "
        "over scenes. The X_L of `generalized-ransac` are all similar matches.",
    )


def example(m: Material) -> Iterator[Block]:
    """One pair before and after."""
    yield (
        "The pair that gained most, with `usac`. Left: the standard matches, coloured by distance ratio, and the "
        "epipolar lines of what the estimator made of them. Right: the same after preprocessing, coloured by probability."
    )
    caption = "Best one-to-one matches above, epipolar lines of inliers below."
    yield from m.picture("example", "Best matches and epipolar lines of one pair, before and after", caption)


def successes(m: Material) -> Iterator[Block]:
    """Successes of every estimator on every input, with contributions: the paper's Table 2."""
    table, results = m.table("successes"), m.results
    yield (
        "Pairs, mean over seeds ± one standard deviation. *Over X_L*: the paper's contribution, (with - without) / "
        "without, with its 95 % bootstrap interval over scenes; `new` where nothing succeeded without. For "
        "`generalized-ransac` all similar matches stand in the place of X_L. *Per scene*: share of successes, averaged "
        "over scenes, X_L → ours, and its change in percentage *points*: pairs of one scene are alike. *ok only*: "
        "successes X_L → ours if only runs with the status `ok` count. Success looks at F alone, whatever its status. " + _ok_sentence(m)
    )
    yield _compact(table, m)
    for threshold in m.params.thresholds_px:
        at = table[table["threshold_px"] == threshold]
        yield _success_block(at[at["group"].isin(results.main)], f"Below {threshold:g} px")
    details = [name for name in results.masks if name not in results.main]
    at = table[(table["threshold_px"] == m.params.success_px) & table["group"].isin(details)]
    if len(at):
        yield _success_block(at, f"Every set, below {m.params.success_px:g} px")
    caption = (
        "Successful pairs over the threshold on the error: a row per estimator, a column per group. The dashed line "
    )
    caption += "marks the paper's 10 px. Bars are one standard deviation over seeds."
    yield from m.picture("curves", "Successful pairs over the threshold", caption)
    yield "Every group at every threshold: `tables/successes.csv`; every pair: `tables/pairs.csv`."


def _ok_sentence(m: Material) -> str:
    table, champion = m.table("successes"), m.params.champion
    at = table[(table["threshold_px"] == m.params.success_px) & (table["group"] == ALL)]
    own = at[at["estimator"] == champion].set_index("input")
    if OURS not in own.index:
        return ""
    ours, without = own.loc[OURS], own[own["gain"].isna()].iloc[0]
    lost = (at["successes"] - at["successes_ok"])[at["input"] == OURS]
    return (
        f"If only runs with the status `ok` counted, {champion} would solve {ours['successes_ok']:.1f} pairs below "
        f"{m.params.success_px:g} px on our matches instead of {ours['successes']:.1f}, and "
        f"{without['successes_ok']:.1f} without preprocessing instead of {without['successes']:.1f}; the estimators "
        f"would lose {lost.min():.1f} to {lost.max():.1f} pairs each on ours."
    )


def _compact(table: pd.DataFrame, m: Material) -> Table:
    """Return one row per estimator; per group the successes on every input, the best bold; then shares per scene."""
    at = table[(table["threshold_px"] == m.params.success_px) & table["group"].isin(m.results.main)]
    records = at.set_index(["estimator", "group", "input"]).to_dict("index")
    groups = [group for group in m.results.main if (at["group"] == group).any()]
    by_scene = [group for group in groups if group in (*m.results.hard, ALL)]
    rows = []
    for estimator in order_of(at["estimator"]):
        names = [name for name in m.results.inputs(estimator) if name != "paper"]
        cells = [" / ".join(best_bold(records[estimator, g, n]["successes"] for n in names)) for g in groups]
        gain = interval(records[estimator, ALL, OURS], "gain") if OURS in names else ""
        scenes = [
            " / ".join(best_bold((100 * records[estimator, g, n]["scene_share"] for n in names), 0)) for g in by_scene
        ]
        rows.append([estimator, *cells, gain, *scenes])
    names = [input_title(name) for name in m.results.inputs_of_all if name not in ("generalized", "paper")]
    pairs = at.drop_duplicates("group").set_index("group")["pairs"]
    head = [f"{' / '.join(names)}, below {m.params.success_px:g} px", *(group_title(g, int(pairs[g])) for g in groups)]
    return Table(head=[*head, "ours over X_L", *(f"{g}, % per scene" for g in by_scene)], rows=rows)


def _success_block(at: pd.DataFrame, title: str) -> Table:
    others = [name for name in order_of(at["input"]) if name not in BASELINES]
    others.sort(key=lambda name: name == OURS)
    printed = ["as printed over X_L"] if "paper" in others else []
    head = [
        "estimator",
        "X_L",
        *map(input_title, others),
        *printed,
        "ours over X_L",
        "ours over snn",
        "per scene",
        "points",
    ]
    rows: list[list[str]] = []
    for group, of_group in at.groupby("group", sort=False):
        rows.append([group_title(str(group), int(of_group["pairs"].iloc[0]))])
        for estimator, part in of_group.groupby("estimator", sort=False):
            cells: dict[str, Row] = {str(row["input"]): row for row in part.to_dict("records")}
            without, ours = next(row for name, row in cells.items() if name in BASELINES), cells.get(OURS, {})
            found = [without, *(cells.get(name) for name in others)]
            texts = ["" if row is None else f"{row['successes']:.1f} ± {row['successes_sd']:.1f}" for row in found]
            gains = [interval(cells.get("paper", {}), "gain")] if printed else []
            gains += [interval(ours, "gain"), interval(ours, "snn_gain")]
            shares, oks = ((row.get(c, np.nan) for row in (without, ours)) for c in ("scene_share", "successes_ok"))
            scenes, ok = " → ".join(map(share, shares)), " → ".join(map(lambda value: number(value, 1), oks))
            rows.append([str(estimator), *texts, *gains, scenes, interval(ours, "scene_gain", points), ok])
    return Table(head=[*head, "ok only"], rows=rows, fold=title)


def duels(m: Material) -> Iterator[Block]:
    """One estimator against every other."""
    table, champion = m.table("duels"), m.params.champion
    yield (
        f"Pairs that `{champion}` is ahead of every other estimator on the same input, with 95 % bootstrap intervals "
        "over scenes; bold where the interval excludes zero."
    )
    yield from m.picture("duels", "Differences of successful pairs with intervals, per group and input")
    for threshold, at in table.groupby("threshold_px", sort=False) if len(table) else ():
        groups, inputs = order_of(at["group"]), order_of(at["input"])
        cells = at.set_index(["estimator", "group", "input"]).to_dict("index")
        rows = []
        for estimator in order_of(at["estimator"]):
            found = (cells.get((estimator, group, name), {}) for group in groups for name in inputs)
            texts = [(interval(row, "difference", signed), row.get("decided", "open")) for row in found]
            rows.append([estimator, *(text if kind == "open" else f"**{text}**" for text, kind in texts)])
        head = ["against", *(f"{group}, {input_title(name)}" for group in groups for name in inputs)]
        yield Table(head=head, rows=rows, fold=f"Pairs ahead below {threshold:g} px")


def poses(m: Material) -> Iterator[Block]:
    """Poses under the true calibration, and distances to the true F."""
    table, limits_deg = m.table("geometry"), sorted(m.params.pose_deg)
    if table.empty:
        return
    at = table[(table["cameras"] > 0) & table["group"].isin(m.results.main)]
    ours = at[(at["group"] == ALL) & (at["input"] == OURS) & (at["posed_successes"] > 0)]
    if len(ours):
        wrong = (ours["wrong_poses"] / ours["posed_successes"]).set_axis(ours["estimator"])
        own = (
            f"{share(wrong[m.params.champion])} with {m.params.champion}, " if m.params.champion in wrong.index else ""
        )
        yield (
            f"An error below {m.params.success_px:g} px on control points may hide a wrong geometry where these cover "
            "a part of the overlap only. Of the successes on our matches whose true pose is known, some have a pose "
            f"error above {limits_deg[-1]:g}°: {own}{share(wrong.min())} to {share(wrong.max())} over all estimators. "
            "The cells are areas under the curve of pose errors (the larger of both angles, true calibration), in "
            "percent, over pairs with cameras; a run without F is a failure."
        )
    if len(at):
        yield _pose_table(at, limits_deg, m)
    heads = [text for limit in limits_deg for text in (f"pose, AUC {limit:g}°", "per scene")]
    head = ["estimator", "input", *heads, f"distance < {m.params.distance_recall:g}", "median distance"]
    columns = [f"{kind}auc_{limit:g}" for limit in limits_deg for kind in ("", "scene_")] + ["distance_recall"]
    for group, part in table[table["group"].isin(m.results.main)].groupby("group", sort=False):
        rows = []
        for row in part.to_dict("records"):
            cells = [*(share(row.get(name, np.nan)) for name in columns), number(row.get("median_distance", np.nan), 4)]
            rows.append([row["estimator"], input_title(row["input"]), *cells])
        first = part.iloc[0]
        if first["cameras"] or first["true_F"]:
            title = f"{group_title(str(group))} ({first['cameras']} with cameras, {first['true_F']} with a true F)"
            yield Table(head=head, rows=rows, texts=2, fold=title)
    yield (
        "Distance: the normalised symmetric geometric distance to the true F; the share of runs below the limit, and "
        "the median. Every set: `tables/geometry.csv`."
    )


def _pose_table(at: pd.DataFrame, limits_deg: Sequence[float], m: Material) -> Table:
    groups, middle = order_of(at["group"]), limits_deg[len(limits_deg) // 2]
    places = [(group, middle) for group in groups if group != ALL]
    places += [(ALL, limit) for limit in limits_deg if ALL in groups]
    records = at.set_index(["estimator", "group", "input"]).to_dict("index")
    rows = []
    for estimator in order_of(at["estimator"]):
        names = [name for name in m.results.inputs(estimator) if name != "paper"]
        found = ((100 * records[estimator, group, name][f"auc_{limit:g}"] for name in names) for group, limit in places)
        rows.append([estimator, *(" / ".join(best_bold(values, 0)) for values in found)])
    cameras = at.drop_duplicates("group").set_index("group")["cameras"]
    names = [input_title(name) for name in m.results.inputs_of_all if name not in ("generalized", "paper")]
    return Table(
        head=[" / ".join(names), *(f"{group_title(g, int(cameras[g]))}, {t:g}°" for g, t in places)], rows=rows
    )


def rankings(m: Material) -> Iterator[Block]:
    """Precision of the lists of every input, and of every ranking of the ranked ones."""
    table = m.table("rankings")
    yield (
        "How many of the first matches are right. Each cell: mean over labelled pairs / mean over scenes of the means "
        "over their pairs. A list that is shorter than 10, 100 or 500 counts as filled up with wrong matches, as in "
        "the paper. The average precision does not: it is over the right matches that a list has, and so favours short "
        "ones. The gain is that of the top 100 over X_L in the order of the distance ratio, with its 95 % interval over scenes."
    )
    caption = (
        "Share of right matches among the best, mean over labelled pairs. A list that has ended goes on with wrong "
    )
    yield from m.picture("rankings", "Share of right matches over the rank", caption + "matches.")
    rows: list[list[str]] = []
    for group, part in table[table["group"].isin(m.results.main)].groupby("group", sort=False) if len(table) else ():
        rows.append([group_title(str(group), int(part["pairs"].max()))])
        for row in part.to_dict("records"):
            name, ranking = str(row["input"]), str(row["ranking"])
            kind = (
                ""
                if ranking == "final"
                else f", {RANKING_LOOKS[ranking].label if ranking in RANKING_LOOKS else ranking}"
            )
            cells = [f"{number(row[c])} / {number(row[f'scene_{c}'])}" for c in PRECISIONS]
            counts = [f"{row['matches']:.0f}", f"{row['right']:.0f}", share(row["enough"])]
            rows.append(
                [input_title(name) + kind, *cells, *counts, interval(row, "gain", lambda value: signed(value, 2))]
            )
    head = ["ranking", "top 10", "top 100", "top 500", "average precision", "matches", "right"]
    yield Table(head=[*head, f"pairs with {ENOUGH_RIGHT} right", "gain, top 100"], rows=rows)
    yield "Every set: `tables/rankings.csv`."


def calibration(m: Material) -> Iterator[Block]:
    """How far probabilities are right."""
    table = m.table("calibration")
    if table.empty:
        return
    shown = table[table["group"].isin(m.results.main)]
    yield "A probability of 0.3 should be right three times out of ten. " + " ".join(_calibration_sentences(shown))
    yield from m.picture(
        "calibration",
        "Share of right matches over the stated probability",
        "Above: share of right matches over the stated probability; the dashed line is perfect. Bins with fewer than "
        f"{ENOUGH_IN_BIN} matches are left out. Below: how many matches state it, on a logarithmic scale.",
    )
    rows = [
        [input_title(row["input"]), group_title(row["group"]), f"{row['matches']:,}", f"{row['right']:,}"]
        + [number(row["brier_score"], 4), number(row["expected_calibration_error"], 4)]
        + [share(row["lowest_share"]), number(row["upper_error"], 4)]
        for row in shown.to_dict("records")
    ]
    head = (
        "matches",
        "pairs",
        "ranked",
        "right",
        "Brier score",
        "calibration error",
        "in lowest bin",
        "error of others",
    )
    yield Table(head=head, rows=rows, texts=2)


def _calibration_sentences(shown: pd.DataFrame) -> Iterator[str]:
    """Say what hides behind the calibration error: how full the lowest bin is, and what the others say."""
    ours = shown[shown["input"] == OURS]
    for row in ours.to_dict("records"):
        if row["group"] == ALL:
            yield (
                f"{share(row['lowest_share'])} of all ranked matches are in the lowest bin of probability: that is why "
                "the calibration error over all matches is as small as "
                f"{number(row['expected_calibration_error'], 3)}; over the other bins it is {number(row['upper_error'], 3)}."
            )
        elif not np.isnan(row.get("gap_stated", np.nan)):
            title = group_title(row["group"])
            yield (
                f"{title[0].upper()}{title[1:]}: the lowest bin has {share(row['lowest_share'])}, the error of the "
                f"others is {number(row['upper_error'], 3)}; the bin that is furthest off states "
                f"{number(row['gap_stated'])} where {number(row['gap_right'])} are right, the highest "
                f"{number(row['top_stated'])} where {number(row['top_right'])} are right."
            )


def cascade(m: Material) -> Iterator[Block]:
    """Preprocessing only where it is needed."""
    table = m.table("cascade")
    if m.rule is not None and len(table):
        yield from cascade_blocks(table, m.rule, m.params.success_px)
        yield from m.picture(
            "cascade", "Runs lost over runs preprocessed", "How the rule was learnt: [cascade.md](cascade.md)."
        )


def pairs(m: Material) -> Iterator[Block]:
    """The pairs and their ground truth."""
    yield m.origin
    yield from m.picture("contact_sheet", "Contact sheet of test pairs", "Some of the test pairs of every family.")
    rows = []
    for row in m.table("sets").to_dict("records"):
        title = f"{row['title']} (the paper's)" if row["paper"] else str(row["title"])
        counts = ["" if pd.isna(row[name]) else str(row[name]) for name in ("scenes", *DIFFICULTIES, "unlabelled")]
        labels = "not present" if row["state"] == "not present" else str(row["labels"])
        labels += ", reported apart" if row["state"] == "apart" else ""
        rows.append([title, labels, str(row["pairs"]), *counts])
    yield Table(head=("set", "labels", "pairs", "scenes", *DIFFICULTIES, "unlabelled"), rows=rows, texts=2)
    yield (
        "Difficulties follow from the ground truth alone: by the share of right matches in X_L. Labels: what decides "
        "that a match is right. `depth` and `plane` are exact. `epipolar` and `control_points`: only the epipolar line "
        "decides, and 1 to 4 % of random matches satisfy that by chance. `none`: the control points decide no F, so "
        "nothing is labelled, and the pair has no difficulty."
    )


def method(m: Material) -> Iterator[Block]:
    """How it was measured."""
    seeds = m.results.tables.runs["seed"].nunique()
    peers = f"; {' and '.join(map(input_title, m.peers))}: rankers of others on the same features" if m.peers else ""
    yield "\n".join(
        (
            "- Error: mean over control points, spread over the overlap, of the root of the Sampson distance, as in "
            "the paper; where a pair has none, over a grid of points and points on their true epipolar lines. Success: "
            "below a threshold. A run without F is a failure.",
            "- Inputs. X_L: nearest neighbours of SIFT descriptors by distance ratio. All similar: all matches above a "
            "similarity with low probabilities, what `generalized-ransac` gets in its place. snn: RootSIFT, mutual "
            f"nearest neighbours, ratio below 0.85. Ours: the preset `default`; as printed: the preset `paper`{peers}.",
            f"- Every estimator gets every input with the same {seeds} seeds, so that differences are paired. A "
            "deterministic estimator runs once.",
            "- Intervals are percentile bootstrap intervals; whole scenes are drawn, because pairs of one scene are "
            "alike. A group of one scene has none.",
            "- Settings were chosen on rendered validation scenes, never on the pairs reported here.",
        )
    )
    rows = [
        [row["estimator"], row["backend"], f"{row['max_iterations']:,}"]
        + [
            "" if np.isnan(row["hypotheses"]) else f"{row['hypotheses']:,.0f}",
            "once" if row["deterministic"] else "per seed",
        ]
        for row in m.table("estimators").to_dict("records")
    ]
    yield Table(head=("estimator", "backend", "samples at most", "hypotheses, median", "runs"), rows=rows, texts=2)
    yield (
        "The cap is per roll hypothesis; hypotheses are those of both, where the backend tells. `epiprior` scores, "
        "beside its samples, the rough matrices of the preprocessing and pairs of oriented matches."
    )


def hand_over(m: Material) -> Iterator[Block]:
    """The settings that were chosen on validation scenes."""
    table = m.table("hand_over")
    yield (
        "How matches are handed to an estimator matters as much as their order. For every estimator and input, "
        "baselines included, settings were chosen on validation scenes alone: by the pairs below 10 px and below 3 px "
        "together, then by the area under the curve."
    )
    names = [
        name
        for name in ("max_distance_ratio", "top_k", "one_to_one", "threshold_px", "refine", "collect")
        if name in table.columns
    ]
    chosen = table[table["chosen"].astype(str).str.lower() == "true"] if len(table) else table
    rows = [
        [row["estimator"], input_title(row["input"]), *(setting(row[name]) for name in names)]
        + [f"{row['successes_10']:.1f} of {row['pairs']}"]
        for row in chosen.to_dict("records")
    ]
    head = ["estimator", "input", *(name.replace("_", " ") for name in names), "validation pairs below 10 px"]
    yield Table(head=head, rows=rows, texts=2)
    yield from m.picture(
        "hand_over",
        "Validation successes over the settings of the hand-over",
        "Mean of the validation pairs below 10 px and below 3 px as one setting varies, the others at the best found "
        "before. Rings mark what was chosen in the end.",
    )


def classifiers(m: Material) -> Iterator[Block]:
    """Cross-validation of the classifiers."""
    table = m.table("classifiers")
    yield (
        "Cross-validated on training scenes. Folds by scene keep matches of one pair on one side. Folds by row, as in "
        "the paper, put them on both, and so claim more. In each cell: by scene, then, for the family that the preset ships, by row."
    )
    rows = []
    for (preset, target, family), part in (
        table.groupby(["preset", "target", "family"], sort=False) if len(table) else ()
    ):
        values = part.set_index("metric")
        cells = [
            " ".join(filter(None, (number(values.loc[n, "grouped"], 3), number(values.loc[n, "ungrouped"], 3))))
            if n in values.index
            else ""
            for n in METRIC_TITLES
        ]
        rows.append([str(preset), TARGET_TITLES.get(str(target), str(target)), str(family), *cells])
    yield Table(head=("preset", "what is classified", "classifier", *METRIC_TITLES.values()), rows=rows, texts=3)
    caption = "Bars are means; lines are one standard deviation over folds."
    yield from m.picture("classifiers", "Metrics of the classifiers, folds by scene and by row", caption)


def roll(m: Material) -> Iterator[Block]:
    """Densities of the roll."""
    yield (
        "The differences of feature orientations over the standard matches tell how far one camera is rolled against "
        "the other. Everything after this step runs under the highest peak, and under no roll."
    )
    yield from m.picture(
        "roll",
        "Densities of the roll for some test pairs",
        "Density of the roll for some rolled test pairs, and the truth.",
    )


def statuses(m: Material) -> Iterator[Block]:
    """What the verification turns down."""
    table = m.table("statuses")
    yield (
        "An estimate comes with a status: `no_model` where chance would give as many inliers, `degenerate` where they "
        "leave F undecided, as on a plane. Everything above judges estimators by their F, whatever the status. Here "
        "the status is judged, over the runs of all estimators that gave an F: right ones, below "
        f"{m.params.success_px:g} px, that are turned down, and wrong ones that pass. Control points near one plane do "
        "not show a wrong epipole: there, a right F that is turned down may be wrong."
    )
    rows: list[list[str]] = []
    for group, part in table[table["group"].isin(m.results.main)].groupby("group", sort=False) if len(table) else ():
        rows.append([group_title(str(group))])
        for row in part.to_dict("records"):
            cells = [str(row["without_F"])]
            for kind in ("right", "wrong"):
                counts = [str(row[name]) for name in (kind, f"{kind}_no_model", f"{kind}_degenerate")]
                cells += [*counts, share(row[f"{kind}_turned_down"], 1)]
            rows.append(["all inputs" if row["input"] == ALL else input_title(row["input"]), *cells])
    kinds = ("of these no_model", "degenerate", "turned down")
    yield Table(head=("input", "runs without F", "right F", *kinds, "wrong F", *kinds), rows=rows)
    yield from m.picture(
        "statuses",
        "Shares of right and of wrong F that the verification turns down",
        "Shares of right and of wrong F that are turned down; the paler part is `no_model`. No bar stands for fewer "
        f"than {MIN_BAR} runs.",
    )
    yield "Every set: `tables/statuses.csv`."


def limits(m: Material) -> Iterator[Block]:
    """Where the champion fails, and who else solves these pairs."""
    table, champion = m.table("limits"), m.params.champion
    if table.empty:
        return
    row = table.iloc[0]
    lost, hard = row["failing"], row["pairs"]
    text = f"`{champion}` on our matches fails on {lost} of {hard} hard pairs at {m.params.success_px:g} px."
    if lost:
        text += (
            f" There the median precision of our top 100 is {number(row['precision_failing'])}, on the solved ones "
            f"{number(row['precision_solved'])}. In hindsight {row['other_input']} of the failing pairs are solved by "
            f"`{champion}` on another input, {row['other_estimator']} by another estimator on our matches, and "
            f"{row['anyone']} by any estimator on any input; the other {row['failing'] - row['anyone']} by none that "
            "was tried. A pair counts as solved if most runs succeed."
        )
    yield text
    names = ("pairs", "failing", "precision_failing", "precision_solved", "other_input", "other_estimator", "anyone")
    rows = [
        [str(row["group"]), *(number(row[n]) if n.startswith("precision") else str(row[n]) for n in names)]
        for row in table.to_dict("records")
    ]
    solved = ("solved by it on another input", "by another on ours", "by any on any input")
    yield Table(head=("hard pairs of", *names[:2], "top 100, failing", "top 100, solved", *solved), rows=rows)


def gallery(m: Material) -> Iterable[Block]:
    """Rescued and lost pairs, on blank frames."""
    if not m.cases or m.params.gallery is None:
        return ()
    text = (
        f"Pairs that preprocessing rescues ({m.params.gallery.estimator} fails in most runs without it and succeeds in "
        "most with it, with the status `ok` on the run that is drawn; those with the fewest right matches first), and "
        "pairs that it loses, those that most estimators lose first, against X_L or against snn. Drawn is the run with "
        "the median error; one whose status is not `ok` has no epipolar lines. The photographs may not be passed on: "
        f"here their frames are blank, with the best matches and the epipolar lines in place. The same gallery on the photographs: `{m.gallery_kept}`."
    )
    return (text, *case_blocks(m.cases, "gallery", "png"))


def bounds(m: Material) -> Iterator[Block]:
    """What was wanted before the results were known."""
    yield (
        "What was wanted before the results were known (`benchmarks/bounds.yaml`), and what came out. A bound is met "
        "by its value; a comparison of estimators only where the 95 % interval excludes zero for every rival. The best "
        "peer is the best of all other inputs with any estimator, chosen in hindsight. Times have bounds of their own, beside the times."
    )
    yield Table(head=("bound", "found", "met"), rows=bound_rows(m.table("bounds")), texts=3)
