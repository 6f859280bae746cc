"""How much of the images matches cover."""

import numpy as np
import pytest

from epiprior.verification.spread import CELL_PX, spread_groups, spread_of


def naive_spread(x1, x2):
    return min(len({(int(x // CELL_PX), int(y // CELL_PX)) for x, y in points}) for points in (x1, x2))


@pytest.mark.parametrize("n", [1, 7, 300])
def test_cells_are_counted_once(n):
    rng = np.random.default_rng(n)
    x1, x2 = rng.uniform(-1, 700, (n, 2)), rng.uniform(0, 400, (n, 2))
    assert spread_of(x1, x2) == naive_spread(x1, x2) == spread_of(x2, x1)
    assert spread_of(x1, x2) <= n


def test_the_image_that_is_covered_less_counts():
    wide = np.column_stack([np.arange(10) * 100.0, np.zeros(10)])
    close = np.column_stack([np.arange(10) * 5.0, np.zeros(10)])  # from 0 to 45: one cell
    assert (spread_of(wide, wide), spread_of(wide, close), spread_of(close, wide)) == (10, 1, 1)


def test_no_match_covers_nothing():
    assert spread_of(np.empty((0, 2)), np.empty((0, 2))) == 0


def test_groups_are_parts_of_both_images():
    x1 = np.array([[10.0, 10.0], [40.0, 40.0], [10.0, 10.0], [60.0, 10.0]])
    x2 = np.array([[10.0, 10.0], [20.0, 30.0], [100.0, 10.0], [10.0, 10.0]])
    a, b, c, d = spread_groups(x1, x2)
    assert a == b
    assert len({a, c, d}) == 3
    assert spread_groups(x1[:0], x2[:0]).shape == (0,)
