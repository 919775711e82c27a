from __future__ import annotations

import math

import pytest
import torch
from torch.testing import assert_close

from torchlight.light import latlong
from torchlight.light import procedural as sky
from torchlight.light.directions import from_angles
from torchlight.light.environment import irradiance, power, radiance_at


def _at(elevation: float, azimuth: float) -> torch.Tensor:
    angles = torch.tensor([math.pi / 2 - elevation, azimuth], dtype=torch.float64)
    return sky.sun_and_window_radiance(from_angles(angles[0], angles[1]))


def test_the_features_are_where_they_are_said_to_be():
    sun = _at(sky.SUN_ELEVATION, sky.SUN_AZIMUTH)
    assert_close(
        sun, torch.tensor(sky.SUN_RADIANCE, dtype=torch.float64) + _at(sky.SUN_ELEVATION, 3.0), atol=1e-9, rtol=0
    )
    assert_close(_at(math.pi / 2, 0.0), torch.tensor(sky.ZENITH_RADIANCE, dtype=torch.float64), atol=1e-9, rtol=0)
    window = _at(sky.WINDOW_ELEVATION, sky.WINDOW_AZIMUTH)
    assert_close(window, torch.tensor(sky.WINDOW_RADIANCE, dtype=torch.float64))
    beside = _at(sky.WINDOW_ELEVATION, sky.WINDOW_AZIMUTH + 0.51 * sky.WINDOW_WIDTH)
    assert beside.max() < 1
    assert_close(_at(-0.5, 0.3), torch.tensor(sky.GROUND_RADIANCE, dtype=torch.float64))


def test_the_sun_has_its_closed_form_power():
    """Integral of 1 - (r / R)^4 over a small disc: 2/3 pi R^2 on the plane, less r^2 / 6 for the sphere."""
    fine, radius = 20_000, sky.SUN_RADIUS
    r = (torch.arange(fine, dtype=torch.float64) + 0.5) * (radius / fine)
    exact = (2 * math.pi * r.sin() * (1 - (r / radius) ** 4)).sum().item() * (radius / fine)
    assert exact == pytest.approx(2 / 3 * math.pi * radius**2, rel=1e-3)
    with_sun = sky.sun_and_window(128).radiance
    directions = latlong.pixel_directions(512)
    background = sky.sun_and_window_radiance(directions)
    near = directions @ from_angles(
        torch.tensor(math.pi / 2 - sky.SUN_ELEVATION).double(), torch.tensor(sky.SUN_AZIMUTH, dtype=torch.float64)
    ) > math.cos(radius)
    background[:, near] = _at(sky.SUN_ELEVATION, sky.SUN_AZIMUTH + 0.1)[:, None]
    omega = [latlong.row_solid_angles(height)[:, None] for height in (128, 512)]
    sun = (with_sun * omega[0]).sum((-2, -1)) - (background * omega[1]).sum((-2, -1))
    assert_close(sun, exact * torch.tensor(sky.SUN_RADIANCE, dtype=torch.float64), atol=0, rtol=0.02)


def test_the_map_is_the_area_average_of_the_formula():
    fine, finer = sky.sun_and_window(64), sky.sun_and_window(128)
    # The sun and the window's rim are sampled at a quarter of a pixel.
    assert_close(power(fine), power(finer), atol=0, rtol=1e-2)
    assert_close(irradiance(fine), irradiance(finer), atol=0, rtol=1e-2)
    smooth = fine.radiance[:, 60, 10]
    assert_close(smooth, sky.sun_and_window_radiance(latlong.pixel_directions(64)[60, 10]))


@pytest.mark.parametrize("shape", [(), (5,), (2, 3)])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_shapes_and_types_follow_the_directions(shape, dtype):
    directions = torch.nn.functional.normalize(torch.ones(*shape, 3, dtype=dtype), dim=-1)
    radiance = sky.sun_and_window_radiance(directions)
    assert radiance.shape == (3, *shape)
    assert radiance.dtype == dtype


def test_maps_take_their_type_from_the_caller():
    assert sky.sun_and_window(8, dtype=torch.float32).radiance.dtype == torch.float32
    assert sky.axis_colours(8, dtype=torch.float32).radiance.dtype == torch.float32


def test_axis_colours_change_under_every_turn_and_mirror():
    light = sky.axis_colours(16)
    radiance = light.radiance
    for other in (radiance.flip(-1), radiance.flip(-2), radiance.roll(8, -1), radiance.roll(16, -1)):
        assert (other - radiance).abs().max() > 0.5
    blue = radiance_at(light, torch.tensor([[0.0, 0.0, 1.0]]))[:, 0]
    assert (blue > 0).tolist() == [False, False, True]
