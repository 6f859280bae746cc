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
from epiprior_lab.labels.ground_truth import LabelSettings, label_matches
from epiprior_lab.pairsets import Pair, npz_bytes

_STORED = {"two_keypoints": TwoKeypointMatches, "table": StandardTable, "union": Union, "united_frames": MatchFrames}


@dataclass(frozen=True, kw_only=True)
class PairRows:
    """Rows and labels of one pair under one roll hypothesis, with the features of one preset.

    `two_keypoints` holds matches of 2keypoints with their descriptors 2kpmd; `table` X_L and X_B; `united` X, X_L and
    X_B together, and `united_labels`, shape (M,), which of them are right.
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
    def two_keypoint_labels(self) -> BoolArray:
        """Which 2keypoint matches consist of right matches only, shape (T,)."""
        labels = self.united_labels[self.united.union.in_x >= 0]
        return labels[self.two_keypoints.main] & labels[self.two_keypoints.other]


def extract_rows(pair: Pair, presets: Sequence[str], labels: LabelSettings | None = None) -> dict[str, list[PairRows]]:
    """Run the library up to the first classifier and label the matches, for every preset and roll hypothesis."""
    return {preset: _preset_rows(pair, preset, labels) for preset in presets}


def _preset_rows(pair: Pair, preset: str, settings: LabelSettings | None) -> list[PairRows]:
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
            united=each.united,
            united_labels=right,
        )
        for each, right in zip(candidates, labels, strict=True)
    ]


def _labels(
    pair: Pair, prepared: PreparedPair, frames: Sequence[MatchFrames], settings: LabelSettings | None
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


def second_round_sample(
    rows: PairRows, probability: FloatArray, first_round: Callable[[Float32Array], FloatArray]
) -> tuple[Float32Array, BoolArray]:
    """Let the matrices vote and a classifier judge the matches; return `SECOND_ROUND_COLUMNS` and labels of the best.

    `probability` is as for `match_rows`; `first_round`, like it, never saw this scene.
    """
    settings = find_preset(rows.preset)
    votes = hypothesis.cast_votes(rows.united.frames_of_x(), rows.two_keypoints, probability, settings)
    table = hypothesis.describe_matches(rows.united, rows.table, rows.two_keypoints, votes)
    first = first_round(table.select(settings.match_columns))
    best = second_round_rows(first, settings.second_round)
    united = rows.united
    again = second_round_table(best, united.union, united.frames, table, first, votes.matrices)
    return again.select(SECOND_ROUND_COLUMNS), rows.united_labels[best]


def match_rows(rows: PairRows, probability: FloatArray) -> tuple[Float32Array, BoolArray]:
    """Let the rough fundamental matrices vote; return the preset's `match_columns`, (M, C) float32, and labels.

    `probability`, shape (T,), is of each 2keypoint match, from a first classifier that was not trained on this scene:
    kpmd depends on it, so that these rows cannot be stored as those of the first classifier are.
    """
    settings = find_preset(rows.preset)
    votes = hypothesis.cast_votes(rows.united.frames_of_x(), rows.two_keypoints, probability, settings)
    table = hypothesis.describe_matches(rows.united, rows.table, rows.two_keypoints, votes)
    return table.select(settings.match_columns), rows.united_labels


def rows_to_bytes(rows: PairRows) -> bytes:
    """Serialise rows; the same rows give the same bytes."""
    columns: dict[str, Any] = {
        name: getattr(rows, name) for name in ("pair_id", "scene", "preset", "roll_deg", "united_labels")
    }
    parts: tuple[Any, ...] = (rows.two_keypoints, rows.table, rows.united.union, rows.united.frames)
    for prefix, part in zip(_STORED, parts, strict=True):
        columns |= {f"{prefix}.{field.name}": getattr(part, field.name) for field in fields(part)}
    return npz_bytes({name: np.asarray(value) for name, value in columns.items()})


def read_rows(path: Path) -> PairRows:
    """Read the rows of one pair under one roll hypothesis."""
    with np.load(path, allow_pickle=False) as stored:
        parts: dict[str, Any] = {}
        for prefix, cls in _STORED.items():
            values = {field.name: stored[f"{prefix}.{field.name}"] for field in fields(cls)}
            parts[prefix] = cls(**{name: _plain(value) for name, value in values.items()})
        return PairRows(
            pair_id=str(stored["pair_id"]),
            scene=str(stored["scene"]),
            preset=str(stored["preset"]),
            roll_deg=float(stored["roll_deg"]),
            two_keypoints=parts["two_keypoints"],
            table=parts["table"],
            united=hypothesis.UnitedMatches(union=parts["union"], frames=parts["united_frames"]),
            united_labels=stored["united_labels"],
        )


def _plain(value: Any) -> Any:
    """Return names as a tuple and scalars as such; other arrays as they are."""
    if value.dtype.kind == "U" and value.ndim:
        return tuple(value.tolist())
    return value if value.ndim else value.item()
