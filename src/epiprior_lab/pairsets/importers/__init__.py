"""Importers of published image pairs, and of one's own photographs, into the pair-set format.

A class of formats is a module with a function that returns what it found; `output.write_found` makes a pair set of it.
"""
