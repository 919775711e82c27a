"""Which samples a photograph shows: a block from above and from the side, the frame, and what merely hovers."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

from torchlight.camera import Camera, project
from torchlight.geometry import primitives
from torchlight.geometry.footprints import (
    MAX_SUBPOINTS,
    erode,
    footprint_points,
    spiral_directions,
    subpoints_for,
    visible_samples,
    winding_above,
)
from torchlight.geometry.receiver import Receiver, sample_centers
from torchlight.geometry.scene import Scene
from torchlight.geometry.transforms import rotation_matrix, transform

RECEIVER = Receiver((0.0, 0.0), (8.0, 6.0), (16, 12))  # footprints of 0.5 x 0.5
NO_OCCLUDER = torch.zeros(0, 3, 3, dtype=torch.float64)


def camera_at(position: tuple[float, float, float], turn: tuple[float, float, float], focal: float = 100.0) -> Camera:
    """A camera of 401 x 301 pixels; turn (180, 0, 0) looks straight down with +y at the image's top."""
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, :3] = rotation_matrix(turn)
    pose[:3, 3] = -pose[:3, :3] @ torch.tensor(position, dtype=torch.float64)
    intrinsics = torch.tensor([[focal, 0, 200], [0, focal, 150], [0, 0, 1]], dtype=torch.float64)
    return Camera(intrinsics, pose, (401, 301), torch.zeros(5, dtype=torch.float64))


def grown(cells: Tensor) -> Tensor:
    """Every cell and its eight neighbours, by plain loops."""
    rows, columns = cells.shape
    result = torch.zeros_like(cells)
    for row, column in cells.nonzero().tolist():
        result[max(row - 1, 0) : min(row + 2, rows), max(column - 1, 0) : min(column + 2, columns)] = True
    return result


def touched(low: tuple[float, float], high: tuple[float, float]) -> Tensor:
    """Samples of RECEIVER whose footprints overlap the open rectangle, [rows, columns]."""
    x, y = sample_centers(RECEIVER).reshape(12, 16, 2).unbind(dim=-1)
    return (x + 0.25 > low[0]) & (x - 0.25 < high[0]) & (y + 0.25 > low[1]) & (y - 0.25 < high[1])


def lost(scene: Scene) -> Tensor:
    return ~visible_samples(scene).reshape(12, 16)


def block(size: tuple[float, float, float], x: float, y: float, z: float = 0.0) -> Tensor:
    return transform(primitives.box(size), 1.0, (0.0, 0.0, 0.0), (x, y, z))


def test_without_a_camera_the_block_s_footprint_and_one_ring_are_lost() -> None:
    found = lost(Scene(block((1.2, 0.8, 2.0), 0.6, -0.4), RECEIVER))
    expected = grown(touched((0.0, -0.8), (1.2, 0.0)))
    assert torch.equal(found, expected)
    assert found.sum() == 5 * 4


@pytest.mark.parametrize("turn", [(90.0, 0.0, 0.0), (180.0, 0.0, 0.0), (0.0, 90.0, 0.0), (270.0, 0.0, 90.0)])
def test_a_block_turned_onto_its_side_stands_up_to_rounding(turn: tuple[float, float, float]) -> None:
    """Its bottom face ends up at z = 1e-17 or so, not at 0: it stands all the same."""
    solid = transform(primitives.box((1.0, 1.0, 1.0)), 1.0, (0.0, 0.0, 0.0), (0.0, 0.0, -0.5))
    placed = transform(solid, 1.0, turn, (0.5, 0.5, 0.5 + 1e-12))
    assert placed[:, :, 2].min() > 0
    assert torch.equal(lost(Scene(placed, RECEIVER)), grown(touched((0.0, 0.0), (1.0, 1.0))))


def test_from_straight_above_the_block_s_top_hides_its_central_projection() -> None:
    """The top of a block of height 2 seen from height 10 covers the base enlarged by 10 / 8."""
    camera = camera_at((0.0, 0.0, 10.0), (180.0, 0.0, 0.0), focal=300.0)
    found = lost(Scene(block((1.2, 1.2, 2.0), 0.0, 0.0), RECEIVER, camera))
    hidden = touched((-0.75, -0.75), (0.75, 0.75))
    # 401 x 301 pixels at 30 per unit show x up to 6.67 and y up to 5: the whole receiver
    assert torch.equal(found, grown(hidden))
    assert found.sum() == 6 * 6


