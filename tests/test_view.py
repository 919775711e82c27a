"""The scene as a picture: which sample lands where, and what is in front."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

from torchlight import view
from torchlight.camera import Camera, project
from torchlight.geometry.primitives import box
from torchlight.geometry.receiver import Receiver, sample_centers
from torchlight.geometry.scene import Scene
from torchlight.geometry.transforms import transform
from torchlight.light.environment import EnvironmentMap
from torchlight.light.procedural import sun_and_window
from torchlight.relighting import relight

RECEIVER = Receiver((0.5, -0.25), (4.0, 3.0), (16, 12), albedo=(0.8, 0.4, 0.2))
SKY = EnvironmentMap(torch.ones(3, 8, 16))
RAYS = 512


@pytest.fixture(autouse=True)
def coarse(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(view, "FINEST_SAMPLES", 64)


def looking_down(height: float = 6.0, size: tuple[int, int] = (48, 36)) -> Camera:
    """A camera straight above the origin whose picture has +x to the right and +y up."""
    pose = torch.diag(torch.tensor([1.0, -1.0, -1.0, 1.0], dtype=torch.float64))
    pose[2, 3] = height
    width, rows = size
    focal = 1.2 * width
    k = torch.tensor([[focal, 0, (width - 1) / 2], [0, focal, (rows - 1) / 2], [0, 0, 1]], dtype=torch.float64)
    return Camera(k, pose, size, torch.zeros(5, dtype=torch.float64))


def scene(camera: Camera | None = None, triangles: Tensor | None = None) -> Scene:
    block = transform(box((1.0, 0.6, 1.2)), 1.0, (0.0, 0.0, 20.0), (0.0, 0.0, 0.0))
    return Scene(block if triangles is None else triangles, RECEIVER, camera)


def plate(z: float, size: float = 1.0) -> Tensor:
    return box((size, size, 0.01)) + torch.tensor([0.0, 0.0, z], dtype=torch.float64)


# --- without a camera ----------------------------------------------------------------------------------------------


def test_the_rectified_view_is_relight_with_row_0_at_the_largest_y() -> None:
    light = sun_and_window(32, dtype=torch.float32)
    seen = view.render(scene(), light, RAYS)
    values = relight(scene(), light, RAYS).reshape(3, 12, 16)
    shown = seen.shows_plane
    assert shown.any()
    assert not shown.all()
    assert_close(seen.values[:, shown], values.flip(1)[:, shown], rtol=0, atol=0)
    assert (seen.values[:, ~shown] == 0).all()
    assert seen.opaque.all()
    middle = sample_centers(RECEIVER).reshape(12, 16, 2).flip(0)[~shown]
    assert torch.linalg.vector_norm(middle, dim=1).max() < 0.9  # the block stands on the origin


def test_a_hovering_plate_hides_nothing_of_the_rectified_receiver() -> None:
    assert view.render(scene(triangles=plate(0.5)), SKY, RAYS).shows_plane.all()


# --- with a camera -------------------------------------------------------------------------------------------------


def test_open_sky_shows_the_albedo_and_nothing_beyond_the_receiver() -> None:
    far = plate(0.5, 0.01) + torch.tensor([40.0, 0.0, 0.0], dtype=torch.float64)
    seen = view.render(scene(looking_down(), far), SKY, RAYS)
    expected = torch.tensor(RECEIVER.albedo)[:, None].expand(3, int(seen.shows_plane.sum()))
    assert_close(seen.values[:, seen.shows_plane], expected, rtol=3e-3, atol=0)
    assert (seen.values[:, ~seen.shows_plane] == 0).all()
    assert torch.equal(seen.opaque, seen.shows_plane)


def test_pixels_of_the_receiver_are_those_its_corners_enclose() -> None:
    camera = looking_down()
    far = plate(0.5, 0.01) + torch.tensor([40.0, 0.0, 0.0], dtype=torch.float64)
    shown = view.render(scene(camera, far), SKY, RAYS).shows_plane
    corners = torch.tensor([[-1.5, 1.25, 0.0], [2.5, -1.75, 0.0]], dtype=torch.float64)
    (left, top), (right, bottom) = project(camera, corners).tolist()
    expected = torch.zeros(36, 48, dtype=torch.bool)
    rows, columns = torch.arange(36)[:, None], torch.arange(48)
    expected = (rows >= top) & (rows <= bottom) & (columns >= left) & (columns <= right)
    assert torch.equal(shown, expected)
    assert 100 < int(shown.sum()) < shown.numel()


def test_values_land_where_the_camera_projects_their_samples() -> None:
    """Each sample's centre is read from the picture at its own pixel; a tilted camera, so no axis is special."""
    angle = math.radians(30)
    tilt = torch.tensor(
        [
            [1, 0, 0, 0],
            [0, math.cos(angle), -math.sin(angle), 0],
            [0, math.sin(angle), math.cos(angle), 0],
            [0, 0, 0, 1],
        ],
        dtype=torch.float64,
    )
    camera = looking_down(6.0, (192, 144))
    pose = tilt @ camera.world_to_camera
    pose[:3, 3] = torch.tensor([0.0, 0.0, 6.0], dtype=torch.float64)
    camera = replace(camera, world_to_camera=pose)
    light = sun_and_window(32, dtype=torch.float32)
    seen = view.render(scene(camera), light, 4096)
    values = relight(scene(), light, 4096)
    centers = sample_centers(RECEIVER)
    pixels = project(camera, torch.cat([centers, torch.zeros_like(centers[:, :1])], dim=1)).round().long()
    inside = (pixels >= 0).all(dim=1) & (pixels[:, 0] < 192) & (pixels[:, 1] < 144)
    column, row = pixels[inside].T
    shown = seen.shows_plane[row, column]
    assert int(shown.sum()) > 100
    difference = (seen.values[:, row, column] - values[:, inside])[:, shown].abs()
    assert difference.median() < 0.01 * values.max()
    assert (difference > 0.1 * values.max()).double().mean() < 0.1  # shadow edges: one point against a footprint


