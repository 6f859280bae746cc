"""Where the photographs are: links to pair sets that lie elsewhere, what is made of them, and what is missing."""

import os
from collections.abc import Sequence
from pathlib import Path

from epiprior.errors import SettingsError
from epiprior_lab.pairsets import read_pair_set
from epiprior_lab.pairsets.changed import CHANGES, chosen_pairs, write_changed_set

FOLDER = Path("data/real")


def link_sets(names: Sequence[str], source: Path | None, folder: Path = FOLDER) -> list[Path]:
    """Link the named pair sets of a folder into another, and return their paths; without `source` check what is there.

    A set that lies in `folder` itself stays as it is; a link is set anew. SettingsError if `source` is no folder or
    holds none of the sets, since older links would be taken in silence, or if a set is missing after all.
    """
    if source is not None and not source.is_dir():
        raise SettingsError(f"{source}: no such folder of pair sets; `make real` alone takes what {folder} has")
    if source is not None and not any((source / name / "pairs.csv").is_file() for name in names):
        raise SettingsError(f"{source}: holds no pair set of {', '.join(names)}")
    for name in names:
        at = folder / name
        if source is None or not (source / name / "pairs.csv").is_file() or (at.exists() and not at.is_symlink()):
            continue
        target = (source / name).resolve()  # before the link goes: `source` may be `folder` itself
        folder.mkdir(parents=True, exist_ok=True)
        at.unlink(missing_ok=True)
        at.symlink_to(os.path.relpath(target, folder.resolve()), target_is_directory=True)
    missing = [name for name in names if not (folder / name / "pairs.csv").is_file()]
    if missing:
        raise SettingsError(
            f"no pair set {', '.join(missing)} in {source or folder}: run `make real DATA=FOLDER` with a folder of "
            "pair sets (docs/photographs.md)"
        )
    return [folder / name for name in names]


def make_changed_sets(
    names: Sequence[str], sources: Sequence[str], *, without: Sequence[str] = (), folder: Path = FOLDER
) -> list[Path]:
    """Write those of `names` that are of `pairsets.changed.CHANGES` into a folder, and return their paths.

    They are made anew of the sets `sources` that lie in `folder`; pairs whose ids are in `without` are passed over.
    """
    wanted = [name for name in names if name in CHANGES]
    if wanted:
        pairs = chosen_pairs({name: read_pair_set(folder / name).pairs for name in sources}, without=without)
        for name in wanted:
            write_changed_set(folder / name, pairs, name)
    return [folder / name for name in wanted]
