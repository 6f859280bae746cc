"""Sequences of a plane with homographies from the first image: a folder per scene.

Homographies take pixels of the first image to the other; we take the centre of the top-left pixel to be (0, 0).
"""

import re
from pathlib import Path

from epiprior_lab.pairsets import DatasetError
from epiprior_lab.pairsets.files import read_matrix
from epiprior_lab.pairsets.homographies import normalise_homography
from epiprior_lab.pairsets.importers.output import FoundPair, Photograph
from epiprior_lab.pairsets.importers.sources import files_of, image_of, need_folder

# The name of a homography, whose group is the number of the other image, and the stem of an image.
SEQUENCES = {
    # Oxford's affine covariant regions: img1.ppm (or .pgm) to img6, H1to2p to H1to6p
    "oxford": (r"H1to(\d+)p?$", "img{}"),
    # HPatches, full images, not patches: 1.ppm to 6.ppm, H_1_2 to H_1_6
    "hpatches": (r"H_1_(\d+)$", "{}"),
}
_KINDS = {"v_": "viewpoint", "i_": "illumination"}  # the scenes of HPatches


def find_sequences(name: str, folder: Path) -> list[FoundPair]:
    """Return the pairs of a folder of scenes, or of one scene, in the layout `name` of `SEQUENCES`.

    DatasetError, with file and line, if nothing is there, an image is missing, or a homography is damaged.
    """
    pattern, stem = SEQUENCES[name]
    pairs = []
    for scene in [folder, *sorted(path for path in need_folder(folder).iterdir() if path.is_dir())]:
        files = files_of(scene, "*")
        numbered = {int(found.group(1)): path for path in files if (found := re.match(pattern, path.name))}
        pairs += [_pair(scene, path, number, stem) for number, path in sorted(numbered.items())]
    if not pairs:
        raise DatasetError(f"{folder}: no homography with a name like {pattern}")
    return pairs


def _pair(folder: Path, path: Path, number: int, stem: str) -> FoundPair:
    H = normalise_homography(read_matrix(path))
    if H is None:
        raise DatasetError(f"{path}: the matrix is singular")
    scene = folder.resolve().name
    first, other = (Photograph(name=f"{scene}_{k}", path=image_of(folder, stem.format(k), path)) for k in (1, number))
    pair_id, kind = f"{scene}_1_{number}", _KINDS.get(scene[:2], "")
    return FoundPair(pair_id=pair_id, scene=scene, image1=first, image2=other, difficulty=kind, homography=H)
