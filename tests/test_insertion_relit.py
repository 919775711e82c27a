"""Photographs under another light and without shadows, against the project's own pictures of the plane."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from test_insertion_rendering import NOTHING, PLANE, SKY, looking, one_pixel_sun
from torch import Tensor
from torch.testing import assert_close

from torchlight.errors import CalibrationError, ConfigError
from torchlight.geometry.primitives import box
from torchlight.geometry.scene import Scene
from torchlight.insertion.placing import stood
from torchlight.insertion.relit import Bounds, bounded, filled, relight_photo, remove_shadow
from torchlight.light.environment import EnvironmentMap
from torchlight.light.procedural import sun_and_window
from torchlight.relighting import relight

FEW = Bounds(rays=1024)
BLOCK = stood(box((0.5, 0.5, 0.6)), (-0.5, 0.0))
SUN = sun_and_window(32)


def seen(light: EnvironmentMap, scene: Scene | None = None) -> Tensor:
    """The rectified photograph of the block under a light, with a checkered albedo."""
    checks = 0.6 + 0.4 * ((torch.arange(30)[:, None] // 5 + torch.arange(40) // 5) % 2)
    return relight(Scene(BLOCK, PLANE) if scene is None else scene, light, 2048).reshape(3, 30, 40).flip(1) * checks


def test_under_the_same_light_it_is_the_same() -> None:
    photo = torch.rand(3, 30, 40, generator=torch.Generator().manual_seed(1))
    made = relight_photo(photo, Scene(BLOCK, PLANE), SUN, SUN, FEW)
    assert_close(made.picture, photo, rtol=1e-6, atol=0)
    assert not made.hole.any()
    assert not made.held.any()


def test_another_light_gives_what_the_plane_shows_under_it() -> None:
    other = EnvironmentMap(SUN.radiance.roll(24, dims=-1))
    made = relight_photo(seen(SUN), Scene(BLOCK, PLANE), SUN, other, Bounds(2048))
    expected = seen(other)
    free = ~on_block()
    level = expected.max()
    error = (made.picture - expected).abs()[:, free] / level
    assert error.mean() < 0.01
    assert error.quantile(0.98) < 0.06  # at the edges of shadows, where two sets of directions differ


def test_without_the_shadow_the_plane_is_even() -> None:
    made = remove_shadow(seen(SUN), Scene(BLOCK, PLANE), SUN, Bounds(2048))
    expected = seen(SUN, Scene(NOTHING, PLANE))
    free = ~made.hole
    assert torch.equal(made.hole & on_block(0.2), on_block(0.2))
    error = ((made.picture - expected).abs() / expected.amax())[:, free]
    assert error.mean() < 0.01
    assert error.quantile(0.98) < 0.06


def on_block(half: float = 0.32) -> Tensor:
    x, y = torch.meshgrid((torch.arange(40) + 0.5) / 10 - 2, 1.5 - (torch.arange(30) + 0.5) / 10, indexing="xy")
    return ((x + 0.5).abs() < half) & (y.abs() < half)


def test_in_the_umbra_the_gain_is_held_and_counted() -> None:
    photo = torch.full((3, 30, 40), 0.5)
    made = remove_shadow(photo, Scene(BLOCK, PLANE), one_pixel_sun(), replace(FEW, gain=3.0))
    assert 0 < int(made.held.sum()) < 600
    assert_close(made.picture[:, made.held].amax(), torch.tensor(1.5))
    assert made.picture.max() <= 1.5 + 1e-6


def test_bounds_hold_what_divides_by_nothing() -> None:
    before = torch.tensor([[[0.0, 0.0, 1.0, 1.0]]]).double().expand(3, 1, 4)
    after = torch.tensor([[[0.0, 1.0, 2.0, 9.0]]]).double().expand(3, 1, 4)
    gain, held = bounded(before, after, torch.tensor(4.0).double())
    assert gain[0, 0].tolist() == [0.0, 4.0, 2.0, 4.0]
    assert held[0].tolist() == [False, True, False, True]


def test_a_hole_is_filled_from_around_it() -> None:
    picture = torch.full((3, 21, 17), 0.4, dtype=torch.float64)
    hole = torch.zeros(21, 17, dtype=torch.bool)
    hole[6:15, 3:12] = True
    spoiled = torch.where(hole, torch.full_like(picture, torch.nan), picture)
    assert_close(filled(spoiled, hole), picture)
    ramp = torch.linspace(0, 1, 17, dtype=torch.float64).expand(3, 21, 17)
    found = filled(torch.where(hole, 9.0, ramp), hole)
    assert_close(found, ramp, rtol=0, atol=0.3)
    assert torch.equal(found[:, ~hole], ramp[:, ~hole])
    assert torch.equal(filled(ramp, torch.ones_like(hole)), ramp)


def test_a_camera_s_photograph_keeps_what_lies_beyond_the_plane() -> None:
    camera = looking()
    axes = torch.tensor([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]], dtype=torch.float64)
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, :3], pose[:3, 3] = axes, -axes @ torch.tensor([0.0, -6.0, 1.0], dtype=torch.float64)
    level = replace(camera, world_to_camera=pose)
    made = relight_photo(torch.full((3, 30, 40), 0.5), Scene(NOTHING, PLANE, level), SKY, SUN, FEW)
    assert 0.3 < made.unknown.double().mean() < 0.7
    assert (made.picture[:, made.unknown] == 0.5).all()


def test_what_cannot_be() -> None:
    with pytest.raises(ConfigError, match="gain: expected a bound of at least 1"):
        Bounds(gain=0.5)
    with pytest.raises(CalibrationError, match="the photograph has 20 x 30 pixels"):
        remove_shadow(torch.zeros(3, 30, 20), Scene(BLOCK, PLANE, looking()), SKY, FEW)
