"""Arrays as bytes of an ``.npz`` file, compressed fast."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

# NumPy's own level, 6, takes five times as long for files that are 5 % smaller.
_LEVEL = 1


def npz_bytes(arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """Return what `numpy.load` reads; the same arrays in the same order give the same bytes."""
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w") as file:
        for name, array in arrays.items():
            content = io.BytesIO()
            np.lib.format.write_array(content, np.asarray(array), allow_pickle=False)
            file.writestr(zipfile.ZipInfo(f"{name}.npy"), content.getvalue(), zipfile.ZIP_DEFLATED, _LEVEL)
    return archive.getvalue()
