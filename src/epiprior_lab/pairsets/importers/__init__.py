"""Importers of published image pairs, and of one's own photographs, into the pair-set format.

A class of formats is a module with a function that returns what it found; `write_found` makes a pair set of it.
"""

from epiprior_lab.pairsets.importers.colmap import find_colmap as find_colmap
from epiprior_lab.pairsets.importers.match_files import find_match_files as find_match_files
from epiprior_lab.pairsets.importers.output import FoundPair as FoundPair
from epiprior_lab.pairsets.importers.output import Photograph as Photograph
from epiprior_lab.pairsets.importers.output import check_out as check_out
from epiprior_lab.pairsets.importers.output import write_found as write_found
from epiprior_lab.pairsets.importers.pair_list import find_pairs as find_pairs
from epiprior_lab.pairsets.importers.pair_list import find_usac as find_usac
from epiprior_lab.pairsets.importers.photos import find_photos as find_photos
from epiprior_lab.pairsets.importers.sequences import find_sequences as find_sequences
from epiprior_lab.pairsets.importers.strecha import find_strecha as find_strecha
from epiprior_lab.pairsets.importers.structure import PairChoice as PairChoice
