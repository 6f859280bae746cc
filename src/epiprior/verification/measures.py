"""What speaks for F beside the number of its inliers, beyond the paper: how plausible it is, and how far they spread.

Plausibility: whether two ordinary photographs can have F. Any 3 x 3 matrix of rank 2 is a fundamental matrix of some
pair of cameras, but not of two photographs: their principal points lie near the centres of the images, and their focal
lengths are alike and of the order of the image's size. An F that outliers made seldom passes this test, and no match
takes part in it: it is evidence of its own.

Spread: how much of the images the inliers cover. Ten matches of one window say less than ten all over the picture.

References: the two equal singular values of an essential matrix (Huang and Faugeras, 1989; Hartley and Zisserman,
result 9.17). As a soft factor over a range of focal lengths: ours.
"""

from functools import cached_property

import numpy as np

from epiprior.geometry import SCORE_THRESHOLD_PX, Evidence
from epiprior.types import FloatArray, ImageSizes, IntArray, MatchSet

CELL_PX = 48.0  # the reach of a few features
FOCAL_LENGTHS = np.geomspace(0.6, 2.5, 13)
CHANCE = 0.02
WITHOUT_RATIO = 0.5
_NEXT, _LAST = [1, 2, 0], [2, 0, 1]  # rows and columns of cofactors


def camera_plausibility(models: FloatArray, image_sizes: ImageSizes | None) -> FloatArray:
    """Return how nearly each F becomes an essential matrix for some focal length of photographs: (K,), in [0, 1].

    It is the highest ratio of the second to the first singular value of ``K2' F K1`` over focal lengths from 0.6 to 2.5
    times the longer side of each image, the same for both, with the principal points at the centres. It is 1 for ideal
    cameras and where `image_sizes`, in the pixels of `models`, are unknown, and about 0.75 in the median for an F that
    outliers made. A crop, a shifted lens or two very different zooms lower the value of a right F towards that of wrong
    ones. It then tells nothing; it does not mislead.
    """
    if image_sizes is None or not len(models):
        return np.ones(len(models))
    K1, K2 = (np.stack([intrinsics(size, float(f)) for f in FOCAL_LENGTHS])[:, None] for size in image_sizes)
    E = K2.swapaxes(2, 3) @ models @ K1
    # Of rank two: the sum and the product of the squared singular values give both.
    total = (E**2).sum(axis=(2, 3))
    cofactors = E[..., _NEXT, :][..., _NEXT] * E[..., _LAST, :][..., _LAST]
    cofactors -= E[..., _NEXT, :][..., _LAST] * E[..., _LAST, :][..., _NEXT]
    product = np.square(cofactors, order="C").sum(axis=(2, 3))
    first = (total + np.sqrt(np.maximum(total * total - 4.0 * product, 0.0))) / 2.0
    first_sq = first * first
    ratio_sq = np.divide(product, first_sq, out=np.zeros_like(first), where=first_sq > 0)
    best = np.maximum(np.sqrt(ratio_sq).max(axis=0), 0.0)
    return np.asarray(np.nan_to_num(best, nan=0.0).clip(0.0, 1.0))


def intrinsics(size: tuple[float, float], focal: float) -> FloatArray:
    """Return K, shape (3, 3), for an image's size and a focal length in units of its longer side."""
    width, height = size
    f = focal * max(width, height)
    return np.array([[f, 0.0, (width - 1) / 2], [0.0, f, (height - 1) / 2], [0.0, 0.0, 1.0]])


def spread_groups(x1: FloatArray, x2: FloatArray) -> IntArray:
    """Return a number for each match, the same for those that lead from one cell to one cell: shape (N,), >= 0."""
    cells = np.floor(np.hstack([x1, x2]) / CELL_PX).astype(np.int64)
    cells -= cells.min(axis=0, initial=0)
    # One number for the four: sorting numbers is much faster than sorting rows.
    sizes = cells.max(axis=0, initial=0) + 1
    numbers = ((cells[:, 0] * sizes[1] + cells[:, 1]) * sizes[2] + cells[:, 2]) * sizes[3] + cells[:, 3]
    return np.unique(numbers, return_inverse=True)[1].reshape(-1).astype(np.int64)


class SpreadEvidence:
    """The evidence of matches, each part of the images once.

    Matches are not independent: a window that was taken for its neighbour gives ten that agree with one another, and
    with every F that agrees with one of them. So matches that lead from one small part of image 1 to one small part of
    image 2 count once, by the best of them. Many-to-many `matches` are made one-to-one first, `single`: each feature
    speaks by its most probable match; `prior` are the probabilities of these, `weights` what they are worth
    (`match_weights`).
    """

    def __init__(self, matches: MatchSet) -> None:
        self.matches, self.single = matches, matches.one_to_one()
        self.prior = prior_probability(self.single)
        self.weights = match_weights(self.single, self.prior)

    @cached_property
    def group(self) -> IntArray:
        """Number of the parts of the images that each match leads from and to, (N,)."""
        return spread_groups(self.single.x1, self.single.x2)

    @cached_property
    def _evidence(self) -> Evidence:
        return Evidence(self.single.x1, self.single.x2, self.weights, self.group)

    def scores(self, models: FloatArray, threshold_px: float = SCORE_THRESHOLD_PX) -> FloatArray:
        """Return the score of each F (K, 3, 3), shape (K,), >= 0: what the matches say, times its plausibility.

        A match at a Sampson distance of `threshold_px` says nothing. Scores may be compared between roll hypotheses of
        one pair.
        """
        return self._evidence.scores(models, threshold_px) * camera_plausibility(models, self.single.image_sizes)


def match_weights(matches: MatchSet, probability: FloatArray) -> FloatArray:
    """Return what each match is worth: the log of how much likelier it makes an F that it agrees with.

    A match of probability p agrees with a wrong F at the rate of chance c, here 0.02: ``log(1 + p / ((1 - p) c))``.
    Matches without a distance ratio, which only clusters propose, count half: what speaks for them are mostly the votes
    of the rough matrices, and these would be heard twice.
    """
    p = np.clip(probability, 0.0, 1.0 - 1e-6)
    worth = np.log1p(p / ((1.0 - p) * CHANCE))
    return np.where(matches.distance_ratio < 1.0, worth, WITHOUT_RATIO * worth)


def prior_probability(matches: MatchSet) -> FloatArray:
    """Return the probability of each match; where it has none, one from its distance ratio.

    The ratio's log odds are a line, fitted by eye to matches of rendered scenes: even odds at a ratio of 0.65.
    """
    known = matches.probability
    guessed = 1.0 / (1.0 + np.exp(13.0 * (matches.distance_ratio - 0.65)))
    return np.clip(np.where(np.isnan(known), guessed, known), 0.0, 1.0)