def test_an_occluder_is_black_and_opaque_where_it_is_in_front() -> None:
    camera = looking_down()
    seen = view.render(scene(camera, plate(2.0)), SKY, RAYS)
    hidden = seen.opaque & ~seen.shows_plane
    centre = [17.5, 23.5]
    rows, columns = torch.nonzero(hidden).double().T
    assert rows.mean().item() == pytest.approx(centre[0])
    assert columns.mean().item() == pytest.approx(centre[1])
    span = 1.2 * 48 / (6.0 - 2.01)  # pixels of a 1 x 1 plate 3.99 below the camera
    assert int(hidden.sum()) == pytest.approx(span**2, rel=0.1)
    assert (seen.values[:, hidden] == 0).all()


def test_what_lies_below_the_plane_is_hidden_by_it() -> None:
    seen = view.render(scene(looking_down(), plate(-1.0)), SKY, RAYS)
    assert torch.equal(seen.opaque, seen.shows_plane)


def test_occluders_beyond_the_receiver_are_opaque_too() -> None:
    side = plate(0.0, 0.3) + torch.tensor([-1.9, 0.0, 0.0], dtype=torch.float64)
    seen = view.render(scene(looking_down(), side), SKY, RAYS)
    outside = seen.opaque & ~seen.shows_plane
    assert 2 < int(outside.sum()) < 30
    assert int(torch.nonzero(outside)[:, 1].max()) < 24


def test_pixels_in_parts_are_pixels_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = view.render(scene(looking_down()), SKY, RAYS)
    monkeypatch.setattr(view, "PIXELS_PER_CALL", 100)
    parts = view.render(scene(looking_down()), SKY, RAYS)
    assert torch.equal(whole.values, parts.values)
    assert torch.equal(whole.opaque, parts.opaque)


# --- parts ---------------------------------------------------------------------------------------------------------


def test_samples_are_split_evenly() -> None:
    assert view.refined(RECEIVER).samples == (64, 48)
    assert view.refined(replace(RECEIVER, samples=(100, 50))).samples == (100, 50)
    assert view.refined(replace(RECEIVER, samples=(1, 3))).samples == (21, 63)


def test_interpolation_is_exact_for_a_ramp_and_skips_what_is_not_free() -> None:
    x, y = sample_centers(RECEIVER, dtype=torch.float32).reshape(12, 16, 2).unbind(dim=-1)
    ramp = torch.stack([x, y, x + 2 * y])
    free = torch.ones(12, 16)
    points = torch.tensor([[0.3, -0.1], [-0.7, 0.6], [2.1, -1.3]], dtype=torch.float64)
    expected = torch.stack([points[:, 0], points[:, 1], points[:, 0] + 2 * points[:, 1]]).float()
    grid = torch.cat([ramp, free[None]])[None]
    assert_close(view.interpolate(grid, points, RECEIVER), expected, rtol=0, atol=1e-5)
    free[5, 7] = 0
    constant = torch.cat([5 * free.expand(3, -1, -1), free[None]])[None]
    near = sample_centers(RECEIVER).reshape(12, 16, 2)[5, 7] + 0.05
    assert_close(view.interpolate(constant, near[None], RECEIVER), torch.full((3, 1), 5.0))


def test_rays_that_miss_the_plane_are_infinitely_deep() -> None:
    directions = torch.tensor([[0.0, 0.0, -1.0], [0.0, 0.6, -0.8], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]).double()
    depth = view.plane_depth(looking_down(), directions)
    assert_close(depth, torch.tensor([6.0, 7.5, math.inf, math.inf], dtype=torch.float64))
    points = torch.tensor([[2.5, 1.25], [2.51, 0.0], [math.inf, 0.0], [math.nan, 0.0]], dtype=torch.float64)
    assert view.on_receiver(points, RECEIVER).tolist() == [True, False, False, False]
