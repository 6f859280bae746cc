"""Matches on disk as tables (CSV, NPZ); features of COLMAP and of hloc."""

from epiprior.io.features import read_colmap_features, read_hloc_features
from epiprior.io.tables import write_matches

__all__ = ["read_colmap_features", "read_hloc_features", "write_matches"]
