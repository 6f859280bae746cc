"""One bag by one method, mapped with inferred and with known intrinsics, and what is right of the models: a task."""

import itertools
import statistics
import tempfile
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from epiprior.collection.model import Model, map_database
from epiprior.io.colmap import quiet
from epiprior_lab.bags.choose import Bag, View
from epiprior_lab.bags.methods import fill_database, know_cameras, processor_seconds
from epiprior_lab.bags.params import MapperParams
from epiprior_lab.evaluation.learned import Columns

INTRINSICS = ("known", "inferred")
_UNPLACED_DEG = 180.0


@dataclass(frozen=True, kw_only=True)
class BagRecord:
    """One model of a bag: the one with most photographs.

    Its home is the place of most of them. Of the `images` of the home so many are `registered`, of these so many
    `wrong`; `strangers` are registered photographs of other places, of `others` in the bag. `accuracy` is as in
    `MapperParams`, over all pairs of the home, where what is not registered counts as wrong. `tracks` are points, and
    `track_length` in how many photographs these are seen, on average; NaN without any. Seconds are processor time: of
    features (NaN where they are part of matching), of matching with verification, of mapping.
    """

    group: str
    scene: str
    kind: str
    size: int
    bag: str
    method: str
    intrinsics: str
    images: int
    registered: int
    wrong: int
    others: int
    strangers: int
    accuracy: float
    tracks: int
    track_length: float
    features_s: float
    matching_s: float
    mapping_s: float


SECONDS = ("features_s", "matching_s", "mapping_s")


def measure_bag(
    *, bag: Bag, method: str, mapper: MapperParams, learned: Sequence[Columns] | None = None, learned_s: float = 0.0
) -> list[BagRecord]:
    """Fill a database by a method, map it, and measure: a record for each of `INTRINSICS`.

    `learned` are the matches of a learned method, which took `learned_s`.
    """
    records = []
    with tempfile.TemporaryDirectory() as scratch:
        images, database = Path(scratch, "images"), Path(scratch, "database.db")
        images.mkdir()
        for name, view in bag.named.items():
            (images / name).symlink_to(view.image.resolve())
        start = processor_seconds()
        how: dict[str, Any] = {"seed": mapper.seed, "min_confidence": mapper.min_confidence, "learned": learned}
        features, matched = fill_database(method, images, bag.named, database, **how)
        used = processor_seconds() - start + learned_s
        seconds: dict[str, Any] = {"features_s": features if learned is None else np.nan, "matching_s": used - features}
        for kind in reversed(INTRINSICS):
            if kind == "known":
                with quiet():
                    least = mapper.min_confidence
                    know_cameras(database, bag.named, matched, seed=mapper.seed, min_confidence=least)
            start = processor_seconds()
            sparse = Path(scratch, "sparse")
            models = map_database(database, images, sparse, seed=mapper.seed, refine=kind == "inferred")
            seconds["mapping_s"] = processor_seconds() - start
            about = {name: getattr(bag, name) for name in ("group", "scene", "kind", "size")}
            found = judge(models[0] if models else None, bag.named, mapper)
            records.append(BagRecord(**about, bag=bag.name, method=method, intrinsics=kind, **found, **seconds))
    return records[::-1]


def judge(model: Model | None, named: dict[str, View], mapper: MapperParams) -> dict[str, Any]:
    """Return the measures of `BagRecord` for a model of a bag."""
    placed = {} if model is None else {name: k for k, name in enumerate(model.seen)}
    inside, whole = (Counter(v.place for n, v in named.items() if n in part) for part in (placed, named))
    home = max(whole, key=lambda place: (inside[place], whole[place]))
    own = {name: view for name, view in named.items() if view.place == home}
    errors = {}
    for a, b in itertools.combinations(own, 2):
        errors[a, b] = _UNPLACED_DEG
        if model is not None and a in placed and b in placed:
            errors[a, b] = _pose_error_deg(model, (placed[a], placed[b]), (own[a], own[b]))
    wrong = 0
    for name in placed.keys() & own.keys():
        to_others = [errors[pair] for pair in errors if name in pair and placed.keys() >= set(pair)]
        wrong += bool(to_others) and statistics.median(to_others) > mapper.wrong_deg
    tracks = {} if model is None else model.tracks
    points = sum(tracks.values())
    return {
        "images": len(own),
        "registered": inside[home],
        "wrong": wrong,
        "others": len(named) - len(own),
        "strangers": len(placed) - inside[home],
        "accuracy": statistics.fmean(np.mean([e < d for e in errors.values()]) for d in mapper.accuracy_deg),
        "tracks": points,
        "track_length": sum(length * count for length, count in tracks.items()) / points if points else np.nan,
    }


def _pose_error_deg(model: Model, rows: tuple[int, int], views: tuple[View, View]) -> float:
    """Return the larger of the errors of rotation and direction between two cameras, degrees."""
    (R1, R2), (c1, c2) = model.rotations[list(rows)], model.centres[list(rows)]
    true1, true2 = (view.camera for view in views)
    turned = (R2 @ R1.T).T @ (true2.R @ true1.R.T)
    found, true = R1 @ (c2 - c1), true1.R @ (true2.centre - true1.centre)
    cosine = float(found @ true) / max(float(np.linalg.norm(found) * np.linalg.norm(true)), 1e-12)
    return max(_angle_deg((float(np.trace(turned)) - 1) / 2), _angle_deg(cosine))


def _angle_deg(cosine: float) -> float:
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))
