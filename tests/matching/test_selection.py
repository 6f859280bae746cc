"""Distinct rows, against the slow way to find them."""

from __future__ import annotations

import numpy as np
import pytest

from epiprior.matching import selection
from epiprior.matching.selection import first_of_equal


def slow(rows):
    seen: set[bytes] = set()
    first = []
    for k, row in enumerate(rows):
        if (key := (row + 0.0).tobytes()) not in seen:
            seen.add(key)
            first.append(k)
    return first


@pytest.mark.parametrize("columns", [1, 2, 4])
@pytest.mark.parametrize("numbers", [3, 40, 10**9])
def test_first_of_equal_is_the_slow_way(columns, numbers):
    rng = np.random.default_rng(columns)
    for n in (0, 1, 2, 30, 500):
        rows = rng.integers(-numbers, numbers, (n, columns)) / 7.0
        rows[rng.random(n) < 0.2] = rows[:1]
        assert first_of_equal(rows).tolist() == slow(rows)


def test_the_sign_of_zero_makes_no_difference():
    assert first_of_equal(np.array([[0.0, 1.0], [-0.0, 1.0]])).tolist() == [0]


def test_rows_of_one_sum_are_told_apart(monkeypatch):
    monkeypatch.setattr(selection, "_FACTORS", np.ones(4))
    rows = np.array([[2.0, 1.0], [1.0, 2.0], [2.0, 1.0], [0.0, 0.0], [3.0, 0.0]])
    assert first_of_equal(rows).tolist() == [0, 1, 3, 4]
