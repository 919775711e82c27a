"""Light between any two kinds of pictures: flux of one pixel, the test map, where axes lie, and what a turn does."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

from torchlight.errors import ConfigError, ShapeError
from torchlight.light.environment import EnvironmentMap, power
from torchlight.light.formats import CONVENTIONS, KINDS, from_picture, grid_as_fine, grid_for, to_picture
from torchlight.light.grids import AngularGrid, CubeGrid, LatlongGrid
from torchlight.light.layouts import LAYOUTS
from torchlight.light.procedural import axis_colours, axis_faces
from torchlight.light.projection import expand, project
from torchlight.light.rotations import parse_rotation
from torchlight.light.sampled import (
    SampledLight,
    clipped_share,
    converted,
    sampled,
    sphere_power,
    to_environment,
)
from torchlight.light_plane import LightPlane

SIZES = {**dict.fromkeys(CONVENTIONS, 12), **dict.fromkeys(LAYOUTS, 5), "angular": 14}
DISTINCT = ("torchlight", "openexr", "skylibs", *LAYOUTS, "angular")  # synonyms are tested to be such elsewhere


def through(light: SampledLight, kind: str) -> SampledLight:
    """Returns light written as a kind of picture, and read from it."""
    moved = converted(light, grid_for(kind, SIZES[kind]))
    values, grid = from_picture(to_picture(moved.radiance, moved.grid, kind), kind)
    return replace(light, radiance=values, grid=grid)


def sun(kind: str) -> SampledLight:
    """A single lit pixel of middling height, on a kind's grid."""
    grid = grid_for(kind, SIZES[kind])
    direction = torch.tensor([0.3, -0.8, 0.52], dtype=torch.float64)
    radiance = torch.zeros(3, len(grid.solid_angles()), dtype=torch.float64)
    return SampledLight(radiance.index_fill(1, grid.locate(direction), 1e5), grid)


@pytest.mark.parametrize("second", DISTINCT)
@pytest.mark.parametrize("first", DISTINCT)
def test_a_sun_of_one_pixel_keeps_its_flux_there_and_back(first: str, second: str) -> None:
    light = sun(first)
    there = through(light, second)
    back = through(there, first)
    for light_now in (there, back):
        assert_close(sphere_power(light_now), sphere_power(light), rtol=1e-9, atol=0)
    pixel = int(light.radiance[0].argmax())
    assert back.radiance[0, pixel] == back.radiance[0].max()


@pytest.mark.parametrize("second", LAYOUTS)
@pytest.mark.parametrize("first", LAYOUTS)
def test_the_test_map_is_exact_between_cube_maps(first: str, second: str) -> None:
    light = axis_faces(5)
    assert_close(through(through(light, first), second).radiance, light.radiance, rtol=0, atol=0)


@pytest.mark.parametrize("kind", CONVENTIONS)
def test_the_test_map_is_exact_between_lat_longs(kind: str) -> None:
    light = sampled(axis_colours(12))
    assert_close(through(light, kind).radiance, light.radiance, rtol=0, atol=0)


@pytest.mark.parametrize("kind", DISTINCT)
def test_the_test_map_keeps_the_colours_of_its_axes_and_its_power(kind: str) -> None:
    light = axis_faces(20)
    moved = through(light, kind)
    axes = torch.cat([torch.eye(3), -torch.eye(3)]).double()
    colours = torch.tensor([[1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 1, 1], [1, 0, 1], [1, 1, 0]]).double()
    found = moved.radiance[:, moved.grid.locate(axes)].T
    # a slope of 0.2 |(1, 2, 3)| = 0.75, times the 10.6 degrees from an axis to the middle of a pixel it is a corner of
    expected = colours * (1 + 0.2 * axes @ torch.tensor([1.0, 2.0, 3.0]).double())[:, None]
    assert_close(found, expected, rtol=0, atol=0.15)
    assert_close(sphere_power(moved), sphere_power(light), rtol=1e-9, atol=0)


def axis_of(r: float, g: float, b: float) -> str:
    return {(1, 0, 0): "+X", (0, 1, 0): "+Y", (0, 0, 1): "+Z", (0, 1, 1): "-X", (1, 0, 1): "-Y", (1, 1, 0): "-Z"}[
        (int(r > 0.1), int(g > 0.1), int(b > 0.1))
    ]


@pytest.mark.parametrize(
    ("kind", "places"),
    [
        ("torchlight", {(0.1, 0.5): "+Z", (0.9, 0.5): "-Z", (0.5, 0.26): "+Y", (0.5, 0.51): "+X", (0.5, 0.74): "-Y"}),
        ("openexr", {(0.1, 0.5): "+Z", (0.9, 0.5): "-Z", (0.5, 0.26): "+X", (0.5, 0.51): "-Y", (0.5, 0.74): "-X"}),
        ("skylibs", {(0.1, 0.5): "+Z", (0.9, 0.5): "-Z", (0.5, 0.26): "-X", (0.5, 0.51): "+Y", (0.5, 0.74): "+X"}),
        ("cross", {(1 / 8, 0.5): "+Z", (3 / 8, 1 / 6): "-X", (3 / 8, 0.5): "+Y", (3 / 8, 5 / 6): "+X"}),
        ("cross", {(5 / 8, 0.5): "-Z", (7 / 8, 0.5): "-Y"}),
        ("horizontal-cross", {(1 / 6, 3 / 8): "+Z", (0.5, 1 / 8): "-X", (0.5, 3 / 8): "+Y", (0.5, 5 / 8): "+X"}),
        ("horizontal-cross", {(0.5, 7 / 8): "-Y", (5 / 6, 3 / 8): "-Z"}),
        ("strip", {(0.5, (i + 0.5) / 6): axis for i, axis in enumerate(("+X", "-X", "+Z", "-Z", "-Y", "+Y"))}),
        ("opengl-strip", {(0.5, (i + 0.5) / 6): axis for i, axis in enumerate(("+X", "-X", "+Z", "-Z", "-Y", "+Y"))}),
        ("angular", {(0.5, 0.51): "+Y", (0.5, 0.25): "-X", (0.5, 0.75): "+X", (0.25, 0.5): "+Z", (0.75, 0.5): "-Z"}),
        ("angular", {(0.5, 0.03): "-Y", (0.03, 0.5): "-Y", (0.5, 0.97): "-Y"}),
    ],
)
def test_axes_lie_where_the_docs_draw_them(kind: str, places: dict[tuple[float, float], str]) -> None:
    size = 60 if kind in CONVENTIONS else 21
    light = converted(axis_faces(21), grid_for(kind, size))
    picture = to_picture(light.radiance, light.grid, kind)
    rows, columns = picture.shape[-2:]
    found = {at: axis_of(*picture[:, int(at[0] * rows), int(at[1] * columns)].tolist()) for at in places}
    assert found == places


