"""The pieces of the compiled growth against scipy and numpy."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import nnls

from torchlight.inversion import forest, growth, nodes, refinement
from torchlight.inversion import growth_kernel as kernel

Minimizer = Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray], int]
POINTS, COUNT = 80, 30
METHODS: dict[str, Minimizer] = {"pivoting": kernel.minimize_nonnegative, "one by one": kernel.lawson_hanson}


def independent(rng: np.random.Generator) -> np.ndarray:
    return rng.random((POINTS, COUNT))


def rank_deficient(rng: np.random.Generator) -> np.ndarray:
    """Rank 12, with columns that are equal, proportional, or 0."""
    matrix = rng.random((POINTS, 12)) @ rng.random((12, COUNT))
    matrix[:, 3], matrix[:, 4], matrix[:, 5] = matrix[:, 2], 0.0, 7 * matrix[:, 2]
    return matrix


def badly_scaled(rng: np.random.Generator) -> np.ndarray:
    return rng.random((POINTS, COUNT)) * 10.0 ** rng.uniform(-6, 6, COUNT)


def smooth(rng: np.random.Generator) -> np.ndarray:
    """Neighbouring columns that are much alike, as those of neighbouring squares are."""
    along, width = np.linspace(0, 1, POINTS)[:, None], rng.uniform(0.1, 0.3)
    return np.exp(-(((along - np.linspace(0, 1, COUNT)) / width) ** 2))


def minimized(matrix: np.ndarray, target: np.ndarray, start: np.ndarray, method: Minimizer) -> tuple[np.ndarray, int]:
    """Returns argmin |A x - b| over x >= 0 by way of its Gram matrix, as the growth does, and the factorisations."""
    gram, norms = matrix.T @ matrix, np.linalg.norm(matrix, axis=0)
    safe, size = np.where(norms > 0, norms, 1.0), float(np.linalg.norm(target))
    x = start * norms / size
    steps = method(gram, norms, matrix.T @ target / (safe * size) * (norms > 0), x, np.empty((COUNT + 5, COUNT + 5)))
    return x * size / safe, steps


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("kind", [independent, rank_deficient, badly_scaled, smooth])
@pytest.mark.parametrize("begin", ["from nothing", "from all", "from some"])
def test_minimum_is_that_of_scipy(kind: Callable[[np.random.Generator], np.ndarray], method: str, begin: str) -> None:
    for seed in range(25):
        rng = np.random.default_rng(seed)
        matrix, target = kind(rng), rng.normal(size=POINTS) + 0.3
        start = {"from nothing": 0.0, "from all": 1.0, "from some": rng.random(COUNT) > 0.5}[begin]
        start = start * (np.linalg.norm(matrix, axis=0) > 0)
        x, steps = minimized(matrix, target, np.ones(COUNT) * start, METHODS[method])
        expected, least = nnls(matrix, target, maxiter=3000)
        size = float(np.linalg.norm(target))
        assert (x >= 0).all()
        assert (x[np.linalg.norm(matrix, axis=0) == 0] == 0).all()
        assert 1 <= steps <= 10 * COUNT
        assert_allclose(np.linalg.norm(matrix @ x - target), least, rtol=1e-9)
        assert_allclose(matrix @ x, matrix @ expected, rtol=0, atol=1e-5 * size)
        if kind in (independent, badly_scaled):
            norms = np.linalg.norm(matrix, axis=0)
            assert_allclose(x * norms, expected * norms, rtol=0, atol=1e-8 * size)


@pytest.mark.parametrize("kind", [independent, smooth])
def test_pivoting_hands_over_to_the_method_that_must_end(
    kind: Callable[[np.random.Generator], np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its Python source with one pivoting allowed, which is never enough here."""
    monkeypatch.setattr(kernel, "PIVOTINGS", 1)
    for seed in range(5):
        rng = np.random.default_rng(seed)
        matrix, target = kind(rng), rng.normal(size=POINTS) + 0.3
        x, steps = minimized(matrix, target, np.ones(COUNT), kernel.minimize_nonnegative.py_func)
        assert steps > 2
        assert_allclose(np.linalg.norm(matrix @ x - target), nnls(matrix, target)[1], rtol=1e-9)


@pytest.mark.parametrize("method", METHODS)
def test_ties_are_no_trap(method: str) -> None:
    """Whole numbers, in which several coefficients meet 0 at the same step and slopes vanish exactly: optimality."""
    for seed in range(200):
        rng = np.random.default_rng(seed)
        matrix = rng.integers(0, 2, (12, COUNT)).astype(float)
        target = rng.integers(-1, 3, 12).astype(float)
        x, _ = minimized(matrix, target, (rng.random(COUNT) > 0.7) * matrix.any(axis=0), METHODS[method])
        slopes = matrix.T @ (target - matrix @ x)
        assert (x >= 0).all()
        assert slopes.max() < 1e-8
        assert abs(slopes[x > 0]).max(initial=0) < 1e-8


@pytest.mark.parametrize("method", METHODS)
def test_black_and_empty_problems_have_no_light(method: str) -> None:
    matrix = np.random.default_rng(0).random((POINTS, COUNT))
    gram, norms = matrix.T @ matrix, np.linalg.norm(matrix, axis=0)
    x = np.ones(COUNT)
    METHODS[method](gram, norms, -np.ones(COUNT), x, np.empty((COUNT, COUNT)))
    assert (x == 0).all()
    nothing = np.zeros(3)
    assert METHODS[method](np.zeros((3, 3)), nothing, nothing, nothing, np.empty((3, 3))) == 1
    assert (nothing == 0).all()


