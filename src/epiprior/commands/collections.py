"""Commands on collections of photographs: `sfm`, `colmap` and `hloc`."""

import contextlib
import logging
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from epiprior.commands import options
from epiprior.commands.printing import complain, say
from epiprior.errors import OutputError, require

if TYPE_CHECKING:
    from epiprior.collection.images import ImageSet
    from epiprior.collection.run import MatchedCollection

_logger = logging.getLogger(__name__)
_SECONDS_BETWEEN_LINES = 10.0

_PAIRS = "'exhaustive' (default up to 200 images), 'similar:K' (default beyond, K = 20), 'sequential:K', or a file."
Images = Annotated[list[Path], typer.Argument(metavar="IMAGES", help="A folder, or photographs.")]
MaybeImages = Annotated[list[Path] | None, typer.Argument(metavar="[IMAGES]", help="A folder, or photographs.")]
Pairs = Annotated[str | None, typer.Option(help=_PAIRS)]
Workers = Annotated[int | None, typer.Option(min=1, help="Processes. Default: all cores.")]
Scheduler = Annotated[str | None, typer.Option(help="Address of a dask cluster, instead of processes.")]
Work = Annotated[Path | None, typer.Option(help="Folder that keeps what is ready. Default: the output, .work added.")]
MinConfidence = Annotated[float, typer.Option(min=0, max=1, help="Geometries below it are not written.")]
CameraMode = Annotated[Literal["single", "per-folder", "per-image"], typer.Option(help="Which images share a camera.")]
CameraModel = Annotated[str, typer.Option(help="COLMAP's name of the camera model.")]
CameraParams = Annotated[
    str, typer.Option(help="Its parameters, with commas, taken as known. Default: inferred as by COLMAP.")
]
MaskPath = Annotated[Path | None, typer.Option(help="Folder of masks NAME.png, black where nothing is to be found.")]
Roots = Annotated[int, typer.Option(min=0, help="How many times the root was taken of the stored descriptors.")]


def sfm(
    images: Images,
    *,
    out: Annotated[Path, typer.Option(help="Folder for the model and all that leads to it.")],
    pairs: Pairs = None,
    mode: options.Mode = "cascade",
    workers: Workers = None,
    scheduler: Scheduler = None,
    min_confidence: MinConfidence = 0.5,
    camera_mode: CameraMode = "per-image",
    camera_model: CameraModel = "SIMPLE_RADIAL",
    camera_params: CameraParams = "",
    mask_path: MaskPath = None,
    estimator: options.Estimator = "epiprior",
    seed: options.Seed = 0,
    threshold: options.Threshold = None,
    preset: options.Preset = "default",
    features: options.Detector = "sift",
    max_image_size: options.MaxImageSize = None,
    max_features: options.MaxFeatures = None,
) -> None:
    """Make a model of a folder of photographs: features, pairs, geometries, COLMAP's mapper, a report.

    Needs pycolmap. The same command goes on where it was stopped. Exit code 1 if there is no model.

        epiprior sfm images/ --out scene/
    """
    from epiprior.collection.database import CameraSettings, infer_cameras, write_database
    from epiprior.collection.images import find_images
    from epiprior.collection.model import map_beside
    from epiprior.collection.report import write_report
    from epiprior.collection.verify import judge_pairs

    settings = options.chosen_settings(preset, features, max_image_size, max_features)
    database, work = out / "database.db", out / "work"
    require("pycolmap", f"{database}: a COLMAP database")
    if out.exists() and not work.is_dir() and any(out.iterdir()):
        raise OutputError(f"{out}: is neither empty nor made by this command")
    found = find_images(images, mask_path=mask_path)
    cameras = infer_cameras(found, CameraSettings(mode=camera_mode, model=camera_model, params=camera_params))
    work.mkdir(parents=True, exist_ok=True)
    matched = _match(
        found, pairs=pairs, mode=mode, workers=workers, scheduler=scheduler, estimator=estimator, seed=seed,
        threshold_px=threshold, settings=settings, work=work, cameras=_by_name(found, cameras),
    )  # fmt: skip
    judged = judge_pairs(matched, min_confidence)
    database.unlink(missing_ok=True)
    count = write_database(database, judged, cameras)
    say(f"{database}: {count} of {len(matched)} pairs have a geometry")
    _logger.info("mapping")
    given = bool(camera_params) and judged.trusted
    models = map_beside(database, found.root, out / "sparse", seed, refine=not given)
    write_report(out / "report.html", judged, models)
    for model in models:
        say(f"{model.folder}: {len(model.seen)} of {len(found.images)} images, {len(model.points)} points")
    say(f"{out / 'report.html'}: open it in a browser; {work} can be deleted")
    if not models:
        complain("no model: no two images with enough matches and enough between them; the report says what was found")
        raise typer.Exit(options.NO_GEOMETRY)
    say(f"see it: colmap gui --import_path {models[0].folder} --database_path {database} --image_path {found.root}")


