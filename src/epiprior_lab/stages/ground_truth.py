"""Stage `ground_truth`: control points of the rendered pairs of one split, and how their views differ."""

from pathlib import Path

from epiprior.types import FloatArray
from epiprior_lab.compute.seeds import child_seed
from epiprior_lab.compute.tasks import Task, map_tasks
from epiprior_lab.labels.ground_truth import control_points_from_depth
from epiprior_lab.pairsets import (
    Pair,
    ViewDifference,
    read_pair_set,
    view_difference,
    write_control_points,
    write_table,
)
from epiprior_lab.params import SPLITS, load_study, read_arguments

SUMMARY = ("pair_id", "scene", "angle_deg", "overlap", "scale_ratio", "roll_deg", "control_points")


def measure(pair: Pair, count: int, seed: int) -> tuple[FloatArray, FloatArray, ViewDifference]:
    """Return the control points of one pair, in both images, and how its views differ."""
    cameras, depths = pair.depth_views()
    x1, x2 = control_points_from_depth(cameras, depths, count=count, seed=seed)
    return x1, x2, view_difference(cameras, depths, step=2)


def main() -> None:
    """Write ``data/ground_truth/<split>/<family>/``: control points of every pair, and ``summary.csv``."""
    split = read_arguments(main.__doc__, split=SPLITS).split
    params = load_study()
    truth = params.ground_truth
    for family in params.scenes.families:
        pairs = read_pair_set(Path("data/scenes") / split / family).pairs
        tasks = []
        for pair in pairs:
            seed = child_seed(truth.seed, "control points", pair.pair_id)
            payload = {"pair": pair, "count": truth.control_points, "seed": seed}
            tasks.append(Task(name=pair.pair_id, payload=payload, files=pair.files))
        title, store = f"ground truth, {split}, {family}", Path("data/.tasks/ground_truth") / split
        found = map_tasks(measure, tasks, description=title, store=store)
        out = Path("data/ground_truth") / split / family
        rows = []
        for pair, (x1, x2, seen) in zip(pairs, found, strict=True):
            write_control_points(out / "control_points" / f"{pair.pair_id}.csv", x1, x2)
            numbers = seen.angle_deg, seen.overlap, seen.scale_ratio, seen.roll_deg
            rows.append([pair.pair_id, pair.scene, *(f"{number:.4f}" for number in numbers), str(len(x1))])
        write_table(out / "summary.csv", SUMMARY, rows)


if __name__ == "__main__":
    main()
