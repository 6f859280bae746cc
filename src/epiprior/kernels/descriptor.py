"""Compiled SIFT descriptors on one level of a scale space: 4 x 4 cells of 8 orientations, from every second pixel.

A level is smoothed by two pixels or more, so that every second pixel of every second row says all: descriptors differ
by a cosine of 0.0005 in the median from those of all pixels, for a quarter of the time.

References: Lowe, Distinctive image features from scale-invariant keypoints, IJCV 2004, section 6; OpenCV's
``sift.simd`` for the constants and for the approximation of the angle, which is right to 0.3 degrees.
"""

import math

import numpy as np

from epiprior.kernels.compilation import compiled

_CELLS, _BINS = 4, 8
_SIDE = _CELLS + 2  # cells along a side with a margin, where samples beyond the outer cells end
_STRIDE = _BINS + 1  # bins of a cell; the last is the first again
_SIZE = _SIDE * _SIDE * _STRIDE
_NEXT, _BELOW, _BOTH = np.uint64(_STRIDE), np.uint64(_SIDE * _STRIDE), np.uint64((_SIDE + 1) * _STRIDE)
_ONE = np.uint64(1)
_CELL_SIGMAS, _CLIP, _LENGTH, _LARGEST = 3.0, 0.2, 512.0, 255.0
_HALF = 0.5 * (_CELLS + 1)  # cells from the centre to where samples end
_STEP = 2  # pixels between samples
# A quarter turn in bins is 2, a half turn 4; the arc tangent in bins of t in [0, 1], odd powers of t.
_ATAN = np.array([0.9997878412794807, -0.3258083974640975, 0.1555786518463281, -0.04432655554792128])
_A1, _A3, _A5, _A7 = (_ATAN * _BINS / (2.0 * math.pi)).astype(np.float32)
_ZERO, _TWO, _FOUR, _EIGHT = np.float32(0), np.float32(2), np.float32(4), np.float32(_BINS)
_TINY = np.float32(1e-16)


@compiled(error_model="numpy")
def _gather(pixels, height, width, x, y, cos, sin, window, reach, samples):  # type: ignore[no-untyped-def]
    """Collect the samples inside the square of cells around pixel (x, y); return how many.

    Of each sample: the gradient, its weight, and row and column in cells. `cos` and `sin` are over the size of a cell.
    """
    edge = _HALF - 1e-4  # a hair inside, so that rounding leaves no sample outside the margin
    n = 0
    for i in range(-reach, reach + 1, _STEP):
        if not 1 <= y + i < height - 1:
            continue
        # Where the row runs inside the square: |u + j cos| and |v - j sin| below the edge.
        u, v = i * sin, i * cos
        low, high = max(-reach, 1 - x), min(reach, width - 2 - x)
        if abs(cos) > 1e-9:
            a, b = (-edge - u) / cos, (edge - u) / cos
            low, high = max(low, math.ceil(min(a, b))), min(high, math.floor(max(a, b)))
        elif abs(u) > edge:
            continue
        if abs(sin) > 1e-9:
            a, b = (v - edge) / sin, (v + edge) / sin
            low, high = max(low, math.ceil(min(a, b))), min(high, math.floor(max(a, b)))
        elif abs(v) > edge:
            continue
        low += (low + reach) % _STEP
        if low > high:
            continue
        count = (high - low) // _STEP + 1
        # Unsigned, so that no index is taken for one from the end.
        at, line = np.uint64((y + i) * width + x + low), np.uint64(width)
        from_edge = np.uint64(low + reach)
        across = window[np.uint64(i + reach)]
        r, dr = np.float32(v - low * sin + _HALF), np.float32(-_STEP * sin)
        c, dc = np.float32(u + low * cos + _HALF), np.float32(_STEP * cos)
        for k in range(count):
            to = np.uint64(n + k)
            step = np.uint64(_STEP * k)
            p = at + step
            samples[0, to] = pixels[p + _ONE] - pixels[p - _ONE]
            samples[1, to] = pixels[p - line] - pixels[p + line]
            samples[2, to] = window[from_edge + step] * across
            samples[3, to] = r + np.float32(k) * dr
            samples[4, to] = c + np.float32(k) * dc
        n += count
    return n


@compiled(error_model="numpy", fastmath={"contract", "arcp", "nsz"})
def _to_bins(dx, dy, weight, row, column, turn, cell):  # type: ignore[no-untyped-def]
    """Replace gradients by weighted sizes (in `dx`) and directions (in `dy`), places by fractions; number the bins.

    Apart from the loops around it, for vector instructions. `turn` is added to the directions, in bins.
    """
    for k in range(len(cell)):
        x, y = dx[k], dy[k]
        ax, ay = abs(x), abs(y)
        t = min(ax, ay) / (max(ax, ay) + _TINY)
        s = t * t
        angle = (((_A7 * s + _A5) * s + _A3) * s + _A1) * t
        angle = _TWO - angle if ay > ax else angle
        angle = _FOUR - angle if x < _ZERO else angle
        angle = (_EIGHT - angle if y < _ZERO else angle) + turn
        angle = angle - _EIGHT if angle >= _EIGHT else angle
        # Rounding may leave an angle at the full turn.
        r, c, o = np.int32(row[k]), np.int32(column[k]), min(np.int32(angle), np.int32(_BINS - 1))
        dx[k] = math.sqrt(x * x + y * y) * weight[k]
        dy[k] = angle - np.float32(o)
        row[k] -= np.float32(r)
        column[k] -= np.float32(c)
        cell[k] = (r * _SIDE + c) * _STRIDE + o


