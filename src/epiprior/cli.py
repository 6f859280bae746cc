"""The command line. Exit codes: 0 ok, 1 no geometry found, 2 bad input or output.

What is slow to import is imported by the command that needs it, so that ``epiprior --help`` answers at once.
"""

from __future__ import annotations

import itertools
import logging
import math
import os
import sys
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperGroup

from epiprior.errors import EpipriorError, ModelError
from epiprior.printing import (
    complain,
    entries,
    estimate_as_json,
    print_estimate,
    print_json,
    print_table,
    summary,
)

if TYPE_CHECKING:
    from epiprior.types import FundamentalEstimate

_NO_GEOMETRY = 1
_BAD_INPUT = 2


class _Commands(TyperGroup):
    """Turn what can go wrong on a user's machine into one line on stderr; a bug keeps its traceback."""

    def main(self, *args: Any, **options: Any) -> Any:
        """Run the command line."""
        try:
            return super().main(*args, **options)
        except EpipriorError as error:
            complain(f"error: {error}")
        except OSError as error:
            _drop_stdout()
            reason = error.strerror or str(error)
            complain(f"error: {error.filename}: {reason}" if error.filename else f"error: {reason}")
        sys.exit(_BAD_INPUT)


def _drop_stdout() -> None:
    """Send what could not be written nowhere, lest the interpreter complain once more at its end."""
    try:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except (OSError, ValueError):
        return


app = typer.Typer(
    cls=_Commands,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
    help="Matches of two photographs with calibrated probabilities, and their fundamental matrix.",
    epilog="Exit codes: 0 ok, 1 no geometry found (the message says why), 2 bad input or output.",
)

Image1 = Annotated[Path, typer.Argument(metavar="A", help="First photograph.", show_default=False)]
Image2 = Annotated[Path, typer.Argument(metavar="B", help="Second photograph.", show_default=False)]
Preset = Annotated[str, typer.Option(help="'default' (the best measured) or 'paper' (as printed).")]
Estimator = Annotated[str, typer.Option(help="See 'epiprior estimators'.")]
Preprocess = Annotated[
    bool,
    typer.Option(help="Rank matches by probability first; without it, the paper's standard matches are used."),
]
Seed = Annotated[int, typer.Option(min=0, help="Of the random draw; same seed, same result.")]
Threshold = Annotated[
    float | None,
    typer.Option(help="Inlier threshold, pixels. Default: the estimator's own, as chosen on validation scenes."),
]
Json = Annotated[bool, typer.Option("--json", help="Print JSON.")]


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"epiprior {metadata.version('epiprior')}")
        raise typer.Exit


@app.callback()
def set_up(
    ctx: typer.Context,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress messages on stderr.")] = False,
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Show the library's messages, such as that kernels are being compiled, on stderr."""
    del version
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(logging.Formatter("epiprior: %(message)s"))
    logger = logging.getLogger("epiprior")
    logger.addHandler(handler)
    logger.setLevel(logging.WARNING if quiet else logging.INFO)
    ctx.call_on_close(lambda: logger.removeHandler(handler))


@app.command()
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
        raise typer.Exit(_NO_GEOMETRY)
    typer.echo(f"{out}: {counts}")


@app.command()
def estimate(
    image1: Image1,
    image2: Image2,
    *,
    estimator: Estimator = "usac",
    preprocess: Preprocess = True,
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

    epiprior estimate left.jpg right.jpg --no-preprocess
    """
    from epiprior import estimate_fundamental

    found = estimate_fundamental(
        image1,
        image2,
        estimator=estimator,
        preprocess=preprocess,
        preset=preset,
        seed=seed,
        threshold_px=threshold,
    )
    if sys.stdout.isatty() if as_json is None else not as_json:
        print_estimate(found)
    else:
        print_json(estimate_as_json(found, preset if preprocess else None, seed))
    _exit_by_status(found)


@app.command()
def draw(
    image1: Image1,
    image2: Image2,
    *,
    out: Annotated[Path, typer.Option(help="Figure to write: .png or .jpg.", show_default=False)],
    estimator: Estimator = "usac",
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
    from epiprior.draw import DrawSettings, draw_matches, write_picture

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
    _exit_by_status(found)


@app.command()
def colmap(
    images: Annotated[list[Path], typer.Argument(metavar="A B ...", help="Photographs.", show_default=False)],
    *,
    database: Annotated[Path, typer.Option(help="COLMAP database to write; must not exist.", show_default=False)],
    estimator: Estimator = "usac",
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
        found = estimate_fundamental(a, b, estimator=estimator, preset=preset, seed=seed, threshold_px=threshold)
        typer.echo(f"{a} {b}: {summary(found)}")
        pairs.append(ColmapPair(image1=a, image2=b, estimate=found))
    write_colmap_database(database, pairs)
    if not any(pair.estimate for pair in pairs):
        _exit_by_status(pairs[0].estimate)


@app.command()
def info(
    model: Annotated[str, typer.Argument(metavar="MODEL", help="Name or folder.", show_default=False)],
    as_json: Json = False,
) -> None:
    """Check a model's files and tell what it was trained on, its columns, metrics and versions.

    epiprior info default

    epiprior info models/paper --json
    """
    from epiprior.models import load_model

    folder = _model_folder(model)
    loaded = load_model(folder)
    if as_json:
        print_json({"folder": str(folder), **loaded.manifest})
        return
    rows = [("folder", str(folder)), *entries(loaded.manifest)]
    print_table(("entry", "value"), rows, title=f"model {loaded.name}")


@app.command()
def estimators(as_json: Json = False) -> None:
    """List the estimators: available here or what to install, and the licence of what runs."""
    from epiprior.estimators.registry import estimators as availability
    from epiprior.estimators.registry import licences

    licence = licences()
    if as_json:
        print_json(
            [
                {"name": n, "available": a == "available", "status": a, "licence": licence[n]}
                for n, a in availability().items()
            ]
        )
        return
    rows = [(name, state, licence[name]) for name, state in availability().items()]
    print_table(("estimator", "available, or what to install", "licence"), rows)


def _model_folder(model: str) -> Path:
    from epiprior.models import find_model

    if any(slash in model for slash in "/\\"):
        return Path(model)
    try:
        return find_model(model)
    except ModelError:
        if Path(model).is_dir():
            return Path(model)
        raise


def _exit_by_status(found: FundamentalEstimate) -> None:
    if not found:
        complain(f"no fundamental matrix: {found.status.value}: {found.message}")
        raise typer.Exit(_NO_GEOMETRY)


def main() -> None:
    """Run the command line."""
    app()


if __name__ == "__main__":
    main()
