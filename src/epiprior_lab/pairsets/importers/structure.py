"""Pairs out of structure from motion: which two photographs, and what they have in common.

COLMAP puts the centre of the top-left pixel at (0.5, 0.5), this library at (0, 0): half a pixel is subtracted.
"""

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from epiprior.errors import SettingsError
from epiprior.features.images import read_image
from epiprior.types import FloatArray, IntArray
from epiprior_lab.pairsets import Camera, DatasetError, image_size
from epiprior_lab.pairsets.cameras import median_angle_deg
from epiprior_lab.pairsets.importers.output import FoundPair, Photograph, Pixels

HALF_PIXEL = 0.5
_MIN_VIEWS = 3
_MOST_ERROR_PX = 2.0
_MOST_POINTS = 200


@dataclass(frozen=True, kw_only=True)
class PairChoice:
    """Which pairs of photographs are taken; SettingsError if a value is out of its range.

    The median angle between the rays to common points is within the bounds, degrees in [0, 180]; there are at least
    `min_shared` (>= 8) common points. Of more than `max_pairs` (>= 1) per scene, some are taken evenly over the angles.
    """

    min_angle_deg: float = 10.0
    max_angle_deg: float = 70.0
    min_shared: int = 12
    max_pairs: int = 60

    def __post_init__(self) -> None:
        low, high = self.min_angle_deg, self.max_angle_deg
        if not 0 <= low < high <= 180:
            raise SettingsError(f"min_angle_deg = {low}, max_angle_deg = {high}, expected 0 <= min < max <= 180")
        for name, least in (("min_shared", 8), ("max_pairs", 1)):
            if getattr(self, name) < least:
                raise SettingsError(f"{name} = {getattr(self, name)}, expected {least} or more")


DEFAULT_CHOICE = PairChoice()


@dataclass(frozen=True, kw_only=True, eq=False)
class View:
    """A photograph with its camera and the points it sees, by increasing id."""

    photograph: Photograph
    camera: Camera
    point_ids: IntArray
    points: FloatArray


def pairs_of_models(
    models: Sequence[Any], photograph_of: Callable[[str], Photograph], scene: str, choice: PairChoice
) -> tuple[list[FoundPair], set[Path]]:
    """Return the pairs of pycolmap's reconstructions, and the files of the photographs that have a pose in one.

    Several reconstructions are scenes of their own, whose numbers lead the names of their photographs.
    """
    pairs: list[FoundPair] = []
    placed: set[Path] = set()
    for number, model in enumerate(models):
        several = len(models) > 1
        views = views_of(model, photograph_of, prefix=f"{number}_" if several else "")
        placed |= {view.photograph.path for view in views}
        pairs += choose_pairs(views, f"{scene}_{number}" if several else scene, choice)
    return pairs, placed


def views_of(reconstruction: Any, photograph_of: Callable[[str], Photograph], *, prefix: str = "") -> list[View]:
    """Return the photographs of a pycolmap reconstruction that have a pose, undistorted, by name.

    Points count that at least three photographs see with a mean reprojection error up to 2 px. `prefix` leads the
    names of the photographs in the new set. DatasetError if a photograph is missing, has another size than its camera,
    or its camera has no undistorted form.
    """
    trusted = {
        point_id: point.xyz
        for point_id, point in reconstruction.points3D.items()
        if len({element.image_id for element in point.track.elements}) >= _MIN_VIEWS and point.error <= _MOST_ERROR_PX
    }
    views = []
    for image in sorted(reconstruction.images.values(), key=lambda image: str(image.name)):
        if not image.has_pose:
            continue
        photograph = photograph_of(image.name)
        path, given = photograph.path, image.camera
        if not path.is_file():
            raise DatasetError(f"no image {path}, which the model names")
        width, height = image_size(path, turn=False)
        if (width, height) != (given.width, given.height):
            raise DatasetError(f"{path}: is {width} x {height}, its camera in the model {given.width} x {given.height}")
        seen = sorted({point.point3D_id for point in image.points2D if point.has_point3D()} & trusted.keys())
        camera, develop = _undistorted(image, path)
        photograph = replace(photograph, name=prefix + photograph.name, camera=camera, develop=develop)
        points = np.array([trusted[point_id] for point_id in seen]).reshape(-1, 3)
        ids = np.array(seen, dtype=np.int64)
        views.append(View(photograph=photograph, camera=camera, point_ids=ids, points=points))
    return views


