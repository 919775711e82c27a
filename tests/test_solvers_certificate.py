"""The KKT residual and the duality gap against closed forms."""

from __future__ import annotations

import pytest
import torch

from torchlight.solvers import NNLS, LeastSquares, ProjectedAdam, nonnegative_certificate
from torchlight.solvers.certificate import gap_along, kkt_residual, nonzero_norm
from torchlight.solvers.system import System


def system(matrix: torch.Tensor, target: list[float], weights: list[float] | None = None) -> System:
    b = torch.tensor([target], dtype=torch.float64)
    root = torch.ones_like(b) if weights is None else torch.tensor([weights], dtype=torch.float64).sqrt()
    return System(matrix, root, b * root)


def one(*values: float) -> torch.Tensor:
    return torch.tensor([values], dtype=torch.float64)


EYE = torch.eye(2, dtype=torch.float64)


@pytest.mark.parametrize(
    ("x", "kkt"),
    [
        (one(3, 0), 0.0),  # the minimiser of |x - (3, -4)|^2 over x >= 0
        (one(0, 0), 3 / 5),  # w_1 = 3
        (one(4, 0), 4 / 25),  # x_1 w_1 = -4
        (one(3, -2), 2 / 5),  # infeasible by 2; x_2 w_2 = 4 counts 4 / 25 only
    ],
)
def test_kkt_residual_of_a_separable_problem(x, kkt):
    found = nonnegative_certificate(system(EYE, [3, -4]), x).kkt_residual
    torch.testing.assert_close(found, one(kkt)[0])


def test_kkt_residual_ignores_the_scale_of_columns():
    g = torch.Generator().manual_seed(0)
    matrix, x = (torch.rand(*shape, generator=g, dtype=torch.float64) for shape in ((6, 3), (1, 3)))
    scale = one(1e-5, 1, 1e4)
    once = nonnegative_certificate(system(matrix, [1, 2, 3, 4, 5, 6]), x)
    scaled = nonnegative_certificate(system(matrix * scale, [1, 2, 3, 4, 5, 6]), x / scale)
    torch.testing.assert_close(scaled.kkt_residual, once.kkt_residual)


def test_gap_is_the_error_itself_for_a_single_column():
    # min |(x, x) - (1, 3)|^2 / 2 has x = 2 and f = 1; x = 1 has f = 2. The dual point found is the optimal (-1, 1).
    found = nonnegative_certificate(system(torch.ones(2, 1, dtype=torch.float64), [1, 3]), one(1))
    torch.testing.assert_close(found.gap, one((2 - 1) / 5)[0])


def test_gap_bounds_the_true_error_and_closes_at_the_minimiser():
    g = torch.Generator().manual_seed(2)
    matrix = torch.rand(40, 15, generator=g, dtype=torch.float64)
    problem = LeastSquares(matrix, torch.rand(1, 40, generator=g, dtype=torch.float64))
    exact, rough = NNLS().solve(problem), ProjectedAdam(steps=30).solve(problem)
    error = rough.relative_residual.square() - exact.relative_residual.square()
    assert 0 < error.item() <= rough.gap.item() <= 100 * error.item()
    assert 0 <= exact.gap.item() < 1e-9


def test_no_dual_point_means_not_certified():
    matrix = torch.tensor([[1.0, -1.0], [0.0, 0.5]], dtype=torch.float64)
    assert nonnegative_certificate(system(matrix, [1, 1]), one(0.1, 0.1)).gap.isnan().item()


def test_weights_enter_as_repeated_samples():
    matrix = torch.tensor([[1.0, 2.0], [3.0, 1.0]], dtype=torch.float64)
    repeated = system(matrix[[0, 1, 1]], [1, 2, 2])
    weighted = system(matrix, [1, 2], [1, 2])
    x = one(0.3, 0.2)
    left, right = nonnegative_certificate(repeated, x), nonnegative_certificate(weighted, x)
    torch.testing.assert_close(left.kkt_residual, right.kkt_residual)
    torch.testing.assert_close(left.relative_residual, right.relative_residual)
    torch.testing.assert_close(left.gap, right.gap)


def test_more_axes_are_more_items():
    """As the adaptive method has them: photographs, channels; norms and directions shared by all."""
    g = torch.Generator().manual_seed(3)
    matrix = torch.rand(20, 6, generator=g, dtype=torch.float64)
    targets, x = (torch.rand(2, 3, n, generator=g, dtype=torch.float64) for n in (20, 6))
    x *= 0.2
    residual = targets - x @ matrix.T
    w, size, norms = residual @ matrix, nonzero_norm(targets), torch.linalg.vector_norm(matrix, dim=0)[None, None]
    ones = torch.ones(1, 1, 20, dtype=torch.float64)
    kkt = kkt_residual(x, w, norms, size)
    gap = gap_along(targets, residual, w, norms, ones @ matrix, ones)
    assert (gap < 0.9).all()
    for photo in range(2):
        found = nonnegative_certificate(System(matrix, ones[0], targets[photo]), x[photo])
        torch.testing.assert_close(kkt[photo], found.kkt_residual)
        torch.testing.assert_close(gap[photo], found.gap)
    assert nonzero_norm(torch.zeros(2, 3, 4)).tolist() == [[1.0] * 3] * 2


def test_items_of_several_weights_have_the_figures_that_they_have_alone():
    """Neighbouring items of equal weights share columns' norms: which are whose matters."""
    g = torch.Generator().manual_seed(0)
    matrix, x = torch.rand(9, 3, generator=g, dtype=torch.float64), torch.rand(4, 3, generator=g, dtype=torch.float64)
    root = torch.rand(4, 9, generator=g, dtype=torch.float64)
    root[1] = root[0]
    targets = torch.rand(4, 9, generator=g, dtype=torch.float64)
    together = nonnegative_certificate(System(matrix, root, targets), x, 1e-3)
    for item in range(4):
        here = slice(item, item + 1)
        alone = nonnegative_certificate(System(matrix, root[here], targets[here]), x[here], 1e-3)
        torch.testing.assert_close(together.kkt_residual[here], alone.kkt_residual)
        torch.testing.assert_close(together.gap[here], alone.gap)
