"""`torch.func` on solve, project and irradiance equals the batched call; what is compiled equals what is not.

Compiled functions run in a process of their own, `python tests/test_gradients_transforms.py`: the shape checks that the
other tests put around every function are not for tracing.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from torch import Tensor
from torch.func import grad, jacrev, vmap
from torch.testing import assert_close

import torchlight as tl
from torchlight.inversion.linear import solve_light
from torchlight.light.bases import Basis
from torchlight.solvers import Solver
from torchlight.solvers.implicit import adjoint_operator, settings_of, solve_operator

SOLVERS = [tl.NNLS(), tl.Ridge(0.1), tl.NonnegativeSynthesis(), tl.ProjectedAdam(50)]
BASES = [tl.Texels(2), tl.HaarCubemap(2), tl.SphericalHarmonics(1, 2)]


def problem(dtype: torch.dtype = torch.float64) -> tuple[Tensor, Tensor, Tensor]:
    """Transport, samples and weights of three photographs of two channels."""
    g = torch.Generator().manual_seed(0)
    matrix = torch.rand(16, 12, generator=g, dtype=torch.float64)
    samples = torch.randn(3, 2, 12, generator=g, dtype=torch.float64).exp() @ matrix.T
    samples = samples * (1 + 0.1 * torch.randn(3, 2, 16, generator=g, dtype=torch.float64))
    weights = 0.5 + torch.rand(3, 16, generator=g, dtype=torch.float64)
    return matrix.to(dtype), samples.to(dtype), weights.to(dtype)


def coefficients(solver: Solver) -> Callable[[Tensor, Tensor, Tensor], Tensor]:
    return lambda matrix, samples, weights: tl.solve(matrix, tl.Observation(samples, weights), solver).coefficients


def loss(solver: Solver) -> Callable[[Tensor, Tensor, Tensor], Tensor]:
    return lambda *parts: coefficients(solver)(*parts).square().sum()


def by_backward(function: Callable[..., Tensor], *parts: Tensor) -> tuple[Tensor, ...]:
    leaves = [part.clone().requires_grad_() for part in parts]
    return torch.autograd.grad(function(*leaves), leaves)


@pytest.mark.parametrize("solver", SOLVERS, ids=lambda solver: type(solver).__name__)
def test_mapped_solves_equal_the_batched_call(solver: Solver) -> None:
    matrix, samples, weights = problem()
    one = coefficients(solver)
    assert_close(vmap(one, (None, 0, 0))(matrix, samples, weights), one(matrix, samples, weights))
    shared = one(matrix, samples, weights[:1].expand(3, -1))
    assert_close(vmap(one, (None, 0, None))(matrix, samples, weights[0]), shared)
    second = vmap(one, (None, 1, 0), 1)(matrix, samples.movedim(0, 1), weights)
    assert_close(second, one(matrix, samples, weights).movedim(0, 1))
    reweighted = one(matrix, samples[:1].expand(3, -1, -1), weights)
    assert_close(vmap(one, (None, None, 0))(matrix, samples[0], weights), reweighted)
    twice = vmap(vmap(one, (None, 0, None)), (None, 0, None))(matrix, samples[:, :, None], weights[0])
    assert_close(twice[:, :, 0], shared)


@pytest.mark.parametrize("solver", SOLVERS, ids=lambda solver: type(solver).__name__)
def test_mapped_transports(solver: Solver) -> None:
    matrix, samples, weights = problem()
    matrices = torch.stack([matrix, 2 * matrix, matrix.flip(0)])
    one = coefficients(solver)
    each = [one(*parts) for parts in zip(matrices, samples, weights, strict=True)]
    assert_close(vmap(one)(matrices, samples, weights), torch.stack(each))
    gradients = vmap(grad(loss(solver), (0, 1, 2)))(matrices, samples, weights)
    expected = [by_backward(loss(solver), *parts) for parts in zip(matrices, samples, weights, strict=True)]
    for mine, theirs in zip(gradients, zip(*expected, strict=True), strict=True):
        assert_close(mine, torch.stack(theirs))


@pytest.mark.parametrize("solver", SOLVERS, ids=lambda solver: type(solver).__name__)
def test_functional_gradients_equal_backward(solver: Solver) -> None:
    parts = problem()
    expected = by_backward(loss(solver), *parts)
    for mine, theirs in zip(grad(loss(solver), (0, 1, 2))(*parts), expected, strict=True):
        assert_close(mine, theirs)
    mapped = vmap(grad(loss(solver), (0, 1, 2)), (None, 0, 0))(*parts)
    assert_close(mapped[0].sum(dim=0), expected[0])
    assert_close(mapped[1], expected[1])
    assert_close(mapped[2], expected[2])
    assert_close(vmap(grad(loss(solver), 1), (None, 0, 0))(*parts), expected[1])


def test_a_jacobian_by_rows() -> None:
    matrix, samples, weights = problem()
    rows = jacrev(lambda leaf: coefficients(tl.NNLS())(matrix, leaf, weights[0]))(samples[0])
    leaf = samples[0].clone().requires_grad_()
    found = coefficients(tl.NNLS())(matrix, leaf, weights[0])
    for channel in range(2):
        for texel in range(12):
            (row,) = torch.autograd.grad(found[channel, texel], leaf, retain_graph=True)
            assert_close(rows[channel, texel], row)


@pytest.mark.parametrize("basis", BASES, ids=lambda basis: basis.name)
def test_mapped_projections_and_irradiance(basis: Basis) -> None:
    matrix, *_ = problem()
    matrices = torch.stack([matrix, 2 * matrix])
    projected = vmap(lambda one: tl.Transfer(one, 2).project(basis))(matrices)
    assert_close(projected, torch.stack([tl.Transfer(one, 2).project(basis) for one in matrices]))
    light = torch.rand(2, 3, basis.size, dtype=torch.float64)
    shown = torch.stack([tl.irradiance(*pair) for pair in zip(projected, light, strict=True)])
    assert_close(vmap(tl.irradiance)(projected, light), shown)
    assert_close(vmap(tl.irradiance, (None, 0))(projected[0], light), tl.irradiance(projected[0], light))


def test_the_operators_keep_the_rules_of_torch() -> None:
    matrix, samples, weights = problem()
    arguments = (matrix, samples, weights, None, "NNLS", settings_of(tl.NNLS()))
    torch.library.opcheck(solve_operator, arguments, test_utils=("test_schema", "test_faketensor"))
    found, status, *_ = solve_operator(*arguments)
    for with_matrix in (True, False):
        adjoint = (torch.ones_like(found), found, status, *arguments, with_matrix)
        torch.library.opcheck(adjoint_operator, adjoint, test_utils=("test_schema", "test_faketensor"))


def check_compiled_bases() -> None:
    """A whole graph: projection, solve, light, irradiance, and the way back, in every basis."""
    matrix, samples, weights = problem()
    for basis in BASES:
        solver = tl.NonnegativeSynthesis() if basis.name == "sh" else tl.NNLS()

        def relit(
            transport: Tensor, samples: Tensor, weights: Tensor, basis: Basis = basis, solver: Solver = solver
        ) -> Tensor:
            transfer = tl.Transfer(transport, 2)
            light = solve_light(transfer, basis, tl.Observation(samples, weights), solver).coefficients
            return tl.irradiance(transfer.project(basis), light).square().sum()

        agree(relit, matrix, samples, weights)


def check_compiled_solvers() -> None:
    """Every solver, its settings made inside the compiled function or outside."""
    parts = problem(torch.float32)
    for solver in SOLVERS:
        agree(loss(solver), *parts)
    agree(lambda *leaves: coefficients(tl.NNLS(ridge=1e-3))(*leaves).sum(), *parts)


def check_compiled_transforms() -> None:
    """A mapped function and a gradient inside a compiled one."""
    parts = problem()
    for function in (vmap(coefficients(tl.NNLS()), (None, 0, 0)), grad(loss(tl.NNLS()), 1)):
        torch.compiler.reset()
        assert_close(torch.compile(function, fullgraph=True, backend="aot_eager")(*parts), function(*parts))


def check_default_backend() -> None:
    """The backend that writes code. What it fuses needs a C++ compiler; a solve and a product leave nothing to fuse."""
    matrix, samples, weights = problem()

    def shown(samples: Tensor) -> Tensor:
        return tl.irradiance(matrix, coefficients(tl.NNLS())(matrix, samples, weights))

    leaf = samples.clone().requires_grad_()
    found = torch.compile(shown, fullgraph=True)(leaf)
    assert_close(found, shown(samples))
    by = torch.rand_like(found)
    assert_close(torch.autograd.grad(found, leaf, by), torch.autograd.grad(shown(leaf), leaf, by))


def agree(function: Callable[..., Tensor], *parts: Tensor) -> None:
    torch.compiler.reset()
    compiled = torch.compile(function, fullgraph=True, backend="aot_eager")
    with torch.no_grad():
        assert_close(compiled(*parts), function(*parts))
    for mine, theirs in zip(by_backward(compiled, *parts), by_backward(function, *parts), strict=True):
        assert_close(mine, theirs)


def test_compiled_equals_eager(tmp_path: Path) -> None:
    environment = {**os.environ, "TORCHINDUCTOR_CACHE_DIR": str(tmp_path)}
    command = [sys.executable, __file__]
    result = subprocess.run(command, check=False, capture_output=True, text=True, env=environment)
    assert result.returncode == 0, result.stderr


if __name__ == "__main__":
    for check in (check_compiled_bases, check_compiled_solvers, check_compiled_transforms, check_default_backend):
        check()
