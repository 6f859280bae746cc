"""Exceptions of the library: bad input raises, geometric failure is a value (`FundamentalEstimate.status`)."""

from importlib import import_module
from types import ModuleType

_REQUIREMENTS = {"pycolmap": "pycolmap>=4,<5", "h5py": "h5py>=3.13,<4"}


class EpipriorError(Exception):
    """Base of every exception that epiprior raises on purpose."""


class ImageError(EpipriorError, ValueError):
    """An image cannot be read or used; the message names the path or the array's shape and type."""


class FeatureError(EpipriorError, ValueError):
    """Features or points that were handed in have a wrong shape, type or value; the message names them."""


class SettingsError(EpipriorError, ValueError):
    """A setting is unknown or out of its range; the message names it, its value and the range."""


class ModelError(EpipriorError, ValueError):
    """A model folder is missing, damaged or of another schema; the message names the file and what differs."""


class EstimatorError(EpipriorError, ValueError):
    """An estimator is unknown, not installed, or was given settings it does not have."""


class OutputError(EpipriorError, OSError):
    """A result cannot be written; the message names the path and the reason."""


def require(package: str, what: str, kind: type[EpipriorError] = OutputError) -> ModuleType:
    """Return a package that is not needed by all; where it is missing, the error says what for and how to get it."""
    try:
        return import_module(package)
    except ImportError as error:
        raise kind(f"{what} needs {package}: pip install '{_REQUIREMENTS[package]}'") from error
