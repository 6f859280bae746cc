"""Arguments, options and exit codes that commands share."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from epiprior import presets
from epiprior.commands.printing import complain

if TYPE_CHECKING:
    from epiprior.types import FundamentalEstimate

NO_GEOMETRY = 1
BAD_INPUT = 2

Image1 = Annotated[Path, typer.Argument(metavar="A", help="First photograph.", show_default=False)]
Image2 = Annotated[Path, typer.Argument(metavar="B", help="Second photograph.", show_default=False)]
Preset = Annotated[str, typer.Option(help="'fast', 'default', 'thorough', or 'paper' (as printed).")]
Estimator = Annotated[str, typer.Option(help="See 'epiprior estimators'.")]
Mode = Annotated[
    presets.Mode,
    typer.Option(
        help="'cascade': simple matches first; ranked by probability only if that does not convince. 'preprocess': "
        "ranked at once. 'standard': the paper's standard matches."
    ),
]
Seed = Annotated[int, typer.Option(min=0, help="Of the random draw; same seed, same result.")]
Threshold = Annotated[
    float | None,
    typer.Option(help="Inlier threshold, pixels. Default: the estimator's own, as chosen on validation scenes."),
]
MinConfidence = Annotated[
    float | None,
    typer.Option(help="Status ok from this confidence on, 0 to 1. Default: what 1 % of unrelated pairs reach."),
]
MaxImageSize = Annotated[
    int | None,
    typer.Option(help="Longer side at which images are worked on, pixels. Default: the preset's.", show_default=False),
]
Detector = Annotated[
    Literal["sift", "colmap-sift"],
    typer.Option("--features", help="'sift' (OpenCV's) or 'colmap-sift' (VLFeat's, needs pycolmap)."),
]
MaxFeatures = Annotated[
    int | None, typer.Option(help="Strongest features kept of an image. Default: the preset's.", show_default=False)
]
Json = Annotated[bool, typer.Option("--json", help="Print JSON.")]


def chosen_settings(
    preset: str, detector: str, max_image_size: int | None, max_features: int | None
) -> presets.PreprocessSettings:
    """Return the preset with the features that were asked for; SettingsError names what is out of range."""
    settings = presets.find_preset(preset)
    own = settings.features
    longest = own.max_image_size if max_image_size is None else max_image_size
    limit = own.max_keypoints if max_features is None else max_features
    features = replace(own, detector=detector, max_image_size=longest, max_keypoints=limit)
    return replace(settings, features=features)


def exit_by_status(found: FundamentalEstimate) -> None:
    """Leave with exit code 1, and the reason on stderr, where there is no F."""
    if not found:
        complain(f"no fundamental matrix: {found.status.value}: {found.message}")
        raise typer.Exit(NO_GEOMETRY)
