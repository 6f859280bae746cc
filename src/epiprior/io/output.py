"""Files that appear as a whole or not at all."""

import contextlib
import os
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

from epiprior.errors import OutputError

PICTURES = (".png", ".jpg", ".jpeg")


def check_output(path: Path, suffixes: Sequence[str] = ()) -> None:
    """Raise OutputError, before any work is done, where `path` can never be written.

    Its suffix is not among the lower-case `suffixes` (none: any), its folder is missing or not writable, or it is one.
    """
    if suffixes and path.suffix.lower() not in suffixes:
        raise OutputError(f"{path}: unknown suffix {path.suffix!r}, known: {', '.join(suffixes)}")
    if not path.parent.is_dir():
        raise OutputError(f"{path}: there is no folder {path.parent}")
    if not os.access(path.parent, os.W_OK):
        raise OutputError(f"{path}: no permission to write to the folder {path.parent}")
    if path.is_dir():
        raise OutputError(f"{path}: is a folder")


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give an empty file beside `path` to write to; it takes the place of `path` once all went well.

    After an exception it is removed and `path` is as before. Any OSError inside (no space, no permission, ...) becomes
    an OutputError that names `path` and the reason.
    """
    partial: Path | None = None
    try:
        handle, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=".partial", dir=path.parent)
        os.close(handle)
        partial = Path(name)
        yield partial
        # mkstemp makes files for the owner alone; a result is an ordinary file.
        mask = os.umask(0o022)
        os.umask(mask)
        partial.chmod(0o666 & ~mask)
        partial.replace(path)
    except OutputError:
        raise
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror or error}") from error
    finally:
        if partial is not None:
            partial.unlink(missing_ok=True)