def _undistorted(image: Any, path: Path) -> tuple[Camera, partial[Pixels]]:
    """Return the camera of an image without distortion, and what makes its pixels."""
    import pycolmap

    given = copy.deepcopy(image.camera)  # it would die with its reconstruction
    if given.is_perspective_pinhole() and given.is_undistorted():
        plain = given
    else:
        try:
            plain = pycolmap.undistort_camera(pycolmap.UndistortCameraOptions(), given)
        except (ValueError, RuntimeError) as error:
            raise DatasetError(f"{path}: its camera {given.model_name} cannot be undistorted: {error}") from error
    pose = image.cam_from_world().matrix()
    K = np.array(plain.calibration_matrix(), dtype=np.float64)
    K[:2, 2] -= HALF_PIXEL
    camera = Camera(K=K, R=pose[:, :3], t=pose[:, 3], width=plain.width, height=plain.height)
    return camera, partial(_develop, path, given, plain is not given)


def _develop(path: Path, camera: Any, distorted: bool) -> Pixels:
    """Return the pixels of a photograph without distortion; EXIF rotation is ignored, as COLMAP does."""
    import pycolmap

    pixels = read_image(path, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    if not distorted:
        return pixels
    bitmap = pycolmap.Bitmap.from_array(np.ascontiguousarray(pixels[:, :, ::-1]))
    plain, _ = pycolmap.undistort_image(pycolmap.UndistortCameraOptions(), bitmap, camera)
    return np.ascontiguousarray(plain.to_array()[:, :, ::-1])


def choose_pairs(views: list[View], scene: str, choice: PairChoice) -> list[FoundPair]:
    """Return the pairs of a scene that `choice` asks for, in the order of names."""
    found = []
    for view1, view2 in combinations(views, 2):
        shared, at1, _ = np.intersect1d(view1.point_ids, view2.point_ids, return_indices=True)
        fewest = min(len(view1.point_ids), len(view2.point_ids))
        if len(shared) < choice.min_shared:
            continue
        angle = median_angle_deg((view1.camera, view2.camera), view1.points[at1])
        points = _control_points(view1, view2, view1.points[at1])
        if choice.min_angle_deg <= angle <= choice.max_angle_deg and len(points[0]) >= choice.min_shared:
            text = f"angle={angle:.1f}deg;covis_points={len(shared)};overlap={len(shared) / fewest:.2f}"
            one, two = view1.photograph, view2.photograph
            name = f"{one.name}_{two.name}"
            pair = FoundPair(pair_id=name, scene=scene, image1=one, image2=two, difficulty=text, points=points)
            found.append((angle, pair))
    if len(found) > choice.max_pairs:
        by_angle = np.argsort([angle for angle, _ in found], kind="stable")
        kept = by_angle[np.linspace(0, len(found) - 1, choice.max_pairs).round().astype(int)]
        found = [found[index] for index in sorted(kept)]
    return [pair for _, pair in found]


def _control_points(view1: View, view2: View, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return where both cameras see the points that lie in both images, at most 200, evenly over their ids."""
    inside = np.ones(len(points), dtype=bool)
    seen = []
    for camera in (view1.camera, view2.camera):
        x, _ = camera.project(points)
        inside &= ((x >= 0) & (x <= np.array([camera.width - 1.0, camera.height - 1.0]))).all(axis=1)
        seen.append(x)
    kept = np.flatnonzero(inside)
    kept = kept[np.linspace(0, len(kept) - 1, min(_MOST_POINTS, len(kept))).round().astype(int)]
    return seen[0][kept], seen[1][kept]
