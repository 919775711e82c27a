"""The compiled active set against its readable twin, scipy and numpy."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose
from scipy.optimize import nnls

from torchlight.solvers import factor_kernel
from torchlight.solvers import nnls_kernel as kernel
from torchlight.solvers.active_set import Limits, minimize_nonnegative

POINTS, COUNT = 80, 37  # not a multiple of the tile
RIDGE, TOLERANCE = 1e-12, 1e-11
Matrix = Callable[[np.random.Generator], np.ndarray]


def independent(rng: np.random.Generator) -> np.ndarray:
    return rng.random((POINTS, COUNT))


def rank_deficient(rng: np.random.Generator) -> np.ndarray:
    """Rank 12, some columns equal."""
    matrix = rng.random((POINTS, 12)) @ rng.random((12, COUNT))
    matrix[:, 3] = matrix[:, 2]
    return matrix


def smooth(rng: np.random.Generator) -> np.ndarray:
    """Neighbouring columns are much alike."""
    along, width = np.linspace(0, 1, POINTS)[:, None], rng.uniform(0.1, 0.3)
    return np.exp(-(((along - np.linspace(0, 1, COUNT)) / width) ** 2))


def wide(rng: np.random.Generator) -> np.ndarray:
    """More columns than samples."""
    return rng.normal(size=(15, COUNT))


MATRICES: list[Matrix] = [independent, rank_deficient, smooth, wide]


def normal_equations(matrix: np.ndarray, targets: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns unit columns, their Gram matrix and their products with unit targets."""
    unit = matrix / np.linalg.norm(matrix, axis=0)
    return unit, unit.T @ unit, targets @ unit / np.linalg.norm(targets, axis=1, keepdims=True)


