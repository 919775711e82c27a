"""Lamps taken out of a light: where, how large, how bright; and nothing is lost."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor
from torch.testing import assert_close
from workbench import SUN, degrees_between

from torchlight.errors import ConfigError, ShapeError
from torchlight.light import latlong
from torchlight.light.directions import from_angles
from torchlight.light.environment import EnvironmentMap, irradiance, power
from torchlight.light.lamps import Lamp, disc_mean, extract_lamps
from torchlight.light.procedural import axis_colours, sun_and_window

COLOUR = torch.tensor([3.0, 2.0, 1.0], dtype=torch.float64)


def towards(azimuth: float, elevation: float) -> Tensor:
    angles = torch.tensor([90 - elevation, azimuth], dtype=torch.float64).deg2rad()
    return from_angles(angles[0], angles[1])


def disc(azimuth: float, elevation: float, radius: float, height: int = 256) -> Tensor:
    """Returns the share of every pixel that lies within a disc (degrees), [1, rows, columns]."""
    cosine = latlong.pixel_directions(4 * height) @ towards(azimuth, elevation)
    return torch.nn.functional.avg_pool2d((cosine >= math.cos(math.radians(radius))).double()[None], 4)


def sky(*discs: Tensor) -> EnvironmentMap:
    """Returns even light of radiance 1 with coloured discs of radiance 1 + 100 (3, 2, 1)."""
    return EnvironmentMap(1 + 100 * COLOUR[:, None, None] * sum(discs, torch.zeros_like(discs[0])))


def speckled(height: int = 32) -> EnvironmentMap:
    return EnvironmentMap(torch.rand(3, height, 2 * height, generator=torch.Generator().manual_seed(1)).double() ** 12)


def lamps_power(lamps: tuple[Lamp, ...]) -> Tensor:
    return sum((exact(it.radiance) * it.solid_angle for it in lamps), exact((0, 0, 0)))


def exact(values: tuple[float, float, float]) -> Tensor:
    return torch.tensor(values, dtype=torch.float64)


def test_a_disc_is_found_with_its_direction_size_and_colour() -> None:
    (lamp,), rest = extract_lamps(sky(disc(130, 40, 3.0)), 4)
    assert degrees_between(lamp.direction, towards(130, 40)) < 0.05
    assert lamp.radius == pytest.approx(math.radians(3.0), rel=0.02)  # pixels are 0.7 degrees wide
    assert_close(exact(lamp.colour), COLOUR / 3, rtol=1e-6, atol=0)
    expected = 100 * COLOUR * math.pi * math.sin(math.radians(3.0)) ** 2
    assert_close(exact(lamp.irradiance), expected, rtol=0.02, atol=0)
    assert_close(exact(lamp.radiance), 100 * COLOUR, rtol=0.04, atol=0)
    assert_close(rest.radiance, torch.ones_like(rest.radiance))


def test_one_pixel_is_a_lamp_of_its_solid_angle() -> None:
    light = EnvironmentMap(torch.ones(3, 64, 128, dtype=torch.float64))
    light.radiance[:, 25, 40] = 1e4
    (lamp,), _ = extract_lamps(light, 1)
    direction = latlong.pixel_directions(64)[25, 40]
    assert degrees_between(lamp.direction, direction) < 1e-4
    # a disc has the mean square angle of a square when its area is pi / 3 times as large
    assert lamp.solid_angle == pytest.approx(math.pi / 3 * float(latlong.row_solid_angles(64)[25]), rel=0.03)
    assert lamp.irradiance[0] == pytest.approx((1e4 - 1) * float(latlong.row_solid_angles(64)[25]), rel=1e-3)


@pytest.mark.parametrize("light", [sun_and_window(64), axis_colours(64), speckled(), sky(disc(10, 85, 4, 64))])
@pytest.mark.parametrize("count", [1, 5])
def test_lamps_and_rest_are_all_of_the_light(light: EnvironmentMap, count: int) -> None:
    lamps, rest = extract_lamps(light, count)
    on_plane = sum((exact(it.plane_irradiance) for it in lamps), exact((0, 0, 0)))
    assert_close(on_plane + irradiance(rest), irradiance(light), rtol=1e-9, atol=0)
    # of power, which is a narrow disc's irradiance over the mean cosine to its middle, at least (1 + cos 10 deg) / 2
    assert_close(lamps_power(lamps) + power(rest), power(light), rtol=0.01, atol=0)
    assert bool((rest.radiance >= 0).all())
    assert_close(rest.radiance[:, 32:], light.radiance[:, 32:], rtol=0, atol=0)


def test_lamps_come_in_the_order_of_what_they_bring_to_the_plane() -> None:
    low, high = disc(0, 10, 4.0), disc(180, 60, 3.0)
    lamps, _ = extract_lamps(sky(low, high), 3)
    assert degrees_between(lamps[0].direction, towards(180, 60)) < 0.1
    assert degrees_between(lamps[1].direction, towards(0, 10)) < 0.1
    assert lamps[0].share > lamps[1].share
    first, _ = extract_lamps(sky(low, high), 1)
    assert degrees_between(first[0].direction, lamps[0].direction) < 1e-6


def test_the_built_in_sun_and_window() -> None:
    lamps, _ = extract_lamps(sun_and_window(128), 8)
    assert degrees_between(lamps[0].direction, SUN) < 0.05
    assert 2 * math.degrees(lamps[0].radius) == pytest.approx(2 * 2.5 * math.sqrt(3 / 4), rel=0.12)  # 1 - (r / R)^4
    assert all(torch.tensor(it.direction)[:2].mean() < 0 for it in lamps[1:])


def test_even_light_has_no_lamps() -> None:
    assert extract_lamps(EnvironmentMap(torch.ones(3, 32, 64)), 4)[0] == ()
    assert extract_lamps(EnvironmentMap(torch.zeros(3, 32, 64)), 4)[0] == ()
    assert extract_lamps(sun_and_window(32), 0)[0] == ()


def test_glare_about_a_sun_is_no_second_lamp() -> None:
    glare = 0.01 * disc(60, 50, 9.0)
    lamps, _ = extract_lamps(sky(disc(60, 50, 1.5), glare), 4)
    assert len(lamps) == 1
    assert lamps[0].radius == pytest.approx(math.radians(1.5), rel=0.05)


def test_what_is_not_the_light_of_lamps_stays_as_it_is() -> None:
    light = sky(disc(60, 50, 2.0, 64))
    light.radiance[:, 40:] = -0.5
    light = replace(light, radiance=light.radiance.float(), nonnegative=False, units="W")
    _, rest = extract_lamps(light, 2)
    assert (rest.nonnegative, rest.units, rest.radiance.dtype) == (False, "W", torch.float32)
    assert_close(rest.radiance[:, 40:], light.radiance[:, 40:], rtol=0, atol=0)


def test_the_mean_over_a_disc() -> None:
    lamp = Lamp((0.0, 0.0, 1.0), 2 * math.pi * (1 - math.cos(math.radians(30))), (1.0, 1.0, 1.0), 1.0)
    height = latlong.pixel_directions(180)[..., 2]
    assert float(disc_mean(lamp, height)) == pytest.approx((1 + math.cos(math.radians(30))) / 2, rel=1e-3)
    tiny = replace(lamp, direction=(1.0, 0.0, 0.0), solid_angle=1e-9)
    assert float(disc_mean(tiny, torch.arange(32.0).reshape(4, 8))) in (12.0, 20.0, 11.0, 19.0)  # beside the middle


def test_errors() -> None:
    with pytest.raises(ConfigError, match="expected 0 to 64, got 65"):
        extract_lamps(sun_and_window(16), 65)
    with pytest.raises(ShapeError, match="one map"):
        extract_lamps(EnvironmentMap(torch.ones(2, 3, 8, 16)), 1)
