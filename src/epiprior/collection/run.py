"""A collection from images to matched pairs: features once, then every pair, on workers; what is ready is kept."""

import contextlib
import itertools
import os
import shutil
import tempfile
import weakref
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from epiprior.collection.features import feature_key, make_features, read_features
from epiprior.collection.images import CollectionImage, ImageSet, find_images
from epiprior.collection.match import MatchSettings, match_pair
from epiprior.collection.pairs import Pair, choose_pairs, default_pairs
from epiprior.collection.store import MatchedPair, PairStore
from epiprior.collection.workers import Pool, open_pool, run_tasks
from epiprior.errors import OutputError
from epiprior.estimators import find_estimator
from epiprior.features.describe import normalise_descriptors
from epiprior.io.output import replacing
from epiprior.presets import FeatureSettings, Mode, PreprocessSettings, find_preset
from epiprior.types import Features, Float32Array

OnPair = Callable[[MatchedPair], None]
OnProgress = Callable[[str, int, int], None]
Given = Callable[[str], Features]
Ready = Callable[[], None]


@dataclass(frozen=True, kw_only=True)
class MatchedCollection:
    """What `match_collection` returns: iterate for the matched pairs, which are read one by one.

    Parameters
    ----------
    images : The photographs, by name, and what was left out.
    pairs : Places in `images.images` of the pairs, ascending.
    work : The folder that holds features and matches.
    """

    images: ImageSet
    pairs: Sequence[Pair]
    work: Path
    feature_keys: Sequence[str] = field(repr=False)
    how: MatchSettings = field(repr=False)
    store: PairStore = field(repr=False)
    cameras: Mapping[str, Any] = field(default_factory=dict, repr=False)

    def __len__(self) -> int:
        return len(self.pairs)

    def __iter__(self) -> Iterator[MatchedPair]:
        return map(self.read, self.pairs)

    def read(self, pair: Pair) -> MatchedPair:
        """Return what was found for one of the `pairs`."""
        return self.store.read(self.key(pair))

    def key(self, pair: Pair) -> bytes:
        """Return the key of a pair in the store."""
        return self.how.pair_key((self.feature_keys[pair[0]], self.feature_keys[pair[1]]), self.cameras_of(pair))

    @property
    def plain(self) -> "MatchedCollection":
        """The same without cameras: all pairs as they were found."""
        return replace(self, cameras={})

    def cameras_of(self, pair: Pair) -> tuple[Any, Any] | None:
        """Return the cameras of a pair where the focal lengths of both are known."""
        first, second = (self.cameras.get(self.images.images[place].name) for place in pair)
        known = all(camera is not None and camera.has_prior_focal_length for camera in (first, second))
        return (first, second) if known else None

    def file(self, place: int) -> Path:
        """Return the file of the features of an image."""
        return _feature_file(self.work, self.feature_keys[place])

    def features(self, place: int) -> Features:
        """Return the features of an image: matches name their rows."""
        return read_features(self.file(place)).features


