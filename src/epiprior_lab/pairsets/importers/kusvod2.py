"""The sets kusvod2 and homogr of the Czech Technical University: control points by hand.

Format (the readme that is published with them): ``nameA.ext`` and ``nameB.ext`` are the images, ``name_vpts.mat``
holds ``validation.pts``, 6 x N, homogeneous points of A above those of B.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from epiprior_lab.pairsets import DatasetError
from epiprior_lab.pairsets.importers.images_beside import image_of, need_folder
from epiprior_lab.pairsets.importers.matlab import matches, read_mat
from epiprior_lab.pairsets.importers.output import FoundPair, Photograph

_ENDING = "_vpts.mat"


def find_kusvod2(folder: Path, *, origin: float = 0.0) -> list[FoundPair]:
    """Return the pairs of a folder with ``*_vpts.mat``.

    Parameters
    ----------
    folder : Path
        Images and files of validation points.
    origin : float
        Coordinate of the centre of the top-left pixel in the files: 1 if they count as MATLAB does. The readme does
        not say; 0 is our choice.

    Raises
    ------
    DatasetError
        If the folder or an image is missing, or a file is damaged; the message names it.
    """
    pairs = []
    for path in sorted(need_folder(folder).glob(f"*{_ENDING}")):
        name = path.name.removesuffix(_ENDING)
        points = getattr(read_mat(path).get("validation"), "pts", None)
        if points is None:
            raise DatasetError(f"{path}: holds no validation.pts")
        x1, x2 = matches(path, points, "validation.pts")
        images = [image_of(folder, name + side, path) for side in "AB"]
        pairs.append(
            FoundPair(
                pair_id=name,
                scene=name,
                image1=Photograph(name=f"{name}A", path=images[0]),
                image2=Photograph(name=f"{name}B", path=images[1]),
                difficulty=f"{len(x1)} manual points",
                points=(np.ascontiguousarray(x1 - origin), np.ascontiguousarray(x2 - origin)),
            )
        )
    if not pairs:
        raise DatasetError(f"{folder}: no file *{_ENDING}")
    return pairs
