"""Twin scenes: two houses of one style, rendered from several places each."""

import numpy as np

from epiprior_lab.pairsets import Camera
from epiprior_lab.scenes.facades import HouseStyle
from epiprior_lab.scenes.pairs import SceneError, draw_camera_pair
from epiprior_lab.scenes.places import FACADE_TEXELS_PER_M, draw_street
from epiprior_lab.scenes.render import draw_light, encode_jpeg, render_image, take
from epiprior_lab.scenes.settings import FAMILIES
from epiprior_lab.scenes.world import FIRST_VIEW, SECOND_VIEW

_SIZE = {"width": 1024, "height": 768}  # of the study
_STREETS = 12


def render_house(
    *, name: str, family: str, style_seed: int, seed: int, pairs: int, jpeg_quality: int
) -> list[tuple[bytes, Camera]]:
    """Return photographs of one house, JPEG, with their cameras: two by two they overlap, `pairs` times.

    Houses of one `style_seed` are twins. What stands about changes within a pair, as in `render_pair`. SceneError
    if a dozen streets in a row offer no such views.
    """
    settings = FAMILIES[family]
    style = HouseStyle(np.random.default_rng(style_seed), settings, FACADE_TEXELS_PER_M)
    for attempt in np.random.SeedSequence(seed).spawn(_STREETS):
        rng = np.random.default_rng(attempt)
        world, subject = draw_street(rng, settings, style)
        drawn = [draw_camera_pair(rng, world, subject, settings, **_SIZE) for _ in range(pairs)]
        cameras = [camera for found in drawn if found is not None for camera in found[:2]]
        if len(cameras) < 2 * pairs:
            continue
        light, photographs = draw_light(rng), []
        for number, camera in enumerate(cameras):
            view = (FIRST_VIEW, SECOND_VIEW)[number % 2]
            seen = take(render_image(world, camera, light, view=view), rng)
            photographs.append((encode_jpeg(seen, jpeg_quality), camera))
        return photographs
    raise SceneError(f"{name}: no {pairs} pairs of views within the bounds of {family!r} in {_STREETS} streets")
