"""The uniform pair-set format: photographs or rendered images in pairs, with ground truth."""

from epiprior_lab.pairsets.archives import npz_bytes
from epiprior_lab.pairsets.cameras import Camera, fundamental_from_cameras, reproject
from epiprior_lab.pairsets.files import DatasetError, encode_depth, read_depth
from epiprior_lab.pairsets.homographies import transfer, transfer_distance
from epiprior_lab.pairsets.images import image_size
from epiprior_lab.pairsets.known_sets import KnownSet, known_sets
from epiprior_lab.pairsets.pair import Pair
from epiprior_lab.pairsets.pair_sets import PairSet, check_pair_set, read_pair_set
from epiprior_lab.pairsets.views import ViewDifference, covisible, depth_at, view_difference
from epiprior_lab.pairsets.writer import PairFiles, write_control_points, write_pair_set, write_table

__all__ = [
    "Camera",
    "DatasetError",
    "KnownSet",
    "Pair",
    "PairFiles",
    "PairSet",
    "ViewDifference",
    "check_pair_set",
    "covisible",
    "depth_at",
    "encode_depth",
    "fundamental_from_cameras",
    "image_size",
    "known_sets",
    "npz_bytes",
    "read_depth",
    "read_pair_set",
    "reproject",
    "transfer",
    "transfer_distance",
    "view_difference",
    "write_control_points",
    "write_pair_set",
    "write_table",
]
