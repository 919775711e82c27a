"""Gradients of a solve against finite differences, closed forms and least squares on the passive columns."""

from __future__ import annotations

from dataclasses import dataclass, fields

import pytest
import torch
from torch import Tensor
from torch.autograd import gradcheck
from torch.testing import assert_close

from torchlight.errors import ConfigError, SolveError
from torchlight.inversion.linear import solve, solve_light
from torchlight.light.bases import Basis, HaarCubemap, SphericalHarmonics, Texels
from torchlight.photo.observation import Observation
from torchlight.relighting import irradiance
from torchlight.solvers import (
    NNLS,
    LeastSquares,
    NonnegativeSynthesis,
    ProjectedAdam,
    Ridge,
    Solution,
    Solver,
    Status,
)
from torchlight.solvers.implicit import settings_of, solver_of
from torchlight.transfer import Transfer

POINTS, PHOTOS, CHANNELS = 20, 2, 2
EXACT = NonnegativeSynthesis(tolerance=1e-12)
CASES = [
    (Texels(2), NNLS()),
    (Texels(2), NNLS(ridge=0.1)),
    (Texels(2), Ridge()),
    (Texels(2), Ridge(damping=0.1)),
    (Texels(2), EXACT),
    (HaarCubemap(2), NNLS()),
    (HaarCubemap(2), Ridge(damping=0.1)),
    (HaarCubemap(2), EXACT),
    (SphericalHarmonics(1, 2), Ridge()),
    (SphericalHarmonics(1, 2), Ridge(damping=0.1)),
    (SphericalHarmonics(1, 2), EXACT),
]