def match_collection(
    images: str | Path | Sequence[str | Path] | ImageSet,
    *,
    pairs: str | None = None,
    mode: Mode = "cascade",
    estimator: str = "epiprior",
    preset: str = "default",
    settings: PreprocessSettings | None = None,
    seed: int = 0,
    threshold_px: float | None = None,
    mask_path: str | Path | None = None,
    cameras: Mapping[str, Any] | None = None,
    work: str | Path | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    given: Given | None = None,
    without: Container[tuple[str, str]] = (),
    on_pair: OnPair | None = None,
    on_progress: OnProgress | None = None,
) -> MatchedCollection:
    """Match the photographs of a collection.

    Parameters
    ----------
    images : A folder, or image files and folders; see `epiprior.collection.images.find_images`, which checks all.
    pairs : ``exhaustive``, ``sequential:K``, ``similar:K`` or a file with a list; see `epiprior.collection.pairs`. By
        default exhaustive up to 200 images, else ``similar:20``.
    mode, estimator, preset, settings, seed, threshold_px : As for `epiprior.estimate_fundamental`.
    mask_path : A folder of masks, as COLMAP takes them.
    cameras : By name of the image, of pycolmap. Where those of both images have a prior focal length, F comes from an
        essential matrix of the same matches; see `epiprior.collection.verify`.
    work : A folder that keeps features and matches: with the same folder, a run that was killed goes on. Made if
        absent; by default a temporary one, which is removed with the result.
    workers : Processes; by default as many as this process may use cores.
    scheduler : Address of a dask cluster, instead of processes; its workers need this installation, and these paths.
    given : Returns the features of the image of a name, instead of detected ones.
    without : Pairs of names, in order, that are not matched.
    on_pair : Called with every pair, as it is ready.
    on_progress : Called with what is done (``features``, ``pairs``), how many of them are ready, and of how many.

    Raises
    ------
    ImageError, SettingsError, EstimatorError : For input that cannot be used, before any work.
    OutputError : If `work` cannot be written.
    """
    find_estimator(estimator)
    chosen = settings or find_preset(preset)
    how = MatchSettings(settings=chosen, mode=mode, estimator=estimator, seed=seed, threshold_px=threshold_px)
    found = images if isinstance(images, ImageSet) else find_images(images, mask_path=mask_path)
    names = [image.name for image in found.images]
    wanted = default_pairs(len(names)) if pairs is None else pairs
    planned = choose_pairs(wanted, names)
    scratch = tempfile.mkdtemp(prefix="epiprior-") if work is None else None
    folder = Path(os.path.abspath(scratch if work is None else work))  # type: ignore[arg-type]  # noqa: PTH100
    try:
        (folder / "features").mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be written: {error.strerror}") from error
    store = PairStore(folder / "pairs.db")
    with contextlib.ExitStack() as stack:
        stack.callback(_let_go, store, scratch)
        with open_pool(workers, scheduler) as pool:
            ready = _counting(on_progress, "features", len(names))
            keys = _find_features(pool, found.images, folder, chosen.features, given, ready)

            def descriptors(place: int) -> Float32Array:
                own = read_features(_feature_file(folder, keys[place])).features.descriptors
                return normalise_descriptors(own, root=chosen.features.root, centred=chosen.features.centred)

            planned = choose_pairs(wanted, names, descriptors) if planned is None else planned
            assert planned is not None
            planned = [(a, b) for a, b in planned if (names[a], names[b]) not in without]
            kept: dict[str, Any] = {"feature_keys": keys, "how": how, "store": store, "cameras": cameras or {}}
            matched = MatchedCollection(images=found, pairs=planned, work=folder, **kept)
            _match_pairs(pool, matched, on_pair, on_progress)
        stack.pop_all()
    weakref.finalize(matched, _let_go, store, scratch)
    return matched


def _counting(on_progress: OnProgress | None, stage: str, total: int) -> Ready:
    """Return what is called for every one that is ready."""
    numbers = itertools.count(1)
    return lambda: on_progress(stage, next(numbers), total) if on_progress else None


def _let_go(store: PairStore, scratch: str | None) -> None:
    store.close()
    if scratch is not None:
        shutil.rmtree(scratch, ignore_errors=True)


def _find_features(
    pool: Pool, images: Sequence[CollectionImage], work: Path, how: FeatureSettings, given: Given | None, ready: Ready
) -> list[str]:
    """Make the files of features that are not there yet, each of which is `ready` then; return the keys of all."""
    keys = [""] * len(images)

    def jobs() -> Iterator[tuple[int, tuple[Any, ...]]]:
        for place, image in enumerate(images):
            own = given(image.name) if given else None
            keys[place] = feature_key(image, how, own)
            if _feature_file(work, keys[place]).is_file():
                ready()
            else:
                yield place, (image, how, own)

    for place, content in run_tasks(pool, make_features, jobs()):
        with replacing(_feature_file(work, keys[place])) as partial:
            partial.write_bytes(content)
        ready()
    return keys


def _feature_file(work: Path, key: str) -> Path:
    return work / "features" / f"{key[:40]}.npz"


def _match_pairs(
    pool: Pool, matched: MatchedCollection, on_pair: OnPair | None, on_progress: OnProgress | None
) -> None:
    images, store = matched.images.images, matched.store
    count = _counting(on_progress, "pairs", len(matched))

    def ready(pair: MatchedPair) -> None:
        if on_pair:
            on_pair(pair)
        count()

    def jobs() -> Iterator[tuple[Pair, tuple[Any, ...]]]:
        for pair in matched.pairs:
            if matched.key(pair) in store:
                ready(store.read(matched.key(pair)))
                continue
            both = [(images[place], matched.file(place)) for place in pair]
            yield pair, (*zip(*both, strict=True), matched.how, matched.cameras_of(pair))

    for pair, (without, found) in run_tasks(pool, match_pair, jobs()):
        store.write(matched.plain.key(pair), without)
        if matched.cameras_of(pair) is not None:
            store.write(matched.key(pair), found)
        ready(found)
