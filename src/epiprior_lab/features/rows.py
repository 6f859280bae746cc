"""Training rows: what the library computes of a pair before any classifier, labelled by the ground truth.

The rows of the first classifier (2kpmd) are stored as they are. Those of the second (kpmd) depend on the
first: they are computed by `match_rows` from stored parts and from probabilities of a first classifier that
never saw the scene.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from epiprior.matching.pair import PreparedPair, prepare_pair, roll_hypotheses
from epiprior.presets import PreprocessSettings, find_preset
from epiprior.ranking import hypothesis
from epiprior.ranking.frames import MatchFrames
from epiprior.ranking.probabilities import StandardTable, Union
from epiprior.ranking.two_keypoints import TwoKeypointMatches
from epiprior.types import BoolArray, Float32Array, FloatArray
from epiprior_lab.features.detection import DetectedPair, detect_pair
from epiprior_lab.labels.ground_truth import LabelSettings, label_matches
from epiprior_lab.pairsets import Pair, npz_bytes

_T = TypeVar("_T")


@dataclass(frozen=True, kw_only=True)
class PairRows:
    """Rows and labels of one pair under one roll hypothesis.

    Parameters
    ----------
    pair_id, scene : str
        Of the pair.
    preset : str
        Whose features they are.
    roll_deg : float
        The hypothesis.
    two_keypoints : TwoKeypointMatches
        Matches of 2keypoints with their descriptors 2kpmd.
    table : StandardTable
        X_L and X_B.
    united : UnitedMatches
        X, X_L and X_B together.
    united_labels : ndarray, shape (M,), bool
        Which of them are right.
    """

    pair_id: str
    scene: str
    preset: str
    roll_deg: float
    two_keypoints: TwoKeypointMatches
    table: StandardTable
    united: hypothesis.UnitedMatches
    united_labels: BoolArray

    @property
    def frames(self) -> MatchFrames:
        """Of the rows of X."""
        return self.united.frames_of_x()

    @property
    def labels(self) -> BoolArray:
        """Which rows of X are right, shape (len(X),)."""
        return self.united_labels[self.united.union.in_x >= 0]

    @property
    def two_keypoint_columns(self) -> tuple[str, ...]:
        """Names of the columns of `two_keypoint`."""
        return self.two_keypoints.columns

    @property
    def two_keypoint(self) -> Float32Array:
        """Descriptors 2kpmd, shape (T, C)."""
        return self.two_keypoints.descriptors

    @property
    def two_keypoint_labels(self) -> BoolArray:
        """Which 2keypoint matches consist of right matches only, shape (T,)."""
        labels = self.labels
        return labels[self.two_keypoints.main] & labels[self.two_keypoints.other]


def extract_rows(pair: Pair, presets: Sequence[str], labels: LabelSettings | None = None) -> dict[str, list[PairRows]]:
    """Run the library up to the first classifier and label the matches.

    Parameters
    ----------
    pair : Pair
        Pair with ground truth.
    presets : sequence of str
        Names; what they have in common is done once.
    labels : LabelSettings, optional
        When a match counts as right.

    Returns
    -------
    dict of str to list of PairRows
        Per preset, one for every roll hypothesis.
    """
    found = detect_pair(pair)
    return {preset: _preset_rows(pair, found, preset, labels) for preset in presets}


def _preset_rows(pair: Pair, found: DetectedPair, preset: str, settings: LabelSettings | None) -> list[PairRows]:
    own = find_preset(preset)
    features1, features2 = found.features
    prepared = prepare_pair(*found.photographs, own, features1=features1, features2=features2)
    rolls = roll_hypotheses(prepared, own)
    candidates = [hypothesis.find_candidates(prepared, roll_deg, own) for roll_deg in rolls]
    labels = _labels(pair, prepared, [each.united.frames for each in candidates], settings)
    return [
        PairRows(
            pair_id=pair.pair_id,
            scene=pair.scene,
            preset=preset,
            roll_deg=each.roll_deg,
            two_keypoints=each.two_keypoints,
            table=prepared.table,
            united=each.united,
            united_labels=right,
        )
        for each, right in zip(candidates, labels, strict=True)
    ]


def _labels(
    pair: Pair, prepared: PreparedPair, frames: Sequence[MatchFrames], settings: LabelSettings | None
) -> list[BoolArray]:
    """Label matches, all at once: depth maps are slow to read.

    The frames are in working pixels, the ground truth in pixels of the images as given.
    """
    given, factors = [], []
    x1, x2 = np.concatenate([f.x1 for f in frames]), np.concatenate([f.x2 for f in frames])
    for x, to_working in zip((x1, x2), prepared.to_working, strict=True):
        inverse = np.linalg.inv(to_working)
        given.append(x @ inverse[:2, :2].T + inverse[:2, 2])
        factors.append(float(np.sqrt(inverse[0, 0] * inverse[1, 1])))
    scale1, scale2 = np.concatenate([f.scale1 for f in frames]), np.concatenate([f.scale2 for f in frames])
    given1, given2 = given
    right = label_matches(pair, given1, given2, scale1 * factors[0], scale2 * factors[1], settings=settings)
    return np.split(right, np.cumsum([len(f) for f in frames])[:-1])


def match_columns(preset: str) -> tuple[str, ...]:
    """Return the columns of kpmd that the preset uses."""
    return find_preset(preset).match_columns


def match_rows(rows: PairRows, probability: FloatArray) -> tuple[Float32Array, BoolArray]:
    """Let the rough fundamental matrices vote, and return kpmd with labels.

    Parameters
    ----------
    rows : PairRows
        Of one pair.
    probability : ndarray, shape (T,), float64
        Of each 2keypoint match, from a classifier that was not trained on this scene.

    Returns
    -------
    rows : ndarray, shape (M, C), float32
        Columns as `match_columns` names them.
    labels : ndarray, shape (M,), bool
        Which matches are right.
    """
    settings: PreprocessSettings = find_preset(rows.preset)
    votes = hypothesis.cast_votes(rows.frames, rows.two_keypoints, probability, settings)
    table = hypothesis.describe_matches(rows.united, rows.table, rows.two_keypoints, votes)
    return table.select(settings.match_columns), rows.united_labels


def _flatten(prefix: str, value: Any) -> dict[str, Any]:
    return {f"{prefix}.{f.name}": getattr(value, f.name) for f in fields(value)}


def _rebuild(cls: type[_T], prefix: str, stored: Any) -> _T:
    values: dict[str, Any] = {}
    for f in fields(cls):  # type: ignore[arg-type]
        value = stored[f"{prefix}.{f.name}"]
        values[f.name] = value if value.ndim else value.item()
    return cls(**values)


def rows_to_bytes(rows: PairRows) -> bytes:
    """Serialise rows; the same rows give the same bytes."""
    columns = {
        "pair_id": rows.pair_id,
        "scene": rows.scene,
        "preset": rows.preset,
        "roll_deg": rows.roll_deg,
        "united_labels": rows.united_labels,
        **_flatten("two_keypoints", rows.two_keypoints),
        **_flatten("table", rows.table),
        **_flatten("union", rows.united.union),
        **_flatten("united_frames", rows.united.frames),
    }
    return npz_bytes({name: np.asarray(value) for name, value in columns.items()})


def load_rows(folder: Path) -> list[PairRows]:
    """Read every stored pair of a folder, in the order of the files' names."""
    return [read_rows(path) for path in sorted(folder.glob("*.npz"))]


def read_rows(path: Path) -> PairRows:
    """Read the rows of one pair under one roll hypothesis."""
    with np.load(path, allow_pickle=False) as stored:
        pairs = TwoKeypointMatches(
            main=stored["two_keypoints.main"],
            other=stored["two_keypoints.other"],
            columns=tuple(str(name) for name in stored["two_keypoints.columns"]),
            descriptors=stored["two_keypoints.descriptors"],
        )
        united = hypothesis.UnitedMatches(
            union=_rebuild(Union, "union", stored), frames=_rebuild(MatchFrames, "united_frames", stored)
        )
        return PairRows(
            pair_id=str(stored["pair_id"]),
            scene=str(stored["scene"]),
            preset=str(stored["preset"]),
            roll_deg=float(stored["roll_deg"]),
            two_keypoints=pairs,
            table=_rebuild(StandardTable, "table", stored),
            united=united,
            united_labels=stored["united_labels"],
        )
