"""Values of MATLAB files, with errors that name the file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import scipy.io

from epiprior.types import FloatArray
from epiprior_lab.pairsets import DatasetError


def read_mat(path: Path) -> dict[str, Any]:
    """Return the variables of a MATLAB file (before version 7.3); structures are objects with attributes.

    Raises
    ------
    DatasetError
        If the file cannot be read.
    """
    try:
        return dict(scipy.io.loadmat(path, struct_as_record=False, squeeze_me=True))
    except NotImplementedError as error:
        raise DatasetError(f"{path}: is a MATLAB file of version 7.3; save it with -v7") from error
    except Exception as error:  # a damaged file raises whatever its bytes lead to
        raise DatasetError(f"{path}: cannot be read as a MATLAB file: {error}") from error


def matches(path: Path, value: object, name: str) -> tuple[FloatArray, FloatArray]:
    """Return both points (N, 2) of a matrix of homogeneous points: six rows, those of image 1 first.

    Raises
    ------
    DatasetError
        If it has another shape, a value is not finite or a point lies at infinity.
    """
    try:
        data = np.atleast_2d(np.asarray(value, dtype=np.float64))
    except (TypeError, ValueError) as error:
        raise DatasetError(f"{path}: {name} is no matrix of numbers") from error
    if data.shape == (1, 6):
        data = data.T  # a single match, squeezed
    if data.ndim != 2 or data.shape[0] != 6:
        raise DatasetError(f"{path}: {name} has shape {data.shape}, expected (6, number of points)")
    if not np.isfinite(data).all() or not (data[[2, 5]] != 0).all():
        raise DatasetError(f"{path}: {name} holds a value that is not finite, or a point at infinity")
    return (data[:2] / data[2]).T, (data[3:5] / data[5]).T
