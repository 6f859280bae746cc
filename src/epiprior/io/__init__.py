"""Matches on disk: tables (CSV, NPZ) and the COLMAP database."""

from epiprior.io.colmap import ColmapPair, write_colmap_database
from epiprior.io.tables import read_matches, write_matches

__all__ = ["ColmapPair", "read_matches", "write_colmap_database", "write_matches"]
