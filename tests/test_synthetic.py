"""Photographs with known light: fluxes are kept, the block is the block, exposure and rounding are as stated."""

from __future__ import annotations

import math

import pytest
import torch
from torch.testing import assert_close

from torchlight.errors import SceneError
from torchlight.geometry.analytic_shadow import Block
from torchlight.geometry.receiver import Receiver, sample_centers
from torchlight.light.environment import EnvironmentMap, irradiance
from torchlight.light.procedural import SUN_AZIMUTH, SUN_ELEVATION, sun_and_window
from torchlight.relighting import relight
from torchlight.synthetic import (
    EXPOSED,
    MAX_PARTS,
    PART_SHARE,
    block_scene,
    block_values,
    eight_bit,
    expose,
    pixel_rays,
    receiver_image,
)

RECEIVER = Receiver((0.2, -0.1), (4.0, 4.0), (16, 16))
BLOCK = Block((1.0, 0.6, 1.2), 20.0, (0.3, 0.2))


def test_rays_carry_all_the_light_and_go_up() -> None:
    light = sun_and_window(32)
    rays = pixel_rays(light)
    assert_close(rays.fluxes.sum(dim=0), irradiance(light), rtol=1e-12, atol=0)
    assert_close(
        torch.linalg.vector_norm(rays.directions, dim=1), torch.ones(len(rays.directions), dtype=torch.float64)
    )
    assert (rays.directions[:, 2] > 0).all()
    assert (rays.fluxes >= 0).all()


def test_rays_stay_in_their_pixels() -> None:
    """One lit pixel: its rays fill exactly that rectangle of azimuth and polar angle."""
    radiance = torch.zeros(3, 16, 32, dtype=torch.float64)
    radiance[:, 3, 5] = torch.tensor([3.0, 2.0, 1.0])
    rays = pixel_rays(EnvironmentMap(radiance))
    lit = rays.fluxes[:, 0] > 0
    assert int(lit.sum()) == MAX_PARTS**2
    assert int((~lit).sum()) == 16 // 2 * 32 - 1
    x, y, z = rays.directions[lit].unbind(dim=1)
    theta, phi = torch.acos(z), torch.atan2(y, x)
    step = math.pi / 16
    for angle, low, high in ((theta, 3 * step, 4 * step), (phi, math.pi - 6 * step, math.pi - 5 * step)):
        assert low <= angle.min() < low + step / 40
        assert high - step / 40 < angle.max() <= high
    assert_close(rays.fluxes[lit, 0], 3 * rays.fluxes[lit, 2])


def test_no_ray_carries_more_than_its_share_but_of_pixels_cut_to_the_limit() -> None:
    rays = pixel_rays(sun_and_window(64))
    luminance = rays.fluxes @ torch.tensor([0.2126, 0.7152, 0.0722], dtype=torch.float64)
    above = luminance > PART_SHARE * luminance.sum() * (1 + 1e-9)
    assert above.any()
    values, counts = luminance[above].unique(return_counts=True)
    assert (counts % MAX_PARTS**2 == 0).all()
    assert values.max() < 20 * PART_SHARE * luminance.sum()


@pytest.mark.parametrize("value", [0.0, -1.0])
def test_a_light_that_leaves_the_plane_black_is_refused(value: float) -> None:
    radiance = torch.full((3, 8, 16), value, dtype=torch.float64)
    radiance[:, 4:] = 1.0
    light = EnvironmentMap(radiance, nonnegative=False)
    with pytest.raises(SceneError, match="black"):
        expose(block_values(BLOCK, RECEIVER, pixel_rays(light)), torch.ones(256, dtype=torch.bool))


def test_the_scene_holds_the_block() -> None:
    scene = block_scene(BLOCK, RECEIVER)
    corners = scene.triangles.reshape(-1, 3)
    turn = math.radians(20)
    axes = torch.tensor([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]], dtype=torch.float64)
    local = (corners[:, :2] - torch.tensor([0.3, 0.2], dtype=torch.float64)) @ axes.T
    assert_close(local.abs(), torch.tensor([[0.5, 0.3]], dtype=torch.float64).expand_as(local))
    assert sorted(set(corners[:, 2].tolist())) == [0.0, 1.2]
    assert (scene.receiver, scene.camera, scene.encoding) == (RECEIVER, None, "linear")


def test_values_agree_with_ray_casting() -> None:
    """The closed form against Embree: nothing in common but the light."""
    light = sun_and_window(64)
    closed = block_values(BLOCK, RECEIVER, pixel_rays(light))
    cast = relight(block_scene(BLOCK, RECEIVER), light, 65_536)
    outside = torch.linalg.vector_norm(sample_centers(RECEIVER) - torch.tensor([0.3, 0.2]), dim=1) > 0.9
    residual = (closed - cast)[:, outside]
    assert (255 * residual.square().mean().sqrt() / closed.max()).item() < 0.3


def test_the_shadow_falls_away_from_the_sun() -> None:
    values = block_values(BLOCK, RECEIVER, pixel_rays(sun_and_window(64)))[1]
    away = -torch.tensor([math.cos(SUN_AZIMUTH), math.sin(SUN_AZIMUTH)], dtype=torch.float64)
    tip = torch.tensor([0.3, 0.2], dtype=torch.float64) + away * 1.2 / math.tan(SUN_ELEVATION) * 0.8
    nearest = (sample_centers(RECEIVER) - tip).square().sum(dim=1).argmin()
    assert values[nearest] < 0.5 * values.max()


def test_exposure_brings_the_brightest_used_sample_to_its_level() -> None:
    values = torch.tensor([[0.1, 8.0, 0.2], [0.4, 0.1, 0.1], [0.0, 0.0, 0.0]])
    used = torch.tensor([True, False, True])
    assert expose(values, used) == pytest.approx(EXPOSED / 0.4)


def test_eight_bits() -> None:
    values = torch.tensor([[-1.0, 0.4 / 255, 0.6 / 255, 0.5, 1.0, 3.0]]).expand(3, -1)
    assert_close((eight_bit(values)[0] * 255), torch.tensor([0.0, 0.0, 1.0, 128.0, 255.0, 255.0]))


def test_row_0_of_the_picture_is_the_largest_y() -> None:
    narrow = Receiver((0.0, 0.0), (1.0, 1.0), (3, 2))
    image = receiver_image(torch.arange(6.0).expand(2, 6), narrow)
    assert image[1].tolist() == [[3, 4, 5], [0, 1, 2]]
