"""Oxford's affine covariant regions and HPatches: sequences of a plane, homographies from the first image.

Both have a folder per scene. Oxford: ``img1.ppm`` (or ``.pgm``) to ``img6``, ``H1to2p`` to ``H1to6p``. HPatches:
``1.ppm`` to ``6.ppm``, ``H_1_2`` to ``H_1_6``; scenes ``v_*`` differ in view, ``i_*`` in light. Homographies take
pixels of the first image to the other; we take the centre of the top-left pixel to be (0, 0).
"""

from __future__ import annotations

import re
from pathlib import Path

from epiprior_lab.pairsets import DatasetError
from epiprior_lab.pairsets.files import read_matrix
from epiprior_lab.pairsets.homographies import normalise_homography
from epiprior_lab.pairsets.importers.images_beside import image_of, need_folder
from epiprior_lab.pairsets.importers.output import FoundPair, Photograph

_KINDS = {"v_": "viewpoint", "i_": "illumination"}


def find_oxford(folder: Path) -> list[FoundPair]:
    """Return the pairs of a folder of scenes, or of one scene.

    Raises
    ------
    DatasetError
        If nothing is there, an image is missing, or a homography is damaged; the message names the file and line.
    """
    return _find(folder, r"H1to(\d+)p?$", "img")


def find_hpatches(folder: Path) -> list[FoundPair]:
    """Return the pairs of the HPatches sequences (full images, not patches), or of one of them.

    Raises
    ------
    DatasetError
        If nothing is there, an image is missing, or a homography is damaged; the message names the file and line.
    """
    return _find(folder, r"H_1_(\d+)$", "")


def _find(folder: Path, pattern: str, stem: str) -> list[FoundPair]:
    pairs = []
    scenes = [folder, *sorted(path for path in need_folder(folder).iterdir() if path.is_dir())]
    for scene in scenes:
        numbered = {int(found.group(1)): path for path in scene.iterdir() if (found := re.match(pattern, path.name))}
        pairs += [_pair(scene, path, number, stem) for number, path in sorted(numbered.items())]
    if not pairs:
        raise DatasetError(f"{folder}: no homography with a name like {pattern}")
    return pairs


def _pair(folder: Path, path: Path, number: int, stem: str) -> FoundPair:
    H = normalise_homography(read_matrix(path))
    if H is None:
        raise DatasetError(f"{path}: the matrix is singular")
    scene = folder.resolve().name
    photographs = [Photograph(name=f"{scene}_{k}", path=image_of(folder, f"{stem}{k}", path)) for k in (1, number)]
    return FoundPair(
        pair_id=f"{scene}_1_{number}",
        scene=scene,
        image1=photographs[0],
        image2=photographs[1],
        difficulty=_KINDS.get(scene[:2], ""),
        homography=H,
    )
