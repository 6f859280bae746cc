"""``epiprior-lab``: the commands of the workspace that are no stages of the pipeline."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from epiprior.errors import EpipriorError

app = typer.Typer(
    help="Workspace of epiprior: evidence on photographs, registered models, the lock of the pipeline.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


@app.command()
def promote(
    preset: Annotated[
        str, typer.Argument(help="Preset whose classifiers become champions: paper or default.")
    ],
) -> None:
    """Give the registered classifiers of a preset the alias `champion` in MLflow."""
    from epiprior_lab import tracking

    tracking.promote(preset)


@app.command("check-lock")
def check_lock(
    root: Annotated[Path, typer.Option(help="Root of the repository.")] = Path(),
) -> None:
    """Check that dvc.lock belongs to this code, these parameters, models and reports."""
    from epiprior_lab import lockcheck

    differences = lockcheck.check_lock(root)
    for stage, lines in sorted(differences.items()):
        typer.echo(f"{stage}: {'; '.join(lines)}")
    if differences:
        typer.echo(
            "dvc.lock does not belong to this tree: run `make repro` and commit its results.", err=True
        )
        raise typer.Exit(1)
    typer.echo("dvc.lock belongs to this code, these parameters and these results.")


def main() -> None:
    """Run the command line; an error on purpose is one line and exit code 1."""
    try:
        app()
    except EpipriorError as error:
        typer.echo(f"error: {error}", err=True)
        sys.exit(1)


if __name__ == "__main__":
    main()