def normal(seed: int, *shape: int) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def uniform(seed: int, *shape: int) -> Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def planted(basis: Basis, seed: int = 0) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Returns transport, samples, weights and the answer: on a face, with multipliers of at least 0.2 where it is 0.

    b = A x + r with A'W r = -S'u, u > 0 on the rows that S x makes 0: stationary, and strictly so.
    """
    transport, weights = uniform(seed, POINTS, 12), 0.5 + uniform(seed + 1, PHOTOS, POINTS)
    synthesis = basis.synthesis_matrix()
    synthesis = torch.eye(12, dtype=torch.float64) if synthesis is None else synthesis
    matrix = transport @ synthesis
    samples, answers = [], []
    for photo in range(PHOTOS):
        for channel in range(CHANNELS):
            key = seed + 10 * photo + channel
            if basis.size == 12:  # radiance that is 0 on four texels
                x = torch.linalg.solve(synthesis, (0.5 + uniform(key, 12)) * (uniform(key + 1, 12).argsort() >= 4))
            else:  # lifted until the darkest texel is 0: the first harmonic is constant
                x = 0.3 * normal(key, basis.size)
                x[0] -= (synthesis @ x).min() / synthesis[0, 0]
            bound = (synthesis @ x).abs() < 1e-12
            pull = -synthesis.T @ (bound * (0.2 + uniform(key + 2, 12)))
            free = normal(key + 3, POINTS)
            gram = matrix.T * weights[photo] @ matrix
            free = free - matrix @ torch.linalg.solve(gram, matrix.T @ (weights[photo] * free))
            samples.append(matrix @ (x + torch.linalg.solve(gram, pull)) + free)
            answers.append(x)
    shape = (PHOTOS, CHANNELS, -1)
    return transport, torch.stack(samples).reshape(shape), weights, torch.stack(answers).reshape(shape)


def wanting(*tensors: Tensor) -> list[Tensor]:
    return [tensor.detach().clone().requires_grad_() for tensor in tensors]


def gradients(solver: Solver, *problem: Tensor, by: Tensor | None = None) -> tuple[Tensor, ...]:
    """Returns the gradients of a fixed linear functional of the coefficients by matrix, samples and weights."""
    leaves = wanting(*problem)
    found = solve(leaves[0], Observation(*leaves[1:]), solver).coefficients
    by = normal(99, *found.shape).to(found) if by is None else by
    return torch.autograd.grad((found * by).sum(), leaves)


@pytest.mark.parametrize("basis", [Texels(2), HaarCubemap(2), SphericalHarmonics(1, 2)], ids=lambda basis: basis.name)
@pytest.mark.parametrize("seed", range(3))
def test_the_planted_answers_are_found(basis: Basis, seed: int) -> None:
    transport, samples, weights, answers = planted(basis, seed)
    solver = EXACT if basis.size < 12 else NNLS()
    found = solve_light(Transfer(transport, 2), basis, Observation(samples, weights), solver).coefficients
    assert_close(found, answers, rtol=0, atol=1e-9)


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize(("basis", "solver"), CASES, ids=lambda case: getattr(case, "name", None) or repr(case))
def test_finite_differences(basis: Basis, solver: Solver, seed: int) -> None:
    """With respect to transport (through the projection), samples and weights, two photographs of two channels."""

    def coefficients(transport: Tensor, samples: Tensor, weights: Tensor) -> Tensor:
        return solve_light(Transfer(transport, 2), basis, Observation(samples, weights), solver).coefficients

    torch.manual_seed(seed)  # of the directions that are compared
    leaves = wanting(*planted(basis, seed)[:3])
    assert gradcheck(coefficients, leaves, eps=1e-5, atol=1e-7, rtol=1e-6, fast_mode=True)


@pytest.mark.parametrize("solver", [NNLS(), NNLS(ridge=0.1), Ridge(damping=0.1)], ids=repr)
def test_every_entry_by_finite_differences(solver: Solver) -> None:
    matrix, samples, weights = normal(0, 9, 4), normal(1, 1, 1, 9), 0.5 + uniform(2, 1, 9)

    def coefficients(*leaves: Tensor) -> Tensor:
        return solve(leaves[0], Observation(*leaves[1:]), solver).coefficients

    assert 0 < int((coefficients(matrix, samples, weights) > 0).sum()) < 4
    assert gradcheck(coefficients, wanting(matrix, samples, weights), eps=1e-5, atol=1e-7, rtol=1e-6)


@pytest.mark.parametrize("damping", [0.0, 0.1])
def test_fewer_samples_than_coefficients(damping: float) -> None:
    """Minimum norm and its limit: the derivative by the matrix has a part that the pseudo-inverse alone lacks."""
    matrix, samples, weights = normal(0, 4, 7), normal(1, 1, 2, 4), 0.5 + uniform(2, 1, 4)

    def coefficients(*leaves: Tensor) -> Tensor:
        return solve(leaves[0], Observation(*leaves[1:]), Ridge(damping)).coefficients

    assert gradcheck(coefficients, wanting(matrix, samples, weights), eps=1e-5, atol=1e-7, rtol=1e-6)


@pytest.mark.parametrize("basis", [Texels(2), HaarCubemap(2), SphericalHarmonics(2, 2)], ids=lambda basis: basis.name)
def test_projection_and_irradiance_by_finite_differences(basis: Basis) -> None:
    (transport,) = wanting(uniform(0, 5, 12))
    matrix, coefficients = wanting(uniform(1, 5, basis.size), normal(2, 2, 3, basis.size))
    assert gradcheck(lambda transport: Transfer(transport, 2).project(basis), (transport,))
    assert gradcheck(irradiance, (matrix, coefficients))


def test_one_unknown_by_hand() -> None:
    """A = (2, 1)', W = (1, 3), b = (4, 3): x = 17/7, r = (-6/7, 4/7); dx/db = (2, 3)/7, dx/dW = (2 r_1, r_2)/7."""
    matrix, samples, weights = (
        torch.tensor(v, dtype=torch.float64) for v in ([[2.0], [1.0]], [[4.0, 3.0]], [1.0, 3.0])
    )
    by_matrix, by_samples, by_weights = gradients(NNLS(0.0), matrix, samples, weights, by=torch.ones(1, 1).double())
    assert_close(by_samples, torch.tensor([[2.0, 3.0]], dtype=torch.float64) / 7)
    assert_close(by_weights, torch.tensor([-12.0, 4.0], dtype=torch.float64) / 49)
    # dL/dA_i = W_i (r_i u - A_i u x), u = 1/7
    expected = torch.tensor([[-6 / 7 - 2 * 17 / 7], [3 * (4 / 7 - 17 / 7)]], dtype=torch.float64) / 7
    assert_close(by_matrix, expected)
    dark = gradients(NNLS(), matrix, -samples, weights, by=torch.ones(1, 1).double())
    assert all(bool((part == 0).all()) for part in dark)


def test_equals_least_squares_on_the_passive_columns() -> None:
    matrix, weights = normal(0, 60, 15), 0.5 + uniform(1, 3, 60)
    samples, by = normal(2, 3, 2, 60), normal(3, 3, 2, 15)
    ours = gradients(NNLS(0.0), matrix, samples, weights, by=by)
    leaves = wanting(matrix, samples, weights)
    found = solve(matrix, Observation(samples, weights), NNLS(0.0)).coefficients
    assert 0 < int((found == 0).sum()) < found.numel()
    loss = torch.zeros((), dtype=torch.float64)
    for photo in range(3):
        for channel in range(2):
            free = found[photo, channel] > 0
            root = leaves[2][photo].sqrt()
            best = torch.linalg.lstsq(root[:, None] * leaves[0][:, free], root * leaves[1][photo, channel]).solution
            loss = loss + (best * by[photo, channel, free]).sum()
    for mine, theirs in zip(ours, torch.autograd.grad(loss, leaves), strict=True):
        assert_close(mine, theirs, rtol=1e-8, atol=1e-10)


