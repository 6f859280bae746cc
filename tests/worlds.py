"""A small made-up world, and two cameras before it, for tests of rendering and of ground truth."""

import numpy as np

from epiprior_lab.pairsets import Camera, Pair, reproject
from epiprior_lab.scenes.pairs import look_at
from epiprior_lab.scenes.render import Light
from epiprior_lab.scenes.world import Frame, World, WorldBuilder, box, upright
from pictures import texture
from synthetic import HEIGHT as TALL
from synthetic import WIDTH as WIDE
from synthetic import K, rotation

WIDTH, HEIGHT = 320, 240


def coloured(seed: int, side: int = 256):
    """Return a smooth picture, so that half a pixel makes no large difference."""
    return np.dstack([texture(side, side, seed + k) for k in range(3)])


def room(*, sky: bool = True) -> World:
    """Return a wall 12 m away, a box before it, and a floor."""
    builder = WorldBuilder(surroundings=np.full((64, 128, 3), 200, np.uint8))
    wall, crate, floor = (builder.texture(coloured(10 * k)) for k in range(3))
    high = 4.0 if sky else 40.0
    upright(builder, Frame.facing((-20.0, 0.0, 0.0), 0.0), (0.0, 40.0), (0.0, high), 0.0, texture=wall)
    box(builder, Frame.facing((-1.0, 0.0, -5.0), 0.0), (0.0, 2.0), (0.0, 2.0), (-2.0, 0.0), textures=crate)
    builder.face((-20.0, 0.0, 0.0), (40.0, 0.0, 0.0), (0.0, 0.0, -12.0), floor)
    return builder.build()


def camera_at(x: float, *, roll_deg: float = 0.0, z: float = -12.0) -> Camera:
    eye, target = np.array([x, -1.7, z]), np.array([0.0, -1.2, -2.0])
    return look_at(eye, target, roll_deg=roll_deg, focal_px=300.0, width=WIDTH, height=HEIGHT)


CAMERAS = camera_at(-1.0), camera_at(1.5, roll_deg=10)


def seen_by_both(count: int = 30, seed: int = 0, cameras=CAMERAS):
    """Return points that two cameras of `camera_at` see, at depths that lie on no plane."""
    rng = np.random.default_rng(seed)
    x1 = np.column_stack([rng.uniform(80, 240, count), rng.uniform(60, 180, count)])
    return x1, reproject(*cameras, x1, rng.uniform(9, 15, count))[0]


def two_cameras(t=(-2.0, 0.3, 0.4), angle: float = 15.0, R=None) -> tuple[Camera, Camera]:
    """Return two cameras of `synthetic`: one at the origin, and one that is turned and moved."""
    turned = rotation((0.1, 1, 0.2), angle) if R is None else R
    poses = ((np.eye(3), np.zeros(3)), (turned, np.asarray(t, dtype=float)))
    first, second = (Camera(K=K, R=R, t=t, width=WIDE, height=TALL) for R, t in poses)
    return first, second


def points_before(cameras, count: int = 60):
    """Return points of the world before two cameras, as both see them."""
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(-1, 1, (count, 2)), rng.uniform(5, 9, count)])
    (x1, depth1), (x2, depth2) = (camera.project(points) for camera in cameras)
    assert min(depth1.min(), depth2.min()) > 0
    return x1, x2


def camera_pair(image, cameras, **changes) -> Pair:
    """Return a pair that has cameras and nothing else."""
    known = dict(zip(("camera1", "camera2"), cameras, strict=True)) | {"image1": image, "image2": image}
    return Pair(**({"pair_id": "p", "scene": "s", "difficulty": ""} | known | changes))


OVERCAST_FROM_ASIDE = Light(to_sun=np.array([0.6, -0.8, 0.0]), ambient=1.0)
