"""Results of tasks on disk, and the content keys that say whether a stored result may be used again."""

import ast
import dataclasses
import functools
import hashlib
import importlib.metadata
import inspect
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from epiprior_lab.compute.source_graph import SOURCE, source_files

_DIGEST_BYTES = 32


class ResultStore:
    """Results of one function, a file per task name, each with the content key of the call that gave it.

    The key has the function's source (its module and all of these packages that this imports), the installed versions,
    the payload, and the contents of the files that are read. Without `versions`, those of this installation do not
    count: the function runs another. Without a `folder`, nothing is kept.
    """

    def __init__(self, function: Callable[..., Any], folder: Path | None = None, *, versions: bool = True) -> None:
        self._folder, self._names = folder, (function.__module__, function.__qualname__)
        sources = source_files(Path(inspect.getfile(sys.modules[function.__module__])).resolve())
        environment = _environment() if versions else b""
        self._common = hashlib.sha256(_digest(*self._names) + environment + _source_digest(sources))
        self._files: dict[Path, bytes] = {}

    def key(self, payload: Mapping[str, Any], files: Sequence[Path]) -> bytes:
        """Return the key of one call; TypeError for a payload without a stable key, OSError for an unreadable file."""
        digest = self._common.copy()
        for part in _encode(payload):
            digest.update(part)
        for path in files:
            if path not in self._files:
                self._files[path] = hashlib.sha256(path.read_bytes()).digest()
            digest.update(self._files[path])
        return digest.digest()

    def read(self, name: str, key: bytes) -> bytes | None:
        """Return a stored body; None if there is none with this key, or it is damaged."""
        try:
            content = self._path(name).read_bytes() if self._folder else b""
        except FileNotFoundError:
            return None
        head, body = content[: 2 * _DIGEST_BYTES], content[2 * _DIGEST_BYTES :]
        return body if head == key + hashlib.sha256(body).digest() else None

    def write(self, name: str, key: bytes, body: bytes) -> None:
        """Replace a stored body in one step: after a kill there is the old one or the new one."""
        if self._folder:
            self._folder.mkdir(parents=True, exist_ok=True)
            path = self._path(name)
            part = path.with_suffix(".part")
            part.write_bytes(key + hashlib.sha256(body).digest() + body)
            part.replace(path)

    def _path(self, name: str) -> Path:
        """Return the one file of a task name: readable, and shared with no other function."""
        assert self._folder is not None
        readable = re.sub(r"[^\w.-]", "_", name)[:80]
        return self._folder / f"{readable}-{_digest(*self._names, name).hex()[:12]}.result"


@functools.cache
def installation() -> bytes:
    """Return the digest of all code of both packages and of the installed versions, as it is when first asked for."""
    files = (file for package in ("epiprior", "epiprior_lab") for file in (SOURCE / package).rglob("*.py"))
    return _source_digest(files) + _environment()


@functools.cache
def _environment() -> bytes:
    """Return the digest of the versions of Python and of all installed distributions."""
    return _digest(
        sys.version, *sorted({f"{item.name}=={item.version}" for item in importlib.metadata.distributions()})
    )


def _digest(*texts: str) -> bytes:
    return hashlib.sha256("\0".join(texts).encode()).digest()


def _source_digest(files: Iterable[Path]) -> bytes:
    """Return the digest of source files; where the source folder lies does not matter."""
    digest = hashlib.sha256()
    for file in sorted(files):
        name = file.relative_to(SOURCE).as_posix() if file.is_relative_to(SOURCE) else file.name
        digest.update(name.encode() + b"\0" + _code_digest(file.read_bytes()))
    return digest.digest()


@functools.cache
def _code_digest(source: bytes) -> bytes:
    """Return the digest of the code of a source file: comments, docstrings and line breaks determine no result."""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            first = node.body[0] if node.body else None
            if isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant):
                node.body = node.body[1:]
    return hashlib.sha256(ast.dump(tree).encode()).digest()


def _encode(value: Any) -> Iterator[bytes]:
    """Yield bytes that are equal for equal values only; pickle depends on object identity as well."""
    text, array = f"{type(value).__module__}.{type(value).__qualname__}:", b""
    parts: list[Any] = []
    if value is None or isinstance(value, (bool, int, float, str, bytes, np.generic)):
        text += repr(value)
    elif isinstance(value, Path):
        text = "path:" + value.as_posix()
    elif isinstance(value, np.ndarray) and not value.dtype.hasobject:
        text, array = f"{text}{value.dtype.str}{value.shape}", value.tobytes()
    elif isinstance(value, (list, tuple)):
        text, parts = f"{text}{len(value)}", list(value)
    elif isinstance(value, Mapping):
        text, parts = f"{text}{len(value)}", [part for key in sorted(value, key=repr) for part in (key, value[key])]
    elif dataclasses.is_dataclass(value) and not isinstance(value, type):
        parts = [{item.name: getattr(value, item.name) for item in dataclasses.fields(value)}]
    else:
        raise TypeError(f"{type(value).__name__} has no stable key")
    encoded = text.encode()
    yield len(encoded).to_bytes(8, "little") + encoded + array
    for part in parts:
        yield from _encode(part)
