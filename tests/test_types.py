import numpy as np
import pytest

from epiprior.errors import FeatureError
from epiprior.types import Features


def test_bad_features_are_named():
    good = {"xy": np.ones((2, 2)), "scale": np.ones(2), "orientation_deg": np.zeros(2), "image_size": (10, 10)}
    good["descriptors"] = np.ones((2, 128), np.float32)
    for field, value, message in (
        ("xy", np.full((2, 2), np.nan), "xy holds a NaN"),
        ("scale", np.array([1.0, 0.0]), "positive"),
        ("scale", np.ones(3), r"\(3,\)"),
        ("descriptors", np.full((2, 128), np.inf), "descriptors holds"),
        ("orientation_deg", ["a", "b"], "orientation_deg"),
        ("image_size", (640, 0), r"\(640, 0\)"),
        ("image_size", (640.0, np.nan), "image_size"),
        ("image_size", (640, 480, 3), "image_size"),
        ("image_size", None, "image_size"),
    ):
        with pytest.raises(FeatureError, match=message):
            Features(**{**good, field: value})
