"""A symmetric matrix from its lower triangle, scaled."""

from __future__ import annotations

import numpy as np
import pytest

from torchlight.solvers.mirror_kernel import mirror


@pytest.mark.parametrize("columns", [0, 1, 8, 21])
def test_what_is_above_the_diagonal_is_not_read(columns: int):
    rng = np.random.default_rng(columns)
    matrix, scale = rng.random((columns, columns)), rng.random(columns)
    expected = np.tril(matrix) * scale[:, None] * scale
    expected += np.tril(expected, -1).T
    matrix[np.triu_indices(columns, 1)] = np.nan
    mirror(matrix, scale)
    np.testing.assert_allclose(matrix, expected, rtol=1e-15, atol=0)
    assert (matrix == matrix.T).all()
