"""Which corners and faces of a soup are the same: against NumPy's own unique rows, whatever the hash."""

from __future__ import annotations

import numpy as np
import pytest

from torchlight.geometry import soup
from torchlight.geometry.soup import distinct, equal_rows, hash_rows, weld


@pytest.fixture(params=["hash", "one hash for all", "two hashes"], autouse=True)
def hashes(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """The hash as it is, and two that unlike rows share."""
    if request.param == "one hash for all":
        monkeypatch.setattr(soup, "hash_rows", lambda rows: np.zeros(len(rows), np.uint64))
    if request.param == "two hashes":
        monkeypatch.setattr(soup, "hash_rows", lambda rows: hash_rows(rows) & np.uint64(1))


def triangles(seed: int, faces: int) -> np.ndarray:
    """A soup whose corners are shared, some of them in one or two coordinates only."""
    generator = np.random.default_rng(seed)
    corners = generator.integers(-2, 3, (max(4, faces // 2), 3)) / 3.0
    return corners[generator.integers(len(corners), size=(faces, 3))] + 0.0


@pytest.mark.parametrize("faces", [0, 1, 7, 300])
def test_welded_corners_are_the_unique_ones_in_the_order_of_z_y_x(faces: int) -> None:
    given = triangles(faces, faces)
    points, numbers = weld(given)
    expected = np.unique(given.reshape(-1, 3)[:, ::-1], axis=0)[:, ::-1]
    np.testing.assert_array_equal(points, expected)
    np.testing.assert_array_equal(points[numbers], given)


def test_corners_apart_by_the_last_bit_are_two() -> None:
    given = np.zeros((1, 3, 3))
    given[0, 0, 0] = np.nextafter(0.0, 1.0)
    given[0, 1, 2] = 1.0
    points, _ = weld(given)
    assert len(points) == 3


@pytest.mark.parametrize("faces", [0, 1, 7, 300])
def test_of_faces_on_the_same_corners_the_first_is_kept(faces: int) -> None:
    given = np.random.default_rng(faces).integers(0, 6, (faces, 3))
    kept, seen = [], set()
    for face in given.tolist():
        if len(set(face)) == 3 and frozenset(face) not in seen:
            seen.add(frozenset(face))
            kept.append(face)
    np.testing.assert_array_equal(distinct(given), np.array(kept, dtype=np.int64).reshape(-1, 3))


def test_equal_rows_stand_together() -> None:
    rows = np.random.default_rng(3).integers(-4, 4, (500, 2))
    order, begins = equal_rows(rows)
    groups = np.split(rows[order], begins[1:])
    assert all((group == group[0]).all() for group in groups)
    assert len(groups) == len({tuple(row) for row in rows.tolist()})
    np.testing.assert_array_equal(np.sort(order), np.arange(500))
