"""Compiled drawing of a world: nearest face per sample, then one filtered texture look-up per pixel and face.

A face with corner O and edges A, B (camera coordinates) is seen through ``M = K [A B O]``: for a pixel
p = (x, y, 1), ``inv(M) p = (s, t, 1) / z``. So inverse depth is the third row of inv(M) times p, exactly, and
(s, t) is the place on the face. All of these are linear along a row of the image.
"""

import math
from typing import NamedTuple

import numba
import numpy as np

from epiprior.types import Float32Array, FloatArray, IntArray

_OPAQUE = 128
_MAX_PROBES = 4.0
_SHADOW_OFFSET_M = 0.08
_SHADOW_BIAS_M = 0.02


class Faces(NamedTuple):
    """The faces of a world as one camera sees them; N of them, near ones first for speed.

    `world_face` (N,) are their numbers in the world; `inverse` (N, 3, 3) is inv(M); `bounds` (N, 4) are pixels (left,
    top, right, bottom) outside which a face is not seen; `light` (N, 2) is brightness in the shade, and by the sun.
    """

    world_face: IntArray
    inverse: FloatArray
    bounds: FloatArray
    normal: FloatArray
    light: FloatArray


class Place(NamedTuple):
    """Camera and sun: `to_world` (3, 3) maps a pixel (x, y, 1) to its ray, of length 1 along the axis, from `eye` (3,).

    `sun_projection` (3, 4) maps world points to pixels of `sun_depth`, which holds how far the sun sees.
    """

    to_world: FloatArray
    eye: FloatArray
    sun_projection: FloatArray
    sun_depth: Float32Array


@numba.njit(cache=True, nogil=True)
def nearest_faces(world, faces, samples, inverse_depth, number):  # type: ignore[no-untyped-def]
    """Write inverse depth and number of the nearest face of each sample, `samples` per axis; they are 0 and -1."""
    rows, columns = inverse_depth.shape
    for k in range(len(faces.inverse)):
        face, M = faces.world_face[k], faces.inverse[k]
        frame, levels = world.texture_frame[face], world.levels[world.texture[face]]
        left = max(0, math.floor((faces.bounds[k, 0] + 0.5) * samples - 0.5))
        right = min(columns - 1, math.ceil((faces.bounds[k, 2] + 0.5) * samples - 0.5))
        top = max(0, math.floor((faces.bounds[k, 1] + 0.5) * samples - 0.5))
        bottom = min(rows - 1, math.ceil((faces.bounds[k, 3] + 0.5) * samples - 0.5))
        # Per sample instead of per pixel along the row.
        ds, dt, dw = M[0, 0] / samples, M[1, 0] / samples, M[2, 0] / samples
        for i in range(top, bottom + 1):
            s0, t0, w0 = _mapped(M, 0.5 / samples - 0.5, (i + 0.5) / samples - 0.5)
            first, last = _span(s0, ds, float(left), float(right))
            first, last = _span(t0, dt, first, last)
            first, last = _span(w0, dw, first, last)
            if world.triangle[face] == 1:
                first, last = _span(w0 - s0 - t0, dw - ds - dt, first, last)
            else:
                first, last = _span(w0 - s0, dw - ds, first, last)
                first, last = _span(w0 - t0, dw - dt, first, last)
            if first > last:
                continue
            start, end = math.ceil(first), math.floor(last)
            if world.cut_out[face] == 0:
                for j in range(start, end + 1):
                    w = w0 + dw * j
                    if w > inverse_depth[i, j]:
                        inverse_depth[i, j] = w
                        number[i, j] = k
                continue
            j = 0.5 * (first + last)
            middle = s0 + ds * j, t0 + dt * j, max(w0 + dw * j, 1e-9)
            _, step_x, step_y = _texture_place(M, frame, middle, samples)
            level, _, _ = _level_of(levels, step_x, step_y)
            offset, width, height = levels[level]
            for j in range(start, end + 1):
                w = w0 + dw * j
                if w <= inverse_depth[i, j]:
                    continue
                u, v = _on_texture(frame, (s0 + ds * j) / w, (t0 + dt * j) / w)
                column, row = int((u - math.floor(u)) * width), int((v - math.floor(v)) * height)
                if world.texels[offset + min(row, height - 1) * width + min(column, width - 1), 3] >= _OPAQUE:
                    inverse_depth[i, j] = w
                    number[i, j] = k


@numba.njit(cache=True, nogil=True)
def _span(value, slope, first, last):  # type: ignore[no-untyped-def]
    """Return the part of [first, last] where ``value + slope * j >= 0``."""
    if slope > 0.0:
        return max(first, -value / slope), last
    if slope < 0.0:
        return first, min(last, -value / slope)
    return (first, last) if value >= 0.0 else (1.0, 0.0)


