"""Pairs of images that a confidence has to tell from two views of a scene, made of any photographs.

- ``unrelated``: two photographs of different places.
- ``overlay``: the same, with one watermark, time stamp or the bars of a screen on both.
- ``plane``: one photograph, seen as a flat thing from two places.
- ``rotation``: seen by a camera that only turns.
- ``copy``: one photograph and a copy: recompressed, resized, cropped, framed or turned by a quarter.

Planes and rotations are warped by the homographies of true cameras, then blurred, exposed and made noisy as others are.
"""

from collections.abc import Callable, Mapping

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from epiprior_lab.scenes.render import encode_jpeg, take
from epiprior_lab.scenes.world import Image

Views = tuple[Image, Image]
HOMOGRAPHIES = ("plane", "rotation", "copy")
_SIZE = (800, 600)
_LONGER_SIDE = 1024
_GREY = (96, 40, 224)


def make_views(kind: str, photographs: Views, seed: int) -> Views:
    """Return a pair of images of a kind out of two photographs, (H, W, 3), RGB; all but two kinds show the first.

    Photographs are taken at 1024 pixels at most. Equal seeds give equal bytes.
    """
    rng = np.random.default_rng(seed)
    first, second = (_shrunk(image, min(1.0, _LONGER_SIDE / max(image.shape[:2]))) for image in photographs)
    return _MAKERS[kind](first, second, rng)


def _shrunk(image: Image, factor: float) -> Image:
    return np.asarray(cv2.resize(image, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA), np.uint8)


def _overlay(first: Image, second: Image, rng: np.random.Generator) -> Views:
    height, width = np.minimum(first.shape[:2], second.shape[:2]).tolist()
    form, grey = int(rng.integers(3)), _GREY[int(rng.integers(3))]
    letters = "".join(chr(65 + int(code)) for code in rng.integers(0, 26, 7))
    size, day = rng.uniform(0.7, 1.3) * width / 800, int(rng.integers(10, 31))

    def written(image: Image) -> Image:
        out = np.ascontiguousarray(image[:height, :width])

        def put(text: str, x: float, y: float, colour: int = 255) -> None:
            at = (round(x), round(y))
            cv2.putText(out, text, at, cv2.FONT_HERSHEY_SIMPLEX, size, (colour,) * 3, round(2 * size) + 1, cv2.LINE_AA)

        if form == 0:  # a tiled watermark
            for y in np.arange(60, height, 110 * size):
                for x in np.arange(10, width, 230 * size):
                    put(letters, x, y, 235)
        elif form == 1:  # the bars of a screen
            bar = round(60 * size)
            out[:bar], out[-bar:] = grey, 255 - grey
            for k, word in enumerate(("12:47", letters, "Search", "LTE 83%")):
                put(word, 10 + width * k / 4, 0.7 * bar, 250 - grey)
                put(word[::-1], 10 + width * k / 4, height - 0.3 * bar, grey)
        else:  # a time stamp
            put(f"2019-07-{day} 14:32:05", width - 400 * size, height - 20 * size)
        return out

    return written(first), written(second)


def _homography_views(image: Image, rng: np.random.Generator, *, moves: bool) -> Views:
    width, height = _SIZE
    K = np.array([[rng.uniform(0.8, 1.4) * width, 0, width / 2], [0, 0, height / 2], [0, 0, 1.0]])
    K[1, 1] = K[0, 0]
    side = rng.uniform(1.0, 1.5) * max(_SIZE) / K[0, 0] / min(image.shape[:2])
    # From the photograph's pixels to the plane z = 1 before the first camera; beyond its rim it is mirrored. It is
    # so large that nothing is seen twice the same way round.
    shift = [-side * length / 2 for length in image.shape[1::-1]]
    to_plane = np.array([[side, 0, shift[0]], [0, side, shift[1]], [0, 0, 1.0]])
    slant = Rotation.from_euler("xy", rng.uniform(-25, 25, 2), degrees=True).as_matrix()
    R, centre, views = np.eye(3), np.zeros(3), []
    for turned in (False, True):
        if turned:
            angles = [rng.uniform(8, 30), rng.uniform(-6, 6), rng.uniform(-10, 10)]
            R = Rotation.from_euler("yxz", angles, degrees=True).as_matrix()
            # A camera that moves looks at the same spot again; one that turns sees what lies beside it.
            away = R.T @ np.array([0, 0, -1.0]) * rng.uniform(0.75, 1.25) + np.array([0, 0, 1.0])
            centre = away if moves else np.zeros(3)
        # Points of the plane are (0, 0, 1) + slant (u, v, 0).
        plane = np.column_stack([slant[:, 0], slant[:, 1], np.array([0, 0, 1.0]) - centre])
        map_ = K @ R @ plane @ to_plane
        seen = cv2.warpPerspective(image, map_, _SIZE, flags=cv2.INTER_AREA, borderMode=cv2.BORDER_REFLECT)
        views.append(take(np.asarray(seen, np.uint8), rng))
    return views[0], views[1]


def _copy(image: Image, rng: np.random.Generator) -> Views:
    copy, height, width = image, *image.shape[:2]
    form = int(rng.integers(6))
    if form in (1, 5):
        copy = _shrunk(copy, rng.uniform(0.5, 0.9))
    elif form == 2:
        top, left = (round(rng.uniform(0.05, 0.3) * side) for side in (height, width))
        copy = copy[top : top + round(0.65 * height), left : left + round(0.65 * width)]
    if form in (3, 5):
        sides = [round(float(part) * width) for part in rng.uniform(0.02, 0.12, 4)]
        border = ((sides[0], sides[1]), (sides[2], sides[3]), (0, 0))
        copy = np.asarray(np.pad(copy, border, constant_values=int(rng.integers(256))), np.uint8)
    elif form == 4:
        copy = np.rot90(copy, int(rng.integers(1, 4)))
    data = np.frombuffer(encode_jpeg(np.ascontiguousarray(copy), int(rng.integers(60, 96))), np.uint8)
    decoded = cv2.cvtColor(np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR)), cv2.COLOR_BGR2RGB)
    return image, np.asarray(decoded, np.uint8)


_MAKERS: Mapping[str, Callable[[Image, Image, np.random.Generator], Views]] = {
    "unrelated": lambda first, second, _: (first, second),
    "overlay": _overlay,
    "plane": lambda first, _, rng: _homography_views(first, rng, moves=True),
    "rotation": lambda first, _, rng: _homography_views(first, rng, moves=False),
    "copy": lambda first, _, rng: _copy(first, rng),
}
KINDS = tuple(_MAKERS)
