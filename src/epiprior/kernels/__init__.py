"""Compiled functions: residuals, minimal solvers, samplers, local optimisation."""
