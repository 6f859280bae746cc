"""Commands on what comes with epiprior: `info` on models, and the list of `estimators`."""

from pathlib import Path
from typing import Annotated

import typer

from epiprior.commands.options import Json
from epiprior.commands.printing import entries, print_json, print_table
from epiprior.errors import ModelError


def info(
    model: Annotated[str, typer.Argument(metavar="MODEL", help="Name or folder.", show_default=False)],
    as_json: Json = False,
) -> None:
    """Check a model's files and print what it was trained on, its columns, metrics and versions.

    epiprior info default

    epiprior info models/paper --json
    """
    from epiprior.ranking.models import find_model, load_model

    folder = Path(model)
    if not any(slash in model for slash in "/\\"):
        try:
            folder = find_model(model)
        except ModelError:
            if not folder.is_dir():
                raise
    loaded = load_model(folder)
    if as_json:
        print_json({"folder": str(folder), **loaded.manifest})
        return
    rows = [("folder", str(folder)), *entries(loaded.manifest)]
    print_table(("entry", "value"), rows, title=f"model {loaded.name}")


def estimators(as_json: Json = False) -> None:
    """List the estimators: available here or what to install, and the licence of what runs."""
    from epiprior.estimators import licences, list_estimators

    licence, states = licences(), list_estimators()
    if as_json:
        print_json(
            [{"name": n, "available": a == "available", "status": a, "licence": licence[n]} for n, a in states.items()]
        )
        return
    rows = [(name, state, licence[name]) for name, state in states.items()]
    print_table(("estimator", "available, or what to install", "licence"), rows)
