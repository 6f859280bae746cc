"""Training rows: what the library computes of a pair before any classifier, labelled by the ground truth."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from epiprior.matching.pair import PreparedPair, prepare_pair, roll_hypotheses
from epiprior.matching.standard import StandardTable
from epiprior.presets import SECOND_ROUND_COLUMNS, find_preset
from epiprior.ranking import hypothesis
from epiprior.ranking.frames import MatchFrames
from epiprior.ranking.probabilities import Union
from epiprior.ranking.second_round import second_round_rows, second_round_table
from epiprior.ranking.two_keypoints import TwoKeypointMatches
from epiprior.types import BoolArray, Float32Array, FloatArray
from epiprior_lab.features.detection import detect_pair
from epiprior_lab.labels.ground_truth import TRUTH, label_matches
from epiprior_lab.pairsets import Pair, npz_bytes
from epiprior_lab.params import TruthParams

Classifier = Callable[[Float32Array], FloatArray]
_PARTS = {"two_keypoints": TwoKeypointMatches, "table": StandardTable, "union": Union, "united_frames": MatchFrames}


@dataclass(frozen=True, kw_only=True)
class PairRows:
    """Rows and labels of one pair under one roll hypothesis, with the features of one preset.

    `two_keypoints` holds matches of 2keypoints with their descriptors 2kpmd; `table` X_L and X_B; `union` and
    `united_frames` X, X_L and X_B together, and `united_labels`, shape (M,), which of them are right.
    """

    pair_id: str
    scene: str
    preset: str
    roll_deg: float
    united_labels: BoolArray
    two_keypoints: TwoKeypointMatches
    table: StandardTable
    union: Union
    united_frames: MatchFrames

    @property
    def two_keypoint_labels(self) -> BoolArray:
        """Which 2keypoint matches consist of right matches only, shape (T,)."""
        labels = self.united_labels[self.union.in_x >= 0]
        return labels[self.two_keypoints.main] & labels[self.two_keypoints.other]


def extract_rows(pair: Pair, preset: str, settings: TruthParams = TRUTH) -> list[PairRows]:
    """Run the library up to the first classifier and label the matches, for every roll hypothesis."""
    own = find_preset(preset)
    found = detect_pair(pair, own.features)
    features1, features2 = found.features
    prepared = prepare_pair(*found.photographs, own, features1=features1, features2=features2)
    candidates = [hypothesis.find_candidates(prepared, roll, own) for roll in roll_hypotheses(prepared, own)]
    labels = _labels(pair, prepared, [each.united.frames for each in candidates], settings)
    return [
        PairRows(
            pair_id=pair.pair_id,
            scene=pair.scene,
            preset=preset,
            roll_deg=each.roll_deg,
            two_keypoints=each.two_keypoints,
            table=prepared.table,
            union=each.united.union,
            united_frames=each.united.frames,
            united_labels=right,
        )
        for each, right in zip(candidates, labels, strict=True)
    ]


def _labels(
    pair: Pair, prepared: PreparedPair, frames: Sequence[MatchFrames], settings: TruthParams
) -> list[BoolArray]:
    """Label matches, in working pixels, by the truth, in given ones; all at once: depth maps are slow to read."""
    points, scales = [], []
    for side, to_working in zip("12", prepared.to_working, strict=True):
        inverse = np.linalg.inv(to_working)
        x, scale = (np.concatenate([getattr(each, name + side) for each in frames]) for name in ("x", "scale"))
        points.append(x @ inverse[:2, :2].T + inverse[:2, 2])
        scales.append(scale * float(np.sqrt(inverse[0, 0] * inverse[1, 1])))
    right = label_matches(pair, *points, *scales, settings=settings)
    return np.split(right, np.cumsum([len(each) for each in frames])[:-1])


def voted_rows(rows: PairRows, first: Classifier, second: Classifier | None = None) -> tuple[Float32Array, BoolArray]:
    """Let the rough fundamental matrices vote; return the preset's `match_columns`, (M, C) float32, and labels.

    With a second classifier it judges the matches, and these are `SECOND_ROUND_COLUMNS` and labels of the best. The
    classifiers give calibrated probabilities and never saw this scene; rows that depend on them cannot be stored.
    """
    settings = find_preset(rows.preset)
    probability = first(rows.two_keypoints.select(settings.two_keypoint_columns))
    united = hypothesis.UnitedMatches(union=rows.union, frames=rows.united_frames)
    votes = hypothesis.cast_votes(united.frames_of_x(), rows.two_keypoints, probability, settings)
    table = hypothesis.describe_matches(united, rows.table, rows.two_keypoints, votes)
    described = table.select(settings.match_columns)
    if second is None:
        return described, rows.united_labels
    judged = second(described)
    best = second_round_rows(judged, settings.second_round)
    again = second_round_table(best, united.union, united.frames, table, judged, votes.matrices)
    return again.select(SECOND_ROUND_COLUMNS), rows.united_labels[best]


def rows_to_bytes(rows: PairRows) -> bytes:
    """Serialise rows; the same rows give the same bytes."""
    columns = {field.name: getattr(rows, field.name) for field in fields(rows)}
    for name, cls in _PARTS.items():
        part = columns.pop(name)
        columns |= {f"{name}.{field.name}": getattr(part, field.name) for field in fields(cls)}
    return npz_bytes({name: np.asarray(value) for name, value in columns.items()})


def read_rows(path: Path) -> PairRows:
    """Read the rows of one pair under one roll hypothesis."""
    with np.load(path, allow_pickle=False) as stored:
        values = {name: _plain(stored[name]) for name in stored.files}
    own = {name: value for name, value in values.items() if "." not in name}
    for name, cls in _PARTS.items():
        own[name] = cls(**{field.name: values[f"{name}.{field.name}"] for field in fields(cls)})
    return PairRows(**own)


def _plain(value: Any) -> Any:
    """Return names as a tuple and scalars as such; other arrays as they are."""
    if value.dtype.kind == "U" and value.ndim:
        return tuple(value.tolist())
    return value if value.ndim else value.item()
