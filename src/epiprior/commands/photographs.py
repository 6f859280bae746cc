"""Commands on photographs: `match`, `estimate`, `draw` and `colmap`."""

from __future__ import annotations

import itertools
import math
import sys
from pathlib import Path
from typing import Annotated

import typer

from epiprior.commands.options import (
    NO_GEOMETRY,
    Estimator,
    Image1,
    Image2,
    Mode,
    Preprocess,
    PreprocessSwitch,
    Preset,
    Seed,
    Threshold,
    exit_by_status,
)
from epiprior.commands.printing import complain, estimate_as_json, print_estimate, print_json, summary


def match(
    image1: Image1,
    image2: Image2,
    *,
    out: Annotated[Path, typer.Option(help="Table to write: .csv or .npz.", show_default=False)],
    preset: Preset = "default",
) -> None:
    """Write the matches of two photographs with their probabilities, best first.

    One row per match; column `set` tells the roll hypotheses apart where there are two.

        epiprior match left.jpg right.jpg --out matches.csv
    """
    from epiprior.io.output import check_output
    from epiprior.io.tables import TABLES, write_matches

    check_output(out, TABLES)
    from epiprior import rank_matches

    ranked = rank_matches(image1, image2, preset=preset)
    write_matches(out, ranked)
    counts = ", ".join(f"{len(s)} at a roll of {s.roll_deg:.0f} deg" for s in ranked.sets)
    if not any(len(s) for s in ranked.sets):
        complain("no matches: too few features in at least one of the images")
        raise typer.Exit(NO_GEOMETRY)
    typer.echo(f"{out}: {counts}")


def estimate(
    image1: Image1,
    image2: Image2,
    *,
    estimator: Estimator = "epiprior",
    mode: Mode = None,
    preprocess: PreprocessSwitch = None,
    seed: Seed = 0,
    threshold: Threshold = None,
    preset: Preset = "default",
    as_json: Annotated[
        bool | None,
        typer.Option("--json/--text", help="Default: text on a terminal, JSON elsewhere.", show_default=False),
    ] = None,
) -> None:
    """Estimate the fundamental matrix F of two photographs: x2' F x1 = 0, pixels, top-left centre at (0, 0).

    epiprior estimate left.jpg right.jpg --estimator usac --json

    epiprior estimate left.jpg right.jpg --mode cascade
    """
    from epiprior import estimate_fundamental

    found = estimate_fundamental(
        image1,
        image2,
        estimator=estimator,
        mode=mode,
        preprocess=preprocess,
        preset=preset,
        seed=seed,
        threshold_px=threshold,
    )
    if sys.stdout.isatty() if as_json is None else not as_json:
        print_estimate(found)
    else:
        print_json(estimate_as_json(found, preset, seed))
    exit_by_status(found)


def draw(
    image1: Image1,
    image2: Image2,
    *,
    out: Annotated[Path, typer.Option(help="Figure to write: .png or .jpg.", show_default=False)],
    estimator: Estimator = "epiprior",
    preprocess: Preprocess = True,
    seed: Seed = 0,
    threshold: Threshold = None,
    preset: Preset = "default",
    matches: Annotated[int, typer.Option(min=1, help="How many of the best matches.")] = 100,
) -> None:
    """Draw the best matches, coloured by probability, and the epipolar lines of some inliers.

    epiprior draw left.jpg right.jpg --out figure.png
    """
    from epiprior.io.output import PICTURES, check_output

    check_output(out, PICTURES)
    from epiprior import estimate_fundamental, rank_matches, standard_matches
    from epiprior.draw.pictures import DrawSettings, draw_matches, write_picture

    ranked = rank_matches(image1, image2, preset=preset) if preprocess else None
    found = estimate_fundamental(
        image1,
        image2,
        estimator=estimator,
        preprocess=preprocess,
        preset=preset,
        seed=seed,
        threshold_px=threshold,
        ranked=ranked,
    )
    if ranked is None:
        shown = standard_matches(image1, image2)
    else:
        shown = min(ranked.sets, key=lambda s: abs(math.remainder(s.roll_deg - found.roll_deg, 360)))
    write_picture(out, draw_matches(image1, image2, shown, found, settings=DrawSettings(max_matches=matches)))
    typer.echo(f"{out}: {summary(found)}")
    exit_by_status(found)


def colmap(
    images: Annotated[list[Path], typer.Argument(metavar="A B ...", help="Photographs.", show_default=False)],
    *,
    database: Annotated[Path, typer.Option(help="COLMAP database to write; must not exist.", show_default=False)],
    estimator: Estimator = "epiprior",
    mode: Mode = None,
    seed: Seed = 0,
    threshold: Threshold = None,
    preset: Preset = "default",
) -> None:
    """Write a COLMAP database with the verified matches of all pairs of the photographs.

    Needs pycolmap. Map it with `colmap mapper` or `pycolmap.incremental_mapping`.
    Exit code 1 only if no pair at all has a geometry.

        epiprior colmap left.jpg right.jpg --database database.db
    """
    from epiprior.io.colmap import ColmapPair, check_colmap_output, write_colmap_database

    if len(images) < 2:
        raise typer.BadParameter("give at least two photographs")
    check_colmap_output(database)
    from epiprior import estimate_fundamental

    pairs = []
    for a, b in itertools.combinations(images, 2):
        found = estimate_fundamental(
            a, b, estimator=estimator, mode=mode, preset=preset, seed=seed, threshold_px=threshold
        )
        typer.echo(f"{a} {b}: {summary(found)}")
        pairs.append(ColmapPair(image1=a, image2=b, estimate=found))
    write_colmap_database(database, pairs)
    if not any(pair.estimate for pair in pairs):
        exit_by_status(pairs[0].estimate)
