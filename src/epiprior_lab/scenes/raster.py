"""Compiled drawing of a world: nearest face per sample, then one texture look-up per sample.

A face with corner O and edges A, B (camera coordinates) is seen through ``M = K [A B O]``: for a pixel p = (x, y, 1),
``inv(M) p = (s, t, 1) / z``. So inverse depth is the third row of inv(M) times p, exactly, and (s, t) is the place on
the face.
"""

from __future__ import annotations

import math

import numba
import numpy as np

_OPAQUE = 128
_MAX_PROBES = 4.0


@numba.njit(cache=True, nogil=True)
def nearest_faces(inverse, bounds, triangle, cut_out, frame, texture, levels, texels, samples, inverse_depth, face):  # type: ignore[no-untyped-def]
    """Write the inverse depth and the number of the nearest face of each sample; both arrays come in as 0 and -1.

    `samples` per pixel and axis; `bounds` are pixels (left, top, right, bottom) outside which a face is not seen.
    """
    rows, columns = inverse_depth.shape
    for k in range(len(inverse)):
        M = inverse[k]
        left = max(0, math.floor((bounds[k, 0] + 0.5) * samples - 0.5))
        right = min(columns - 1, math.ceil((bounds[k, 2] + 0.5) * samples - 0.5))
        top = max(0, math.floor((bounds[k, 1] + 0.5) * samples - 0.5))
        bottom = min(rows - 1, math.ceil((bounds[k, 3] + 0.5) * samples - 0.5))
        for i in range(top, bottom + 1):
            y = (i + 0.5) / samples - 0.5
            s0, t0, w0 = M[0, 1] * y + M[0, 2], M[1, 1] * y + M[1, 2], M[2, 1] * y + M[2, 2]
            for j in range(left, right + 1):
                x = (j + 0.5) / samples - 0.5
                w = M[2, 0] * x + w0
                if w <= inverse_depth[i, j]:
                    continue
                s, t = M[0, 0] * x + s0, M[1, 0] * x + t0
                if s < 0.0 or t < 0.0 or s > w or t > w or (triangle[k] == 1 and s + t > w):
                    continue
                if cut_out[k] == 1:
                    u, v, ux, vx, uy, vy = _texture_place(M, frame[k], s, t, w, samples)
                    level, _, _, _ = _level_of(levels[texture[k]], ux, vx, uy, vy)
                    first, width, height = levels[texture[k], level]
                    column, row = int(math.floor(u * width)) % width, int(math.floor(v * height)) % height
                    if texels[first + row * width + column, 3] < _OPAQUE:
                        continue
                inverse_depth[i, j] = w
                face[i, j] = k


@numba.njit(cache=True, nogil=True)
def _texture_place(M, frame, s, t, w, samples):  # type: ignore[no-untyped-def]
    """Return texture coordinates and their derivatives per sample along x and y; (s, t, w) is inv(M) p."""
    f, g = s / w, t / w
    u = frame[0, 0] + f * frame[1, 0] + g * frame[2, 0]
    v = frame[0, 1] + f * frame[1, 1] + g * frame[2, 1]
    step = 1.0 / (w * samples)
    fx, gx = (M[0, 0] - f * M[2, 0]) * step, (M[1, 0] - g * M[2, 0]) * step
    fy, gy = (M[0, 1] - f * M[2, 1]) * step, (M[1, 1] - g * M[2, 1]) * step
    ux, vx = fx * frame[1, 0] + gx * frame[2, 0], fx * frame[1, 1] + gx * frame[2, 1]
    uy, vy = fy * frame[1, 0] + gy * frame[2, 0], fy * frame[1, 1] + gy * frame[2, 1]
    return u, v, ux, vx, uy, vy


@numba.njit(cache=True, nogil=True)
def _level_of(levels, ux, vx, uy, vy):  # type: ignore[no-untyped-def]
    """Return the halving to read from, the number of probes, and the texture step that the probes spread over."""
    width, height = levels[0, 1], levels[0, 2]
    length_x, length_y = math.hypot(ux * width, vx * height), math.hypot(uy * width, vy * height)
    area = abs(ux * vy - uy * vx) * width * height
    major = max(length_x, length_y)
    du, dv = (ux, vx) if length_x >= length_y else (uy, vy)
    minor = max(area / max(major, 1e-12), 1.0)
    probes = min(_MAX_PROBES, max(1.0, math.ceil(major / minor)))
    blur = major / probes
    level = 0
    while blur > 1.42 and level < len(levels) - 1:
        blur *= 0.5
        level += 1
    return level, int(probes), du, dv


