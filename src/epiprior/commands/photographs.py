"""Commands on two photographs, `match`, `estimate`, `draw`, `explain`, and on what comes with epiprior."""

import math
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from epiprior.commands import options, printing


def match(
    image1: options.Image1,
    image2: options.Image2,
    *,
    out: Annotated[Path, typer.Option(help="Table to write: .csv or .npz.", show_default=False)],
    preset: options.Preset = "default",
    features: options.Detector = "sift",
    max_image_size: options.MaxImageSize = None,
    max_features: options.MaxFeatures = None,
) -> None:
    """Write the matches of two photographs with their probabilities, best first.

    One row per match; column `set` tells the roll hypotheses apart where there are two.

        epiprior match left.jpg right.jpg --out matches.csv
    """
    from epiprior.io.output import check_output
    from epiprior.io.tables import TABLES, write_matches

    check_output(out, TABLES)
    from epiprior import rank_matches

    settings = options.chosen_settings(preset, features, max_image_size, max_features)
    ranked = rank_matches(image1, image2, settings=settings)
    write_matches(out, ranked)
    counts = ", ".join(f"{len(s)} at a roll of {s.roll_deg:.0f} deg" for s in ranked.sets)
    if not any(len(s) for s in ranked.sets):
        from epiprior.features.detect import explain_shortage

        why = explain_shortage((image1, image2), (None, None), settings.features)
        printing.complain(f"no matches: {why or 'no feature resembles one of the other image'}")
        raise typer.Exit(options.NO_GEOMETRY)
    printing.say(f"{out}: {counts}")


def estimate(
    image1: options.Image1,
    image2: options.Image2,
    *,
    estimator: options.Estimator = "epiprior",
    mode: options.Mode = "cascade",
    seed: options.Seed = 0,
    threshold: options.Threshold = None,
    min_confidence: options.MinConfidence = None,
    preset: options.Preset = "default",
    features: options.Detector = "sift",
    max_image_size: options.MaxImageSize = None,
    max_features: options.MaxFeatures = None,
    as_json: Annotated[
        bool | None,
        typer.Option("--json/--text", help="Default: text on a terminal, JSON elsewhere.", show_default=False),
    ] = None,
) -> None:
    """Estimate the fundamental matrix F of two photographs: x2' F x1 = 0, pixels, top-left centre at (0, 0).

    epiprior estimate left.jpg right.jpg --estimator usac --json

    epiprior estimate left.jpg right.jpg --mode preprocess
    """
    from epiprior import estimate_fundamental

    settings = options.chosen_settings(preset, features, max_image_size, max_features)
    estimation = partial(estimate_fundamental, estimator=estimator, mode=mode, seed=seed, threshold_px=threshold)
    found = estimation(image1, image2, settings=settings, min_confidence=min_confidence)
    if sys.stdout.isatty() if as_json is None else not as_json:
        printing.print_estimate(found)
    else:
        printing.print_json(printing.estimate_as_json(found, preset, seed))
    options.exit_by_status(found)


def draw(
    image1: options.Image1,
    image2: options.Image2,
    *,
    out: Annotated[Path, typer.Option(help="Figure to write: .png or .jpg.", show_default=False)],
    estimator: options.Estimator = "epiprior",
    mode: options.Mode = "preprocess",
    seed: options.Seed = 0,
    threshold: options.Threshold = None,
    preset: options.Preset = "default",
    features: options.Detector = "sift",
    max_image_size: options.MaxImageSize = None,
    max_features: options.MaxFeatures = None,
    matches: Annotated[int, typer.Option(min=1, help="How many of the best matches.")] = 100,
) -> None:
    """Draw the best matches, coloured by probability, and the epipolar lines of some inliers.

    epiprior draw left.jpg right.jpg --out figure.png
    """
    from epiprior.io.output import PICTURES, check_output

    check_output(out, PICTURES)
    from epiprior import estimate_fundamental, rank_matches, snn_matches, standard_matches
    from epiprior.draw.pictures import DrawSettings, draw_matches, write_picture

    settings = options.chosen_settings(preset, features, max_image_size, max_features)
    ranked = None if mode == "standard" else rank_matches(image1, image2, settings=settings)
    estimation = partial(estimate_fundamental, estimator=estimator, mode=mode, seed=seed, threshold_px=threshold)
    found = estimation(image1, image2, settings=settings, ranked=ranked)
    if found.input == "snn":
        shown = snn_matches(image1, image2, features=settings.features)
    elif ranked is None or found.input != settings.name:
        shown = standard_matches(image1, image2, features=replace(settings.features, root=False))
    else:
        shown = min(ranked.sets, key=lambda s: abs(math.remainder(s.roll_deg - found.roll_deg, 360)))
    write_picture(out, draw_matches(image1, image2, shown, found, settings=DrawSettings(max_matches=matches)))
    printing.say(f"{out}: {printing.summary(found)}")
    options.exit_by_status(found)


def explain(
    image1: options.Image1,
    image2: options.Image2,
    *,
    match: Annotated[int, typer.Option(min=0, help="Row of the match in what 'epiprior match' writes, from 0.")],
    out: Annotated[Path | None, typer.Option(help="Figure to write: .png or .jpg.", show_default=False)] = None,
    preset: options.Preset = "default",
    features: options.Detector = "sift",
    max_image_size: options.MaxImageSize = None,
    max_features: options.MaxFeatures = None,
    as_json: options.Json = False,
) -> None:
    """Show why a match has its probability: its columns beside those of other matches, what holds it, its best F.

    Options as for 'epiprior match', whose rows it counts.

        epiprior explain left.jpg right.jpg --match 0 --out why.png
    """
    from epiprior.io.output import PICTURES, check_output

    if out:
        check_output(out, PICTURES)
    from epiprior.explain import explain_match

    found = explain_match(
        image1, image2, match, settings=options.chosen_settings(preset, features, max_image_size, max_features)
    )
    if out:
        from epiprior.draw.explanation import draw_explanation
        from epiprior.draw.pictures import write_picture

        write_picture(out, draw_explanation(image1, image2, found))
    if as_json:
        printing.print_json(printing.explanation_as_json(found))
    else:
        printing.print_explanation(found)
        if out:
            printing.say(f"{out}: the picture")


def info(
    model: Annotated[str, typer.Argument(metavar="MODEL", help="Name or folder.", show_default=False)],
    as_json: options.Json = False,
) -> None:
    """Check a model's files and print what it was trained on, its columns, metrics and versions.

    epiprior info default

    epiprior info models/paper --json
    """
    from epiprior.ranking.models import load_model
    from epiprior.settings_file import find_settings_file

    named = not any(slash in model for slash in "/\\")
    folder = (named and find_settings_file(model)) or Path(model)
    loaded = load_model(folder)
    if as_json:
        printing.print_json({"folder": str(folder), **loaded.manifest})
        return
    rows = [("folder", str(folder)), *printing.entries(loaded.manifest)]
    printing.print_table(("entry", "value"), rows, title=f"model {loaded.name}")


def estimators(as_json: options.Json = False) -> None:
    """List the estimators: available here or what to install, and the licence of what runs."""
    from epiprior.estimators import licences, list_estimators

    licence, states = licences(), list_estimators()
    if as_json:
        printing.print_json(
            [{"name": n, "available": a == "available", "status": a, "licence": licence[n]} for n, a in states.items()]
        )
        return
    rows = [(name, state, licence[name]) for name, state in states.items()]
    printing.print_table(("estimator", "available, or what to install", "licence"), rows)
