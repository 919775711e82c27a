from __future__ import annotations

import math

import pytest
import torch
from torch.testing import assert_close

from torchlight.errors import ConfigError, ShapeError
from torchlight.light import latlong
from torchlight.light.cubature import cubature
from torchlight.light.environment import EnvironmentMap, flux, irradiance


def _uniform(height: int) -> EnvironmentMap:
    return EnvironmentMap(torch.ones(3, height, 2 * height, dtype=torch.float64))


def _one_pixel_sun(height: int, row: int, column: int) -> EnvironmentMap:
    radiance = torch.full((3, height, 2 * height), 1e-3, dtype=torch.float64)
    radiance[:, row, column] = torch.tensor([60_000.0, 50_000.0, 40_000.0], dtype=torch.float64)
    return EnvironmentMap(radiance)


@pytest.mark.parametrize("height", [1, 2, 3, 8, 9, 64])
@pytest.mark.parametrize("count", [1, 1000])
def test_uniform_light_gives_pi(height, count):
    rays = cubature(_uniform(height), count=count)
    assert_close(rays.fluxes.sum(0), torch.full((3,), math.pi, dtype=torch.float64), atol=0, rtol=1e-12)


@pytest.mark.parametrize("count", [500, 3000, 20_000])
def test_total_flux_is_exact_whatever_the_count(count):
    radiance = torch.rand(3, 32, 64, generator=torch.Generator().manual_seed(0), dtype=torch.float64) ** 8
    light = EnvironmentMap(radiance)
    rays = cubature(light, count=count)
    assert len(rays.fluxes) == max(count, 500)
    assert_close(rays.fluxes.sum(0), irradiance(light), atol=0, rtol=1e-11)
    assert (rays.directions[:, 2] > 0).all()
    assert_close(rays.directions.norm(dim=-1), torch.ones(len(rays.directions), dtype=torch.float64))


def test_rays_that_resolve_the_pixels_carry_each_pixels_flux():
    radiance = torch.rand(3, 4, 8, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    light = EnvironmentMap(radiance)
    rays = cubature(light, count=60_000)
    row, column = latlong.pixel_indices(rays.directions, 4)
    gathered = torch.zeros(3, 32, dtype=torch.float64).index_add(1, row * 8 + column, rays.fluxes.T)
    # Cells that straddle two pixels give all to one: their share is a cell's width over a pixel's.
    assert_close(gathered.unflatten(1, (4, 8)), flux(light), atol=2e-3, rtol=0)


def test_a_sun_of_one_pixel_is_split_finer_than_the_pixel():
    light = _one_pixel_sun(256, 60, 100)
    rays = cubature(light, count=4096)
    bright = rays.fluxes[:, 0] > 1e-3 * rays.fluxes[:, 0].max()
    assert bright.sum() > 1000
    mean = torch.nn.functional.normalize(rays.fluxes[:, 1] @ rays.directions, dim=0)
    expected = latlong.pixel_directions(256)[60, 100]
    pixel = math.pi / 256
    # The sky's 0.04 % of the flux pull by 3 % of a pixel.
    assert_close(mean, expected, atol=0.05 * pixel, rtol=0)
    # A meridian through the pixel's middle is a shadow edge: half of the sun passes.
    _, columns = latlong.image_coordinates(rays.directions, 256)
    sun = flux(light)[1, 60, 100]
    passed = rays.fluxes[(columns < 100.5) & (columns > 99), 1].sum()
    assert_close(passed / sun, torch.tensor(0.5, dtype=torch.float64), atol=0.01, rtol=0)


@pytest.mark.parametrize("tilt_degrees", [-50.0, 0.0, 20.0, 70.0])
def test_the_shadow_of_a_half_plane_converges(tilt_degrees):
    """Uniform light behind an edge along y: E = pi / 2 (1 + sin tilt), the view factor of a wedge."""
    tilt = math.radians(tilt_degrees)
    normal = torch.tensor([math.cos(tilt), 0.0, math.sin(tilt)], dtype=torch.float64)
    exact = math.pi / 2 * (1 + math.sin(tilt))
    for count, tolerance in ((512, 3e-2), (4096, 6e-3), (32_768, 2e-3)):
        rays = cubature(_uniform(8), count=count)
        value = rays.fluxes[rays.directions @ normal > 0, 0].sum().item()
        assert_close(value, exact, atol=tolerance, rtol=0)


def test_negative_light_is_split_like_positive():
    light = _one_pixel_sun(64, 20, 30)
    negative = EnvironmentMap(-light.radiance, nonnegative=False)
    first, second = cubature(light, count=2000), cubature(negative, count=2000)
    assert_close(second.directions, first.directions, atol=0, rtol=0)
    assert_close(second.fluxes, -first.fluxes, atol=0, rtol=0)


def test_a_tolerance_stops_early_and_black_needs_nothing():
    start = len(cubature(EnvironmentMap(torch.zeros(3, 8, 16)), count=100_000, tolerance=1e-9).fluxes)
    assert start < 500
    rays = cubature(_uniform(8), count=100_000, tolerance=1e-4)
    assert start < len(rays.fluxes) < 10_000
    assert len(cubature(_uniform(8), count=100_000, tolerance=1e-5).fluxes) > len(rays.fluxes)


def test_the_result_is_the_same_on_every_call():
    first, second = cubature(_uniform(8), count=777), cubature(_uniform(8), count=777)
    assert_close(first.directions, second.directions, atol=0, rtol=0)


def test_bad_requests_are_refused():
    with pytest.raises(ShapeError, match="one map"):
        cubature(EnvironmentMap(torch.ones(2, 3, 4, 8)))
    with pytest.raises(ConfigError, match="count >= 1"):
        cubature(_uniform(4), count=0)
    with pytest.raises(ConfigError, match="tolerance"):
        cubature(_uniform(4), tolerance=math.nan)