@compiled(error_model="numpy")
def _share_out(size, direction, row, column, cell, hist):  # type: ignore[no-untyped-def]
    """Add every sample to the eight bins around it, by its distance from each."""
    for k in range(len(cell)):
        at = np.uint64(cell[k])
        lower = size[k] * row[k]
        upper = size[k] - lower
        upper_right, lower_right = upper * column[k], lower * column[k]
        upper_left, lower_left = upper - upper_right, lower - lower_right
        share = upper_left * direction[k]
        hist[at] += upper_left - share
        hist[at + _ONE] += share
        share = upper_right * direction[k]
        hist[at + _NEXT] += upper_right - share
        hist[at + _NEXT + _ONE] += share
        share = lower_left * direction[k]
        hist[at + _BELOW] += lower_left - share
        hist[at + _BELOW + _ONE] += share
        share = lower_right * direction[k]
        hist[at + _BOTH] += lower_right - share
        hist[at + _BOTH + _ONE] += share


@compiled(error_model="numpy")
def _finish(hist, out):  # type: ignore[no-untyped-def]
    """Write the inner cells, clipped at a fifth of their length, at length 512, rounded and at most 255."""
    total, at = 0.0, 0
    for r in range(1, _CELLS + 1):
        for c in range(1, _CELLS + 1):
            cell = (r * _SIDE + c) * _STRIDE
            hist[cell] += hist[cell + _BINS]
            for o in range(_BINS):
                out[at] = hist[cell + o]
                total += out[at] * out[at]
                at += 1
    limit = np.float32(_CLIP * math.sqrt(total))
    total = 0.0
    for k in range(len(out)):
        out[k] = min(out[k], limit)
        total += out[k] * out[k]
    factor = _LENGTH / max(math.sqrt(total), 1e-7)
    for k in range(len(out)):
        out[k] = min(np.rint(out[k] * factor), _LARGEST)


@compiled(error_model="numpy")
def describe_level(pixels, height, width, frames, rows, out):  # type: ignore[no-untyped-def]
    """Write the descriptors, float32 of shape (128,), of the frames `rows` to these rows of `out`.

    `pixels`, (height * width,) float32, are the smoothed image row by row; `frames`, (N, 4) float64: x, y, sigma in its
    pixels, and orientation in radians, clockwise on the screen.
    """
    hist = np.empty(_SIZE, np.float32)
    window, samples, cells = np.empty(0, np.float32), np.empty((5, 0), np.float32), np.empty(0, np.int32)
    for n in rows:
        size = _CELL_SIGMAS * frames[n, 2]
        x, y, angle = int(np.rint(frames[n, 0])), int(np.rint(frames[n, 1])), frames[n, 3]
        # Even, so that the centre is a sample.
        reach = min(_STEP * math.ceil(size * math.sqrt(2.0) * _HALF / _STEP), _STEP * (height + width))
        side = 2 * reach // _STEP + 1
        if side * side > len(cells):
            window = np.empty(2 * reach + 1, np.float32)
            samples, cells = np.empty((5, side * side), np.float32), np.empty(side * side, np.int32)
        for k in range(2 * reach + 1):
            window[k] = math.exp(-2.0 * ((k - reach) / (size * _CELLS)) ** 2)
        turn = angle * _BINS / (2.0 * math.pi)
        turn -= _BINS * math.floor(turn / _BINS)
        count = _gather(
            pixels, height, width, x, y, math.cos(angle) / size, math.sin(angle) / size, window, reach, samples
        )
        dx, dy, row, column = samples[0, :count], samples[1, :count], samples[3, :count], samples[4, :count]
        cell = cells[:count]
        _to_bins(dx, dy, samples[2], row, column, np.float32(turn), cell)
        for k in range(_SIZE):
            hist[k] = _ZERO
        _share_out(dx, dy, row, column, cell, hist)
        _finish(hist, out[n])


@compiled(fastmath={"contract", "reassoc", "nsz"})
def inner_product(a, b):  # type: ignore[no-untyped-def]
    """Return the inner product of two rows, float32; summed in as many parts as a vector of the processor holds.

    For the few pairs of descriptors of which a matrix product would compute too many.
    """
    total = np.float32(0)
    for k in range(len(a)):
        total += a[k] * b[k]
    return total