@pytest.mark.parametrize("solver", [NNLS(), Ridge(damping=0.01), EXACT, ProjectedAdam(500)], ids=repr)
def test_a_sample_of_weight_zero_is_absent(solver: Solver) -> None:
    transport, samples, weights, _ = planted(Texels(2))
    samples[:, :, 3], weights[:, 3] = torch.nan, 0.0
    kept = [k for k in range(POINTS) if k != 3]
    by_matrix, by_samples, by_weights = gradients(solver, transport, samples, weights)
    for whole in (by_matrix[3], by_samples[..., 3], by_weights[..., 3]):
        assert_close(whole, torch.zeros_like(whole))
    without = gradients(solver, transport[kept], samples[..., kept], weights[..., kept])
    for mine, theirs in zip((by_matrix[kept], by_samples[..., kept], by_weights[..., kept]), without, strict=True):
        assert_close(mine, theirs, rtol=1e-6, atol=1e-9)  # what rounding makes of ill-conditioned inverses


@pytest.mark.parametrize("solver", [NNLS(), Ridge(), EXACT], ids=repr)
def test_failed_items_have_no_gradient_and_harm_no_other(solver: Solver) -> None:
    transport, samples, weights, _ = planted(Texels(2))
    alone = gradients(solver, transport, samples[:1, :1], weights[:1], by=torch.ones(1, 1, 12).double())
    samples[0, 1, 5] = torch.nan
    weights[1] = 0.0
    by = torch.zeros(2, 2, 12, dtype=torch.float64)
    by[0, 0], by[0, 1], by[1] = 1.0, 7.0, torch.nan
    by_matrix, by_samples, by_weights = gradients(solver, transport, samples, weights, by=by)
    assert_close(by_matrix, alone[0])
    assert_close(by_samples[0, 0], alone[1][0, 0])
    assert_close(by_weights[0], alone[2][0])
    for part in (by_samples[0, 1], by_samples[1], by_weights[1]):
        assert_close(part, torch.zeros_like(part))


@pytest.mark.parametrize("solver", [NNLS(), NNLS(0.0), Ridge(), Ridge(0.1), EXACT, ProjectedAdam(50)], ids=repr)
def test_a_dark_photograph_and_a_dark_scene_are_finite(solver: Solver) -> None:
    transport, samples, weights, _ = planted(Texels(2))
    for problem in ((transport, 0 * samples, weights), (0 * transport, samples, weights)):
        assert all(bool(torch.isfinite(part).all()) for part in gradients(solver, *problem))


def test_equal_columns_share_their_gradient() -> None:
    """Two equal columns and ridge 0: their sum is determined and has its exact gradient, their difference has none."""
    matrix, samples, weights = uniform(0, 9, 3), 3 + uniform(1, 1, 9), torch.ones(9, dtype=torch.float64)
    doubled = matrix[:, [0, 1, 2, 2]]
    single = gradients(NNLS(0.0), matrix, samples, weights, by=torch.tensor([[0.0, 0.0, 1.0]]).double())
    both = gradients(NNLS(0.0), doubled, samples, weights, by=torch.tensor([[0.0, 0.0, 1.0, 1.0]]).double())
    assert solve(doubled, Observation(samples, weights), NNLS(0.0)).coefficients[0, 2:].min() > 0
    assert_close(both[1:], single[1:])
    apart = gradients(NNLS(0.0), doubled, samples, weights, by=torch.tensor([[0.0, 0.0, 1.0, -1.0]]).double())
    assert_close(apart[1], torch.zeros_like(apart[1]), rtol=0, atol=1e-9)


@pytest.mark.parametrize(("basis", "solver"), CASES, ids=lambda case: getattr(case, "name", None) or repr(case))
def test_float32_gives_the_same_gradients(basis: Basis, solver: Solver) -> None:
    by = normal(7, PHOTOS, CHANNELS, basis.size)

    def found(*problem: Tensor) -> tuple[Tensor, ...]:
        leaves = wanting(*problem)
        light = solve_light(Transfer(leaves[0], 2), basis, Observation(*leaves[1:]), solver).coefficients
        return torch.autograd.grad((light * by.to(light)).sum(), leaves)

    # float32 rounds the problem itself: the float64 reference takes the rounded one
    single = [part.float() for part in planted(basis)[:3]]
    for mine, theirs in zip(found(*single), found(*(part.double() for part in single)), strict=True):
        assert mine.dtype == torch.float32
        assert_close(mine.double(), theirs, rtol=1e-4, atol=1e-4 * theirs.abs().max().item())


