"""Results of tasks on disk, and the content keys that say whether a stored result may be used again."""

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
    """What a process runs: source files of both packages, by their names below the source folder, and versions."""

    sources: tuple[str, ...]
    digest: bytes

    def is_here(self) -> bool:
        """Return whether this process runs the same."""
        return _installation_digest(self.sources) == self.digest


class ContentKeys:
    """Keys of calls of one function: source, installed versions, payload, and files that it reads.

    Parameters
    ----------
    function : callable
        The function that is called. Its source is its module, and all of these packages that this imports.

    Raises
    ------
    SettingsError
        If the function's module has no source file.

    Attributes
    ----------
    installation : Installation
        What another process must run to get the same results.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        module = sys.modules[function.__module__]
        if module.__file__ is None:
            raise SettingsError(f"function {function.__qualname__}: module {module.__name__} has no source file")
        self._common = hashlib.sha256("\0".join([*_names(function), *_environment()]).encode())
        sources = source_files(Path(module.__file__).resolve())
        self._common.update(_source_digest(sources))
        names = tuple(sorted(file.relative_to(SOURCE).as_posix() for file in sources if file.is_relative_to(SOURCE)))
        self.installation = Installation(sources=names, digest=_installation_digest(names))
        self._files: dict[Path, bytes] = {}

    def key(self, payload: Mapping[str, Any], files: Sequence[Path]) -> bytes:
        """Return the key of one call.

        Raises
        ------
        TypeError
            If the payload holds something that has no stable key.
        OSError
            If a file cannot be read.
        """
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
    digest = hashlib.sha256("\0".join([*_names(function), name]).encode()).hexdigest()[:12]
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


def _names(function: Callable[..., Any]) -> list[str]:
    return [function.__module__, function.__qualname__]


@functools.cache
def _environment() -> tuple[str, ...]:
    """Return the versions of Python and of all installed distributions."""
    versions = {f"{item.name}=={item.version}" for item in importlib.metadata.distributions()}
    return (sys.version, *sorted(versions))


@functools.cache
def _installation_digest(names: tuple[str, ...]) -> bytes:
    """Return the digest of source files, as they are when it is first asked for, and of versions."""
    files = [SOURCE / name for name in names if (SOURCE / name).is_file()]
    return _source_digest(files) + hashlib.sha256("\0".join(_environment()).encode()).digest()


def _source_digest(files: Iterable[Path]) -> bytes:
    """Return the digest of source files; where the source folder lies does not matter."""
    digest = hashlib.sha256()
    for file in sorted(files):
        name = file.relative_to(SOURCE).as_posix() if file.is_relative_to(SOURCE) else file.name
        digest.update(name.encode() + b"\0" + hashlib.sha256(file.read_bytes()).digest())
    return digest.digest()


def _encode(value: Any) -> Iterator[bytes]:
    """Yield bytes that are equal for equal values only; pickle depends on object identity as well."""
    kind = f"{type(value).__module__}.{type(value).__qualname__}:"
    if value is None or isinstance(value, (bool, int, float, str, np.generic)):
        yield _framed(kind + repr(value))
    elif isinstance(value, bytes):
        yield _framed(kind + value.hex())
    elif isinstance(value, Path):
        yield _framed("path:" + value.as_posix())
    elif isinstance(value, np.ndarray) and not value.dtype.hasobject:
        yield _framed(f"{kind}{value.dtype.str}{value.shape}")
        yield np.ascontiguousarray(value).tobytes()
    elif isinstance(value, (list, tuple)):
        yield _framed(f"{kind}{len(value)}")
        for item in value:
            yield from _encode(item)
    elif isinstance(value, Mapping):
        yield _framed(f"{kind}{len(value)}")
        for key in sorted(value, key=repr):
            yield from _encode(key)
            yield from _encode(value[key])
    elif dataclasses.is_dataclass(value) and not isinstance(value, type):
        yield _framed(kind)
        yield from _encode({item.name: getattr(value, item.name) for item in dataclasses.fields(value)})
    else:
        raise TypeError(f"{type(value).__name__} has no stable key")


def _framed(text: str) -> bytes:
    """Return text with its length before it."""
    encoded = text.encode()
    return len(encoded).to_bytes(8, "little") + encoded