def colmap(
    images: MaybeImages = None,
    *,
    database: Annotated[Path, typer.Option(help="A new one, or one with features, to which matches are added.")],
    pairs: Pairs = None,
    mode: options.Mode = "cascade",
    workers: Workers = None,
    scheduler: Scheduler = None,
    min_confidence: MinConfidence = 0.5,
    camera_mode: CameraMode = "per-image",
    camera_model: CameraModel = "SIMPLE_RADIAL",
    camera_params: CameraParams = "",
    mask_path: MaskPath = None,
    roots: Roots = 1,
    work: Work = None,
    estimator: options.Estimator = "epiprior",
    seed: options.Seed = 0,
    threshold: options.Threshold = None,
    preset: options.Preset = "default",
    features: options.Detector = "sift",
    max_image_size: options.MaxImageSize = None,
    max_features: options.MaxFeatures = None,
) -> None:
    """Write a COLMAP database with verified matches, or add them to one that COLMAP has filled with features.

    Needs pycolmap. Map it with `colmap mapper` or `pycolmap.incremental_mapping`. To a database with features, IMAGES
    is COLMAP's image folder; without it ranking knows the photographs' features only. Pairs that have a geometry there
    stay as they are. Exit code 1 only if no pair at all has a geometry.

        epiprior colmap images/ --database scene.db
    """
    from epiprior.collection import database as colmap_database
    from epiprior.collection.images import find_images
    from epiprior.collection.verify import judge_pairs
    from epiprior.io.colmap import check_colmap_output

    settings = options.chosen_settings(preset, features, max_image_size, max_features)
    asked: dict[str, Any] = {
        "pairs": pairs, "mode": mode, "workers": workers, "scheduler": scheduler, "estimator": estimator, "seed": seed,
        "threshold_px": threshold, "settings": settings, "work": work or Path(f"{database}.work"),
    }  # fmt: skip
    if database.exists():
        if images is not None and len(images) != 1:
            raise OutputError(f"{database}: exists already; to add to it, give the folder of its images, or none")
        if mask_path is not None:
            raise typer.BadParameter(f"{database} has features already: --mask-path comes too late")
        if (camera_mode, camera_model, camera_params) != ("per-image", "SIMPLE_RADIAL", ""):
            raise typer.BadParameter(f"{database} has cameras already: --camera-mode, -model and -params come too late")
        filled = colmap_database.read_filled(database, images[0] if images else None, roots=roots)
        matched = _match(filled.images, given=filled.features, without=filled.verified, cameras=filled.cameras, **asked)
        count = colmap_database.extend_database(database, judge_pairs(matched, min_confidence))
    else:
        if not images:
            raise typer.BadParameter(f"{database} does not exist, and there are no photographs")
        check_colmap_output(database)
        found = find_images(images, mask_path=mask_path)
        how = colmap_database.CameraSettings(mode=camera_mode, model=camera_model, params=camera_params)
        cameras = colmap_database.infer_cameras(found, how)
        matched = _match(found, cameras=_by_name(found, cameras), **asked)
        count = colmap_database.write_database(database, judge_pairs(matched, min_confidence), cameras)
    _tell(database, count, matched)
    say(f"map it: colmap mapper --database_path {database} --image_path {matched.images.root} --output_path sparse")


