"""Crossings of a line: the ends of hidden intervals without a sort, against the running sum of sorted steps."""

from __future__ import annotations

import numpy as np
import pytest

kernel = pytest.importorskip("torchlight.geometry.crossing_kernel", reason="numba has no wheel here")
COLUMNS, WEIGHT = 20, 2**40


def by_sorting(places: np.ndarray, steps: np.ndarray, sheets: int) -> np.ndarray:
    """The differences of one row: weight x share of each sample right of every end."""
    result = np.zeros(COLUMNS + 1, dtype=np.int64)
    for k in np.argsort(places):
        was = sheets
        sheets = was + int(steps[k])
        if (was == 0) != (sheets == 0):
            sign, column = (1 if was == 0 else -1), int(places[k])
            part = int(np.rint(sign * WEIGHT * (column + 1 - places[k])))
            result[column] += part
            result[column + 1] += sign * WEIGHT - part
    return result


def without(places: np.ndarray, steps: np.ndarray, sheets: int) -> tuple[bool, np.ndarray]:
    packs = np.array([[kernel.packed(p, s) for p, s in zip(places, steps, strict=True)]], dtype=np.int64)
    scratch, differences = np.empty((4, kernel.MANY), np.int32), np.zeros((1, COLUMNS + 1), np.int64)
    fineness = (2.0**31 - 1.0) / COLUMNS
    done = kernel.add_unsorted(packs, 0, len(places), sheets, 0, WEIGHT, scratch, fineness, differences)
    return done, differences[0]


@pytest.mark.parametrize("count", [1, 7, 8, 9, 16, 31, 64])
@pytest.mark.parametrize("sheets", [0, 2, -1])
def test_ends_without_a_sort_are_those_of_sorted_crossings(count: int, sheets: int) -> None:
    rng = np.random.default_rng(count)
    places, steps = rng.uniform(0, COLUMNS, count), rng.choice([-2, -1, 1, 2], count)
    places = (places.view(np.int64) & ~np.int64(7)).view(np.float64)  # as they are kept
    done, found = without(places, steps, sheets)
    assert done
    np.testing.assert_array_equal(found, by_sorting(places, steps, sheets))
    assert sheets != 0 or found.any()


def test_equal_places_and_too_many_crossings_are_left_to_a_sort() -> None:
    places = np.linspace(1.0, 9.0, 9)
    for number, second in ((9, 4.0), (9, 4.0 + 1e-12), (65, 4.5)):
        some = np.r_[places[:8], second] if number == 9 else np.linspace(1.0, 9.0, 65)
        done, found = without(some, np.tile([2, -2], 40)[:number], 0)
        assert not done
        assert not found.any()