@pytest.mark.parametrize("size", [1, 2, 3, 4, 5, 9, 40])
def test_cholesky_is_that_of_numpy(size: int) -> None:
    matrix = np.random.default_rng(size).normal(size=(size + 3, size))
    gram = matrix.T @ matrix
    factor = np.full((size + 2, size + 2), np.nan)
    factor[:size, :size] = np.triu(gram)
    assert kernel.cholesky(factor, size)
    assert_allclose(np.triu(factor[:size, :size]), np.linalg.cholesky(gram).T, rtol=1e-9, atol=1e-9)


def test_cholesky_says_where_there_is_no_factor() -> None:
    assert not kernel.cholesky(np.array([[1.0, 2.0], [0.0, 1.0]]), 2)
    assert not kernel.cholesky(np.zeros((1, 1)), 1)
    assert kernel.cholesky(np.array([[4.0, 2.0], [0.0, 1.0 + 1e-9]]), 2)


@pytest.mark.parametrize("negative", [0.0, 1e-9, 1e-4])
def test_a_block_that_rounding_made_indefinite_gets_the_ridge_it_needs(negative: float) -> None:
    rng = np.random.default_rng(0)
    basis = np.linalg.qr(rng.normal(size=(6, 6)))[0]
    gram = basis @ np.diag([1.0, 0.8, 0.5, 0.1, 0.0, -negative]) @ basis.T
    norms, index = 10.0 ** rng.uniform(-3, 3, 9), np.array([1, 2, 4, 5, 7, 8])
    matrix, factor = np.full((9, 9), np.nan), np.full((9, 9), np.nan)
    matrix[np.ix_(index, index)] = gram * np.outer(norms[index], norms[index])
    kernel.factor_block(matrix, norms, index, 6, factor)
    upper = np.triu(factor[:6, :6])
    assert_allclose(upper.T @ upper, gram, rtol=0, atol=20 * max(negative, 1e-12))


@pytest.mark.parametrize("count", [0, 1, 3, 4, 5, 11])
def test_rows_are_subtracted_within_their_columns_only(count: int) -> None:
    rng = np.random.default_rng(count)
    rows, weights = rng.normal(size=(count + 2, 9)), rng.normal(size=count + 1)
    before = rows.copy()
    kernel.subtract_rows(weights, rows, count, 2, 7)
    expected = before.copy()
    expected[count, 2:7] -= weights[:count] @ before[:count, 2:7]
    assert_allclose(rows, expected, rtol=1e-13, atol=1e-13)
    assert np.array_equal(rows[:count], before[:count])


def test_positive_definite_means_all_eigenvalues_beyond_the_shift() -> None:
    rng = np.random.default_rng(0)
    answers = []
    for _ in range(500):
        basis = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        symmetric = basis @ np.diag(rng.normal(size=3) + 0.5) @ basis.T
        shift, least = rng.normal() * 0.3, np.linalg.eigvalsh(symmetric)[0]
        answers.append(bool(kernel.positive_definite(symmetric, shift)))
        assert answers[-1] == (least > shift)
    assert 50 < sum(answers) < 450


def test_clipped_gain_is_that_of_the_step_within_reach() -> None:
    rng = np.random.default_rng(1)
    clipped = 0
    for _ in range(200):
        matrix, slopes = rng.normal(size=(5, 3)), rng.normal(size=3)
        prior, reach = float(rng.random()), float(10 ** rng.uniform(-2, 1))
        y = np.linalg.solve(matrix.T @ matrix + prior * np.eye(3), slopes)
        step = min(1.0, reach / np.abs(y).max())
        clipped += step < 1
        found = kernel.clipped_gain(matrix.T @ matrix, slopes, prior, reach)
        assert_allclose(found, (2 * step - step**2) * slopes @ y, rtol=1e-9)
    assert 20 < clipped < 180
    assert kernel.clipped_gain(np.eye(3), np.zeros(3), 1.0, 1.0) == 0


def test_signs_are_those_of_the_wavelets() -> None:
    signs = [[kernel.sign(wavelet, quarter) for quarter in range(4)] for wavelet in range(3)]
    assert signs == [[1, -1, 1, -1], [1, 1, -1, -1], [1, -1, -1, 1]]


# --- one truth -----------------------------------------------------------------------------------------------------


def test_the_kernel_holds_the_numbers_of_its_twin() -> None:
    """They are written out there: numba keeps compiled code until the kernel's own file changes."""
    for name in ("ALWAYS_ASKED", "ASKED_ENERGY", "LEAST_PRIOR", "LEAST_REACH", "REACH", "TRIED", "WAVELETS"):
        assert getattr(kernel, name) == getattr(growth, name)
    assert (kernel.UNKNOWN, kernel.TEXEL) == (nodes.UNKNOWN, nodes.TEXEL)
    assert (kernel.RIDGE, kernel.FLOOR) == (forest.RIDGE, refinement.FLOOR)
    assert growth.LIMITS.tolerance == kernel.TOLERANCE
    for fate in list(refinement.Fate)[:5]:
        assert getattr(kernel, fate.name) == fate
