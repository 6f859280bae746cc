"""A camera's view of a world: image and exact depth."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from epiprior.types import BoolArray, Float32Array, FloatArray
from epiprior_lab.datasets import Camera
from epiprior_lab.scenes import raster
from epiprior_lab.scenes.world import BOTH_VIEWS, Image, World

_NEAR = 0.05


class _Seen(NamedTuple):
    """The faces of a world that a camera may see."""

    index: BoolArray
    inverse: FloatArray
    bounds: FloatArray


def render_depth(world: World, camera: Camera, *, view: int = BOTH_VIEWS) -> Float32Array:
    """Return the depth of the nearest face at each pixel's centre, shape (height, width); inf where there is none."""
    inverse_depth, _ = _nearest(world, camera, _seen(world, camera, view), 1)
    with np.errstate(divide="ignore"):
        return (1.0 / inverse_depth).astype(np.float32)


def render_image(world: World, camera: Camera, *, view: int = BOTH_VIEWS, samples: int = 2) -> Image:
    """Return a camera's image, before anything that a lens or sensor does to it.

    Parameters
    ----------
    world : World
        What is seen.
    camera : Camera
        From where.
    view : int, default BOTH_VIEWS
        Faces of the other view only are left out.
    samples : int, default 2
        Samples per pixel along each axis; they are averaged.

    Returns
    -------
    ndarray, shape (height, width, 3), uint8
        RGB.
    """
    seen = _seen(world, camera, view)
    _, face = _nearest(world, camera, seen, samples)
    image = np.empty((*face.shape, 3), dtype=np.uint8)
    normal = np.cross(world.down[seen.index], world.across[seen.index])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    raster.paint(
        seen.inverse,
        world.texture_frame[seen.index],
        world.texture[seen.index],
        world.shade[seen.index],
        world.mirror[seen.index],
        normal,
        world.levels,
        world.texels,
        world.surroundings,
        camera.R.T @ np.linalg.inv(camera.K),
        samples,
        face,
        image,
    )
    if samples == 1:
        return image
    return np.asarray(cv2.resize(image, (camera.width, camera.height), interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _nearest(world: World, camera: Camera, seen: _Seen, samples: int) -> tuple[FloatArray, np.ndarray]:
    """Return inverse depth and the number of the nearest face, among those seen, at each sample."""
    shape = camera.height * samples, camera.width * samples
    inverse_depth, face = np.zeros(shape), np.full(shape, -1, dtype=np.int32)
    raster.nearest_faces(
        seen.inverse,
        seen.bounds,
        world.triangle[seen.index],
        world.cut_out[seen.index],
        world.texture_frame[seen.index],
        world.texture[seen.index],
        world.levels,
        world.texels,
        samples,
        inverse_depth,
        face,
    )
    return inverse_depth, face


def _seen(world: World, camera: Camera, view: int) -> _Seen:
    """Return the faces before the camera, the maps from pixels to places on them, and where they fall in the image."""
    corner = world.corner @ camera.R.T + camera.t
    across, down = world.across @ camera.R.T, world.down @ camera.R.T
    last = np.where(world.triangle[:, None] == 1, corner + down, corner + across + down)
    polygons = np.stack([corner, corner + across, last, corner + down], axis=1)
    bounds = _bounds(polygons, camera)
    M = camera.K @ np.stack([across, down, corner], axis=2)
    with np.errstate(invalid="ignore"):
        regular = np.abs(np.linalg.det(M)) > 1e-9 * np.prod(np.linalg.norm(M, axis=1), axis=1)
    inside = (bounds[:, 2] >= 0) & (bounds[:, 0] <= camera.width - 1)
    inside &= (bounds[:, 3] >= 0) & (bounds[:, 1] <= camera.height - 1)
    index = regular & inside & ((world.views & view) > 0)
    return _Seen(index, np.ascontiguousarray(np.linalg.inv(M[index])), np.ascontiguousarray(bounds[index]))


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
