import numpy as np

from calls import refused
from epiprior.errors import FeatureError
from epiprior.types import Features


def test_bad_features_are_named():
    good = {"xy": np.ones((2, 2)), "scale": np.ones(2), "orientation_deg": np.zeros(2), "image_size": (10, 10)}
    good["descriptors"] = np.ones((2, 128), np.float32)
    refused(FeatureError, "xy holds a NaN", Features, **good | {"xy": np.full((2, 2), np.nan)})
    refused(FeatureError, "positive", Features, **good | {"scale": np.array([1.0, 0.0])})
    refused(FeatureError, r"\(3,\)", Features, **good | {"scale": np.ones(3)})
    refused(FeatureError, "descriptors holds", Features, **good | {"descriptors": np.full((2, 128), np.inf)})
    refused(FeatureError, "orientation_deg", Features, **good | {"orientation_deg": ["a", "b"]})
    refused(FeatureError, r"\(640, 0\)", Features, **good | {"image_size": (640, 0)})
    for size in ((640.0, np.nan), (640, 480, 3), None):
        refused(FeatureError, "image_size", Features, **good | {"image_size": size})
