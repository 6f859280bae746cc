"""``epiprior-lab``: the commands of the workspace that are no stages of the pipeline."""

import os
import sys
from pathlib import Path
from typing import Annotated

import typer

from epiprior.errors import EpipriorError
from epiprior_lab.labels.by_hand.command import label
from epiprior_lab.pairsets.importers.commands import register as register_importers

app = typer.Typer(
    help="Workspace of epiprior: evidence on photographs, registered models, the lock of the pipeline.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
app.command()(label)
register_importers(app)


@app.command()
def evaluate(
    folder: Annotated[Path, typer.Argument(help="A pair set in the uniform format, or a folder of pair sets.")],
    sets: Annotated[list[str] | None, typer.Option("--set", help="Only this set; may be repeated.")] = None,
    estimators: Annotated[
        list[str] | None, typer.Option("--estimator", help="Gets every input; may be repeated; magsac++ by default.")
    ] = None,
    seeds: Annotated[int, typer.Option(help="Repetitions of each estimate.")] = 3,
    out: Annotated[Path, typer.Option(help="Folder of the tables and the page.")] = Path("data/own-evaluation"),
    scheduler: Annotated[
        str | None, typer.Option(help="Dask scheduler that gets the pairs, such as tcp://host:8786.")
    ] = None,
) -> None:
    """Evaluate the exported model on pair sets of your own, against X_L and snn."""
    from epiprior_lab.compute.tasks import SCHEDULER_VARIABLE
    from epiprior_lab.evaluation.folder import ESTIMATOR, evaluate_folder
    from epiprior_lab.report.report import write_folder_report

    if scheduler:
        os.environ[SCHEDULER_VARIABLE] = scheduler
    found = evaluate_folder(folder, sets=sets, estimators=estimators or (ESTIMATOR,), seeds=seeds, out=out)
    write_folder_report(found, out)
    typer.echo(f"{out / 'index.html'}")


@app.command("link-sets")
def link_sets(
    source: Annotated[Path | None, typer.Argument(help="Folder of pair sets; none: check what is linked.")] = None,
    params: Annotated[Path, typer.Option(help="Parameters that name the sets.")] = Path("benchmarks/real/params.yaml"),
) -> None:
    """Link the pair sets of the benchmark on photographs into data/real, and make those that are made of them."""
    from epiprior_lab.evaluation.sets import link_sets, make_changed_sets
    from epiprior_lab.pairsets.changed import CHANGES
    from epiprior_lab.params import load_params

    own = load_params(params)
    given = [name for name in own.evaluate.groups if name not in CHANGES]
    sources = [name for name in given if name not in (own.evaluate.apart or ())]
    for path in link_sets(given, source):
        typer.echo(f"{path} -> {path.resolve()}" if path.is_symlink() else str(path))
    for path in make_changed_sets(own.evaluate.groups, sources, without=own.truth.one_plane or ()):
        typer.echo(str(path))


@app.command()
def promote(
    preset: Annotated[str, typer.Argument(help="Preset whose classifiers become champions: paper or default.")],
) -> None:
    """Register a preset's newest exported classifiers in MLflow, with the alias `champion`."""
    from epiprior_lab import tracking

    for name, version in tracking.promote(preset).items():
        typer.echo(f"{name}: version {version} is the champion")


@app.command()
def readme(root: Annotated[Path, typer.Option(help="Root of the repository.")] = Path()) -> None:
    """Write the result tables of the README anew from the reports."""
    from epiprior_lab.report.readme import render_readme

    path = root / "README.md"
    before = path.read_text(encoding="utf-8")
    after = render_readme(before, root)
    path.write_text(after, encoding="utf-8", newline="\n")
    typer.echo("README.md: its tables are those of the reports" if after == before else "README.md: tables written")


@app.command("check-lock")
def check_lock(root: Annotated[Path, typer.Option(help="Root of the repository.")] = Path()) -> None:
    """Check that dvc.lock, and that of the photographs, belong to this code, these parameters, models and reports."""
    from epiprior_lab import lockcheck

    stale = False
    for folder, command in lockcheck.PIPELINES.items():
        lock = Path(folder) / "dvc.lock"
        if folder and not (root / lock).is_file():
            typer.echo(f"{lock}: not there, photographs were not evaluated")
            continue
        differences = lockcheck.check_lock(root, folder)
        for stage, lines in sorted(differences.items()):
            typer.echo(f"{stage}: {'; '.join(lines)}")
        if differences:
            typer.echo(f"{lock} does not belong to this tree: run `{command}` and commit its results.", err=True)
            stale = True
        else:
            typer.echo(f"{lock} belongs to this code, these parameters and these results.")
    if stale:
        raise typer.Exit(1)


def main() -> None:
    """Run the command line; an error on purpose is one line and exit code 1."""
    try:
        app()
    except EpipriorError as error:
        typer.echo(f"error: {error}", err=True)
        sys.exit(1)


if __name__ == "__main__":
    main()