@pytest.mark.parametrize("kind", ["torchlight", "cross", "angular"])
def test_a_turn_moves_the_axes_and_keeps_the_power(kind: str) -> None:
    """x to y, y to z, z to x: by 120 degrees about (1, 1, 1)."""
    light = axis_faces(10)
    moved = converted(light, grid_for(kind, 20), parse_rotation("1,1,1,120"))
    colours = [axis_of(*moved.radiance[:, moved.grid.locate(axis)].tolist()) for axis in torch.eye(3).double()]
    assert colours == ["+Z", "+X", "+Y"]
    assert_close(sphere_power(moved), sphere_power(light), rtol=1e-9, atol=0)


def test_a_turned_sun_keeps_its_flux_through_every_kind() -> None:
    for kind in ("torchlight", "cross", "angular"):
        light = sun(kind)
        moved = converted(light, light.grid, parse_rotation("x:33,z:-71"))
        assert_close(sphere_power(moved), sphere_power(light), rtol=1e-9, atol=0)
        assert_close(moved.radiance.max().item(), 1e5, rtol=0.9, atol=0)


def test_harmonics_keep_the_power_of_a_sun_through_every_kind_but_not_its_peak() -> None:
    for kind in ("torchlight", "cross", "angular"):
        light = sun(kind)
        coefficients = project(to_environment(light).radiance, 3)
        assert_close(coefficients[:, 0] * math.sqrt(4 * math.pi), sphere_power(light), rtol=1e-9, atol=0)
        back = EnvironmentMap(expand(coefficients, 16), nonnegative=False)
        assert_close(power(back), sphere_power(light), rtol=1e-9, atol=0)
        assert back.radiance.max().item() < 0.1 * light.radiance.max().item()


def test_sizes_keep_the_detail() -> None:
    assert grid_as_fine("cross", LatlongGrid(64)) == CubeGrid(32)
    assert grid_as_fine("angular", LatlongGrid(64)) == AngularGrid(128)
    assert grid_as_fine("usd", CubeGrid(32)) == LatlongGrid(64)
    assert grid_as_fine("torchlight", AngularGrid(99)) == LatlongGrid(100)
    assert grid_as_fine("strip", LatlongGrid(5)) == CubeGrid(3)
    for kind in KINDS:
        assert grid_as_fine(kind, grid_for(kind, 7)) == grid_for(kind, 7)


def test_negative_light_is_kept_and_its_share_is_that_of_the_flux() -> None:
    radiance = torch.ones(3, 6 * 4, dtype=torch.float64)
    radiance[:, 4:8] = -1.0  # one of six faces
    light = SampledLight(radiance, CubeGrid(2), nonnegative=False)
    assert clipped_share(light) == pytest.approx(1 / 6)
    assert_close(sphere_power(light), torch.full((3,), 4 * math.pi * 4 / 6, dtype=torch.float64))
    moved = to_environment(light, 8)
    assert not moved.nonnegative
    assert_close(power(moved), sphere_power(light))
    with pytest.raises(ConfigError, match="declared non-negative"):
        SampledLight(radiance, CubeGrid(2))


def test_a_plane_turns_about_z_only() -> None:
    light = replace(axis_faces(4), plane=LightPlane(2.0))
    assert converted(light, LatlongGrid(8), parse_rotation("30")).plane == LightPlane(2.0)
    assert converted(light, LatlongGrid(8)).plane == LightPlane(2.0)
    assert converted(light, LatlongGrid(8), parse_rotation("x:30")).plane is None


def test_what_cannot_be_is_refused() -> None:
    with pytest.raises(ConfigError, match="NaN or infinite"):
        SampledLight(torch.full((3, 6), math.nan), CubeGrid(1))
    with pytest.raises(ShapeError, match=r"expected floating-point \[3, 6\]"):
        SampledLight(torch.zeros(3, 7), CubeGrid(1))
    with pytest.raises(ShapeError, match="resample them"):
        to_picture(torch.zeros(3, 6), CubeGrid(1), "usd")
    with pytest.raises(ConfigError, match=r"unknown name 'strips'; did you mean strip\?"):
        grid_for("strips", 4)
    with pytest.raises(ShapeError, match="one map"):
        sampled(EnvironmentMap(torch.zeros(2, 3, 2, 4)))


def test_dtype_and_values_of_captions() -> None:
    light = SampledLight(torch.ones(3, 16 * 16), AngularGrid(16))
    picture: Tensor = to_picture(light.radiance, light.grid, "angular")
    assert picture.dtype == torch.float32
    assert picture[0, 0, 0] == 0
    assert picture[0, 8, 8] == 1
