"""One rendered pair of a family, from a seed: a scene, and two cameras that see enough of it in common."""

from dataclasses import dataclass

import numpy as np

from epiprior.errors import EpipriorError, SettingsError
from epiprior.types import FloatArray
from epiprior_lab.pairsets import Camera, ViewDifference, covisible, depth_at, view_difference
from epiprior_lab.pairsets.cameras import Cameras, DepthMaps
from epiprior_lab.scenes.facades import HouseStyle
from epiprior_lab.scenes.places import FACADE_TEXELS_PER_M, Subject, draw_open_scene, draw_street
from epiprior_lab.scenes.render import draw_light, render_depth, render_image, take
from epiprior_lab.scenes.settings import FAMILIES, FamilySettings
from epiprior_lab.scenes.world import FIRST_VIEW, SECOND_VIEW, Image, World

_WORLDS = 12
_PREVIEW = 8
_TRIES = 40
_LEAST_DEPTH_M = 1.5
_RELIEF_M = 0.3


class SceneError(EpipriorError, RuntimeError):
    """No two cameras could be placed within a family's bounds; the message names family and seed."""


@dataclass(frozen=True, eq=False)
class RenderedPair:
    """Two images (H, W, 3), RGB, of one scene; depths (H, W) along the axis, metres, inf where nothing is seen."""

    images: tuple[Image, Image]
    depths: DepthMaps
    cameras: Cameras
    difference: ViewDifference


def render_pair(family: str, seed: int, *, width: int = 1024, height: int = 768) -> RenderedPair:
    """Render a pair of a family of `FAMILIES`; equal seeds give equal bytes.

    SettingsError if the family is unknown; SceneError if a dozen scenes in a row offer no two views within its bounds.
    """
    if family not in FAMILIES:
        raise SettingsError(f"family = {family!r}, expected one of {', '.join(FAMILIES)}")
    rng, world, cameras, difference = _draw(family, np.random.SeedSequence(seed), width, height)
    images, depths = [], []
    light = draw_light(rng)
    lights = light, draw_light(rng) if rng.random() < FAMILIES[family].relit else light
    for camera, view, own in zip(cameras, (FIRST_VIEW, SECOND_VIEW), lights, strict=True):
        images.append(take(render_image(world, camera, own, view=view), rng))
        depths.append(render_depth(world, camera, view=view))
    return RenderedPair((images[0], images[1]), (depths[0], depths[1]), cameras, difference)


def render_doppelgangers(family: str, seed: int, *, width: int = 1024, height: int = 768) -> tuple[Image, Image]:
    """Render two different facades of one style, (H, W, 3) each: the same windows and walls, another house.

    The style is one of the family's streets. Equal seeds give equal bytes; SceneError as `render_pair`.
    """
    first, *others = np.random.SeedSequence(seed).spawn(3)
    style = HouseStyle(np.random.default_rng(first), FAMILIES[family], FACADE_TEXELS_PER_M)
    images = []
    for own in others:
        rng, world, cameras, _ = _draw(family, own, width, height, style)
        images.append(take(render_image(world, cameras[0], draw_light(rng), view=FIRST_VIEW), rng))
    return images[0], images[1]


def _draw(
    family: str, seed: np.random.SeedSequence, width: int, height: int, style: HouseStyle | None = None
) -> tuple[np.random.Generator, World, Cameras, ViewDifference]:
    """Draw scenes until one, a street if `style` is given, offers two views; return it and its random numbers."""
    settings = FAMILIES[family]
    for attempt in seed.spawn(_WORLDS):
        rng = np.random.default_rng(attempt)
        if style is not None or rng.random() < settings.facades:
            world, subject = draw_street(rng, settings, style)
        else:
            world, subject = draw_open_scene(rng, settings)
        views = draw_camera_pair(rng, world, subject, settings, width=width, height=height)
        if views is not None:
            return rng, world, views[:2], views[2]
    where = f"family {family!r}, seed {seed.entropy}"
    raise SceneError(f"{where}: no two views within the family's bounds in {_WORLDS} scenes")


