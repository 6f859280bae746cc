"""One rendered pair of a family, from a seed."""

from dataclasses import dataclass

import numpy as np

from epiprior.errors import EpipriorError, SettingsError
from epiprior.types import Float32Array
from epiprior_lab.pairsets import Camera, ViewDifference
from epiprior_lab.scenes.camera_pairs import draw_camera_pair
from epiprior_lab.scenes.facades import HouseStyle
from epiprior_lab.scenes.photography import take
from epiprior_lab.scenes.places import FACADE_TEXELS_PER_M, draw_open_scene, draw_street
from epiprior_lab.scenes.render import cast_shadows, draw_light, render_depth, render_image
from epiprior_lab.scenes.settings import FAMILIES, FamilySettings
from epiprior_lab.scenes.world import FIRST_VIEW, SECOND_VIEW, Image

_WORLDS = 12


class SceneError(EpipriorError, RuntimeError):
    """No two cameras could be placed within a family's bounds; the message names family and seed."""


@dataclass(frozen=True, eq=False)
class RenderedPair:
    """Two images (H, W, 3), RGB, of one scene; depths (H, W) along the axis, metres, inf where nothing is seen."""

    image1: Image
    image2: Image
    depth1: Float32Array
    depth2: Float32Array
    camera1: Camera
    camera2: Camera
    difference: ViewDifference


def render_pair(
    family: str, seed: int, *, width: int = 1024, height: int = 768, settings: FamilySettings | None = None
) -> RenderedPair:
    """Render a pair of a family of `FAMILIES`, or with other `settings`; equal seeds give equal bytes.

    SettingsError if the family is unknown or a side is below 64 pixels; SceneError if a dozen scenes in a row offer no
    two views within the family's bounds.
    """
    if settings is None and family not in FAMILIES:
        raise SettingsError(f"family = {family!r}, expected one of {', '.join(FAMILIES)}")
    settings = settings or FAMILIES[family]
    if min(width, height) < 64:
        raise SettingsError(f"image size {width} x {height}, expected at least 64 x 64")
    for attempt in np.random.SeedSequence(seed).spawn(_WORLDS):
        rng = np.random.default_rng(attempt)
        draw = draw_street if rng.random() < settings.facades else draw_open_scene
        world, subject = draw(rng, settings)
        cameras = draw_camera_pair(rng, world, subject, settings, width=width, height=height)
        if cameras is None:
            continue
        images, depths = [], []
        light = draw_light(rng)
        lights = light, draw_light(rng) if rng.random() < settings.relit else light
        for camera, view, sun in zip(cameras[:2], (FIRST_VIEW, SECOND_VIEW), lights, strict=True):
            shadows = cast_shadows(world, sun, subject.frame.foot, view=view)
            images.append(take(render_image(world, camera, sun, shadows, view=view), rng))
            depths.append(render_depth(world, camera, view=view))
        return RenderedPair(images[0], images[1], depths[0], depths[1], *cameras)
    raise SceneError(f"family {family!r}, seed {seed}: no two views within the family's bounds in {_WORLDS} scenes")


def render_doppelgangers(family: str, seed: int, *, width: int = 1024, height: int = 768) -> tuple[Image, Image]:
    """Render two different facades of one style, (H, W, 3) each: the same windows and walls, another house.

    The style is one of the family's streets. Equal seeds give equal bytes; SceneError as `render_pair`.
    """
    settings = FAMILIES[family]
    parts = np.random.SeedSequence(seed).spawn(3)
    style = HouseStyle(np.random.default_rng(parts[0]), settings, FACADE_TEXELS_PER_M)
    images = []
    for part in parts[1:]:
        for attempt in part.spawn(_WORLDS):
            rng = np.random.default_rng(attempt)
            world, subject = draw_street(rng, settings, style)
            cameras = draw_camera_pair(rng, world, subject, settings, width=width, height=height)
            if cameras is None:
                continue
            light = draw_light(rng)
            shadows = cast_shadows(world, light, subject.frame.foot, view=FIRST_VIEW)
            images.append(take(render_image(world, cameras[0], light, shadows, view=FIRST_VIEW), rng))
            break
        else:
            raise SceneError(f"family {family!r}, seed {seed}: no view within the family's bounds in {_WORLDS} scenes")
    return images[0], images[1]
