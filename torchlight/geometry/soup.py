"""A triangle soup as corners and faces: which of its corners, and of its faces, are the same."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int, UInt64

MULTIPLIER = np.uint64(0x9E3779B97F4A7C15)  # odd, near 2^64 over the golden ratio (Knuth 1973, section 6.4)


def weld(
    soup: Float[np.ndarray, "faces 3 3"],
) -> tuple[Float[np.ndarray, "points 3"], Int[np.ndarray, "faces 3"]]:
    """Returns the distinct corners, equal to the bit and in the order of z, y and x, and each face's three of them."""
    corners = np.ascontiguousarray(soup).reshape(-1, 3)
    order, begins = equal_rows(corners.view(np.int64))
    points = corners[order[begins]]
    by_place = np.lexsort(points.T)
    rank = np.empty(len(points), dtype=np.int64)
    rank[by_place] = np.arange(len(points))
    number = np.empty(len(corners), dtype=np.int64)
    number[order] = np.repeat(rank, np.diff(begins, append=len(order)))
    return points[by_place], number.reshape(-1, 3)


def distinct(faces: Int[np.ndarray, "faces 3"]) -> Int[np.ndarray, "kept_faces 3"]:
    """Returns the faces with three different corners, of each set of faces on the same corners the first."""
    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (c != a)]
    order, begins = equal_rows(np.sort(faces, axis=1))
    first = np.minimum.reduceat(order, begins) if len(begins) else order
    return faces[np.sort(first)]


def equal_rows(
    rows: Int[np.ndarray, "rows columns"],
) -> tuple[Int[np.ndarray, " rows"], Int[np.ndarray, " groups"]]:
    """Returns an order in which equal rows stand together, and where in it each group of them begins.

    They are sorted by a hash of all columns, which is far faster than by one column after another; the latter is done
    where two unlike rows have the same hash.
    """
    hashes = hash_rows(rows)
    order = np.argsort(hashes)
    ordered, hashes = np.take(rows, order, axis=0), hashes[order]
    new = ~same_rows(ordered[1:], ordered[:-1])
    if bool((new != (hashes[1:] != hashes[:-1])).any()):
        order = np.lexsort(rows.T)
        new = ~same_rows(rows[order[1:]], rows[order[:-1]])
    return order, np.flatnonzero(np.r_[True, new][: len(rows)])


def hash_rows(rows: Int[np.ndarray, "rows columns"]) -> UInt64[np.ndarray, " rows"]:
    """Returns 64 bits for each row, equal for equal rows."""
    result = np.zeros(len(rows), dtype=np.uint64)
    for column in rows.view(np.uint64).T:
        result = (result ^ column) * MULTIPLIER
        result ^= result >> np.uint64(32)
    return result


def same_rows(one: np.ndarray, two: np.ndarray) -> Bool[np.ndarray, " rows"]:
    """Returns which rows are equal in all columns."""
    result = np.ones(len(one), dtype=bool)
    for a, b in zip(one.T, two.T, strict=True):
        result &= a == b
    return result
