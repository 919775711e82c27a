"""Equations of columns that came and left, solved with an older factor: against numpy on the set itself."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from torchlight.solvers import border_kernel as kernel
from torchlight.solvers.factor_kernel import TILE, factored, forward

COUNT, SHIFT = 43, 1e-6  # not a multiple of the tile


class Base:
    """A factor of some columns of a random Gram matrix."""

    def __init__(self, seed: int, count: int = COUNT) -> None:
        rng = np.random.default_rng(seed)
        columns = rng.random((120, count))
        columns /= np.linalg.norm(columns, axis=0)
        self.gram, self.linear = columns.T @ columns, rng.normal(size=count)
        self.passive = rng.random(count) < 0.6
        self.index = np.zeros(count, np.int64)
        self.used = int(self.passive.sum())
        self.index[: self.used] = np.flatnonzero(self.passive)
        self.factor, self.inverse = np.zeros((count + TILE, count + TILE)), np.ones(count + TILE)
        factored(self.gram, self.index, self.used, 0, SHIFT, self.factor, self.inverse)
        half = np.zeros(count)
        forward(self.factor, self.inverse, self.index, self.used, self.linear, half)
        self.border = kernel.empty_border(count)
        kernel.begin(self.border, self.index, self.used, half)

    def solved(self, passive: np.ndarray, rows: int) -> tuple[dict[int, float], int]:
        """Returns the value of each column, and the rows that the border has."""
        current, values = np.zeros(len(passive), np.int64), np.zeros(len(passive))
        listed, rows = kernel.bordered(
            self.gram, self.linear, SHIFT, passive, self.index, self.used, self.factor, self.inverse, self.border, rows,
            current, values,
        )  # fmt: skip
        many = max(listed, 0)
        return dict(zip(current[:many].tolist(), values[:many].tolist(), strict=True)), rows

    def expected(self, passive: np.ndarray) -> dict[int, float]:
        """Returns the same by numpy."""
        where = np.flatnonzero(passive)
        block = self.gram[np.ix_(where, where)] + SHIFT * np.eye(len(where))
        return dict(zip(where.tolist(), np.linalg.solve(block, self.linear[where]).tolist(), strict=True))


def changed(passive: np.ndarray, columns: list[int]) -> np.ndarray:
    """Returns the set with these columns on the other side."""
    other = passive.copy()
    other[columns] = ~other[columns]
    return other


@pytest.mark.parametrize("seed", range(5))
def test_values_are_numpys_while_columns_come_and_leave_and_come_back(seed: int):
    base = Base(seed, 120)
    rng = np.random.default_rng(seed + 100)
    passive, rows, touched = base.passive, 0, set()
    for _ in range(4):
        columns = rng.permutation(120)[:2].tolist() + sorted(touched)[:1]
        passive, touched = changed(passive, columns), touched | set(columns)
        found, rows = base.solved(passive, rows)
        expected = base.expected(passive)
        assert rows == len(touched)
        assert found.keys() == expected.keys()
        assert_allclose([found[j] for j in sorted(found)], list(expected.values()), rtol=1e-7, atol=1e-9)


def test_the_base_itself_needs_no_row():
    base = Base(1)
    found, rows = base.solved(base.passive, 0)
    expected = base.expected(base.passive)
    assert rows == 0
    assert found.keys() == expected.keys()
    assert_allclose(list(found.values()), list(expected.values()), rtol=1e-9, atol=1e-12)


def test_many_changes_want_a_factor_of_their_own():
    base = Base(2)
    found, rows = base.solved(~base.passive, 0)
    assert (found, rows) == ({}, 0)


def test_changes_at_the_end_of_the_factor_want_its_last_rows_made_again():
    """To append a column to a factor is less than what it takes to go without."""
    base = Base(3, 120)
    last = int(np.flatnonzero(base.passive)[-1])
    assert base.solved(changed(base.passive, [last]), 0) == ({}, 0)
    found, rows = base.solved(changed(base.passive, [0]), 0)
    assert rows == 1
    assert len(found) == changed(base.passive, [0]).sum()


def test_a_column_that_repeats_another_leaves_no_sound_equations():
    """Without a shift the Schur complement of a copy is zero or rounding."""
    base = Base(4, 120)
    outside, inside = int(np.flatnonzero(~base.passive)[0]), int(np.flatnonzero(base.passive)[5])
    base.gram[outside], base.gram[:, outside] = base.gram[inside], base.gram[:, inside]
    base.gram[outside, outside] = 1.0 - 2 * SHIFT
    assert base.solved(changed(base.passive, [outside]), 0) == ({}, 1)
