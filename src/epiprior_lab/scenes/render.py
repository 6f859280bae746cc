"""A camera's view of a world: image and exact depth."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from epiprior.types import Float32Array, FloatArray
from epiprior_lab.pairsets import Camera
from epiprior_lab.scenes import raster
from epiprior_lab.scenes.light import Light, Shadows
from epiprior_lab.scenes.world import BOTH_VIEWS, Image, World

_NEAR = 0.05


def render_depth(world: World, camera: Camera, *, view: int = BOTH_VIEWS) -> Float32Array:
    """Return the depth of the nearest face at each pixel's centre, (height, width); inf where there is none."""
    inverse_depth, _ = _nearest(world, camera, _faces(world, camera, view, None), 1)
    with np.errstate(divide="ignore"):
        return np.asarray(1.0 / inverse_depth, dtype=np.float32)


def render_image(
    world: World, camera: Camera, light: Light, shadows: Shadows, *, view: int = BOTH_VIEWS, samples: int = 2
) -> Image:
    """Return a camera's image, before anything that a lens or sensor does to it.

    Parameters
    ----------
    world : World
        What is seen.
    camera : Camera
        From where.
    light, shadows : Light, Shadows
        The sun, and what it sees of this world.
    view : int, default BOTH_VIEWS
        Faces of the other view only are left out.
    samples : int, default 2
        Samples per pixel along each axis, for the rims of faces; textures are filtered in any case.

    Returns
    -------
    ndarray, shape (height, width, 3), uint8
        RGB.
    """
    faces = _faces(world, camera, view, light)
    _, number = _nearest(world, camera, faces, samples)
    place = raster.Place(
        to_world=np.ascontiguousarray(camera.R.T @ np.linalg.inv(camera.K)),
        eye=camera.centre,
        surroundings=world.surroundings,
        sun_projection=shadows.projection,
        sun_depth=shadows.depth,
    )
    image = np.empty((camera.height, camera.width, 3), dtype=np.uint8)
    raster.paint(faces, raster.Textures(world.levels, world.texels), place, number, image)
    return image


def _nearest(world: World, camera: Camera, faces: raster.Faces, samples: int) -> tuple[Float32Array, NDArray[np.int32]]:
    """Return inverse depth and the number of the nearest face at each sample."""
    shape = camera.height * samples, camera.width * samples
    inverse_depth, number = np.zeros(shape, dtype=np.float32), np.full(shape, -1, dtype=np.int32)
    raster.nearest_faces(faces, raster.Textures(world.levels, world.texels), samples, inverse_depth, number)
    return inverse_depth, number


def _faces(world: World, camera: Camera, view: int, light: Light | None) -> raster.Faces:
    """Return the faces in view, the maps from pixels to places on them, and where they fall in the image."""
    corner = world.corner @ camera.R.T + camera.t
    across, down = world.across @ camera.R.T, world.down @ camera.R.T
    last = np.where(world.triangle[:, None] == 1, corner + down, corner + across + down)
    polygons = np.stack([corner, corner + across, last, corner + down], axis=1)
    bounds = _bounds(polygons, camera)
    M = camera.K @ np.stack([across, down, corner], axis=2)
    # A face seen exactly from its edge has no inverse, and nothing to show.
    regular = np.abs(np.linalg.det(M)) > 1e-9 * np.prod(np.linalg.norm(M, axis=1), axis=1)
    inside = (bounds[:, 2] >= 0) & (bounds[:, 0] <= camera.width - 1)
    inside &= (bounds[:, 3] >= 0) & (bounds[:, 1] <= camera.height - 1)
    index = np.flatnonzero(regular & inside & ((world.views & view) > 0))
    # Near faces first: most samples of what is behind them are then refused at once.
    index = index[np.argsort(polygons[index, :, 2].min(axis=1), kind="stable")]
    normal = np.cross(world.down[index], world.across[index])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return raster.Faces(
        inverse=np.ascontiguousarray(np.linalg.inv(M[index])),
        bounds=np.ascontiguousarray(bounds[index]),
        frame=world.texture_frame[index],
        texture=world.texture[index],
        triangle=world.triangle[index],
        cut_out=world.cut_out[index],
        mirror=world.mirror[index],
        normal=normal,
        light=_light_on(normal, world.brightness[index], light),
    )


def _light_on(normal: FloatArray, brightness: FloatArray, light: Light | None) -> FloatArray:
    """Return each face's brightness in the shade and what the sun adds, shape (N, 2); zeros without light."""
    if light is None:
        return np.zeros((len(normal), 2))
    by_sun = (1.0 - light.ambient) * np.maximum(normal @ light.to_sun, 0.0)
    return np.column_stack([brightness * light.ambient, brightness * by_sun])


def _bounds(polygons: FloatArray, camera: Camera) -> FloatArray:
    """Return the box (left, top, right, bottom) in pixels of polygons (N, 4, 3); inverted where all is behind."""
    following = np.roll(polygons, -1, axis=1)
    z, z_next = polygons[..., 2], following[..., 2]
    crossing = (z < _NEAR) != (z_next < _NEAR)
    part = (_NEAR - z) / np.where(crossing, z_next - z, 1.0)
    cuts = polygons + part[..., None] * (following - polygons)
    points = np.concatenate([polygons, cuts], axis=1)
    valid = np.concatenate([z >= _NEAR, crossing], axis=1)
    pixels = points @ camera.K.T
    with np.errstate(divide="ignore", invalid="ignore"):
        pixels = pixels[..., :2] / pixels[..., 2:]
    low = np.where(valid[..., None], pixels, np.inf).min(axis=1)
    high = np.where(valid[..., None], pixels, -np.inf).max(axis=1)
    return np.concatenate([np.maximum(low, -1e6), np.minimum(high, 1e6)], axis=1)
