"""The command line. Exit codes: 0 ok, 1 no geometry found, 2 bad input or output."""

import io
import logging
import os
import sys
from importlib import metadata
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from epiprior.commands.collections import colmap, hloc, sfm
from epiprior.commands.options import BAD_INPUT
from epiprior.commands.photographs import draw, estimate, estimators, explain, info, match
from epiprior.commands.printing import complain, drop_stdout, say
from epiprior.errors import EpipriorError


class _Commands(TyperGroup):
    """Turn what can go wrong on a user's machine into one line on stderr; a bug keeps its traceback."""

    def main(self, *args: Any, **options: Any) -> Any:
        """Run the command line."""
        try:
            return super().main(*args, **options)
        except EpipriorError as error:
            complain(f"error: {error}")
        except OSError as error:
            drop_stdout()
            reason = error.strerror or str(error)
            complain(f"error: {error.filename}: {reason}" if error.filename else f"error: {reason}")
        sys.exit(BAD_INPUT)


app = typer.Typer(
    cls=_Commands,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
    help="Matches of two photographs with calibrated probabilities, and their fundamental matrix.",
    epilog="Exit codes: 0 ok, 1 no geometry found (the message says why), 2 bad input or output.",
)


def _print_version(wanted: bool) -> None:
    if wanted:
        say(f"epiprior {metadata.version('epiprior')}")
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
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a file name may hold bytes that are no text
            stream.reconfigure(errors="backslashreplace")
    # Read by OpenCV and pycolmap, which are imported later: their lines on stderr do not name the file.
    os.environ.setdefault("OPENCV_LOG_LEVEL", "FATAL")
    os.environ.setdefault("GLOG_minloglevel", "1")
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(logging.Formatter("epiprior: %(message)s"))
    logger = logging.getLogger("epiprior")
    logger.addHandler(handler)
    logger.setLevel(logging.WARNING if quiet else logging.INFO)
    ctx.call_on_close(lambda: logger.removeHandler(handler))


for command in (match, estimate, draw, explain, sfm, colmap, hloc, info, estimators):
    app.command()(command)


def main() -> None:
    """Run the command line."""
    app()


if __name__ == "__main__":
    main()
