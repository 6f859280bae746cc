"""Which source files a module loads: what stages depend on, and what a stored result was made by."""

import ast
import functools
import re
from collections.abc import Iterator
from pathlib import Path

SOURCE = Path(__file__).resolve().parents[2]


@functools.cache
def source_files(path: Path, root: Path = SOURCE) -> frozenset[Path]:
    """Return all files below a source folder that are loaded when a file is imported or run.

    These are `path` (below `root` or elsewhere), the ``__init__.py`` of its packages, and all that they import,
    directly or not, inside functions as well. A package with a ``__getattr__`` counts whole where it is imported.
    """
    packages = path.relative_to(root).parents[:-1] if path.is_relative_to(root) else ()
    waiting = {path, *(root / folder / "__init__.py" for folder in packages)}
    found: set[Path] = set()
    while waiting:
        file = waiting.pop()
        found.add(file)
        waiting |= set(_imported(file, root)) - found
    return frozenset(found)


def _imported(path: Path, root: Path) -> Iterator[Path]:
    """Yield the files below `root` that one file imports, packages on the way included."""
    package = path.relative_to(root).parts[:-1] if path.is_relative_to(root) else ()
    for node in _walk(ast.parse(path.read_bytes())):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield from _files(tuple(alias.name.split(".")), root)
        elif isinstance(node, ast.ImportFrom):
            above = package[: len(package) + 1 - node.level] if node.level else ()
            base = (*above, *(node.module.split(".") if node.module else ()))
            for alias in node.names:
                yield from _files((*base, alias.name), root)


def _walk(node: ast.AST) -> Iterator[ast.AST]:
    """Yield a node and all below it, but what only type checkers read."""
    yield node
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test):
            continue
        yield from _walk(child)


def _files(name: tuple[str, ...], root: Path) -> Iterator[Path]:
    """Yield the files behind a dotted name, whose last part may be a module or a name in one."""
    folder = root
    for part in name:
        if (folder / f"{part}.py").is_file():
            yield folder / f"{part}.py"
            return
        if not (folder / part / "__init__.py").is_file():
            break
        folder /= part
        yield folder / "__init__.py"
    if folder != root and re.search(rb"^def __getattr__\(", (folder / "__init__.py").read_bytes(), re.MULTILINE):
        yield from folder.rglob("*.py")
