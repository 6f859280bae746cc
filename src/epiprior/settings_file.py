"""The models, and files of settings that were chosen on validation scenes: both come with epiprior."""

from __future__ import annotations

import json
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from epiprior.errors import SettingsError

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Settings = TypeVar("Settings", bound="DataclassInstance")


def find_settings_file(name: str) -> Path | None:
    """Return the file or the folder `name` of the models: in the wheel, or in a checkout; None if there is none."""
    package = Path(__file__).resolve().parent
    candidates = [package / "_models" / name]
    if package.parent.name == "src":
        candidates.append(package.parents[1] / "models" / name)
    return next((path for path in candidates if path.exists()), None)


def read_settings_file(path: Path) -> dict[str, Any]:
    """Return the object that a JSON file holds; raise SettingsError if it cannot be read or holds none."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise SettingsError(f"{path}: cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise SettingsError(f"{path}: not JSON: {error}") from error
    if not isinstance(content, dict):
        raise SettingsError(f"{path}: the file is {type(content).__name__}, expected an object")
    return content


def parse_settings(where: str, values: object, usual: Settings) -> Settings:
    """Return a dataclass of settings with the values that a file names; the others are those of `usual`.

    SettingsError, which begins `where`, if the values are no object, name an unknown field, or are out of range.
    """
    if not isinstance(values, dict):
        raise SettingsError(f"{where}: {type(values).__name__}, expected an object")
    known = [field.name for field in fields(usual)]
    unknown = sorted(set(values) - set(known))
    if unknown:
        raise SettingsError(f"{where}: unknown {', '.join(unknown)}; known: {', '.join(known)}")
    try:
        return replace(usual, **values)
    except SettingsError as error:
        raise SettingsError(f"{where}: {error}") from error
