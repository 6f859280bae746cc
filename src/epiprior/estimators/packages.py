"""Look up optional packages without importing them."""

from __future__ import annotations

import functools
import importlib.util
from importlib import metadata


def what_to_install(module: str, requirement: str) -> str:
    """Return an empty string if `module` can be imported, else the command that installs `requirement`."""
    return "" if importlib.util.find_spec(module) else f'pip install "{requirement}"'


@functools.cache  # parsing the metadata takes milliseconds, and every estimate carries a version
def package_version(package: str) -> str:
    """Return ``package version`` as installed, or `package` alone where it carries no metadata."""
    try:
        return f"{package} {metadata.version(package)}"
    except metadata.PackageNotFoundError:
        return package
