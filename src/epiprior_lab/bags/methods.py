"""What fills a COLMAP database with the keypoints and verified pairs of a folder of photographs: one way per method.

`colmap` is COLMAP as it comes: its SIFT, its matching of all pairs, its verification. `snn` are features of epiprior,
mutual nearest neighbours below a ratio, COLMAP's verification. `cascade` and `preprocess` are epiprior, as ``epiprior
colmap`` fills a database. Learned matchers bring keypoints and matches, which COLMAP verifies. One thread each.
"""

import contextlib
import itertools
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from epiprior.collection.database import CameraSettings, infer_cameras, write_database
from epiprior.collection.features import feature_key, make_features
from epiprior.collection.images import find_images
from epiprior.collection.match import MatchSettings, match_pair
from epiprior.collection.run import MatchedCollection
from epiprior.collection.store import PairStore
from epiprior.collection.verify import judge_pairs
from epiprior.io.colmap import add_camera, add_image, add_pair, quiet
from epiprior.matching.baselines import snn_matches
from epiprior.presets import Mode, find_preset
from epiprior.types import FloatArray, IntArray
from epiprior_lab.bags.choose import View
from epiprior_lab.evaluation.learned import Columns
from epiprior_lab.pairsets import Camera

MODES: Mapping[str, Mode] = {"cascade": "cascade", "preprocess": "preprocess"}
_Rows = Mapping[tuple[str, str], IntArray]


def processor_seconds() -> float:
    """Return the seconds that this process has used, and its children that ended."""
    return sum(os.times()[:4])


def fill_database(
    method: str,
    images: Path,
    named: Mapping[str, View],
    database: Path,
    *,
    seed: int,
    min_confidence: float,
    learned: Sequence[Columns] | None,
) -> tuple[float, MatchedCollection | None]:
    """Fill a new database from the photographs of a folder; return the processor seconds that features took.

    `learned` is what a learned matcher found for all pairs, in order; its features were found before. Last, for
    `know_cameras`, what epiprior found, under the true cameras.
    """
    with quiet():
        if learned is not None:
            _write_learned(images, database, learned, seed)
            return 0.0, None
        if method == "colmap":
            return _by_colmap(images, database, seed), None
        return _by_epiprior(method, images, named, database, seed=seed, min_confidence=min_confidence)


def know_cameras(
    database: Path, named: Mapping[str, View], matched: MatchedCollection | None, *, seed: int, min_confidence: float
) -> None:
    """Put the true intrinsics into a database, and verify all matches under these: as COLMAP, or as epiprior does."""
    import pycolmap

    if matched is not None:
        database.unlink()
        in_order = [(image.name, matched.cameras[image.name]) for image in matched.images.images]
        write_database(database, judge_pairs(matched, min_confidence), in_order)
        return
    with pycolmap.Database.open(database) as opened:
        for image in opened.read_all_images():
            camera = true_camera(named[image.name].camera)
            camera.camera_id = image.camera_id
            opened.update_camera(camera)
        opened.clear_two_view_geometries()
    _verify(database, list(named), seed)


def true_camera(known: Camera) -> Any:
    """Return a camera as one of pycolmap whose focal length is known."""
    import pycolmap

    (fx, _, cx), (_, fy, cy) = known.K[:2]
    camera = pycolmap.Camera.create_from_model_name(0, "PINHOLE", fx, known.width, known.height)
    camera.params, camera.has_prior_focal_length = [fx, fy, cx + 0.5, cy + 0.5], True
    return camera


def _match(matched: MatchedCollection) -> None:
    """Match the pairs that are not in the store: what workers of `match_collection` do, in this process."""
    images, store = matched.images.images, matched.store
    for a, b in matched.pairs:
        if matched.key((a, b)) not in store:
            both = (images[a], images[b]), (matched.file(a), matched.file(b))
            plain, known = match_pair(*both, matched.how, matched.cameras_of((a, b)))
            store.write(matched.plain.key((a, b)), plain)
            store.write(matched.key((a, b)), known)


def _by_colmap(images: Path, database: Path, seed: int) -> float:
    import pycolmap

    extraction, matching = pycolmap.FeatureExtractionOptions(), pycolmap.FeatureMatchingOptions()
    verification, start = pycolmap.TwoViewGeometryOptions(), processor_seconds()
    extraction.use_gpu = matching.use_gpu = False
    extraction.num_threads = matching.num_threads = 1
    verification.ransac.random_seed = seed
    mode = pycolmap.CameraMode.PER_IMAGE
    pycolmap.extract_features(database, images, camera_mode=mode, extraction_options=extraction)
    used = processor_seconds() - start
    pycolmap.match_exhaustive(database, matching_options=matching, verification_options=verification)
    return used


