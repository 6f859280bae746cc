"""Matches on disk: tables (CSV, NPZ) and the COLMAP database; features of COLMAP and of hloc."""

from epiprior.io.colmap import ColmapPair, write_colmap_database
from epiprior.io.features import read_colmap_features, read_hloc_features
from epiprior.io.tables import write_matches

__all__ = ["ColmapPair", "read_colmap_features", "read_hloc_features", "write_colmap_database", "write_matches"]
