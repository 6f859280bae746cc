"""Stage `render`: the scenes of one split, a pair set per family."""

from __future__ import annotations

import argparse
from pathlib import Path

from epiprior_lab.datasets import PairFiles, encode_depth, write_pair_set
from epiprior_lab.parallel import Task, default_workers, map_tasks
from epiprior_lab.params import load_params
from epiprior_lab.scenes import render_pair
from epiprior_lab.scenes.photography import encode_jpeg
from epiprior_lab.seeds import child_seed


def render(*, pair_id: str, family: str, seed: int, width: int, height: int, jpeg_quality: int) -> PairFiles:
    """Return one pair with its files encoded."""
    pair = render_pair(family, seed, width=width, height=height)
    seen = pair.difference
    return PairFiles(
        pair_id=pair_id,
        scene=pair_id,
        difficulty=f"angle={seen.angle_deg:.1f}deg;overlap={seen.overlap:.2f};scale={seen.scale_ratio:.2f};"
        f"roll={seen.roll_deg:.0f}deg",
        camera1=pair.camera1,
        camera2=pair.camera2,
        jpeg1=encode_jpeg(pair.image1, jpeg_quality),
        jpeg2=encode_jpeg(pair.image2, jpeg_quality),
        depth1=encode_depth(pair.depth1),
        depth2=encode_depth(pair.depth2),
    )


def main() -> None:
    """Write ``data/scenes/<split>/<family>/``; every pair is a scene of its own, so splits share none."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--split", required=True, choices=("train", "validation", "test"))
    split = parser.parse_args().split
    scenes = load_params().scenes
    names = {
        family: [f"{family}-{split}-{number:04d}" for number in range(getattr(scenes.pairs, split)[family])]
        for family in scenes.families
    }
    tasks = [
        Task(
            name=name,
            payload={
                "pair_id": name,
                "family": family,
                "seed": child_seed(scenes.seed, "render", name),
                "width": scenes.image_width,
                "height": scenes.image_height,
                "jpeg_quality": scenes.jpeg_quality,
            },
        )
        for family, members in names.items()
        for name in members
    ]
    store = Path("data/.tasks/render") / split
    rendered = map_tasks(render, tasks, workers=default_workers(), description=f"render, {split}", store=store)
    by_name = {pair.pair_id: pair for pair in rendered}
    for family, members in names.items():
        write_pair_set(Path("data/scenes") / split / family, [by_name[name] for name in members])


if __name__ == "__main__":
    main()
