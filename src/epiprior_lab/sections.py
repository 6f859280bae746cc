"""Sections of a parameter file: frozen dataclasses that check what they are given against their annotations."""

import types
import typing
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from epiprior.errors import SettingsError


@dataclass(frozen=True)
class Range:
    """Inclusive bounds of a number, or of every number in a tuple."""

    low: float
    high: float


@dataclass(frozen=True, kw_only=True)
class Section:
    """Base of all sections: checks types and ranges of its fields when it is made.

    Raises
    ------
    SettingsError
        If a field has a wrong type, is out of range, or is an empty or repeating list. The message names it.
    """

    def __post_init__(self) -> None:
        for name, hint in typing.get_type_hints(type(self), include_extras=True).items():
            _check(name, getattr(self, name), hint)


AnySection = typing.TypeVar("AnySection", bound=Section)


def build_section(section: type[AnySection], document: Any, prefix: str) -> AnySection:
    """Make a section of what a YAML file holds, its sub-sections first.

    Parameters
    ----------
    section : type
        Its class.
    document : object
        A mapping, if all is well; lists become tuples.
    prefix : str
        Dotted name of the section in messages, with a dot behind it; empty for the whole.

    Raises
    ------
    SettingsError
        If a key is unknown or missing, or a value is refused.
    """
    if not isinstance(document, Mapping):
        raise SettingsError(f"{prefix.rstrip('.') or 'document'}: expected a mapping, got {document!r}")
    hints = typing.get_type_hints(section)
    unknown = [str(key) for key in document if key not in hints]
    missing = [key for key in hints if key not in document]
    if unknown:
        raise SettingsError(f"unknown key {prefix}{unknown[0]}; known are {', '.join(hints)}")
    if missing:
        raise SettingsError(f"missing key {prefix}{missing[0]}")
    values = {}
    for key, hint in hints.items():
        value = document[key]
        if isinstance(hint, type) and issubclass(hint, Section):
            value = build_section(hint, value, f"{prefix}{key}.")
        values[key] = _plain(value)
    try:
        return section(**values)
    except SettingsError as error:
        raise SettingsError(f"{prefix}{error}") from error


def _plain(value: Any) -> Any:
    """Return lists as tuples, inside mappings as well."""
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    return tuple(value) if isinstance(value, list) else value


def _check(name: str, value: Any, hint: Any) -> None:
    """Check one value against its annotation; `hint` is made of the few forms that sections use."""
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin is Annotated:
        _check(name, value, arguments[0])
        low, high = arguments[1].low, arguments[1].high
        if not low <= value <= high:  # also refuses NaN
            raise SettingsError(f"{name} = {value!r}: expected {low} to {high}")
    elif origin in (types.UnionType, typing.Union):
        if value is not None:
            _check(name, value, arguments[0])
    elif origin is tuple:
        _check_list(name, value, arguments[0])
    elif origin is Mapping:
        if not isinstance(value, Mapping) or not all(isinstance(key, str) for key in value):
            raise SettingsError(f"{name} = {value!r}: expected a mapping of names")
        for key, item in value.items():
            _check(f"{name}.{key}", item, arguments[1])
    elif origin is Literal:
        if value not in arguments:
            raise SettingsError(f"{name} = {value!r}: expected one of {', '.join(map(str, arguments))}")
    else:
        _check_type(name, value, hint)


def _check_list(name: str, value: Any, hint: Any) -> None:
    if not isinstance(value, tuple) or not value:
        raise SettingsError(f"{name} = {value!r}: expected a list of one or more values")
    for item in value:
        _check(name, item, hint)
    if len(set(value)) < len(value):
        raise SettingsError(f"{name} = {value!r}: a value is repeated")


def _check_type(name: str, value: Any, hint: Any) -> None:
    accepted = (int, float) if hint is float else hint
    if not isinstance(value, accepted) or (isinstance(value, bool) and hint is not bool):
        raise SettingsError(f"{name} = {value!r}: expected {hint.__name__}")
