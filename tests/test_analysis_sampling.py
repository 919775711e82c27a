"""The sampling theorem: eq. 7 is exact for l < B, turned or not, and for nothing beyond; turns are uniform on SO(3)."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

from torchlight.analysis.sampling import harmonic_coefficients, random_rotations, rotated, sampling_set
from torchlight.errors import ConfigError, ShapeError
from torchlight.light.harmonics import real_spherical_harmonics


def random_coefficients(bandwidth: int, batch: tuple[int, ...] = ()) -> Tensor:
    generator = torch.Generator().manual_seed(bandwidth)
    return torch.randn(*batch, bandwidth**2, generator=generator, dtype=torch.float64)


def radiance(coefficients: Tensor, directions: Tensor) -> Tensor:
    degree = math.isqrt(coefficients.shape[-1]) - 1
    return torch.einsum("...c,...nc->...n", coefficients, real_spherical_harmonics(degree, directions))


@pytest.mark.parametrize("bandwidth", [1, 2, 3, 5, 12, 32])
def test_light_of_bandwidth_b_is_reconstructed(bandwidth: int) -> None:
    coefficients = random_coefficients(bandwidth, (2,))
    sampling = sampling_set(bandwidth)
    found = harmonic_coefficients(radiance(coefficients, sampling.directions), sampling, bandwidth)
    assert_close(found, coefficients, rtol=0, atol=1e-10)


@pytest.mark.parametrize("bandwidth", [1, 2, 7, 32])
def test_turned_sets_reconstruct_as_well(bandwidth: int) -> None:
    coefficients = random_coefficients(bandwidth)
    sampling = rotated(sampling_set(bandwidth), random_rotations(3, seed=1))
    assert sampling.directions.shape == (3, bandwidth * (2 * bandwidth - 1), 3)
    values = radiance(coefficients, sampling.directions)
    for k in range(3):
        one = rotated(sampling_set(bandwidth), random_rotations(3, seed=1)[k])
        found = harmonic_coefficients(values[k], one, bandwidth)
        assert_close(found, coefficients, rtol=0, atol=1e-10)


def test_light_beyond_the_bandwidth_is_aliased() -> None:
    """The bound is sharp: of degree l = B, Y_B,B-1 goes unnoticed or is taken for something else."""
    sampling = sampling_set(4)
    beyond = real_spherical_harmonics(4, sampling.directions).T[16:]
    assert harmonic_coefficients(beyond, sampling, 4).abs().max() > 0.1


@pytest.mark.parametrize("bandwidth", [1, 4, 9])
def test_weights_cover_the_sphere(bandwidth: int) -> None:
    sampling = sampling_set(bandwidth)
    assert_close(sampling.weights.sum().item(), 4 * math.pi, rtol=1e-13, atol=0)
    assert_close(sampling.directions.norm(dim=1), torch.ones_like(sampling.weights), rtol=0, atol=1e-14)


def test_the_set_of_bandwidth_3_is_the_paper_s() -> None:
    """Fig. 2, left: rings of five at cos = 0 and +-sqrt(3/5), weights 8/9 and 5/9, one direction at azimuth 0."""
    sampling = sampling_set(3)
    heights = sampling.directions[:, 2].reshape(3, 5)
    expected = torch.tensor([-math.sqrt(0.6), 0.0, math.sqrt(0.6)], dtype=torch.float64)
    assert_close(heights, expected[:, None].expand(3, 5), rtol=0, atol=1e-14)
    weights = torch.tensor([5 / 9, 8 / 9, 5 / 9], dtype=torch.float64) * 2 * math.pi / 5
    assert_close(sampling.weights.reshape(3, 5), weights[:, None].expand(3, 5), rtol=1e-13, atol=0)
    azimuth = torch.atan2(sampling.directions[:5, 1], sampling.directions[:5, 0]) % (2 * math.pi)
    assert_close(azimuth, torch.arange(5, dtype=torch.float64) * 2 * math.pi / 5, rtol=0, atol=1e-14)


def test_dtype_follows_the_keyword() -> None:
    sampling = sampling_set(3, dtype=torch.float32)
    assert {sampling.directions.dtype, sampling.weights.dtype, random_rotations(2, 0, dtype=torch.float32).dtype} == {
        torch.float32
    }


def test_rotations_are_rotations_and_repeatable() -> None:
    turns = random_rotations(50, seed=3)
    identity = torch.eye(3, dtype=torch.float64).expand(50, 3, 3)
    assert_close(turns @ turns.transpose(1, 2), identity, rtol=0, atol=1e-14)
    assert_close(torch.linalg.det(turns), torch.ones(50, dtype=torch.float64), rtol=0, atol=1e-14)
    assert torch.equal(turns, random_rotations(50, seed=3))
    assert not torch.equal(turns, random_rotations(50, seed=4))


def test_rotations_are_uniform() -> None:
    """Moments of the Haar measure: E[R] = 0, E[R_ij R_kl] = delta/3, E[trace^2] = 1; 4 sigma of 10,000 draws."""
    turns = random_rotations(10_000, seed=0).reshape(-1, 9)
    assert_close(turns.mean(dim=0), torch.zeros(9, dtype=torch.float64), rtol=0, atol=0.025)
    assert_close(turns.T @ turns / 10_000, torch.eye(9, dtype=torch.float64) / 3, rtol=0, atol=0.015)
    trace = turns[:, [0, 4, 8]].sum(dim=1)
    assert_close(trace.square().mean().item(), 1.0, rtol=0, atol=0.06)


@pytest.mark.parametrize("bandwidth", [0, -1, 33])
def test_a_bandwidth_out_of_range_is_refused(bandwidth: int) -> None:
    with pytest.raises(ConfigError, match="bandwidth: expected 1 to 32"):
        sampling_set(bandwidth)


def test_other_mistakes_are_refused() -> None:
    with pytest.raises(ConfigError, match="rotations: expected 1 to 10,000, got 0"):
        random_rotations(0, seed=0)
    with pytest.raises(ShapeError, match="bandwidth 3 needs 15 directions, got 6"):
        harmonic_coefficients(torch.zeros(6), sampling_set(2), 3)
