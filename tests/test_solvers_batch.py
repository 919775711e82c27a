"""Many photographs, one Gram matrix: masks of their own, threads, company and rough starts change nothing."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.optimize import nnls

from torchlight.solvers import NNLS, LeastSquares, batch, shared_gram
from torchlight.solvers.active_set import Limits, minimize_nonnegative
from torchlight.solvers.filling import Lacking, filling_of
from torchlight.solvers.modulus import QUICK, THOROUGH, Modulus, Stages, modulus_of
from torchlight.solvers.shared_gram import SharedGram, unit_gram, unit_gram_under, weighted_gram
from torchlight.solvers.system import System, same_rows

POINTS, COLUMNS, PHOTOS = 120, 40, 12


def transport_like(seed: int = 0) -> torch.Tensor:
    """Non-negative columns, neighbours alike, two of them zero."""
    g = torch.Generator().manual_seed(seed)
    edges = torch.rand(COLUMNS, generator=g, dtype=torch.float64)
    along = torch.linspace(0, 1, POINTS, dtype=torch.float64)[:, None]
    matrix = torch.sigmoid((along - edges) * 20) + 0.2 * torch.rand(POINTS, COLUMNS, generator=g).double()
    matrix[:, [3, 17]] = 0
    return matrix


def photographs(matrix: torch.Tensor, seed: int = 1) -> torch.Tensor:
    """Light, dark, noise alone."""
    g = torch.Generator().manual_seed(seed)
    light = torch.rand(PHOTOS, 3, COLUMNS, generator=g, dtype=torch.float64) ** 4
    samples = light @ matrix.T + 0.05 * torch.randn(PHOTOS, 3, POINTS, generator=g, dtype=torch.float64)
    samples[2] = 0
    samples[5] = torch.randn(3, POINTS, generator=g, dtype=torch.float64)
    return samples


def masks(seed: int = 2, share: float = 0.2) -> torch.Tensor:
    g = torch.Generator().manual_seed(seed)
    weights = (torch.rand(PHOTOS, POINTS, generator=g) > share).double()
    weights[3] *= 2.5
    weights[4, : POINTS // 2 + 10] = 0  # more than half: the Gram matrix is made afresh
    weights[7] = weights[8]
    return weights


@pytest.mark.parametrize("seed", range(3))
def test_masked_photographs_have_scipys_objective(seed):
    matrix, weights = transport_like(seed), masks(seed)
    samples = photographs(matrix, seed + 10)
    found = NNLS().solve(LeastSquares(matrix, samples, weights))
    found.check()
    for photo in range(PHOTOS):
        root = weights[photo].sqrt().numpy()
        for channel in range(3):
            a, b = matrix.numpy() * root[:, None], samples[photo, channel].numpy() * root
            size = max(float(np.linalg.norm(b)), 1e-300)
            least = nnls(a, b / size, maxiter=5000)[1]
            residual = np.linalg.norm(a @ found.coefficients[photo, channel].numpy() - b) / size
            np.testing.assert_allclose(residual, least, rtol=0, atol=1e-10)


def test_photograph_has_the_same_bits_alone_and_in_company_and_on_one_thread_and_two():
    matrix = transport_like()
    samples = photographs(matrix)
    together = NNLS().solve(LeastSquares(matrix, samples))
    before = torch.get_num_threads()
    try:
        for threads in (1, 2):
            torch.set_num_threads(threads)
            for photo in (0, 5, 11):
                alone = NNLS().solve(LeastSquares(matrix, samples[photo : photo + 1]))
                assert torch.equal(alone.coefficients[0], together.coefficients[photo])
    finally:
        torch.set_num_threads(before)


def test_masked_photograph_in_company_agrees_with_itself_alone():
    matrix, weights = transport_like(), masks()
    samples = photographs(matrix)
    together = NNLS().solve(LeastSquares(matrix, samples, weights))
    for photo in range(PHOTOS):
        alone = NNLS().solve(LeastSquares(matrix, samples[photo], weights[photo]))
        assert alone.status.tolist() == together.status[photo].tolist()
        # its Gram matrix is another's downdated, or its own: rounding apart the same objective
        torch.testing.assert_close(alone.relative_residual, together.relative_residual[photo], rtol=0, atol=1e-12)


def test_readable_twin_gives_the_same_objective(monkeypatch):
    matrix, weights = transport_like(), masks()
    problem = LeastSquares(matrix, photographs(matrix), weights)
    compiled = NNLS().solve(problem)

    def twin(unit, linear, start, ridge, limits, near):
        found = [minimize_nonnegative(unit.gram, c, x, ridge, limits) for c, x in zip(linear, start, strict=True)]
        return torch.stack([x for x, _ in found]), torch.tensor([steps for _, steps in found])

    monkeypatch.setattr(batch, "minimize", twin)
    readable = NNLS().solve(problem)
    readable.check()
    torch.testing.assert_close(readable.relative_residual, compiled.relative_residual, rtol=0, atol=1e-10)


def test_start_does_not_matter(monkeypatch):
    matrix = transport_like()
    problem = LeastSquares(matrix, photographs(matrix))
    guessed = NNLS().solve(problem)
    monkeypatch.setattr(batch, "SMALL", 0)
    monkeypatch.setattr(batch, "ENOUGH", 1000)
    cold = NNLS().solve(problem)
    assert torch.equal(cold.coefficients, guessed.coefficients)
    assert cold.steps.sum() > guessed.steps.sum()


@pytest.mark.parametrize(("stages", "wrong", "far"), [(THOROUGH, 2, 1e-2), (QUICK, 3, 3e-2)])
def test_rough_minimizers_have_almost_the_true_support(stages: Stages, wrong: int, far: float):
    matrix = transport_like()
    columns = torch.nn.functional.normalize(matrix[:, matrix.sum(0) > 0], dim=0)
    gram, linear = columns.T @ columns, torch.nn.functional.normalize(photographs(matrix)[0], dim=1) @ columns
    rough = modulus_of(gram, stages).minimizers(linear)
    for z, c in zip(rough, linear, strict=True):
        found = nnls(torch.linalg.cholesky(gram).T.numpy(), torch.linalg.solve(torch.linalg.cholesky(gram), c).numpy())
        assert (torch.from_numpy(found[0] > 0) != (z > 0)).sum().item() <= wrong
        torch.testing.assert_close(z, torch.from_numpy(found[0]), rtol=0, atol=far)


@pytest.mark.parametrize("samples", ["shared", "afresh"])
def test_damped_solve_fills_in_what_a_photograph_lacks(samples, monkeypatch):
    """Without noise the filled-in right-hand side is that of the whole photograph."""
    g = torch.Generator().manual_seed(4)
    columns = torch.nn.functional.normalize(torch.rand(POINTS, 6, generator=g, dtype=torch.float64), dim=0)
    target = torch.rand(6, generator=g, dtype=torch.float64) @ columns.T
    weights = torch.ones(2, POINTS, dtype=torch.float64)
    weights[1, :30] = 0
    shared = SharedGram(
        torch.arange(6), torch.ones(6).double(), columns, weights[0], weighted_gram(columns, weights[0])
    )
    unit = unit_gram(shared.gram)
    linear = torch.stack([target * row for row in weights]) @ columns
    system = System(columns, weights.sqrt(), weights * target)
    seen: list[torch.Tensor] = []

    def spy(_: Modulus, right: torch.Tensor) -> torch.Tensor:
        seen.append(right)
        return right

    monkeypatch.setattr(Modulus, "minimizers", spy)
    guess = modulus_of(unit.gram)
    filling = filling_of(columns * unit.inverse, guess, batch.DAMPING) if samples == "shared" else None
    whole = batch.Batch(system, shared, unit, guess, filling, linear, 0.0, Limits(1e-11, 10))
    groups = [torch.tensor([0]), torch.tensor([1])]
    monkeypatch.setattr(batch, "MOST_LACKING", 30 / 6)
    own = unit_gram_under(shared, weights[1])
    assert own is not None
    lacking = [batch.lacking_of_group(whole, group) for group in groups]
    assert (lacking[1] is not None) == (samples == "shared")
    batch.guessed(whole, groups, lacking, [unit, own])
    torch.testing.assert_close(seen[0][1], seen[0][0], rtol=0, atol=2e-3)  # the damping, 1e-5, of small eigenvalues
    assert (linear[1] - linear[0]).abs().max().item() > 0.1


def test_damped_solve_by_the_samples_that_are_missing_is_numpys():
    """Samples of weight 1 and 0.5 are taken away, wholly and by a half; one column keeps halves alone."""
    g = torch.Generator().manual_seed(5)
    columns = torch.nn.functional.normalize(torch.rand(POINTS, 12, generator=g, dtype=torch.float64), dim=0)
    columns[20:, 3] = 0
    lacking = torch.arange(0, 24)
    taken = torch.where(lacking % 5 == 4, 0.5, 1.0).double()
    left = torch.ones(POINTS, dtype=torch.float64)
    left[lacking] -= taken
    linear = torch.rand(3, 12, generator=g, dtype=torch.float64)
    gram = columns.T @ columns
    groups = [Lacking(1, lacking[:5], taken[:5]), Lacking(2, lacking, taken)]
    found = filling_of(columns, modulus_of(gram), 1e-3).damped(groups, linear)
    shifted = columns.T @ (columns * left[:, None]) + 1e-3 * torch.eye(12, dtype=torch.float64)
    torch.testing.assert_close(found[1:], torch.linalg.solve(shifted, linear[1:].T).T, rtol=1e-9, atol=1e-9)
    left[lacking[5:]] += taken[5:]
    shifted = columns.T @ (columns * left[:, None]) + 1e-3 * torch.eye(12, dtype=torch.float64)
    torch.testing.assert_close(found[0], torch.linalg.solve(shifted, linear[0]), rtol=1e-9, atol=1e-9)


def test_damped_solve_by_a_factor_is_numpys_and_leaves_an_unseen_column_dark():
    g = torch.Generator().manual_seed(5)
    columns = torch.nn.functional.normalize(torch.rand(POINTS, 12, generator=g, dtype=torch.float64), dim=0)
    columns[20:, 3] = 0
    columns[:20, 4] = 0
    weights = torch.ones(POINTS, dtype=torch.float64)
    shared = SharedGram(torch.arange(12), torch.ones(12).double(), columns, weights, columns.T @ columns)
    weights = weights.clone()
    weights[:20] = 0
    own = unit_gram_under(shared, weights)
    assert own is not None
    linear = torch.rand(3, 12, generator=g, dtype=torch.float64)
    linear[:, 3] = 0
    base = unit_gram(shared.gram)
    found = batch.solved_directly(own, base, linear)
    unit = columns * base.inverse
    shifted = unit.T @ (unit * weights[:, None]) + batch.DAMPING * torch.eye(12, dtype=torch.float64)
    torch.testing.assert_close(found, torch.linalg.solve(shifted, linear.T).T, rtol=1e-7, atol=1e-9)
    assert (found[:, 3] == 0).all()


@pytest.mark.parametrize("case", ["few rows", "most rows", "weights raised", "a column almost gone"])
def test_updated_gram_matrix_is_the_one_made_afresh(case):
    g = torch.Generator().manual_seed(3)
    columns = torch.rand(POINTS, COLUMNS, generator=g, dtype=torch.float64)
    weights = torch.rand(POINTS, generator=g, dtype=torch.float64)
    own = weights.clone()
    if case == "few rows":
        own[5:20] = 0
    elif case == "most rows":
        own[20:] = 0
    elif case == "weights raised":
        own[7:30] *= 3
    else:
        columns[30:, 4] = 1e-7
        columns[:30, 4] += 1
        own[:30] = 0
    shared = SharedGram(
        torch.arange(COLUMNS), torch.ones(COLUMNS).double(), columns, weights, weighted_gram(columns, weights)
    )
    expected = columns.T @ (own[:, None] * columns)
    lengths = expected.diagonal().sqrt()
    found = unit_gram_under(shared, own)
    assert found is not None
    torch.testing.assert_close(found.norms, lengths, rtol=1e-13, atol=0)
    torch.testing.assert_close(found.gram, expected / lengths / lengths[:, None], rtol=0, atol=1e-13)
    assert torch.equal(found.gram, found.gram.T)
    assert unit_gram_under(shared, weights) is None


def test_gram_matrix_has_numpys_numbers_and_the_same_bits_on_any_number_of_threads(monkeypatch):
    monkeypatch.setattr(shared_gram, "COLUMNS_PER_TASK", 16)
    columns, weights = transport_like(), torch.rand(POINTS, generator=torch.Generator().manual_seed(1)).double()
    once = weighted_gram(columns, weights)
    torch.testing.assert_close(once, columns.T @ (columns * weights[:, None]), rtol=1e-13, atol=1e-13)
    assert torch.equal(once, once.T)
    before = torch.get_num_threads()
    try:
        for threads in (1, 2):
            torch.set_num_threads(threads)
            assert torch.equal(weighted_gram(columns, weights), once)
    finally:
        torch.set_num_threads(before)


def test_column_that_only_one_photograph_sees_is_used_for_it():
    matrix = torch.eye(3, dtype=torch.float64).repeat(2, 1)
    matrix[:, 2] = 0
    matrix[5, 2] = 1
    samples = torch.ones(3, 1, 6, dtype=torch.float64)
    weights = torch.ones(3, 6, dtype=torch.float64)
    weights[:2, 5] = 0  # as most have it, nobody sees column 2
    found = NNLS().solve(LeastSquares(matrix, samples, weights)).coefficients[:, 0]
    torch.testing.assert_close(found, torch.tensor([[1.0, 1, 0], [1, 1, 0], [1, 1, 1]]).double())


def test_equal_rows_are_found_in_order():
    rows = torch.tensor([[1.0, 0.0], [2.0, 0.0], [1.0, -0.0], [2.0, 1.0], [2.0, 0.0]], dtype=torch.float64)
    assert [group.tolist() for group in same_rows(rows)] == [[0, 2], [1, 4], [3]]


def test_many_masked_photographs_have_the_residuals_of_scipy(monkeypatch):
    """The guess is filled in by the samples that each photograph lacks; what comes out does not depend on it."""
    monkeypatch.setattr(batch, "ENOUGH_MASKS", 2)
    made: list[int] = []
    genuine = batch.filling_of
    monkeypatch.setattr(batch, "filling_of", lambda *parts: made.append(1) or genuine(*parts))
    matrix = transport_like()
    g = torch.Generator().manual_seed(6)
    samples = torch.rand(5, 2, matrix.shape[0], generator=g, dtype=torch.float64)
    weights = (torch.rand(5, matrix.shape[0], generator=g) > 0.1).double()
    found = NNLS().solve(LeastSquares(matrix, samples, weights))
    found.check()
    assert made == [1]
    for photo in range(5):
        for channel in range(2):
            rows = weights[photo] > 0
            b = samples[photo, channel, rows]
            _, least = nnls(matrix[rows].numpy(), b.numpy())
            residual = (matrix[rows] @ found.coefficients[photo, channel] - b).norm().item()
            assert residual == pytest.approx(least, rel=1e-7)