def _by_epiprior(
    method: str, images: Path, named: Mapping[str, View], database: Path, *, seed: int, min_confidence: float
) -> tuple[float, MatchedCollection | None]:
    """Do what `match_collection` does, in this process, so that processor time is that of the work."""
    found, settings, start = find_images(images), find_preset("default"), processor_seconds()
    how = MatchSettings(settings=settings, mode=MODES.get(method, "standard"), seed=seed)
    work = database.with_suffix(".work")
    (work / "features").mkdir(parents=True)
    pairs = list(itertools.combinations(range(len(found.images)), 2))
    keys = [feature_key(image, settings.features) for image in found.images]
    store = PairStore(work / "pairs.db")
    cameras = {name: true_camera(view.camera) for name, view in named.items()}
    kept: dict[str, Any] = {"feature_keys": keys, "how": how, "store": store, "cameras": cameras}
    matched = MatchedCollection(images=found, pairs=pairs if method in MODES else [], work=work, **kept)
    for place, image in enumerate(found.images):
        matched.file(place).write_bytes(make_features(image, settings.features))
    used = processor_seconds() - start
    _match(matched)
    inferred = infer_cameras(found, CameraSettings())
    by_name = {image.name: camera for image, (_, camera) in zip(found.images, inferred, strict=True)}
    as_inferred = replace(matched, cameras=by_name)
    _match(as_inferred)  # where EXIF tells focal lengths
    write_database(database, judge_pairs(as_inferred, min_confidence), inferred)
    if method in MODES:
        return used, matched
    with contextlib.closing(store):
        rows = {}
        for a, b in pairs:
            one = snn_matches(None, None, features1=matched.features(a), features2=matched.features(b)).one_to_one()
            names = found.images[a].name, found.images[b].name
            rows[names] = np.column_stack([one.feature1, one.feature2])
        _add_matches(database, rows, seed)
    return used, None


def _write_learned(images: Path, database: Path, learned: Sequence[Columns], seed: int) -> None:
    """Write the keypoints that some match uses, one row each in all pairs, and the matches."""
    import pycolmap

    found = find_images(images)
    names = [image.name for image in found.images]
    pairs = list(itertools.combinations(names, 2))
    seen: dict[str, dict[int, FloatArray]] = {name: {} for name in names}
    for pair, columns in zip(pairs, learned, strict=True):
        for side, name in enumerate(pair, 1):
            seen[name] |= dict(zip(columns[f"feature{side}"].tolist(), columns[f"x{side}"], strict=True))
    places = {name: {number: row for row, number in enumerate(sorted(own))} for name, own in seen.items()}
    with pycolmap.Database.open(database) as opened:
        for name, (_, camera) in zip(names, infer_cameras(found, CameraSettings()), strict=True):
            xy = np.array([seen[name][number] for number in places[name]]).reshape(-1, 2)
            add_image(opened, name, add_camera(opened, camera), xy)
    rows = {}
    for pair, columns in zip(pairs, learned, strict=True):
        sides = [[places[name][n] for n in columns[f"feature{s}"].tolist()] for s, name in enumerate(pair, 1)]
        rows[pair] = np.array(sides, dtype=np.int64).T
    _add_matches(database, rows, seed)


def _add_matches(database: Path, rows: _Rows, seed: int) -> None:
    import pycolmap

    with pycolmap.Database.open(database) as opened:
        ids: dict[str, Any] = {image.name: image.image_id for image in opened.read_all_images()}
        for (a, b), matches in rows.items():
            add_pair(opened, (ids[a], ids[b]), matches)
    _verify(database, list(ids), seed)


def _verify(database: Path, names: Sequence[str], seed: int) -> None:
    import pycolmap

    listed, options = database.with_suffix(".txt"), pycolmap.TwoViewGeometryOptions()
    listed.write_text("".join(f"{a} {b}\n" for a, b in itertools.combinations(names, 2)), encoding="utf-8")
    options.ransac.random_seed = seed
    pycolmap.verify_matches(database, listed, options=options)