@numba.njit(cache=True, nogil=True)
def _texture_place(M, frame, place, samples):  # type: ignore[no-untyped-def]
    """Return texture coordinates, and their change per sample along x and y; `place` is inv(M) p."""
    s, t, w = place
    f, g = s / w, t / w
    step = 1.0 / (w * samples)
    fx, gx = (M[0, 0] - f * M[2, 0]) * step, (M[1, 0] - g * M[2, 0]) * step
    fy, gy = (M[0, 1] - f * M[2, 1]) * step, (M[1, 1] - g * M[2, 1]) * step
    step_x = fx * frame[1, 0] + gx * frame[2, 0], fx * frame[1, 1] + gx * frame[2, 1]
    step_y = fy * frame[1, 0] + gy * frame[2, 0], fy * frame[1, 1] + gy * frame[2, 1]
    return _on_texture(frame, f, g), step_x, step_y


@numba.njit(cache=True, nogil=True)
def _on_texture(frame, f, g):  # type: ignore[no-untyped-def]
    """Return the texture coordinates of a place (f, g) on a face, parts of its edges."""
    u = frame[0, 0] + f * frame[1, 0] + g * frame[2, 0]
    return u, frame[0, 1] + f * frame[1, 1] + g * frame[2, 1]


@numba.njit(cache=True, nogil=True)
def _level_of(levels, step_x, step_y):  # type: ignore[no-untyped-def]
    """Return which halving to read, the number of probes, and the texture step that these spread over."""
    width, height = levels[0, 1], levels[0, 2]
    length_x = math.sqrt((step_x[0] * width) ** 2 + (step_x[1] * height) ** 2)
    length_y = math.sqrt((step_y[0] * width) ** 2 + (step_y[1] * height) ** 2)
    area = abs(step_x[0] * step_y[1] - step_y[0] * step_x[1]) * width * height
    major, along = (length_x, step_x) if length_x >= length_y else (length_y, step_y)
    minor = max(area / max(major, 1e-12), 1.0)
    probes = min(_MAX_PROBES, max(1.0, math.ceil(0.8 * major / minor)))
    blur = max(major / probes, minor)
    level = 0
    while blur > 1.42 and level < len(levels) - 1:
        blur *= 0.5
        level += 1
    return level, int(probes), along


@numba.njit(cache=True, nogil=True)
def _texel(level, texels, u, v):  # type: ignore[no-untyped-def]
    """Return the bilinear texel at (u, v) of one halving; beyond [0, 1] it repeats, except close to the rim."""
    offset, width, height = level
    u = min(max(u, 0.5 / width), 1.0 - 0.5 / width) if -0.01 <= u <= 1.01 else u - math.floor(u)
    v = min(max(v, 0.5 / height), 1.0 - 0.5 / height) if -0.01 <= v <= 1.01 else v - math.floor(v)
    x, y = u * width - 0.5, v * height - 0.5
    c0, r0 = math.floor(x), math.floor(y)
    a, b = x - c0, y - r0
    c1, r1 = c0 + 1, r0 + 1
    c0, r0 = c0 if c0 >= 0 else width - 1, r0 if r0 >= 0 else height - 1
    c1, r1 = c1 if c1 < width else 0, r1 if r1 < height else 0
    upper, lower = offset + r0 * width, offset + r1 * width
    return _mixed((texels[upper + c0], texels[upper + c1], texels[lower + c0], texels[lower + c1]), a, b)


