"""The commands of the command line, one module per group; `epiprior.cli` puts them together.

What is slow to import is imported by the command that needs it, so that ``epiprior --help`` answers at once.
"""
