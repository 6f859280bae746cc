"""Importers of published image pairs, and of one's own photographs, into the pair-set format.

Each source is a module with a function that returns what it found; `write_found` makes a pair set of it.
"""

from epiprior_lab.pairsets.importers.adelaidermf import find_adelaidermf
from epiprior_lab.pairsets.importers.colmap import find_colmap
from epiprior_lab.pairsets.importers.kusvod2 import find_kusvod2
from epiprior_lab.pairsets.importers.output import FoundPair, Photograph, check_out, write_found
from epiprior_lab.pairsets.importers.pair_list import find_pairs
from epiprior_lab.pairsets.importers.photos import find_photos
from epiprior_lab.pairsets.importers.planes import find_hpatches, find_oxford
from epiprior_lab.pairsets.importers.strecha import find_strecha
from epiprior_lab.pairsets.importers.structure import PairChoice
from epiprior_lab.pairsets.importers.usac import find_usac

__all__ = [
    "FoundPair",
    "PairChoice",
    "Photograph",
    "check_out",
    "find_adelaidermf",
    "find_colmap",
    "find_hpatches",
    "find_kusvod2",
    "find_oxford",
    "find_pairs",
    "find_photos",
    "find_strecha",
    "find_usac",
    "write_found",
]