def test_adam_has_the_gradient_of_the_point_that_it_approaches() -> None:
    transport, samples, weights, _ = planted(Texels(2))
    exact, near = (gradients(s, transport, samples, weights) for s in (NNLS(), ProjectedAdam(5000)))
    for mine, theirs in zip(near, exact, strict=True):
        assert_close(mine, theirs, rtol=0, atol=1e-4 * theirs.abs().max().item())


def test_second_derivatives_are_refused_in_one_line() -> None:
    transport, samples, weights, _ = planted(Texels(2))
    (leaf,) = wanting(samples)
    loss = solve(transport, Observation(leaf, weights), NNLS()).coefficients.square().sum()
    (first,) = torch.autograd.grad(loss, leaf, create_graph=True)
    with pytest.raises(SolveError, match="first derivatives only") as caught:
        first.sum().backward()
    assert "\n" not in str(caught.value)


def test_a_constraint_has_no_gradient() -> None:
    transport, samples, weights, _ = planted(Texels(2))
    (synthesis,) = wanting(torch.eye(12, dtype=torch.float64))
    found = solve(transport, Observation(samples, weights), EXACT, synthesis)
    with pytest.raises(ConfigError, match=r"synthesis.*detach") as caught:
        found.coefficients.sum().backward()
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("solver", [NNLS(), Ridge(0.1), EXACT, ProjectedAdam(50)], ids=repr)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_the_front_door_changes_no_bit(solver: Solver, dtype: torch.dtype) -> None:
    transport, samples, weights = (part.to(dtype) for part in planted(Texels(2))[:3])
    direct = solver.solve(LeastSquares(transport, samples, weights))
    plain = solve(transport, Observation(samples, weights), solver)
    (leaf,) = wanting(samples)
    watched = solve(transport, Observation(leaf, weights), solver)
    for field in fields(Solution):
        expected = getattr(direct, field.name)
        assert not getattr(plain, field.name).requires_grad
        assert getattr(watched, field.name).requires_grad == (field.name == "coefficients")
        for other in (plain, watched):
            assert_close(getattr(other, field.name), expected, rtol=0, atol=0, equal_nan=True)


def test_a_solver_of_ones_own_is_differentiated_as_it_is() -> None:
    @dataclass(frozen=True)
    class Landweber:
        step: float = 0.01

        def solve(self, problem: LeastSquares) -> Solution:
            x = self.step * problem.samples @ problem.matrix
            done = torch.zeros(x.shape[:-1], dtype=torch.int64)
            return Solution(x, done, done, *[done.to(x)] * 3)

    transport, samples, weights, _ = planted(Texels(2))
    _, by_samples, by_weights = torch.autograd.grad(
        solve(
            (leaves := wanting(transport, samples, weights))[0], Observation(*leaves[1:]), Landweber()
        ).coefficients.sum(),
        leaves,
        materialize_grads=True,
    )
    assert_close(by_samples, (0.01 * transport.sum(dim=1)).expand_as(samples))
    assert_close(by_weights, torch.zeros_like(weights))


@pytest.mark.parametrize(
    "solver",
    [NNLS(0.25, 1e-3, 17), Ridge(), Ridge(0.5, 1e-6), NonnegativeSynthesis(1e-9, 1e-5, 3, 4), ProjectedAdam(7, 0.5)],
    ids=repr,
)
def test_settings_survive_the_way_through_torch(solver: Solver) -> None:
    again = solver_of(type(solver).__name__, settings_of(solver))
    assert again == solver
    assert [type(getattr(again, field.name)) for field in fields(type(again))] == [  # pyright: ignore[reportArgumentType]
        type(getattr(solver, field.name))
        for field in fields(type(again))  # pyright: ignore[reportArgumentType]
    ]


def test_stopped_short_is_finite() -> None:
    transport, samples, weights, _ = planted(Texels(2))
    hasty = ProjectedAdam(2)
    found = solve(transport, Observation(samples, weights), hasty)
    assert bool((found.status == Status.STOPPED_SHORT).any())
    assert all(bool(torch.isfinite(part).all()) for part in gradients(hasty, transport, samples, weights))
