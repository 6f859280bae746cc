"""The code behind one estimator, and behind no other: what a stored result of it depends on.

`epiprior_lab.compute.source_graph` follows imports, and the registry imports every estimator. Here those of the
registry are
followed only to the estimator that is asked for.
"""

from __future__ import annotations

import ast
import functools
import hashlib
import importlib
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

from epiprior.errors import SettingsError
from epiprior_lab.compute.source_graph import SOURCE, source_files

_PACKAGE = "epiprior.estimators"
_FOLDER = SOURCE.joinpath(*_PACKAGE.split("."))
_ENTRY = SOURCE / "epiprior" / "estimators" / "run.py"


@functools.cache
def estimator_files(estimator: str) -> frozenset[Path]:
    """Return the source files that decide what an estimator does, from matches to the judged F.

    Parameters
    ----------
    estimator : str
        Name in the registry.

    Raises
    ------
    SettingsError
        If there is none of that name.
    """
    registry = importlib.import_module(f"{_PACKAGE}.registry")
    backends = {
        Path(str(module.__file__)): {found.name for found in module.ESTIMATORS}
        for module in vars(registry).values()
        if isinstance(module, ModuleType) and hasattr(module, "ESTIMATORS")
    }
    own = [path for path, names in backends.items() if estimator in names]
    if not own:
        raise SettingsError(f"estimator is {estimator!r}: not in the registry")
    outside = {path for path in source_files(_ENTRY) if not path.is_relative_to(_FOLDER)}
    waiting = {_FOLDER / "__init__.py", *own, *(found for path in outside for found in _imported(path))}
    inside: set[Path] = set()
    while waiting:
        path = waiting.pop()
        inside.add(path)
        found = set(_imported(path))
        waiting |= (found - backends.keys() if path.name == "registry.py" else found) - inside
    return frozenset(outside | inside)


def _imported(path: Path) -> Iterator[Path]:
    """Yield the modules of the package of estimators that a file imports."""
    for node in ast.walk(ast.parse(path.read_bytes())):
        if not isinstance(node, ast.ImportFrom) or not (node.module or "").startswith(_PACKAGE):
            continue
        part = str(node.module).removeprefix(_PACKAGE).lstrip(".")
        for name in [part] if part else [alias.name for alias in node.names]:
            if (_FOLDER / f"{name}.py").is_file():
                yield _FOLDER / f"{name}.py"


@functools.cache
def estimator_code(estimator: str) -> str:
    """Return a digest of `estimator_files`; where the source folder lies does not matter."""
    digest = hashlib.sha256()
    for path in sorted(estimator_files(estimator)):
        name = path.relative_to(SOURCE).as_posix()
        digest.update(name.encode() + b"\0" + hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()


def check_code(estimator: str, code: str) -> None:
    """Check that this process has the code that a task was given out for.

    Raises
    ------
    SettingsError
        If it has another.
    """
    if estimator_code(estimator) != code:
        raise SettingsError(f"estimator {estimator}: this worker has other code than the process that sent the task")