def test_from_the_side_the_block_hides_what_lies_behind_it() -> None:
    """Eye at (-10, 0, 10), block top at height 2: its far edge x = 0.6 lands at x = 0.6 + 2 (0.6 + 10) / 8 = 3.25."""
    camera = camera_at((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    pose = torch.eye(4, dtype=torch.float64)
    right, down, forward = [0.0, -1, 0], [-(0.5**0.5), 0, -(0.5**0.5)], [0.5**0.5, 0, -(0.5**0.5)]
    pose[:3, :3] = torch.tensor([right, down, forward], dtype=torch.float64)
    pose[:3, 3] = -pose[:3, :3] @ torch.tensor([-10.0, 0, 10], dtype=torch.float64)
    camera = Camera(camera.intrinsics, pose, (401, 301), camera.distortion)
    hidden = ~visible_samples(Scene(block((1.2, 1.2, 2.0), 0.0, 0.0), RECEIVER, camera)).reshape(12, 16)
    points = footprint_points(RECEIVER, 4)[..., :2]
    inside = within_convex(points, central_shadow()).any(dim=1).reshape(12, 16)
    assert torch.equal(hidden, grown(inside))
    assert 0 < inside.sum() < 192


def central_shadow() -> Tensor:
    """The hull of the base and of the top's projection, the base enlarged by 10 / 8 about the eye's foot."""
    base = torch.tensor([[x, y] for x in (-0.6, 0.6) for y in (-0.6, 0.6)], dtype=torch.float64)
    eye = torch.tensor([-10.0, 0.0], dtype=torch.float64)
    corners = torch.cat([base, eye + (base - eye) * 10 / 8])
    assert_close(corners[:, 0].max().item(), 3.25)
    angle = torch.atan2(corners[:, 1], corners[:, 0] - 1.0)
    ordered = corners[angle.argsort()]
    kept = [k for k in range(len(ordered)) if turns_left(ordered[k - 1], ordered[k], ordered[(k + 1) % len(ordered)])]
    return ordered[kept]


def turns_left(a: Tensor, b: Tensor, c: Tensor) -> bool:
    return ((b[0] - a[0]) * (c[1] - b[1]) - (b[1] - a[1]) * (c[0] - b[0])).item() > 1e-12


def within_convex(points: Tensor, corners: Tensor) -> Tensor:
    edge = corners.roll(-1, 0) - corners
    offset = points[..., None, :] - corners
    return (edge[:, 0] * offset[..., 1] - edge[:, 1] * offset[..., 0] > 0).all(dim=-1)


def test_the_frame_is_eroded_by_one_sample() -> None:
    """At 100 pixels per 10 units of height the image shows |x| <= 200 / 60 and |y| <= 150 / 60 of the plane."""
    found = lost(Scene(NO_OCCLUDER, RECEIVER, camera_at((0.0, 0.0, 10.0), (180.0, 0.0, 0.0), focal=600.0)))
    points = footprint_points(RECEIVER, 4)
    outside = ((points[..., 0].abs() > 200 / 60) | (points[..., 1].abs() > 150 / 60)).any(dim=1).reshape(12, 16)
    assert torch.equal(found, grown(outside))
    assert found.sum() == 192 - 10 * 8


@pytest.mark.parametrize("height", [0.002, 0.3, 1.5])
def test_a_hovering_plate_stands_on_nothing(height: float) -> None:
    """The lowest one leaves points beneath it that no light reaches: they are in the photograph all the same."""
    scene = Scene(block((6.0, 5.0, 0.1), 0.3, 0.2, height), RECEIVER)
    assert visible_samples(scene).all()


def test_a_lid_on_posts_loses_only_what_the_posts_stand_on() -> None:
    lid = block((6.0, 4.0, 0.2), 0.0, 0.0, 0.5)
    posts = torch.cat([block((0.4, 0.4, 0.5), x, y) for x in (-2.75, 2.75) for y in (-1.75, 1.75)])
    found = lost(Scene(torch.cat([lid, posts]), RECEIVER))
    feet = torch.zeros(12, 16, dtype=torch.bool)
    for x in (-2.75, 2.75):
        for y in (-1.75, 1.75):
            feet |= touched((x - 0.2, y - 0.2), (x + 0.2, y + 0.2))
    assert torch.equal(found, grown(feet))


def test_a_ceiling_above_the_camera_hides_nothing() -> None:
    ceiling = block((60.0, 60.0, 1.0), 0.0, 0.0, 12.0)
    camera = camera_at((0.0, 0.0, 10.0), (180.0, 0.0, 0.0), focal=300.0)
    assert visible_samples(Scene(ceiling, RECEIVER, camera)).all()


@pytest.mark.parametrize("turn", [(0.0, 0.0, 0.0), (180.0, 0.0, 0.0)])
def test_a_camera_below_the_plane_sees_nothing(turn: tuple[float, float, float]) -> None:
    assert not visible_samples(Scene(NO_OCCLUDER, RECEIVER, camera_at((0.0, 0.0, -10.0), turn))).any()


def test_a_camera_that_looks_away_sees_nothing() -> None:
    assert not visible_samples(Scene(NO_OCCLUDER, RECEIVER, camera_at((0.0, 0.0, 10.0), (0.0, 0.0, 0.0)))).any()


def test_a_distortion_that_folds_back_into_the_frame_shows_nothing_there() -> None:
    """r (1 - 0.3 r^2) grows only up to r = 1.05; beyond, points land in the frame a second time."""
    plain = camera_at((0.0, 0.0, 1.5), (180.0, 0.0, 0.0), focal=190.0)
    folded = Camera(
        plain.intrinsics, plain.world_to_camera, plain.image_size, torch.tensor([-0.3, 0, 0, 0, 0]).double()
    )
    points = footprint_points(RECEIVER, 4)
    radius = torch.linalg.vector_norm(points[..., :2], dim=-1) / 1.5
    pixels = project(folded, points)
    in_frame = ((pixels >= 0) & (pixels <= torch.tensor([400, 300]))).all(dim=-1)
    assert (in_frame & (radius > 1.2)).any()
    seen = visible_samples(Scene(NO_OCCLUDER, RECEIVER, folded))
    assert seen.any()
    assert radius[seen].max() < 1.06


def test_a_pose_so_near_that_a_footprint_spans_many_pixels_gets_as_many_points() -> None:
    """At 300 pixels from height 10 a footprint of 0.5 is 15 pixels wide; from height 100, 1.5 pixels."""
    near, far = (camera_at((0.0, 0.0, z), (180.0, 0.0, 0.0), focal=300.0) for z in (10.0, 100.0))
    assert subpoints_for(near, RECEIVER) == 15
    assert subpoints_for(far, RECEIVER) == 2
    close = camera_at((0.0, 0.0, 1.0), (180.0, 0.0, 0.0), focal=3000.0)
    assert subpoints_for(close, RECEIVER) == MAX_SUBPOINTS


def test_footprint_points_are_the_centres_of_equal_cells() -> None:
    receiver = Receiver((1.0, 2.0), (4.0, 1.0), (2, 1))
    expected = torch.tensor([[[-0.5, 1.75, 0], [0.5, 1.75, 0], [-0.5, 2.25, 0], [0.5, 2.25, 0]]], dtype=torch.float64)
    found = footprint_points(receiver, 2)
    assert_close(found[:1], expected)
    assert_close(found[1:], expected + torch.tensor([2.0, 0, 0], dtype=torch.float64))


def test_winding_counts_faces_by_the_side_they_show() -> None:
    xy = torch.tensor([[0.1, 0.2], [5.0, 0.0]], dtype=torch.float64)
    standing, hovering = block((1.0, 1.0, 1.0), 0.0, 0.0), block((1.0, 1.0, 1.0), 0.0, 0.0, 2.0)
    sunk = block((1.0, 1.0, 1.0), 0.0, 0.0, -0.5)
    for solid, expected in ((standing, 1.0), (hovering, 0.0), (sunk, 1.0), (standing.flip(1), -1.0)):
        assert winding_above(solid, xy, 1e-6).tolist() == [expected, 0.0]
    assert winding_above(torch.cat([standing, hovering, sunk]), xy, 1e-6).tolist() == [2.0, 0.0]
    assert winding_above(NO_OCCLUDER, xy, 1e-6).tolist() == [0.0, 0.0]


def test_erosion_takes_one_ring_and_none_at_the_receiver_s_edge() -> None:
    mask = torch.ones(12, 16, dtype=torch.bool)
    mask[0, 0], mask[6, 7] = False, False
    assert torch.equal(erode(mask.reshape(-1), RECEIVER).reshape(12, 16), ~grown(~mask))
    assert erode(torch.ones(192, dtype=torch.bool), RECEIVER).all()


def test_spiral_directions_cover_the_upper_hemisphere_evenly() -> None:
    directions = torch.from_numpy(spiral_directions(64))
    assert_close(torch.linalg.vector_norm(directions, dim=-1), torch.ones(64, dtype=torch.float64))
    assert (directions[:, 2] > 0).all()
    assert_close(directions.mean(dim=0), torch.tensor([0.0, 0.0, 0.5], dtype=torch.float64), rtol=0, atol=0.02)
    nearest = (directions @ directions.T).fill_diagonal_(-1).amax(dim=1).clamp(max=1).arccos()
    assert nearest.min() > 0.5 * math.sqrt(2 * math.pi / 64)
