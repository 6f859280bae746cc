"""Files of settings that were chosen on validation scenes and come with the models."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from epiprior.errors import SettingsError


def find_settings_file(name: str) -> Path | None:
    """Return the file `name` that comes with the models: in the wheel, or in a checkout; None if there is none."""
    package = Path(__file__).resolve().parent
    candidates = [package / "_models" / name]
    if package.parent.name == "src":
        candidates.append(package.parents[1] / "models" / name)
    return next((path for path in candidates if path.is_file()), None)


def read_settings_file(path: Path) -> dict[str, Any]:
    """Return the object that a JSON file holds.

    Raises
    ------
    SettingsError
        If it cannot be read, is no JSON, or holds no object.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise SettingsError(f"{path}: cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise SettingsError(f"{path}: not JSON: {error}") from error
    if not isinstance(content, dict):
        raise SettingsError(f"{path}: the file is {type(content).__name__}, expected an object")
    return content
