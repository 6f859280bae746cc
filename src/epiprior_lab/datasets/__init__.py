"""The uniform pair-set format: photographs or rendered images in pairs, with ground truth."""

from epiprior_lab.datasets.cameras import Camera, fundamental_from_cameras, reproject
from epiprior_lab.datasets.files import DatasetError, encode_depth, read_depth
from epiprior_lab.datasets.pair_sets import Pair, PairSet, read_pair_set
from epiprior_lab.datasets.views import ViewDifference, covisible, depth_at, view_difference
from epiprior_lab.datasets.writer import PairFiles, write_control_points, write_pair_set, write_table

__all__ = [
    "Camera",
    "DatasetError",
    "Pair",
    "PairFiles",
    "PairSet",
    "ViewDifference",
    "covisible",
    "depth_at",
    "encode_depth",
    "fundamental_from_cameras",
    "read_depth",
    "read_pair_set",
    "reproject",
    "view_difference",
    "write_control_points",
    "write_pair_set",
    "write_table",
]
