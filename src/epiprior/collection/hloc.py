"""Matches of a collection for hloc: its features are read, its file of matches is written."""

from pathlib import Path

import numpy as np

from epiprior.collection.images import ImageSet, known_images
from epiprior.collection.verify import JudgedPairs
from epiprior.errors import FeatureError, OutputError, require
from epiprior.io.features import hloc_names
from epiprior.io.output import check_output, replacing

_MOST_SHORT = np.iinfo(np.int16).max


def check_hloc_output(path: Path) -> None:
    """Raise OutputError, before any work, where matches can never be written to `path`, which must not exist."""
    require("h5py", f"{path}: an h5 file")
    check_output(path)
    if path.exists():
        raise OutputError(f"{path}: exists already; a file of matches is not overwritten")


def read_hloc_images(features: Path, folder: Path | None) -> ImageSet:
    """Return the images of which a file of hloc holds features; `folder` holds the photographs, if at hand.

    FeatureError if it cannot be read; ImageError if a photograph is missing.
    """
    import h5py

    try:
        with h5py.File(features, "r") as file:
            called = hloc_names(file)
    except OSError as error:
        raise FeatureError(f"{features}: not an h5 file that can be read: {error}") from error
    if len(called) < 2:
        raise FeatureError(f"{features}: holds features of {len(called)} images, at least two are needed")
    pairs = [name.replace("/", "-") for name in called]
    if len(set(pairs)) < len(pairs):
        twice = next(name for name, pair in zip(called, pairs, strict=True) if pairs.count(pair) > 1)
        raise FeatureError(f"{features}: {twice!r} is called like another image once hloc writes - for /")
    return known_images(called, folder, features)


def write_hloc_matches(path: Path, judged: JudgedPairs) -> int:
    """Write the layout of hloc's ``match_features``; return how many pairs have a geometry.

    The group ``NAME1/NAME2``, each with ``-`` for ``/``, holds ``matches0`` (N1,), the row of image 2 for each keypoint
    of image 1 or -1, and ``matching_scores0`` (N1,), the confidence of the pair for matched ones. Every pair has a
    group; where it is not relied on nothing is matched, nor are watermarks, which this file cannot tell from a scene.
    """
    import h5py

    check_hloc_output(path)
    matched = judged.matched
    counts = [len(matched.features(place)) for place in range(len(matched.images.images))]
    found = 0
    with replacing(path) as partial:
        with h5py.File(partial, "w", libver="latest") as file:
            for (a, b), (pair, why_not) in zip(matched.pairs, judged, strict=True):
                kind = np.int16 if counts[b] <= _MOST_SHORT else np.int32
                matches, scores = np.full(counts[a], -1, kind), np.zeros(counts[a], np.float16)
                if not why_not and pair.geometry != "WATERMARK":
                    matches[pair.matches[:, 0]], scores[pair.matches[:, 0]] = pair.matches[:, 1], pair.confidence
                    found += 1
                group = file.create_group("/".join(name.replace("/", "-") for name in (pair.image1, pair.image2)))
                group.create_dataset("matches0", data=matches)
                group.create_dataset("matching_scores0", data=scores)
        check_hloc_output(path)
    return found
