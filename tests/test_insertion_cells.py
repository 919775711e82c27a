"""A light as directions with powers: exact totals, and every slanted surface's irradiance."""

from __future__ import annotations

import math

import pytest
import torch
from torch.testing import assert_close

from torchlight.errors import ConfigError
from torchlight.insertion.cells import as_seen_from, light_cells
from torchlight.light import latlong
from torchlight.light.environment import EnvironmentMap
from torchlight.light.procedural import sun_and_window
from torchlight.light_plane import LightPlane


def test_powers_sum_to_the_light_above_the_horizon() -> None:
    light = sun_and_window(32)
    solid = latlong.row_solid_angles(32)
    solid[16:] = 0
    expected = (light.radiance.sum(dim=-1) * solid).sum(dim=-1)
    assert_close(light_cells(light, 500).powers.sum(dim=0).double(), expected, rtol=1e-6, atol=0)


def test_an_odd_row_counts_as_far_as_it_is_above_the_horizon() -> None:
    cells = light_cells(EnvironmentMap(torch.ones(3, 5, 10)), 300)
    assert_close(cells.powers.sum(dim=0), torch.full((3,), 2 * math.pi), rtol=1e-6, atol=0)
    assert (cells.directions[:, 2] > 0).all()


@pytest.mark.parametrize("slant_degrees", [0.0, 40.0, 90.0, 150.0, 180.0])
def test_a_slanted_surface_receives_the_sky_it_sees(slant_degrees: float) -> None:
    # E = pi L (1 + cos slant) / 2 under half a sphere of constant L
    cells = light_cells(EnvironmentMap(torch.full((3, 16, 32), 2.0)), 8192)
    slant = math.radians(slant_degrees)
    normal = torch.tensor([math.sin(slant), 0.0, math.cos(slant)])
    received = ((cells.directions @ normal).clamp(min=0)[:, None] * cells.powers).sum(dim=0)
    expected = torch.full((3,), math.pi * (1 + math.cos(slant)))
    assert_close(
        received, expected, rtol=0, atol=0.008
    )  # of 2 pi: a thousandth, by 8192 rays, each anywhere in its cell


def test_a_near_light_is_seen_where_it_stands() -> None:
    cells = light_cells(sun_and_window(16), 200)
    plane = LightPlane(10.0, (1.0, 2.0))
    point = torch.tensor([3.0, -1.0, 4.0], dtype=torch.float64)
    seen = as_seen_from(cells, plane, point)
    d = cells.directions.double()
    place = torch.tensor([1.0, 2.0, 0.0]).double() + 10 * d / d[:, 2:]
    expected = torch.nn.functional.normalize(place - point, dim=-1)
    assert_close(seen.directions, expected.float(), rtol=0, atol=1e-6)
    assert as_seen_from(cells, None, point) is cells


@pytest.mark.parametrize("count", [0, 2**20 + 1])
def test_numbers_of_rays_that_cannot_be(count: int) -> None:
    with pytest.raises(ConfigError, match="rays: expected 1 to"):
        light_cells(sun_and_window(8), count)
