"""Which system is solved in which basis, and that bases which span the same light give the same light."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.optimize import nnls
from torch import Tensor
from torch.testing import assert_close

from torchlight.errors import ConfigError, ShapeError
from torchlight.geometry.analytic_shadow import Block
from torchlight.geometry.receiver import Receiver
from torchlight.inversion.linear import default_solver, named_solver, solve, solve_light
from torchlight.light.bases import Basis, HaarCubemap, SphericalHarmonics, Texels
from torchlight.photo.observation import Observation
from torchlight.solvers import NNLS, NonnegativeSynthesis, ProjectedAdam, Ridge, Solver, Status
from torchlight.synthetic import block_scene
from torchlight.transfer import Transfer, transport


@pytest.fixture(scope="module")
def transfer() -> Transfer:
    return transport(block_scene(Block((1.0, 0.6, 1.2), 20.0), Receiver((0.0, 0.0), (4.0, 4.0), (12, 12))), 4, 8)


@pytest.fixture(scope="module")
def observation(transfer: Transfer) -> Observation:
    """Heavy-tailed light with noise, so that NNLS has active constraints; a tenth of the samples is not used."""
    generator = torch.Generator().manual_seed(0)
    light = torch.exp(1.5 * torch.randn(3, 48, generator=generator))
    samples = transfer.mv(light)
    samples = samples * (1 + 0.1 * torch.randn(samples.shape, generator=generator))
    return Observation(samples, (torch.rand(144, generator=generator) > 0.1).float())


def objective(transfer: Transfer, observation: Observation, radiance: Tensor) -> Tensor:
    residual = transfer.mv(radiance) - observation.samples
    return (residual.double().square() * observation.weights).sum(dim=-1)


def test_nnls_on_texels_equals_scipy(transfer: Transfer, observation: Observation) -> None:
    solution = solve_light(transfer, Texels(4), observation, NNLS())
    used = (observation.weights > 0).numpy()
    matrix = transfer.transport.double().numpy()[used]
    for channel in range(3):
        target = observation.samples[channel].double().numpy()[used]
        expected, norm = nnls(matrix, target)
        ours = solution.coefficients[channel].double().numpy()
        assert_close(matrix @ ours, matrix @ expected, rtol=0, atol=1e-5 * target.max())
        assert_close(np.linalg.norm(matrix @ ours - target).item(), norm, rtol=1e-6, atol=0)
    assert (solution.coefficients == 0).any()


def test_haar_nnls_is_texel_nnls(transfer: Transfer, observation: Observation) -> None:
    texels = solve_light(transfer, Texels(4), observation, NNLS())
    haar = solve_light(transfer, HaarCubemap(4), observation, NNLS())
    radiance = HaarCubemap(4).synthesis(haar.coefficients)
    assert_close(radiance, texels.coefficients, rtol=0, atol=1e-5 * texels.coefficients.max().item())
    assert torch.equal(haar.status, texels.status)
    assert torch.equal(haar.kkt_residual, texels.kkt_residual)


@pytest.mark.parametrize("degree", [1, 3])
def test_harmonics_by_their_default_are_nowhere_negative(
    transfer: Transfer, observation: Observation, degree: int
) -> None:
    basis = SphericalHarmonics(degree, 4)
    solution = solve_light(transfer, basis, observation, default_solver(basis))
    radiance = basis.synthesis(solution.coefficients)
    assert (solution.status == Status.CONVERGED).all()
    assert radiance.min() >= -1e-5 * radiance.max()
    free = solve_light(transfer, basis, observation, Ridge())
    assert (
        objective(transfer, observation, radiance)
        >= objective(transfer, observation, basis.synthesis(free.coefficients)) * (1 - 1e-5)
    ).all()


def test_ridge_is_least_squares_in_every_complete_basis(transfer: Transfer, observation: Observation) -> None:
    used = observation.weights > 0
    matrix = transfer.transport.double()[used].numpy()
    target = observation.samples.double()[:, used].T.numpy()
    best = ((matrix @ np.linalg.lstsq(matrix, target, rcond=None)[0] - target) ** 2).sum(axis=0)
    for basis in (Texels(4), HaarCubemap(4)):
        found = solve_light(transfer, basis, observation, Ridge())
        reached = objective(transfer, observation, basis.synthesis(found.coefficients)).numpy()
        assert_close(reached, best, rtol=1e-3, atol=0)


def test_adam_comes_close_on_texels_and_haar(transfer: Transfer, observation: Observation) -> None:
    exact = objective(transfer, observation, solve_light(transfer, Texels(4), observation, NNLS()).coefficients)
    for basis in (Texels(4), HaarCubemap(4)):
        found = solve_light(transfer, basis, observation, ProjectedAdam())
        radiance = basis.synthesis(found.coefficients)
        assert radiance.min() >= -1e-5 * radiance.max()
        assert_close(objective(transfer, observation, radiance), exact, rtol=1e-3, atol=0)


@pytest.mark.parametrize("solver", [NNLS(), ProjectedAdam()])
def test_signs_of_harmonic_coefficients_mean_nothing(
    transfer: Transfer, observation: Observation, solver: Solver
) -> None:
    with pytest.raises(ConfigError, match=f"{type(solver).__name__}.*'sh'.*NonnegativeSynthesis") as error:
        solve_light(transfer, SphericalHarmonics(2, 4), observation, solver)
    assert "\n" not in str(error.value)


def test_a_basis_of_another_resolution_is_refused(transfer: Transfer, observation: Observation) -> None:
    with pytest.raises(ShapeError, match="resolution"):
        solve_light(transfer, SphericalHarmonics(2, 8), observation, Ridge())


def test_solve_takes_any_matrix_and_follows_its_dtype() -> None:
    matrix = torch.tensor([[2.0, 0.0], [0.0, 4.0], [0.0, 0.0]], dtype=torch.float64)
    observation = Observation(torch.tensor([[2.0, -4.0, 7.0]]), torch.tensor([1.0, 1.0, 0.0]))
    free, signed = (solve(matrix, observation, solver).coefficients for solver in (Ridge(), NNLS()))
    assert_close(free, torch.tensor([[1.0, -1.0]], dtype=torch.float64))
    assert_close(signed, torch.tensor([[1.0, 0.0]], dtype=torch.float64))
    swap = torch.tensor([[0.0, 1.0], [-1.0, 0.0]], dtype=torch.float64)  # S x >= 0: x_2 >= 0 and x_1 <= 0
    bound = solve(matrix, observation, NonnegativeSynthesis(), swap).coefficients
    assert_close(bound, torch.zeros(1, 2, dtype=torch.float64), rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    ("name", "basis", "solver"),
    [
        ("nnls", Texels(4), NNLS()),
        ("nnls", HaarCubemap(4), NNLS()),
        ("nnls", SphericalHarmonics(2, 4), NonnegativeSynthesis()),
        ("ridge", SphericalHarmonics(2, 4), Ridge()),
        ("adam", HaarCubemap(4), ProjectedAdam()),
    ],
)
def test_names_of_the_command_line(name: str, basis: Basis, solver: Solver) -> None:
    assert named_solver(name, basis) == solver


@pytest.mark.parametrize(("name", "basis"), [("adam", SphericalHarmonics(2, 4)), ("svd", Texels(4)), ("", Texels(4))])
def test_other_names_are_refused_in_one_line(name: str, basis: Basis) -> None:
    with pytest.raises(ConfigError, match="--solver") as error:
        named_solver(name, basis)
    assert "\n" not in str(error.value)
