from __future__ import annotations

import math

import pytest
import torch
from torch.testing import assert_close

from torchlight.errors import ConfigError, ShapeError
from torchlight.light import environment as env
from torchlight.light import latlong
from torchlight.light.directions import from_angles
from torchlight.light.procedural import axis_colours


def _random(*shape: int, dtype: torch.dtype = torch.float64) -> env.EnvironmentMap:
    return env.EnvironmentMap(torch.rand(*shape, generator=torch.Generator().manual_seed(0), dtype=dtype))


@pytest.mark.parametrize("batch", [(), (2,), (2, 1)])
@pytest.mark.parametrize("height", [1, 3, 16])
def test_uniform_light_gives_pi_and_four_pi(batch, height):
    uniform = env.EnvironmentMap(torch.full((*batch, 3, height, 2 * height), 2.0, dtype=torch.float64))
    expected = torch.full((*batch, 3), 2 * math.pi, dtype=torch.float64)
    assert_close(env.irradiance(uniform), expected, atol=0, rtol=1e-12)
    assert_close(env.power(uniform), 4 * expected, atol=0, rtol=1e-12)
    assert_close(env.flux(uniform).sum((-2, -1)), expected, atol=0, rtol=1e-12)


def test_integrals_converge_to_sums_of_radiance_at():
    light = _random(3, 4, 8)
    directions = latlong.pixel_directions(512)
    weights = latlong.row_solid_angles(512)[:, None]
    samples = env.radiance_at(light, directions)
    assert samples.shape == (3, 512, 1024)
    assert_close((samples * weights).sum((-2, -1)), env.power(light), atol=0, rtol=1e-10)
    cosine = directions[..., 2].clamp(min=0)
    assert_close((samples * weights * cosine).sum((-2, -1)), env.irradiance(light), atol=0, rtol=1e-4)


def test_axes_have_their_colours():
    light = axis_colours(32, dtype=torch.float32)
    directions = torch.tensor([[1, 0, 0], [0, 1, 0], [0, 0, 1], [-1, 0, 0], [0, -1, 0], [0, 0, -1]]) * 0.5
    colours = env.radiance_at(light, directions) > 0
    assert colours.T.tolist() == [
        [True, False, False],
        [False, True, False],
        [False, False, True],
        [False, True, True],
        [True, False, True],
        [True, True, False],
    ]


@pytest.mark.parametrize("degrees", [90.0, -45.0, 360 / 64, 720 + 22.5])
def test_rotation_turns_counter_clockwise(degrees):
    light = _random(2, 3, 32, 64)
    theta, phi = torch.tensor([0.3, 1.0, 1.5, 2.7]).double(), torch.tensor([0.1, 2.0, -1.0, 3.0]).double()
    turned = env.radiance_at(env.rotate_about_z(light, degrees), from_angles(theta, phi + math.radians(degrees)))
    assert_close(turned, env.radiance_at(light, from_angles(theta, phi)), atol=0, rtol=0)


def test_fractions_of_a_pixel_average_by_area_and_keep_power():
    light = _random(3, 4, 8)
    turned = env.rotate_about_z(light, 0.25 * 45)
    expected = 0.75 * light.radiance + 0.25 * light.radiance.roll(-1, dims=-1)
    assert_close(turned.radiance, expected)
    assert_close(env.power(turned), env.power(light))


def test_luminance_and_the_share_that_clipping_changes():
    assert_close(env.luminance(torch.ones(3, 2)), torch.ones(2))
    assert_close(env.luminance(torch.tensor([[0.0], [1.0], [0.0]])), torch.tensor([0.7152]))
    radiance = torch.ones(3, 8, 16, dtype=torch.float64)
    radiance[..., :4] = -1.0
    light = env.EnvironmentMap(radiance, nonnegative=False)
    assert_close(env.negative_share(light), torch.tensor(0.25, dtype=torch.float64))
    assert_close(env.negative_share(env.EnvironmentMap(torch.zeros(3, 8, 16))), torch.tensor(0.0))


def test_bad_maps_are_refused_in_one_line():
    good = torch.ones(3, 4, 8)
    with pytest.raises(ShapeError, match="twice the height"):
        env.EnvironmentMap(torch.ones(3, 4, 4))
    for bad in (math.nan, math.inf):
        with pytest.raises(ConfigError, match="NaN or infinite"):
            env.EnvironmentMap(torch.where(torch.arange(8) == 3, bad, good))
    with pytest.raises(ConfigError, match="nonnegative=False"):
        env.EnvironmentMap(-good)
    assert not env.EnvironmentMap(-good, nonnegative=False).nonnegative
    with pytest.raises(ConfigError, match="finite angle"):
        env.rotate_about_z(env.EnvironmentMap(good), math.nan)
