"""Where callers found these before they moved."""

from epiprior.geometry import first_of_equal
from epiprior.kernels.one_to_one import one_to_one_mask

__all__ = ["first_of_equal", "one_to_one_mask"]
