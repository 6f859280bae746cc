"""The three inputs on photographs: X_L as in the paper, `snn`, and ours, to the same estimator.

Neither training nor the search of hand-overs sees these photographs. Sets are kept in the uniform
layout of `epiprior_lab.pairsets`.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from rich.console import Console
from rich.table import Table

from epiprior.errors import SettingsError
from epiprior.estimators.handover import HandOver, find_hand_overs, hand_over, load_hand_overs
from epiprior.ranking.models import find_model
from epiprior.types import MatchSet
from epiprior_lab.compute.seeds import child_seed
from epiprior_lab.compute.tasks import Task, default_workers, map_tasks
from epiprior_lab.evaluation.estimates import estimate_row, write_rows
from epiprior_lab.evaluation.photographs.points import evaluation_points
from epiprior_lab.evaluation.statistics import precision_at, successes
from epiprior_lab.features.matching import PairMatches, match_pair
from epiprior_lab.labels.ground_truth import label_matches, reference_fundamental
from epiprior_lab.pairsets import DatasetError, Pair, read_pair_set

logger = logging.getLogger(__name__)
Row = dict[str, Any]

INPUTS = ("standard", "snn", "default")
TITLES = {"standard": "X_L", "snn": "snn", "default": "ours"}
ESTIMATOR = "magsac++"
TOP = 100
THRESHOLDS_PX = (10.0, 3.0)


def run_real(
    datasets: Path,
    *,
    sets: Sequence[str] | None = None,
    seeds: int = 3,
    out: Path = Path("data/real.csv"),
    workers: int | None = None,
    store: Path | None = Path("data/.tasks/real"),
    scheduler: str | None = None,
    console: Console | None = None,
) -> pd.DataFrame:
    """Evaluate the three inputs on sets of photographs, print a table per set, write a row per pair.

    Parameters
    ----------
    datasets : Path
        Folder of pair sets.
    sets : sequence of str, optional
        Names of the sets; all sub-folders that hold a ``pairs.csv`` by default.
    seeds : int
        Repetitions of each estimate, >= 1.
    out : Path
        CSV file: a row per pair, input and seed.
    workers : int, optional
        Processes; `parallel.default_workers` by default.
    store : Path, optional
        Where results per pair are kept, so that a run that was killed continues; None keeps none.
    scheduler : str, optional
        Address of a dask scheduler that gets the pairs; `parallel.default_scheduler` by default.
    console : Console, optional
        Where tables are printed.

    Returns
    -------
    DataFrame
        What was written.

    Raises
    ------
    SettingsError
        If `seeds` is below 1 or there is no such set.
    DatasetError
        If a set is damaged; nothing is skipped.
    """
    if seeds < 1:
        raise SettingsError(f"seeds is {seeds}, expected at least 1")
    console = console or Console()
    # `snn` is a fixed recipe (ratio below 0.85, all of it); on photographs it does better as it is than as validation
    # on rendered scenes would cut it.
    chosen = {**{name: load_hand_overs()[ESTIMATOR][name] for name in INPUTS}, "snn": HandOver()}
    rows: list[Row] = []
    for root in find_sets(datasets, sets):
        pairs = read_pair_set(root).pairs
        tasks = [
            Task(
                name=pair.pair_id,
                payload={
                    "pair": pair,
                    "set_name": root.name,
                    "seeds": tuple(range(seeds)),
                    "hand_overs": chosen,
                },
                files=(*pair.files, *_settings_files()),
            )
            for pair in pairs
        ]
        results = map_tasks(
            evaluate_photographs,
            tasks,
            workers=workers or default_workers(),
            description=root.name,
            store=None if store is None else store / root.name,
            scheduler=scheduler,
        )
        of_set = [row for result in results for row in result]
        console.print(summary(pd.DataFrame(of_set), title=root.name))
        rows += of_set
    table = pd.DataFrame(rows)
    # Where there are no control points errors mean something else; such sets stay apart.
    measured = table[table["points"] == "control_points"]
    if measured["set"].nunique() > 1:
        console.print(summary(measured, title="all sets with control points"))
    write_rows(rows, out)
    return table


def find_sets(datasets: Path, names: Sequence[str] | None = None) -> list[Path]:
    """Return the folders of pair sets, in the order of `names`, or all by name.

    Raises
    ------
    SettingsError
        If a named set is not there, or there is none at all; the message names it.
    """
    known = {path.parent.name: path.parent for path in sorted(datasets.glob("*/pairs.csv"))}
    if not known:
        raise SettingsError(f"{datasets}: no folder with a pairs.csv in it")
    missing = [name for name in names or () if name not in known]
    if missing:
        raise SettingsError(f"{datasets}: no set {missing[0]!r}; there are {', '.join(known)}")
    return [known[name] for name in names or known]


def _settings_files() -> tuple[Path, ...]:
    """Return what decides the results beside the photographs: files of the default model, the hand-over."""
    files = sorted(path for path in find_model("default").iterdir() if path.is_file())
    found = find_hand_overs()
    return (*files, *(() if found is None else (found,)))


def evaluate_photographs(
    *, pair: Pair, set_name: str, seeds: Sequence[int], hand_overs: Mapping[str, HandOver]
) -> list[Row]:
    """Evaluate one pair.

    Parameters
    ----------
    pair : Pair
        Two photographs.
    set_name : str
        Leads every row.
    seeds : sequence of int
        One estimate each.
    hand_overs : mapping of str to HandOver
        Per input.

    Returns
    -------
    list of dict
        One row per input and seed: ``set, pair_id, scene, input, seed, matches`` (handed over),
        ``precision_100`` (share of right matches among the first 100 of the list, one-to-one; a shorter list
        counts as filled up with wrong ones; NaN where too few control points leave F open) and the columns of
        `evaluation.estimate_row`. Matches are labelled by the true epipolar lines.
    """
    matches = match_pair(pair, INPUTS)
    points = evaluation_points(pair)
    rows = []
    for name in INPUTS:
        best = best_set(matches, name, hand_overs[name])
        precision = top_precision(pair, best)
        for seed in seeds:
            row = estimate_row(
                matches,
                points,
                estimator=ESTIMATOR,
                input_name=name,
                seed=child_seed(seed, pair.pair_id),
                hand_over=hand_overs[name],
            )
            rows.append(
                {
                    "set": set_name,
                    "pair_id": pair.pair_id,
                    "scene": pair.scene,
                    "points": "cameras" if pair.control_points_path is None else "control_points",
                    "input": name,
                    "seed": seed,
                    "matches": len(hand_over(best, hand_overs[name])),
                    "precision_100": precision,
                    **{key: value for key, value in row.items() if key != "matches"},
                }
            )
    return rows


def top_precision(pair: Pair, best: MatchSet) -> float:
    """Return the share of right matches among the first 100, or NaN where the ground truth decides no F."""
    try:
        if pair.truth == "epipolar":
            reference_fundamental(pair)
    except DatasetError:
        logger.warning("pair %s: its control points decide no F; matches are not labelled", pair.pair_id)
        return float("nan")
    return precision_at(label_matches(pair, best.x1, best.x2, best.scale1, best.scale2), TOP)


def best_set(matches: PairMatches, name: str, how: HandOver) -> MatchSet:
    """Return the one-to-one ranking of the roll hypothesis whose top 100 are the most probable."""
    sets = [matches.one_to_one() for matches in matches.sets[name]]
    cut = [s if how.max_distance_ratio is None else s.take(s.distance_ratio <= how.max_distance_ratio) for s in sets]
    return max(cut, key=lambda s: float(np.nansum(s.probability[:TOP])))


def summarise(rows: pd.DataFrame) -> pd.DataFrame:
    """Return one row per input.

    Parameters
    ----------
    rows : DataFrame
        As from `evaluate_photographs`.

    Returns
    -------
    DataFrame
        ``pairs``, ``precision_100`` (mean over pairs), ``successes_<threshold>`` (pairs, mean over seeds) and
        ``scene_share`` (share of successes at the first threshold per scene, mean over scenes: pairs of one
        scene are alike, and some scenes have many).
    """
    out = []
    for name in INPUTS:
        part = rows[rows["input"] == name]
        errors = part["error_px"]
        line: Row = {"input": name, "pairs": len(part.groupby(["set", "pair_id"]))}
        line["precision_100"] = float(part.groupby(["set", "pair_id"])["precision_100"].first().mean())
        for threshold in THRESHOLDS_PX:
            line[f"successes_{threshold:g}"] = float(successes(errors, threshold).sum() / part["seed"].nunique())
        right = part.assign(right=successes(errors, THRESHOLDS_PX[0]))
        line["scene_share"] = float(right.groupby(["set", "scene"])["right"].mean().mean())
        out.append(line)
    return pd.DataFrame(out)


def summary(rows: pd.DataFrame, *, title: str) -> Table:
    """Return a table for the terminal; the best number of each column is bold."""
    numbers = summarise(rows)
    formats = {"precision_100": "{:.2f}", **{f"successes_{t:g}": "{:.1f}" for t in THRESHOLDS_PX}}
    formats["scene_share"] = "{:.0%}"
    table = Table(title=f"{title}, {numbers['pairs'].max()} pairs", title_justify="left")
    table.add_column("input")
    table.add_column("top 100 right", justify="right")
    for threshold in THRESHOLDS_PX:
        table.add_column(f"below {threshold:g} px", justify="right")
    table.add_column(f"{THRESHOLDS_PX[0]:g} px, per scene", justify="right")
    for _, line in numbers.iterrows():
        cells = []
        for column, style in formats.items():
            text = style.format(line[column])
            best = style.format(numbers[column].max())
            cells.append(f"[bold]{text}[/bold]" if text == best else text)
        table.add_row(TITLES[str(line["input"])], *cells)
    return table
