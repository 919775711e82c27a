"""Resampling keeps every pixel's flux and every constant; closed forms where grids nest or turn by whole pixels."""

from __future__ import annotations

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor
from torch.testing import assert_close

from torchlight.errors import ConfigError, ShapeError
from torchlight.light import latlong
from torchlight.light.directions import from_angles
from torchlight.light.environment import EnvironmentMap, rotate_about_z
from torchlight.light.grids import AngularGrid, CubeGrid, Grid, LatlongGrid
from torchlight.light.resampling import resample, shared_angles
from torchlight.light.rotations import about_axis, turns

GRIDS: tuple[Grid, ...] = (LatlongGrid(6), LatlongGrid(9), CubeGrid(4), AngularGrid(9))
TURN = turns([("x", 40.0), ("z", 25.0), ("y", -70.0)])


def name(grid: Grid) -> str:
    return f"{type(grid).__name__[0]}{grid.shape[-1]}"


@pytest.mark.parametrize("grid", [*GRIDS, AngularGrid(1), AngularGrid(2), LatlongGrid(1), CubeGrid(1)], ids=name)
def test_a_grid_parts_the_sphere(grid: Grid) -> None:
    """Solid angles sum to 4 pi, and random directions fall into each pixel as often as its solid angle says."""
    areas = grid.solid_angles()
    assert_close(areas.sum().item(), 4 * math.pi, rtol=1e-12, atol=0)
    directions = torch.randn(200_000, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    counts = torch.bincount(grid.locate(directions), minlength=len(areas)).double()
    found = counts / len(directions) * 4 * math.pi
    # five standard deviations of the count of the likeliest pixel
    assert_close(found, areas, rtol=0, atol=5 * 4 * math.pi * math.sqrt(areas.max().item() / (4 * math.pi) / 200_000))


@pytest.mark.parametrize("grid", GRIDS, ids=name)
def test_parts_of_a_pixel_lie_in_it(grid: Grid) -> None:
    pixels = torch.arange(len(grid.solid_angles()))
    directions, angles = grid.parts(pixels, 5)
    assert_close(torch.linalg.vector_norm(directions, dim=-1), torch.ones(len(pixels), 25, dtype=torch.float64))
    owners = grid.owners(pixels)[:, None].expand(-1, 25)
    assert torch.equal(grid.locate(directions)[angles > 0], owners[angles > 0])
    found = torch.zeros_like(grid.solid_angles()).index_add(0, owners.reshape(-1), angles.reshape(-1))
    big = grid.solid_angles() > grid.solid_angles().max() / 4
    assert_close(found[big], grid.solid_angles()[big], rtol=0.15, atol=0)  # of coarse pixels, by the trapezoidal rule


@pytest.mark.parametrize("turn", [None, TURN], ids=["upright", "turned"])
@pytest.mark.parametrize("target", GRIDS, ids=name)
@pytest.mark.parametrize("source", GRIDS, ids=name)
def test_the_flux_of_every_single_pixel_is_kept_and_a_constant_stays(source: Grid, target: Grid, turn: Tensor) -> None:
    areas, lit = source.solid_angles(), target.solid_angles()
    suns = torch.eye(len(areas), dtype=torch.float64)
    white = torch.ones(1, len(areas), dtype=torch.float64)
    moved, (white,) = resample(torch.cat([suns, white]), source, target, turn).split([len(areas), 1])
    assert bool((moved >= 0).all())
    assert_close(moved @ lit, areas, rtol=1e-9, atol=1e-15)
    assert_close(white[lit > 0], torch.ones_like(white)[lit > 0], rtol=0, atol=1e-3)


@pytest.mark.parametrize("turn", [None, TURN], ids=["upright", "turned"])
@pytest.mark.parametrize("target", GRIDS[1::2], ids=name)
@pytest.mark.parametrize("source", GRIDS[::2], ids=name)
def test_a_single_pixel_arrives_where_it_points(source: Grid, target: Grid, turn: Tensor) -> None:
    areas, lit = source.solid_angles(), target.solid_angles()
    pixels = torch.nonzero(areas > areas.max() / 2).squeeze(-1)[::7]
    directions, shares = source.parts(pixels, 9)
    middle = torch.nn.functional.normalize((directions * shares[..., None]).sum(dim=1), dim=-1)
    suns = torch.nn.functional.one_hot(pixels, len(areas)).double()
    flux = resample(suns, source, target, turn) * lit
    points, weights = target.parts(torch.arange(len(lit)), 9)
    centres = torch.nn.functional.normalize((points * weights[..., None]).sum(dim=1), dim=-1)
    found = torch.nn.functional.normalize(flux @ centres, dim=-1)
    expected = middle if turn is None else middle @ turn.T
    width = math.sqrt(lit.max().item())
    assert (found - expected).norm(dim=-1).max().item() < 0.35 * width


def test_overlaps_agree_with_random_directions() -> None:
    source, target = AngularGrid(9), LatlongGrid(6)
    shared = shared_angles(source, target, TURN)
    directions = torch.randn(400_000, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    key = source.locate(directions) * len(target.solid_angles()) + target.locate(directions @ TURN.T)
    counts = torch.bincount(key, minlength=len(source.solid_angles()) * len(target.solid_angles())).double()
    angles = torch.zeros_like(counts).index_add(
        0, shared.sources * len(target.solid_angles()) + shared.targets, shared.angles
    )
    # five standard deviations of the count of the largest pair
    noise = 4 * math.pi * math.sqrt(angles.max().item() / (4 * math.pi) / 400_000)
    assert_close(angles, counts / 400_000 * 4 * math.pi, rtol=0, atol=5 * noise)


@pytest.mark.parametrize("grid", GRIDS, ids=name)
def test_the_same_grid_is_left_alone(grid: Grid) -> None:
    values = torch.rand(2, len(grid.solid_angles()), generator=torch.Generator().manual_seed(0))
    assert torch.equal(resample(values, grid, grid), values)


def test_quarter_turns_of_a_cube_map_only_move_texels() -> None:
    grid = CubeGrid(4)
    values = torch.rand(96, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    turned = values
    for axis in ("x", "y", "z"):
        turned = resample(turned, grid, grid, turns([(axis, 90.0)]))
        assert_close(turned.sort().values, values.sort().values, rtol=0, atol=1e-12)
    back = resample(turned, grid, grid, turns([("x", 90.0), ("y", 90.0), ("z", 90.0)]).T)
    assert_close(back, values, rtol=0, atol=1e-12)


@pytest.mark.parametrize("degrees", [45.0, -30.0, 11.0, 360.0, 3.3])
def test_a_turn_about_z_is_that_of_environments(degrees: float) -> None:
    light = EnvironmentMap(torch.rand(3, 12, 24, dtype=torch.float64, generator=torch.Generator().manual_seed(0)))
    turned = resample(light.radiance.flatten(1), LatlongGrid(12), LatlongGrid(12), about_axis((0.0, 0.0, 1.0), degrees))
    assert_close(turned.reshape(3, 12, 24), rotate_about_z(light, degrees).radiance, rtol=0, atol=1e-12)


def test_halving_a_lat_long_weighs_its_rows_by_solid_angle() -> None:
    image = torch.rand(8, 16, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    weights = latlong.row_solid_angles(8)[:, None]
    expected = (image * weights).reshape(4, 2, 8, 2).sum((1, 3)) / weights.expand(8, 16).reshape(4, 2, 8, 2).sum((1, 3))
    assert_close(resample(image.flatten(), LatlongGrid(8), LatlongGrid(4)).reshape(4, 8), expected, rtol=0, atol=1e-12)
    doubled = resample(image.flatten(), LatlongGrid(8), LatlongGrid(16)).reshape(16, 32)
    assert_close(doubled, image.repeat_interleave(2, 0).repeat_interleave(2, 1), rtol=0, atol=1e-12)


def test_nested_faces_are_repeated_and_averaged() -> None:
    faces = torch.rand(6, 2, 2, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    fine = resample(faces.flatten(), CubeGrid(2), CubeGrid(6))
    assert_close(fine.reshape(6, 6, 6), faces.repeat_interleave(3, 1).repeat_interleave(3, 2), rtol=0, atol=1e-9)
    assert_close(resample(fine, CubeGrid(6), CubeGrid(2)), faces.flatten(), rtol=0, atol=1e-9)


@settings(max_examples=30, deadline=None)
@given(
    height=st.integers(1, 9),
    other=st.integers(1, 9),
    theta=st.floats(0, math.pi),
    phi=st.floats(-math.pi, math.pi),
    degrees=st.floats(-360, 360),
    kinds=st.tuples(st.sampled_from((LatlongGrid, CubeGrid, AngularGrid)), st.sampled_from((LatlongGrid, CubeGrid))),
)
def test_any_sun_keeps_its_flux_through_any_turn(height, other, theta, phi, degrees, kinds) -> None:
    source, target = kinds[0](height), kinds[1](other)
    direction = from_angles(torch.tensor(theta, dtype=torch.float64), torch.tensor(phi, dtype=torch.float64))
    pixel = source.locate(direction)
    sun = torch.zeros(len(source.solid_angles()), dtype=torch.float64).index_fill(0, pixel, 1e4)
    turn = about_axis(direction.roll(1).tolist(), degrees)
    moved = resample(sun, source, target, turn)
    assert_close(moved @ target.solid_angles(), sun @ source.solid_angles(), rtol=1e-6, atol=1e-9)


def test_dtype_batch_and_gradient_pass_through() -> None:
    values = torch.rand(2, 3, 54, generator=torch.Generator().manual_seed(0), requires_grad=True)
    moved = resample(values, CubeGrid(3), LatlongGrid(4))
    assert (moved.shape, moved.dtype) == ((2, 3, 32), torch.float32)
    (gradient,) = torch.autograd.grad((moved * LatlongGrid(4).solid_angles()).sum(), values)
    assert_close(gradient[0, 0].double(), CubeGrid(3).solid_angles(), rtol=1e-5, atol=0)


def test_progress_ends_at_its_total() -> None:
    seen: list[tuple[int, int]] = []
    resample(torch.ones(64), AngularGrid(8), CubeGrid(2), None, lambda done, total: seen.append((done, total)))
    assert seen[-1] == (88, 88)


def test_values_of_another_grid_are_refused() -> None:
    with pytest.raises(ShapeError, match="expected 24 pixels"):
        resample(torch.ones(25), CubeGrid(2), LatlongGrid(4))
    with pytest.raises(ShapeError, match="1 pixel or more"):
        CubeGrid(0)


def test_more_pixels_than_can_be_counted_are_refused_before_they_are() -> None:
    with pytest.raises(ConfigError, match="choose a smaller size"):
        shared_angles(AngularGrid(5000), CubeGrid(2000))
