"""Stage `render`: the scenes of one split, a pair set per family.

Pairs that are evaluated, of validation and test, have to be solvable: a scene with too few right matches among X is
drawn anew. Training, of the rankers and of the confidence, takes every scene.
"""

from pathlib import Path
from tempfile import TemporaryDirectory

from epiprior_lab.compute.seeds import child_seed
from epiprior_lab.compute.tasks import Task, map_tasks
from epiprior_lab.labels.solvable import right_among_putative
from epiprior_lab.pairsets import PairFiles, encode_depth, read_pair_set, write_pair_set
from epiprior_lab.params import SPLITS, TruthParams, load_study, read_arguments
from epiprior_lab.scenes.pairs import SceneError, render_pair
from epiprior_lab.scenes.render import encode_jpeg

LEAST_RIGHT = 15  # right matches among X, of pairs that are evaluated
_DRAWS = 20


def render_solvable(
    *, seed: int, least_right: int, labels: TruthParams, pair_id: str, family: str, **size: int
) -> PairFiles:
    """Return the first of some draws whose X holds at least `least_right` right matches; of 0, the first.

    SceneError if there is none in 20 draws.
    """
    for draw in range(_DRAWS):
        # The first draw is that of the seed itself.
        own = child_seed(seed, str(draw)) if draw else seed
        files = render(pair_id=pair_id, family=family, seed=own, **size)
        with TemporaryDirectory() as folder:
            write_pair_set(Path(folder), [files])
            if least_right == 0 or right_among_putative(read_pair_set(folder).pairs[0], labels) >= least_right:
                return files
    raise SceneError(f"{pair_id}: none of {_DRAWS} draws has {least_right} right matches among X")


def render(*, pair_id: str, family: str, seed: int, width: int, height: int, jpeg_quality: int) -> PairFiles:
    """Return one pair with its files encoded."""
    pair = render_pair(family, seed, width=width, height=height)
    seen = pair.difference
    views = f"angle={seen.angle_deg:.1f}deg;overlap={seen.overlap:.2f};scale={seen.scale_ratio:.2f}"
    return PairFiles(
        pair_id=pair_id,
        scene=pair_id,
        difficulty=f"{views};roll={seen.roll_deg:.0f}deg",
        cameras=pair.cameras,
        jpegs=(encode_jpeg(pair.images[0], jpeg_quality), encode_jpeg(pair.images[1], jpeg_quality)),
        depths=(encode_depth(pair.depths[0]), encode_depth(pair.depths[1])),
    )


def main() -> None:
    """Write ``data/scenes/<split>/<family>/``; every pair is a scene of its own, so splits share none."""
    split = read_arguments(main.__doc__, split=SPLITS).split
    params = load_study()
    scenes = params.scenes
    common = {
        "least_right": LEAST_RIGHT if split in ("validation", "test") else 0,
        "labels": params.truth,
        "width": scenes.image_width,
        "height": scenes.image_height,
        "jpeg_quality": scenes.jpeg_quality,
    }
    for family in scenes.families:
        tasks = []
        for number in range(scenes.pairs[split][family]):
            name = f"{family}-{split}-{number:04d}"
            payload = {"pair_id": name, "family": family, "seed": child_seed(scenes.seed, "render", name), **common}
            tasks.append(Task(name=name, payload=payload))
        title, store = f"render, {split}, {family}", Path("data/.tasks/render") / split
        rendered = map_tasks(render_solvable, tasks, description=title, store=store)
        write_pair_set(Path("data/scenes") / split / family, rendered)


if __name__ == "__main__":
    main()
