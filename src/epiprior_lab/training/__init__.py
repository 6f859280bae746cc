"""Families of classifiers, grouped cross-validation, calibration."""