@numba.njit(cache=True, nogil=True)
def _mixed(four, a, b):  # type: ignore[no-untyped-def]
    """Return the bilinear mean of four pixels; the last value is only meant where they have four channels."""
    t00, t01, t10, t11 = four
    k00, k01, k10, k11 = (1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b
    last = len(t00) - 1
    return (
        k00 * t00[0] + k01 * t01[0] + k10 * t10[0] + k11 * t11[0],
        k00 * t00[1] + k01 * t01[1] + k10 * t10[1] + k11 * t11[1],
        k00 * t00[2] + k01 * t01[2] + k10 * t10[2] + k11 * t11[2],
        k00 * t00[last] + k01 * t01[last] + k10 * t10[last] + k11 * t11[last],
    )


@numba.njit(cache=True, nogil=True)
def _surroundings_at(surroundings, ray):  # type: ignore[no-untyped-def]
    """Return the colour seen in a world direction (y points down)."""
    x, y, z = ray
    rows, columns = surroundings.shape[:2]
    elevation = math.atan2(-y, math.sqrt(x * x + z * z))
    r = (0.5 - elevation / math.pi) * (rows - 1)
    c = (0.5 + math.atan2(x, z) / (2 * math.pi)) * columns
    r0 = min(int(r), rows - 2)
    c0, c1 = int(c) % columns, (int(c) + 1) % columns
    four = surroundings[r0, c0], surroundings[r0, c1], surroundings[r0 + 1, c0], surroundings[r0 + 1, c1]
    red, green, blue, _ = _mixed(four, c - math.floor(c), r - r0)
    return red, green, blue


@numba.njit(cache=True, nogil=True)
def _sunlit(projection, depth, point):  # type: ignore[no-untyped-def]
    """Return how much sun reaches a world point, in [0, 1]: the mean of four tests; 1 outside the map."""
    size = len(depth)
    x, y, z = point
    w = projection[2, 0] * x + projection[2, 1] * y + projection[2, 2] * z + projection[2, 3]
    column = (projection[0, 0] * x + projection[0, 1] * y + projection[0, 2] * z + projection[0, 3]) / w
    row = (projection[1, 0] * x + projection[1, 1] * y + projection[1, 2] * z + projection[1, 3]) / w
    if not (0.0 <= column < size - 1 and 0.0 <= row < size - 1):
        return 1.0
    c, r = int(column), int(row)
    a, b = column - c, row - r
    reach = w - _SHADOW_BIAS_M
    lit = (1 - a) * (1 - b) if depth[r, c] > reach else 0.0
    lit += a * (1 - b) if depth[r, c + 1] > reach else 0.0
    lit += (1 - a) * b if depth[r + 1, c] > reach else 0.0
    return lit + (a * b if depth[r + 1, c + 1] > reach else 0.0)


@numba.njit(cache=True, nogil=True)
def _mapped(M, x, y):  # type: ignore[no-untyped-def]
    """Return ``M (x, y, 1)``."""
    s = M[0, 0] * x + M[0, 1] * y + M[0, 2]
    t = M[1, 0] * x + M[1, 1] * y + M[1, 2]
    return s, t, M[2, 0] * x + M[2, 1] * y + M[2, 2]


@numba.njit(cache=True, nogil=True)
def _face_colour(world, faces, place, k, x, y):  # type: ignore[no-untyped-def]
    """Return the colour of face `k` around a pixel (x, y)."""
    face, M, normal = faces.world_face[k], faces.inverse[k], faces.normal[k]
    rx, ry, rz = _mapped(place.to_world, x, y)
    s, t, w = _mapped(M, x, y)
    w = max(w, 1e-9)
    (u, v), step_x, step_y = _texture_place(M, world.texture_frame[face], (s, t, w), 1)
    levels = world.levels[world.texture[face]]
    level, probes, (du, dv) = _level_of(levels, step_x, step_y)
    r, g, b, opacity = 0.0, 0.0, 0.0, 0.0
    for probe in range(probes):
        part = (probe + 0.5) / probes - 0.5
        dr, dg, db, da = _texel(levels[level], world.texels, u + part * du, v + part * dv)
        r, g, b, opacity = r + dr, g + dg, b + db, opacity + da
    shade = faces.light[k, 0]
    if faces.light[k, 1] > 0.0:
        # Tested a little before the face, or faces at a slant to the sun would be dotted with their own shadow.
        z, above, eye = 1.0 / w, _SHADOW_OFFSET_M, place.eye
        px = eye[0] + z * rx + above * normal[0]
        py = eye[1] + z * ry + above * normal[1]
        pz = eye[2] + z * rz + above * normal[2]
        shade += faces.light[k, 1] * _sunlit(place.sun_projection, place.sun_depth, (px, py, pz))
    factor = shade / probes
    r, g, b = r * factor, g * factor, b * factor
    share = world.mirror[face] * min(max((255.0 - opacity / probes) / (255.0 - _OPAQUE), 0.0), 1.0)
    if share > 0.0:
        d = 2.0 * (rx * normal[0] + ry * normal[1] + rz * normal[2])
        reflected = rx - d * normal[0], ry - d * normal[1], rz - d * normal[2]
        mr, mg, mb = _surroundings_at(world.surroundings, reflected)
        r, g, b = r + share * (mr - r), g + share * (mg - g), b + share * (mb - b)
    return r, g, b


@numba.njit(cache=True, nogil=True)
def paint(world, faces, place, number, image):  # type: ignore[no-untyped-def]
    """Write the colour of each pixel: the mean over its samples in `number`, each face looked up once."""
    rows, columns = image.shape[:2]
    samples = number.shape[0] // rows
    found, count = np.empty(samples * samples, dtype=np.int64), np.empty(samples * samples, dtype=np.int64)
    for y in range(rows):
        for x in range(columns):
            different = 0
            for i in range(y * samples, (y + 1) * samples):
                for j in range(x * samples, (x + 1) * samples):
                    k = number[i, j]
                    position = 0
                    while position < different and found[position] != k:
                        position += 1
                    if position == different:
                        found[position], count[position] = k, 0
                        different += 1
                    count[position] += 1
            r, g, b = 0.0, 0.0, 0.0
            for position in range(different):
                k = found[position]
                if k < 0:
                    dr, dg, db = _surroundings_at(world.surroundings, _mapped(place.to_world, x, y))
                else:
                    dr, dg, db = _face_colour(world, faces, place, k, x, y)
                part = count[position] / (samples * samples)
                r, g, b = r + part * dr, g + part * dg, b + part * db
            for channel, value in enumerate((r, g, b)):
                image[y, x, channel] = np.uint8(min(max(value + 0.5, 0.0), 255.0))