def hloc(
    images: MaybeImages = None,
    *,
    features: Annotated[Path, typer.Option(help="hloc's file of features, with scales and orientations.")],
    matches: Annotated[Path, typer.Option(help="File of matches to write; must not exist.")],
    pairs: Pairs = None,
    mode: options.Mode = "cascade",
    workers: Workers = None,
    scheduler: Scheduler = None,
    min_confidence: MinConfidence = 0.5,
    roots: Roots = 2,
    work: Work = None,
    estimator: options.Estimator = "epiprior",
    seed: options.Seed = 0,
    threshold: options.Threshold = None,
    preset: options.Preset = "default",
    max_image_size: options.MaxImageSize = None,
) -> None:
    """Match the features of an h5 file of hloc; write a file of matches as hloc's `match_features` does.

    IMAGES is hloc's image folder; without it ranking knows the photographs' features only. Exit code 1 only if no pair
    at all has a geometry.

        epiprior hloc images/ --features feats.h5 --matches matches.h5 --pairs pairs.txt
    """
    from epiprior.collection.hloc import check_hloc_output, read_hloc_images, write_hloc_matches
    from epiprior.collection.verify import judge_pairs
    from epiprior.io.features import read_hloc_features

    settings = options.chosen_settings(preset, "sift", max_image_size, None)
    check_hloc_output(matches)
    if images is not None and len(images) != 1:
        raise typer.BadParameter("give the one folder that the names of the features are relative to, or none")
    found = read_hloc_images(features, images[0] if images else None)
    matched = _match(
        found, pairs=pairs, mode=mode, workers=workers, scheduler=scheduler, estimator=estimator, seed=seed,
        threshold_px=threshold, settings=settings, work=work or Path(f"{matches}.work"),
        given=lambda name: read_hloc_features(features, name, roots=roots),
    )  # fmt: skip
    _tell(matches, write_hloc_matches(matches, judge_pairs(matched, min_confidence)), matched)


def _match(images: Any, **asked: Any) -> "MatchedCollection":
    from epiprior.collection.run import match_collection

    with _progress() as on_progress:
        return match_collection(images, on_progress=on_progress, **asked)


def _by_name(found: "ImageSet", cameras: Sequence[tuple[str, Any]]) -> dict[str, Any]:
    return {image.name: camera for image, (_, camera) in zip(found.images, cameras, strict=True)}


def _tell(written: Path, count: int, matched: "MatchedCollection") -> None:
    """Say what was written; leave with exit code 1, and the first reason, where no pair has a geometry."""
    say(f"{written}: {count} of {len(matched)} pairs have a geometry; {matched.work} can be deleted")
    if len(matched) and not count:
        pair = next(iter(matched))
        complain(f"no geometry: {pair.image1}, {pair.image2}: {pair.status}: {pair.message}")
        raise typer.Exit(options.NO_GEOMETRY)


@contextlib.contextmanager
def _progress() -> Iterator[Callable[[str, int, int], None]]:
    """Yield what shows bars with the time that is left on a terminal, and elsewhere a line every ten seconds."""
    from rich import progress as bar
    from rich.console import Console

    console = Console(stderr=True)
    if console.is_terminal and _logger.isEnabledFor(logging.INFO):
        columns = (bar.TextColumn("{task.description}"), bar.BarColumn(), bar.MofNCompleteColumn())
        times = (bar.TimeElapsedColumn(), bar.TimeRemainingColumn())
        with bar.Progress(*columns, *times, console=console) as bars:
            known: dict[str, Any] = {}

            def advance(stage: str, done: int, total: int) -> None:
                if stage not in known:
                    known[stage] = bars.add_task(stage, total=total)
                bars.update(known[stage], completed=done)

            yield advance
        return
    started: dict[str, tuple[float, int]] = {}
    last = time.monotonic()

    def line(stage: str, done: int, total: int) -> None:
        nonlocal last
        now = time.monotonic()
        since, before = started.setdefault(stage, (now, done))
        if now - last < _SECONDS_BETWEEN_LINES and done < total:
            return
        last = now
        left = (total - done) * (now - since) / (done - before) if done > before else 0.0
        _logger.info("%s: %d of %d%s", stage, done, total, f", {left:.0f} s left" if left else "")

    yield line
