"""Estimators on pairs with ground truth: runs, measures, statistics."""
