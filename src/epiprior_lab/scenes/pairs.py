"""One rendered pair of a family, from a seed."""

from dataclasses import dataclass

import numpy as np

from epiprior.errors import EpipriorError, SettingsError
from epiprior_lab.pairsets import ViewDifference
from epiprior_lab.pairsets.cameras import Cameras, DepthMaps
from epiprior_lab.scenes.camera_pairs import draw_camera_pair
from epiprior_lab.scenes.facades import HouseStyle
from epiprior_lab.scenes.photography import take
from epiprior_lab.scenes.places import FACADE_TEXELS_PER_M, draw_open_scene, draw_street
from epiprior_lab.scenes.render import draw_light, render_depth, render_image
from epiprior_lab.scenes.settings import FAMILIES
from epiprior_lab.scenes.world import FIRST_VIEW, SECOND_VIEW, Image, World

_WORLDS = 12


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
