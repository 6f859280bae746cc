"""The uniform pair-set format: photographs or rendered images in pairs, with ground truth."""

from epiprior_lab.pairsets.cameras import (
    Camera,
    ViewDifference,
    covisible,
    depth_at,
    fundamental_from_cameras,
    reproject,
    view_difference,
)
from epiprior_lab.pairsets.files import (
    DatasetError,
    encode_depth,
    image_size,
    npz_bytes,
    read_depth,
    write_control_points,
    write_table,
)
from epiprior_lab.pairsets.homographies import transfer, transfer_distance
from epiprior_lab.pairsets.known_sets import KnownSet, known_sets
from epiprior_lab.pairsets.pair import Pair
from epiprior_lab.pairsets.reader import PairSet, check_pair_set, read_pair_set
from epiprior_lab.pairsets.writer import PairFiles, write_pair_set

__all__ = [
    "Camera", "DatasetError", "KnownSet", "Pair", "PairFiles", "PairSet", "ViewDifference", "check_pair_set",
    "covisible", "depth_at", "encode_depth", "fundamental_from_cameras", "image_size", "known_sets", "npz_bytes",
    "read_depth", "read_pair_set", "reproject", "transfer", "transfer_distance", "view_difference",
    "write_control_points", "write_pair_set", "write_table",
]  # fmt: skip
