"""The uniform pair-set format: photographs or rendered images in pairs, with ground truth."""

from epiprior_lab.datasets.cameras import Camera, fundamental_from_cameras, reproject
from epiprior_lab.datasets.files import DatasetError, encode_depth, read_depth
from epiprior_lab.datasets.pair_sets import Pair, PairSet, read_pair_set
from epiprior_lab.datasets.writer import PairFiles, write_control_points, write_pair_set

__all__ = [
    "Camera",
    "DatasetError",
    "Pair",
    "PairFiles",
    "PairSet",
    "encode_depth",
    "fundamental_from_cameras",
    "read_depth",
    "read_pair_set",
    "reproject",
    "write_control_points",
    "write_pair_set",
]
