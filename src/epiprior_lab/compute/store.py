"""Results of tasks on disk, and the content keys that say whether a stored result may be used again."""

import ast
import dataclasses
import functools
import hashlib
import importlib.metadata
import re
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from epiprior.errors import SettingsError
from epiprior_lab.compute.source_graph import SOURCE, source_files

_DIGEST_BYTES = 32


@dataclasses.dataclass(frozen=True, kw_only=True)
class Installation:
    """What a process runs: names of source files below the source folder; digest of their contents, and of versions."""

    sources: tuple[str, ...]
    digest: bytes

    def is_here(self) -> bool:
        """Return whether this process runs the same."""
        return _installation_digest(self.sources) == self.digest


class ContentKeys:
    """Keys of calls of one function: source, installed versions, payload, and files that it reads.

    Its source is its module and all of these packages that this imports; SettingsError if the module has no source
    file. Without `versions`, those of this installation do not count: the function runs another. `installation` is what
    another process must run to get the same results.
    """

    def __init__(self, function: Callable[..., Any], *, versions: bool = True) -> None:
        module = sys.modules[function.__module__]
        if module.__file__ is None:
            raise SettingsError(f"function {function.__qualname__}: module {module.__name__} has no source file")
        sources = source_files(Path(module.__file__).resolve())
        environment = _environment() if versions else b""
        self._common = hashlib.sha256(_digest(*_names(function)) + environment + _source_digest(sources))
        names = tuple(sorted(file.relative_to(SOURCE).as_posix() for file in sources if file.is_relative_to(SOURCE)))
        self.installation = Installation(sources=names, digest=_installation_digest(names))
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


def result_path(store: Path, function: Callable[..., Any], name: str) -> Path:
    """Return the one file of a function and task name: readable, and shared with no other."""
    digest = _digest(*_names(function), name).hex()[:12]
    readable = re.sub(r"[^\w.-]", "_", name)[:80]
    return store / f"{readable}-{digest}.result"


def read_result(path: Path, key: bytes) -> bytes | None:
    """Return a stored body, or None if there is none of this key or the file is damaged."""
    try:
        content = path.read_bytes()
    except FileNotFoundError:
        return None
    head, body = content[: 2 * _DIGEST_BYTES], content[2 * _DIGEST_BYTES :]
    return body if head == key + hashlib.sha256(body).digest() else None


def write_result(path: Path, key: bytes, body: bytes) -> None:
    """Replace a stored body in one step: after a kill there is the old one or the new one."""
    with tempfile.NamedTemporaryFile(dir=path.parent, suffix=".part", delete=False) as file:
        try:
            file.write(key + hashlib.sha256(body).digest() + body)
            file.close()
            Path(file.name).replace(path)
        except BaseException:
            Path(file.name).unlink(missing_ok=True)
            raise


def _names(function: Callable[..., Any]) -> tuple[str, str]:
    return function.__module__, function.__qualname__


def _digest(*texts: str) -> bytes:
    return hashlib.sha256("\0".join(texts).encode()).digest()


@functools.cache
def _environment() -> bytes:
    """Return the digest of the versions of Python and of all installed distributions."""
    return _digest(
        sys.version, *sorted({f"{item.name}=={item.version}" for item in importlib.metadata.distributions()})
    )


@functools.cache
def _installation_digest(names: tuple[str, ...]) -> bytes:
    """Return the digest of source files, as they are when it is first asked for, and of versions."""
    return _source_digest(SOURCE / name for name in names if (SOURCE / name).is_file()) + _environment()


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
