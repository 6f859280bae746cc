"""Arguments, options and exit codes that commands share."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from epiprior import mode
from epiprior.commands.printing import complain

if TYPE_CHECKING:
    from epiprior.types import FundamentalEstimate

NO_GEOMETRY = 1
BAD_INPUT = 2

Image1 = Annotated[Path, typer.Argument(metavar="A", help="First photograph.", show_default=False)]
Image2 = Annotated[Path, typer.Argument(metavar="B", help="Second photograph.", show_default=False)]
Preset = Annotated[str, typer.Option(help="'default' (the best measured) or 'paper' (as printed).")]
Estimator = Annotated[str, typer.Option(help="See 'epiprior estimators'.")]
Mode = Annotated[
    mode.Mode | None,
    typer.Option(
        help="'preprocess': matches are ranked by probability first (the default). 'standard': the paper's standard "
        "matches. 'cascade': standard matches first; ranked ones only if inliers cover little or F is implausible.",
        show_default=False,
    ),
]
Preprocess = Annotated[
    bool, typer.Option(help="Rank matches by probability first; without it, the paper's standard matches are used.")
]
PreprocessSwitch = Annotated[
    bool | None,
    typer.Option(
        "--preprocess/--no-preprocess", help="Short for '--mode preprocess' and '--mode standard'.", show_default=False
    ),
]
Seed = Annotated[int, typer.Option(min=0, help="Of the random draw; same seed, same result.")]
Threshold = Annotated[
    float | None,
    typer.Option(help="Inlier threshold, pixels. Default: the estimator's own, as chosen on validation scenes."),
]
Json = Annotated[bool, typer.Option("--json", help="Print JSON.")]


def exit_by_status(found: FundamentalEstimate) -> None:
    """Leave with exit code 1, and the reason on stderr, where there is no F."""
    if not found:
        complain(f"no fundamental matrix: {found.status.value}: {found.message}")
        raise typer.Exit(NO_GEOMETRY)
