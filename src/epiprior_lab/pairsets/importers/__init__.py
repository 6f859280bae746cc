"""Importers of published image pairs, and of one's own photographs, into the pair-set format.

A class of formats is a module with a function that returns what it found: COLMAP models (`colmap`), Strecha's cameras
(`strecha`), own photographs (`photos`), a file of matches per pair (`match_files`), homographies of a sequence
(`sequences`), pairs with text files (`pair_list`). `write_found` makes a pair set of it.
"""

from epiprior_lab.pairsets.importers.colmap import find_colmap
from epiprior_lab.pairsets.importers.match_files import find_match_files
from epiprior_lab.pairsets.importers.output import FoundPair, Photograph, check_out, write_found
from epiprior_lab.pairsets.importers.pair_list import find_pairs, find_usac
from epiprior_lab.pairsets.importers.photos import find_photos
from epiprior_lab.pairsets.importers.sequences import find_sequences
from epiprior_lab.pairsets.importers.strecha import find_strecha
from epiprior_lab.pairsets.importers.structure import PairChoice

__all__ = [
    "FoundPair",
    "PairChoice",
    "Photograph",
    "check_out",
    "find_colmap",
    "find_match_files",
    "find_pairs",
    "find_photos",
    "find_sequences",
    "find_strecha",
    "find_usac",
    "write_found",
]
