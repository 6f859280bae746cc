"""A camera's view of a world: how it is lit, its exact depth, its image, and what lens, sensor and file do to that."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from epiprior.types import Float32Array, FloatArray
from epiprior_lab.pairsets import Camera
from epiprior_lab.scenes import raster
from epiprior_lab.scenes.world import BOTH_VIEWS, Image, World

_NEAR = 0.05
_SAMPLES = 2  # per pixel along each axis, for the rims of faces; textures are filtered in any case
_MAP_SIDE = 1280
_SUN_DISTANCE_M = 400.0
_REACH_M = 32.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Light:
    """How a place is lit: the unit vector towards the sun, and the brightness without sun, in [0, 1]."""

    to_sun: FloatArray
    ambient: float


def draw_light(rng: np.random.Generator) -> Light:
    """Draw sunshine, or in a quarter of the cases an overcast sky."""
    direction = np.array([rng.uniform(-1.0, 1.0), -rng.uniform(0.45, 1.3), -rng.uniform(0.25, 1.0)])
    overcast = rng.random() < 0.25
    ambient = float(rng.uniform(0.8, 0.9) if overcast else rng.uniform(0.42, 0.62))
    return Light(to_sun=direction / np.linalg.norm(direction), ambient=ambient)


def render_depth(world: World, camera: Camera, *, view: int = BOTH_VIEWS) -> Float32Array:
    """Return the depth of the nearest face at each pixel's centre, (height, width); inf where there is none."""
    inverse_depth, _ = _nearest(world, camera, _faces(world, camera, view, None), 1)
    with np.errstate(divide="ignore"):
        return np.asarray(1.0 / inverse_depth, dtype=np.float32)


def render_image(world: World, camera: Camera, light: Light, *, view: int = BOTH_VIEWS) -> Image:
    """Return an RGB image (height, width, 3) of the faces of `view`; shadows fall within about 30 m of the origin."""
    faces = _faces(world, camera, view, light)
    _, number = _nearest(world, camera, faces, _SAMPLES)
    to_world, sun = camera.R.T @ np.linalg.inv(camera.K), _sun_camera(light)
    projection = np.column_stack([sun.K @ sun.R, sun.K @ sun.t])
    place = raster.Place(to_world, camera.centre, projection, render_depth(world, sun, view=view))
    image = np.empty((camera.height, camera.width, 3), dtype=np.uint8)
    raster.paint(world, faces, place, number, image)
    return image


def take(image: Image, rng: np.random.Generator) -> Image:
    """Return an image, shape (H, W, 3), as a camera would have delivered it."""
    height, width = image.shape[:2]
    warmth = rng.uniform(-0.06, 0.06)
    exposure = rng.uniform(82, 120)  # median brightness that the camera aims at, levels of 256
    gamma = rng.uniform(0.85, 1.2)
    vignetting = np.float32(rng.uniform(0.0, 0.2))  # loss of brightness in the corners
    image = np.asarray(cv2.GaussianBlur(image, (0, 0), rng.uniform(0.3, 0.9)), dtype=np.uint8)
    noise = np.float32(rng.uniform(0.6, 2.5))  # a deviation, levels of 256
    tones = (np.arange(256) / 255.0) ** gamma * 255.0
    middle = max(float(np.median(tones[image[::8, ::8]])), 1.0)
    light = tones[:, None] * np.clip(exposure / middle, 0.6, 2.2) * np.array((1.0 + warmth, 1.0, 1.0 - warmth))
    # A soft shoulder instead of clipping: skies keep their tone.
    light = np.where(light > 220, 220 + 35 * (1 - np.exp(-(light - 220) / 35)), light)
    table = light.astype(np.float32).reshape(256, 1, 3)
    exposed: Float32Array = np.asarray(cv2.LUT(image, table), dtype=np.float32)
    y = np.linspace(-1, 1, height, dtype=np.float32)[:, None]
    x = np.linspace(-1, 1, width, dtype=np.float32)[None]
    exposed *= (1 - vignetting * (x * x + y * y) / 2)[..., None]
    # One grain for all channels: what a real camera leaves after demosaicing is mostly noise of brightness.
    grains = rng.standard_normal((height, width), dtype=np.float32)
    exposed += (noise * grains)[..., None]
    return np.asarray(np.clip(exposed + 0.5, 0, 255).astype(np.uint8))


def encode_jpeg(image: Image, quality: int) -> bytes:
    """Return an RGB image as the bytes of a JPEG file of a quality in 1 to 100."""
    _, data = cv2.imencode(".jpg", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, quality])
    return data.tobytes()


def _nearest(world: World, camera: Camera, faces: raster.Faces, samples: int) -> tuple[Float32Array, NDArray[np.int32]]:
    """Return inverse depth and the number among `faces` of the nearest face at each sample, `samples` per axis."""
    shape = camera.height * samples, camera.width * samples
    inverse_depth, number = np.zeros(shape, dtype=np.float32), np.full(shape, -1, dtype=np.int32)
    raster.nearest_faces(world, faces, samples, inverse_depth, number)
    return inverse_depth, number


def _faces(world: World, camera: Camera, view: int, light: Light | None) -> raster.Faces:
    """Return the faces in view; without light they are black."""
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
    brightness = np.zeros((len(normal), 2))
    if light is not None:
        by_sun = (1.0 - light.ambient) * np.maximum(normal @ light.to_sun, 0.0)
        factor = world.brightness[index]
        brightness = np.column_stack([factor * light.ambient, factor * by_sun])
    return raster.Faces(index, np.asarray(np.linalg.inv(M[index])), bounds[index], normal, brightness)


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


def _sun_camera(light: Light) -> Camera:
    """Return a camera in the sun, 400 m away, that sees what is within about 30 m of the origin."""
    forward = -light.to_sun
    right = np.cross(np.array([0.0, 1.0, 0.0]), forward)
    right /= np.linalg.norm(right)
    R = np.stack([right, np.cross(forward, right), forward])
    focal, centre = 0.5 * _MAP_SIDE * _SUN_DISTANCE_M / _REACH_M, (_MAP_SIDE - 1) / 2
    K = np.array([[focal, 0.0, centre], [0.0, focal, centre], [0.0, 0.0, 1.0]])
    return Camera(K=K, R=R, t=-R @ (_SUN_DISTANCE_M * light.to_sun), width=_MAP_SIDE, height=_MAP_SIDE)