@numba.njit(cache=True, nogil=True)
def _add_texel(out, weight, levels, texels, u, v):  # type: ignore[no-untyped-def]
    """Add the bilinear texel at (u, v) of one halving; coordinates beyond [0, 1] repeat, except close to the rim."""
    first, width, height = levels
    if -0.01 <= u <= 1.01:
        u = min(max(u, 0.5 / width), 1.0 - 0.5 / width)
    if -0.01 <= v <= 1.01:
        v = min(max(v, 0.5 / height), 1.0 - 0.5 / height)
    x, y = u * width - 0.5, v * height - 0.5
    column, row = int(math.floor(x)), int(math.floor(y))
    a, b = x - column, y - row
    c0, c1, r0, r1 = column % width, (column + 1) % width, row % height, (row + 1) % height
    p00, p01 = texels[first + r0 * width + c0], texels[first + r0 * width + c1]
    p10, p11 = texels[first + r1 * width + c0], texels[first + r1 * width + c1]
    for channel in range(4):
        value = (p00[channel] * (1 - a) + p01[channel] * a) * (1 - b) + (p10[channel] * (1 - a) + p11[channel] * a) * b
        out[channel] += weight * value


@numba.njit(cache=True, nogil=True)
def _surroundings_at(surroundings, x, y, z, out):  # type: ignore[no-untyped-def]
    """Write the colour seen in a world direction (y points down)."""
    rows, columns = surroundings.shape[:2]
    elevation = math.atan2(-y, math.hypot(x, z))
    r = (0.5 - elevation / math.pi) * (rows - 1)
    c = (0.5 + math.atan2(x, z) / (2 * math.pi)) * columns
    r0 = min(int(r), rows - 2)
    c0 = int(c) % columns
    c1 = (c0 + 1) % columns
    a, b = c - math.floor(c), r - r0
    for channel in range(3):
        upper = surroundings[r0, c0, channel] * (1 - a) + surroundings[r0, c1, channel] * a
        lower = surroundings[r0 + 1, c0, channel] * (1 - a) + surroundings[r0 + 1, c1, channel] * a
        out[channel] = upper * (1 - b) + lower * b


@numba.njit(cache=True, nogil=True)
def paint(inverse, frame, texture, shade, mirror, normal, levels, texels, surroundings, to_world, samples, face, image):  # type: ignore[no-untyped-def]
    """Write the colour of each sample; `to_world` maps a pixel (x, y, 1) to its ray in the world."""
    rows, columns = face.shape
    colour, reflection = np.zeros(4), np.zeros(3)
    for i in range(rows):
        y = (i + 0.5) / samples - 0.5
        for j in range(columns):
            x = (j + 0.5) / samples - 0.5
            k = face[i, j]
            rx = to_world[0, 0] * x + to_world[0, 1] * y + to_world[0, 2]
            ry = to_world[1, 0] * x + to_world[1, 1] * y + to_world[1, 2]
            rz = to_world[2, 0] * x + to_world[2, 1] * y + to_world[2, 2]
            if k < 0:
                _surroundings_at(surroundings, rx, ry, rz, reflection)
                for channel in range(3):
                    image[i, j, channel] = np.uint8(reflection[channel] + 0.5)
                continue
            M = inverse[k]
            s = M[0, 0] * x + M[0, 1] * y + M[0, 2]
            t = M[1, 0] * x + M[1, 1] * y + M[1, 2]
            w = M[2, 0] * x + M[2, 1] * y + M[2, 2]
            u, v, ux, vx, uy, vy = _texture_place(M, frame[k], s, t, w, samples)
            level, probes, du, dv = _level_of(levels[texture[k]], ux, vx, uy, vy)
            colour[:] = 0.0
            for probe in range(probes):
                offset = (probe + 0.5) / probes - 0.5
                _add_texel(colour, 1.0 / probes, levels[texture[k], level], texels, u + offset * du, v + offset * dv)
            share = mirror[k] * min(max((255.0 - colour[3]) / (255.0 - _OPAQUE), 0.0), 1.0)
            if share > 0.0:
                d = 2.0 * (rx * normal[k, 0] + ry * normal[k, 1] + rz * normal[k, 2])
                _surroundings_at(
                    surroundings, rx - d * normal[k, 0], ry - d * normal[k, 1], rz - d * normal[k, 2], reflection
                )
            for channel in range(3):
                value = colour[channel] * shade[k] * (1.0 - share) + reflection[channel] * share
                image[i, j, channel] = np.uint8(min(max(value, 0.0), 255.0) + 0.4999)
