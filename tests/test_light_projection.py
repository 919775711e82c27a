"""Coefficients of lat-long maps: closed forms, quadrature, power, and the convolution with the cosine."""

from __future__ import annotations

import math

import pytest
import torch
from torch.testing import assert_close

from torchlight.errors import ConfigError, ShapeError
from torchlight.light import latlong
from torchlight.light.environment import EnvironmentMap, irradiance, power
from torchlight.light.grids import LatlongGrid
from torchlight.light.harmonics import real_spherical_harmonics
from torchlight.light.projection import cosine_factors, degree_of, expand, project


def noise(height: int) -> torch.Tensor:
    return torch.rand(3, height, 2 * height, dtype=torch.float64, generator=torch.Generator().manual_seed(0))


def test_a_constant_has_one_coefficient() -> None:
    found = project(torch.full((3, 8, 16), 2.0, dtype=torch.float64), 4)
    expected = torch.zeros(3, 25, dtype=torch.float64).index_fill(1, torch.tensor([0]), 2 * math.sqrt(4 * math.pi))
    assert_close(found, expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("degree", [0, 3, 9])
def test_coefficients_are_the_integrals_over_pixels(degree: int) -> None:
    """Against the same integral by 16 x 16 points in every pixel."""
    light = noise(6)
    directions, _ = _points(6, 16)
    values = real_spherical_harmonics(degree, directions).mean(dim=1)  # points stand for equal solid angles
    expected = torch.einsum("cp,pk,p->ck", light.flatten(1), values, LatlongGrid(6).solid_angles())
    assert_close(project(light, degree), expected, rtol=0, atol=5e-3)  # the midpoint rule's error at degree 9


def _points(height: int, count: int) -> tuple[torch.Tensor, torch.Tensor]:
    step = (torch.arange(count, dtype=torch.float64) + 0.5) / count
    edges = torch.cos(latlong.row_boundaries(height))
    z = edges[:-1, None] + edges.diff()[:, None] * step
    phi = math.pi * (1 - (torch.arange(2 * height, dtype=torch.float64)[:, None] + step) / height)
    sine = (1 - z * z).sqrt()
    grid = [g[:, None, :, None].expand(-1, 2 * height, -1, count) for g in (z, sine)]
    turn = phi[None, :, None, :].expand(height, -1, count, -1)
    points = torch.stack([grid[1] * turn.cos(), grid[1] * turn.sin(), grid[0]], dim=-1)
    return points.reshape(2 * height**2, count**2, 3), phi


def test_a_harmonic_is_found_again() -> None:
    truth = torch.randn(3, 25, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    back = project(expand(truth, 128), 4)
    assert_close(back, truth, rtol=0, atol=3e-3)  # a pixel's average dims degree l by l (l + 1) / 24 of its width^2
    assert_close(back[:, 0], truth[:, 0], rtol=0, atol=1e-12)


def test_power_is_exact_both_ways_and_a_sun_loses_only_its_peak() -> None:
    sun = torch.zeros(3, 32, 64, dtype=torch.float64)
    sun[:, 5, 17] = 1e5
    coefficients = project(sun, 6)
    assert_close(coefficients[:, 0] * math.sqrt(4 * math.pi), power(EnvironmentMap(sun)), rtol=1e-12, atol=0)
    back = EnvironmentMap(expand(coefficients, 20), nonnegative=False)
    assert_close(power(back), power(EnvironmentMap(sun)), rtol=1e-12, atol=0)
    assert back.radiance.max().item() < 0.02 * sun.max().item()
    brightest = latlong.pixel_directions(20).reshape(-1, 3)[back.radiance[0].argmax()]
    assert (brightest @ latlong.pixel_directions(32)[5, 17]).item() > math.cos(math.radians(9))


def test_cosine_factors_are_the_published_ones() -> None:
    """Ramamoorthi and Hanrahan (2001), equations 8 and 9: 3.141593, 2.094395, 0.785398, 0, -0.130900, 0, 0.049087."""
    found = cosine_factors(6)[[l * (l + 1) for l in range(7)]]
    expected = torch.tensor([3.141593, 2.094395, 0.785398, 0, -0.130900, 0, 0.049087], dtype=torch.float64)
    assert_close(found, expected, rtol=0, atol=6e-7)
    assert len(cosine_factors(6)) == 49


def test_convolved_coefficients_give_the_plane_its_irradiance() -> None:
    light = noise(16)
    up = real_spherical_harmonics(40, torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64))
    found = (project(light, 40) * cosine_factors(40)) @ up
    assert_close(found, irradiance(EnvironmentMap(light)), rtol=2e-4, atol=0)  # degrees above 40


def test_what_cannot_be_is_refused() -> None:
    with pytest.raises(ConfigError, match="0 to 64"):
        project(noise(4), 65)
    with pytest.raises(ShapeError, match=r"8 coefficients are not"):
        degree_of(8)
