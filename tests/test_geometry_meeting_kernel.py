"""Contours that meet a line: what float32 is asked first never leaves out what float64 finds."""

from __future__ import annotations

import numpy as np
import pytest

kernel = pytest.importorskip("torchlight.geometry.meeting_kernel", reason="numba has no wheel here")
ORDER = [1, 2, 4, 5, *range(6, 14)]  # of an edge's numbers in a table
COUNT, LINES = kernel.AT_ONCE, 4096


def edges_in_doubt(seed: int, x: float, y: float) -> np.ndarray:
    """Edges whose ends lie almost on a line, on either side of it, and whose first face is seen almost edge-on."""
    rng = np.random.default_rng(seed)
    edges = np.zeros((COUNT, 16))
    edges[:, [0, 3]], edges[:, [2, 5]] = rng.uniform(0, 9, (COUNT, 2)), rng.uniform(0, 2, (COUNT, 2))
    beside = rng.integers(1, LINES, COUNT)[:, None] + rng.choice([-1, 1], (COUNT, 2)) * 10 ** rng.uniform(
        -9, -3, (COUNT, 2)
    )
    edges[:, [1, 4]] = beside + y * edges[:, [2, 5]]
    edges[:, 6:12] = rng.normal(size=(COUNT, 6))
    edges[:, 8] = -edges[:, 6] * x - edges[:, 7] * y + rng.choice([-1, 1], COUNT) * 10 ** rng.uniform(-9, -3, COUNT)
    edges[:, 12:14] = rng.choice([-1.0, 1.0], (COUNT, 2))
    edges[:, 6:12] /= np.sqrt((edges[:, 6:9] ** 2).sum(axis=1))[:, None]
    return edges


def contours_that_meet(edges: np.ndarray, x: float, y: float) -> np.ndarray:
    one, two = (edges[:, k] * x + edges[:, k + 1] * y + edges[:, k + 2] for k in (6, 9))
    n = np.where(one > 0, edges[:, 12], -edges[:, 12]) + np.where(two > 0, edges[:, 13], -edges[:, 13])
    first, last = (np.clip(np.ceil(edges[:, k] - y * edges[:, k + 1]), 0, LINES) for k in (1, 4))
    return np.flatnonzero((n != 0) & (first != last))


@pytest.mark.parametrize("seed", range(8))
def test_float32_leaves_no_contour_out(seed: int) -> None:
    x, y = 0.7 + seed, -30.0 * seed
    edges = edges_in_doubt(seed, x, y)
    turning, places = edges[:, ORDER].T.astype(np.float32).copy(), np.arange(COUNT, dtype=np.uint32)
    hits, first = np.empty(COUNT, np.uint32), np.empty((2, COUNT), np.int32)
    slack = kernel.SLACK * (abs(edges[:, [1, 4]]).max() + abs(y) * 2.0 + 1.0)
    doubt = kernel.ROUNDING * (x * abs(edges[:, [6, 9]]).max() + abs(y) * abs(edges[:, [7, 10]]).max() + 1.0)
    found = kernel.find_turning(
        turning, places, np.uint64(0), np.uint64(COUNT), edges, x, y, 0.0, float(LINES), slack, doubt,
        hits, first, np.empty(COUNT, np.int64), np.empty(COUNT),
    )  # fmt: skip
    right = contours_that_meet(edges, x, y)
    assert 20 < len(right) < COUNT
    np.testing.assert_array_equal(hits[:found], right)