def look_at(
    eye: FloatArray, target: FloatArray, *, roll_deg: float, focal_px: float, width: int, height: int
) -> Camera:
    """Return a camera at `eye` that looks at `target`; with roll, things turn clockwise in its image."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(np.array([0.0, 1.0, 0.0]), forward)
    right /= np.linalg.norm(right)
    roll = np.deg2rad(roll_deg)
    turn = np.array([[np.cos(roll), -np.sin(roll), 0.0], [np.sin(roll), np.cos(roll), 0.0], [0.0, 0.0, 1.0]])
    R = turn @ np.stack([right, np.cross(forward, right), forward])
    K = np.array([[focal_px, 0.0, (width - 1) / 2], [0.0, focal_px, (height - 1) / 2], [0.0, 0.0, 1.0]])
    return Camera(K=K, R=R, t=-R @ eye, width=width, height=height)


def draw_camera_pair(
    rng: np.random.Generator, world: World, subject: Subject, settings: FamilySettings, *, width: int, height: int
) -> tuple[Camera, Camera, ViewDifference] | None:
    """Return the first of 40 draws with angle, overlap and relief, on small depth maps, within bounds, or None."""
    for _ in range(_TRIES):
        camera1, camera2 = _draw_cameras(rng, subject, settings, width=width, height=height)
        small = _preview(camera1), _preview(camera2)
        depths = render_depth(world, small[0], view=FIRST_VIEW), render_depth(world, small[1], view=SECOND_VIEW)
        if min(float(np.quantile(depth, 0.03)) for depth in depths) < _LEAST_DEPTH_M:
            continue
        difference = view_difference(small, depths, step=1)
        within = settings.overlap[0] <= difference.overlap <= settings.overlap[1]
        within &= settings.angle_deg[0] <= difference.angle_deg <= settings.angle_deg[1]
        if within and _relief(small, depths) >= settings.relief:
            return camera1, camera2, difference
    return None


def _draw_cameras(
    rng: np.random.Generator, subject: Subject, settings: FamilySettings, *, width: int, height: int
) -> tuple[Camera, Camera]:
    angle = rng.uniform(*settings.angle_deg)
    limit = max(0.0, subject.obliquity_deg - angle / 2)
    middle = rng.uniform(-limit, limit)
    azimuths = middle + rng.permutation((-0.5, 0.5)) * angle
    near = rng.uniform(*subject.distance_m)
    distances = rng.permutation((near, near * np.exp(rng.uniform(*np.log(settings.scale_ratio)))))
    aim = np.array([rng.uniform(*subject.aim_across_m), rng.uniform(*subject.aim_up_m)])
    focal = rng.uniform(0.8, 1.05) * width
    rolls = rng.uniform(-3, 3), rng.choice((-1, 1)) * rng.uniform(*settings.roll_deg)
    cameras = []
    for azimuth, distance, roll in zip(azimuths, distances, rolls, strict=True):
        shift = rng.uniform(-0.1, 0.1, size=2) * distance
        target = np.array([aim[0] + shift[0], -max(0.3, aim[1] + 0.4 * shift[1]), 0.0])
        a, c = np.sin(np.deg2rad(azimuth)) * distance, np.cos(np.deg2rad(azimuth)) * distance
        eye = np.array([aim[0] + a, -rng.uniform(*subject.eye_m), -c])
        focal_px = focal * rng.uniform(0.97, 1.03)
        cameras.append(look_at(eye, target, roll_deg=roll, focal_px=focal_px, width=width, height=height))
    return cameras[0], cameras[1]


def _preview(camera: Camera) -> Camera:
    """Return the same camera with an image of an eighth of the size."""
    K = camera.K.copy()
    K[:2] /= _PREVIEW
    K[:2, 2] += 0.5 / _PREVIEW - 0.5
    return Camera(K=K, R=camera.R, t=camera.t, width=camera.width // _PREVIEW, height=camera.height // _PREVIEW)


def _relief(cameras: Cameras, depths: DepthMaps) -> float:
    """Return the part of the common points that lies off the subject's plane."""
    x1, _, visible = covisible(cameras, depths)
    points = cameras[0].back_project(x1[visible], depth_at(depths[0], x1[visible]))
    return float((np.abs(points[:, 2]) > _RELIEF_M).mean())
