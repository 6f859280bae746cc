"""Why a pair has too few matches, as far as its images tell."""

from epiprior.features.detect import detect_features
from epiprior.features.images import View, describe_photograph, load_photograph
from epiprior.presets import FeatureSettings
from epiprior.types import Features

_FEW = 100


def explain_shortage(
    images: tuple[View | None, View | None],
    features: tuple[Features | None, Features | None],
    settings: FeatureSettings,
) -> str:
    """Return which of the images have few features, and what may explain it; an empty string where neither has.

    Images and features as handed in; where features are None, they are found again by `settings`.
    """
    reasons = []
    for k, (image, given) in enumerate(zip(images, features, strict=True), start=1):
        photograph = None if image is None else load_photograph(image, settings.max_image_size)
        found = detect_features(photograph, settings) if given is None and photograph is not None else given
        if found is None or len(found) >= _FEW:
            continue
        name = (photograph and photograph.name) or f"image {k}"
        count = f"{name}: {len(found)} features"
        reasons.append(count if photograph is None else f"{count} {describe_photograph(photograph)}")
    return "; ".join(reasons)