def minimized(
    gram: np.ndarray, linear: np.ndarray, start: np.ndarray, ridge: float = RIDGE, most: int = 1000, near: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    x, steps = np.array(start, dtype=np.float64), np.zeros(len(linear), np.int64)
    kernel.minimize_items(gram, linear, ridge, TOLERANCE, 0.0, near, most, x, steps)
    return x, steps


def violation(gram: np.ndarray, linear: np.ndarray, x: np.ndarray, ridge: float) -> float:
    w = linear - x @ gram - ridge * x
    return float(np.where(x > 0, np.abs(w), w).max())


@pytest.mark.parametrize("ridge", [0.0, 1e-12, 1e-6])
@pytest.mark.parametrize("kind", MATRICES)
def test_every_item_ends_stationary_whatever_the_start(kind: Matrix, ridge: float):
    for seed in range(10):
        rng = np.random.default_rng(seed)
        matrix = kind(rng)
        _, gram, linear = normal_equations(matrix, rng.normal(size=(3, len(matrix))) + 0.3)
        for start in (np.zeros((3, COUNT)), np.ones((3, COUNT)), rng.random((3, COUNT)) - 0.5):
            x, steps = minimized(gram, linear, np.maximum(start, 0), ridge)
            assert x.min() >= 0
            assert violation(gram, linear, x, ridge) <= 2 * TOLERANCE
            assert steps.max() < 1000


@pytest.mark.parametrize("kind", MATRICES)
def test_objective_is_that_of_scipy_and_of_the_twin(kind: Matrix):
    for seed in range(10):
        rng = np.random.default_rng(seed)
        matrix = kind(rng)
        targets = rng.normal(size=(2, len(matrix))) + 0.3
        unit, gram, linear = normal_equations(matrix, targets)
        x, _ = minimized(gram, linear, np.zeros((2, COUNT)))
        for item in range(2):
            b = targets[item] / np.linalg.norm(targets[item])
            least = nnls(unit, b, maxiter=5000)[1]
            assert_allclose(np.linalg.norm(unit @ x[item] - b), least, rtol=0, atol=1e-9)
            g, c, start = (torch.from_numpy(part) for part in (gram, linear[item], np.zeros(COUNT)))
            twin, _ = minimize_nonnegative(g, c, start, RIDGE, Limits(TOLERANCE, 1000))
            assert_allclose(unit @ x[item], unit @ twin.numpy(), rtol=0, atol=1e-8)


@pytest.mark.parametrize("kind", [independent, smooth])
def test_answer_has_the_same_bits_from_any_start_and_in_any_company(kind: Matrix):
    rng = np.random.default_rng(3)
    matrix = kind(rng)
    _, gram, linear = normal_equations(matrix, rng.normal(size=(5, len(matrix))) + 0.3)
    together, _ = minimized(gram, linear, np.zeros((5, COUNT)))
    for item in range(5):
        alone, _ = minimized(gram, linear[item : item + 1], rng.random((1, COUNT)))
        np.testing.assert_array_equal(alone[0], together[item])


@pytest.mark.parametrize("kind", MATRICES)
def test_what_is_near_is_as_near_as_asked(kind: Matrix):
    """The last factor is spared, and what that leaves undone is small: by numpy, from w = c - G x."""
    spared = 0
    for seed in range(10):
        rng = np.random.default_rng(seed)
        matrix = kind(rng)
        _, gram, linear = normal_equations(matrix, rng.normal(size=(3, len(matrix))) + 0.3)
        exact, many = minimized(gram, linear, np.zeros((3, COUNT)))
        x, steps = minimized(gram, linear, np.zeros((3, COUNT)), near=1e-12)
        assert x.min() >= 0
        assert violation(gram, linear, x, RIDGE) <= 2 * TOLERANCE
        assert_allclose(objective(gram, linear, x), objective(gram, linear, exact), rtol=0, atol=1e-13)
        spared += int((many - steps).sum())
    assert kind is not independent or spared > 0


def objective(gram: np.ndarray, linear: np.ndarray, x: np.ndarray) -> np.ndarray:
    return ((x @ gram) * x / 2 - linear * x).sum(axis=1)


@pytest.mark.parametrize("kind", MATRICES)
def test_one_by_one_ends_at_the_same_point(kind: Matrix):
    """Lawson and Hanson's method on its own, which few problems reach."""
    rng = np.random.default_rng(5)
    matrix = kind(rng)
    _, gram, linear = normal_equations(matrix, rng.normal(size=(1, len(matrix))) + 0.3)
    expected, _ = minimized(gram, linear, np.zeros((1, COUNT)))
    for start in (np.zeros(COUNT), rng.random(COUNT)):
        x, factor = start.copy(), np.zeros((COUNT + 4, COUNT + 4))
        kernel.lawson_hanson(gram, linear[0], RIDGE, TOLERANCE, 0.0, 1000, x, factor, np.ones(COUNT + 4))
        assert violation(gram, linear[0], x, RIDGE) <= 2 * TOLERANCE
        unit = matrix / np.linalg.norm(matrix, axis=0)
        assert_allclose(unit @ x, unit @ expected[0], rtol=0, atol=1e-8)


def test_columns_of_zeros_and_dark_items_stay_dark():
    rng = np.random.default_rng(6)
    _, gram, linear = normal_equations(independent(rng), rng.random((2, POINTS)))
    gram[4], gram[:, 4], linear[:, 4] = 0.0, 0.0, 0.0
    gram[4, 4], linear[1] = 1.0, 0.0
    x, _ = minimized(gram, linear, np.ones((2, COUNT)))
    assert (x[:, 4] == 0).all()
    assert (x[1] == 0).all()


def test_ties_go_to_the_least_norm():
    """With its columns twice, half of every coefficient goes to each copy."""
    rng = np.random.default_rng(8)
    matrix = independent(rng)[:, :10]
    twice, targets = np.concatenate([matrix, matrix], axis=1), rng.random((1, POINTS))
    _, gram, linear = normal_equations(twice, targets)
    x, _ = minimized(gram, linear, np.zeros((1, 20)), ridge=1e-10)
    once, _ = minimized(gram[:10, :10].copy(), linear[:, :10].copy(), np.zeros((1, 10)), ridge=0.0)
    assert_allclose(x, np.concatenate([once, once], axis=1) / 2, rtol=0, atol=1e-5)


def test_too_few_steps_are_said():
    rng = np.random.default_rng(9)
    _, gram, linear = normal_equations(independent(rng), rng.normal(size=(4, POINTS)))
    x, steps = minimized(gram, linear, np.ones((4, COUNT)), most=2)
    assert steps.max() == 2
    assert x.min() >= 0


@pytest.mark.parametrize("count", [1, 3, 4, 5, 16, COUNT])
def test_factor_is_numpys_and_rows_known_before_stay(count: int):
    rng = np.random.default_rng(count)
    _, gram, _ = normal_equations(independent(rng), rng.random((1, POINTS)))
    index = np.sort(rng.permutation(COUNT)[:count])
    expected = np.linalg.cholesky(gram[np.ix_(index, index)] + 1e-9 * np.eye(count))
    for kept in (0, count // 2):
        factor, inverse = np.zeros((COUNT + 4, COUNT + 4)), np.ones(COUNT + 4)
        factor_kernel.factored(gram, index, kept, 0, 1e-9, factor, inverse)
        assert factor_kernel.factored(gram, index, count, kept, 1e-9, factor, inverse) == 1e-9
        assert_allclose(np.tril(factor[:count, :count]), expected, rtol=1e-10, atol=1e-12)


def test_indefinite_block_gets_the_shift_that_it_needs():
    gram = np.array([[1.0, 1.0], [1.0, 1.0 - 1e-10]])
    factor, inverse = np.zeros((6, 6)), np.ones(6)
    shift = factor_kernel.factored(gram, np.arange(2), 2, 0, 1e-13, factor, inverse)
    assert 1e-13 < shift < 1e-8
    assert_allclose(factor[:2, :2] @ factor[:2, :2].T, gram + shift * np.eye(2), rtol=0, atol=1e-12)


def test_damped_solve_is_numpys():
    rng = np.random.default_rng(10)
    _, gram, linear = normal_equations(independent(rng), rng.random((3, POINTS)))
    x = np.empty_like(linear)
    damping = 1e-5 * (1 + np.arange(COUNT))
    factor_kernel.solve_items(gram, damping, linear, x)
    assert_allclose(x, np.linalg.solve(gram + np.diag(damping), linear.T).T, rtol=1e-8)


@pytest.mark.parametrize("cosine", [0.3, 1e-3])
def test_an_item_may_end_where_its_cosine_is_met(cosine):
    """Fewer factors than the minimum takes; from w = A'r by numpy, no cosine is larger than asked."""
    rng = np.random.default_rng(12)
    columns = independent(rng)
    columns /= np.linalg.norm(columns, axis=0)
    targets = rng.random((40, POINTS))
    targets /= np.linalg.norm(targets, axis=1)[:, None]
    gram, linear = columns.T @ columns, targets @ columns
    spent = {}
    for asked in (0.0, cosine):
        x, steps = np.zeros_like(linear), np.zeros(len(linear), np.int64)
        kernel.minimize_items(gram, linear, 1e-12, TOLERANCE, asked, 0.0, 1000, x, steps)
        residual = targets - x @ columns.T
        w = residual @ columns
        worst = np.where(x > 0, abs(w), w.clip(min=0)).max(axis=1) / np.linalg.norm(residual, axis=1)
        assert x.min() >= 0
        assert worst.max() <= max(asked, 1e-8)
        spent[asked] = steps.sum()
    assert spent[cosine] <= spent[0.0]
    assert cosine < 0.1 or spent[cosine] < spent[0.0]


@pytest.mark.parametrize(("cosine", "little"), [(0.0, 3e-4), (0.01, 0.0)])
def test_columns_nearer_to_a_right_angle_than_the_cosine_by_far_stay_out(cosine: float, little: float):
    """Columns e1, e2 and (e1 + e3) / sqrt(2), b = (0.8, 0.0003, -0.3, 0.5): the minimum has 0.8 e1 and 0.0003 e2."""
    columns = np.array([[1, 0, 0, 0], [0, 1, 0, 0], [np.sqrt(0.5), 0, np.sqrt(0.5), 0]])
    target = np.array([0.8, 3e-4, -0.3, 0.5])
    length = np.linalg.norm(target)
    gram, linear = columns @ columns.T, (columns @ target / length)[None]
    expected = np.array([0.8, little, 0.0]) / length
    x, steps = np.array([[1.0, 0.0, 1.0]]), np.zeros(1, np.int64)
    kernel.minimize_items(gram, linear, 0.0, TOLERANCE, cosine, 0.0, 1000, x, steps)
    assert_allclose(x[0], expected, rtol=0, atol=1e-12)
    x, factor = np.zeros(3), np.zeros((7, 7))
    kernel.lawson_hanson(gram, linear[0], 1e-13, TOLERANCE, cosine, 1000, x, factor, np.ones(7))
    assert_allclose(x, expected, rtol=0, atol=1e-12)


def test_cosine_is_that_of_the_residual_without_negative_values():
    rng = np.random.default_rng(3)
    columns = independent(rng)
    columns /= np.linalg.norm(columns, axis=0)
    target = rng.normal(size=POINTS) + 1.0
    target /= np.linalg.norm(target)
    gram, linear, index = columns.T @ columns, columns.T @ target, np.arange(0, COUNT, 3)
    values = np.linalg.solve(gram[np.ix_(index, index)], linear[index])
    assert (values < 0).sum() > 2
    w = linear - gram[:, index] @ values
    x = np.zeros(COUNT)
    x[index] = values.clip(min=0)
    residual = target - columns @ x
    against = columns.T @ residual / np.linalg.norm(residual)
    cosine = np.where(x > 0, abs(against), against.clip(min=0)).max()
    for factor, verdict in ((1.0001, True), (0.9999, False)):
        assert kernel.met(gram, linear, index, len(index), values, w, factor * cosine, np.empty(COUNT)) == verdict


def test_all_negative_columns_leave_but_only_promising_ones_come_in():
    passive = np.array([True, True, False, False, False])
    wrong = np.array([True, False, True, True, True])
    w = np.array([0.0, 0.0, 1.0, 0.4, 0.6])
    kernel.swap(passive, wrong, w, 0.5, 3)
    assert passive.tolist() == [False, True, True, False, True]
    kernel.swap(passive, wrong, w, 0.5, -1)
    assert passive.tolist() == [False, True, True, False, False]
    kernel.swap(passive, wrong, w, 0.0, 3)
    assert passive.tolist() == [True, True, False, True, True]


def test_where_all_columns_belong_in_they_come_in_before_columns_are_taken_one_by_one():
    rng = np.random.default_rng(0)
    matrix = np.eye(120) + 1e-9 * rng.random((120, 120))
    truth = rng.permuted(np.tile(np.geomspace(1e-7, 1, 120), (3, 1)), axis=1)
    _, gram, linear = normal_equations(matrix, truth @ matrix.T)
    _, steps = minimized(gram, linear, np.zeros_like(linear))
    assert steps.max() < kernel.PIVOTINGS
