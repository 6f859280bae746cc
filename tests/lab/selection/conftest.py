"""The relief of the evaluation's tests."""

from lab.evaluation.conftest import pairs, relief

__all__ = ["pairs", "relief"]
