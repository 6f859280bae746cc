"""Features of a pair: found once for all presets and baselines that detect the same."""

from dataclasses import dataclass

from epiprior.features.detect import detect_features
from epiprior.features.images import Photograph, View, load_photograph
from epiprior.kernels.parallel import in_threads
from epiprior.presets import DEFAULT, FeatureSettings
from epiprior.types import Features
from epiprior_lab.pairsets import Pair


@dataclass(frozen=True, kw_only=True)
class DetectedPair:
    """The working images of a pair, which cache their descriptors at fixed orientations, and their features."""

    photographs: tuple[Photograph, Photograph]
    features: tuple[Features, Features]
    settings: FeatureSettings  # by which the features were found

    @property
    def pixel_factors(self) -> tuple[float, float]:
        """Given pixels per working pixel in both images, as `estimate_from_matches` wants them."""
        return self.photographs[0].factor, self.photographs[1].factor


def detect_pair(pair: Pair, settings: FeatureSettings = DEFAULT.features) -> DetectedPair:
    """Read both images of a pair and find their features."""
    return detect_images(pair.image1, pair.image2, settings)


def detect_images(image1: View, image2: View, settings: FeatureSettings = DEFAULT.features) -> DetectedPair:
    """Find the features of two images."""
    photo1, photo2 = (load_photograph(image, settings.max_image_size) for image in (image1, image2))
    first, second = in_threads(lambda photo: detect_features(photo, settings), (photo1, photo2))
    return DetectedPair(photographs=(photo1, photo2), features=(first, second), settings=settings)
