"""Who hides what: Embree and its torch twin against each other, a plate's shifted rectangle and a slab test."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from torchlight.errors import ConfigError, TorchlightWarning
from torchlight.geometry import embree as embree_module
from torchlight.geometry import primitives, visibility
from torchlight.geometry.receiver import Receiver
from torchlight.geometry.scene import Scene
from torchlight.geometry.transforms import transform
from torchlight.geometry.visibility import (
    OcclusionTest,
    RayTest,
    embree,
    hits_any,
    occlusion_test,
    raycast,
    scene_occlusion,
    unit_frame,
)

BACKENDS = {"embree": embree, "raycast": raycast}
NO_OFFSET = (0.0, 0.0)


def soup(seed: int, faces: int) -> Tensor:
    """Triangles of very different sizes and attitudes above the plane."""
    generator = torch.Generator().manual_seed(seed)
    middle = torch.rand(faces, 1, 3, generator=generator, dtype=torch.float64) * torch.tensor([2.0, 2.0, 1.0])
    size = 10 ** (-2 * torch.rand(faces, 1, 1, generator=generator, dtype=torch.float64))
    corners = middle + size * (torch.rand(faces, 3, 3, generator=generator, dtype=torch.float64) - 0.5)
    return corners + torch.tensor([0.0, 0.0, 0.6])


def upward(generator: torch.Generator, count: int, lowest: float = 0.05) -> Tensor:
    """Unit directions, uniform in solid angle above a least z."""
    z = lowest + (1 - lowest) * torch.rand(count, generator=generator, dtype=torch.float64)
    phi = 2 * torch.pi * torch.rand(count, generator=generator, dtype=torch.float64)
    radius = torch.sqrt(1 - z * z)
    return torch.stack([radius * phi.cos(), radius * phi.sin(), z], dim=-1)


def about_centroids(triangles: Tensor, factor: float) -> Tensor:
    middle = triangles.mean(dim=1, keepdim=True)
    return middle + (triangles - middle) * factor


def rays_from_plane(seed: int, count: int) -> tuple[Tensor, Tensor]:
    generator = torch.Generator().manual_seed(seed)
    origins = torch.rand(count, 3, generator=generator, dtype=torch.float64) * torch.tensor([3.0, 3.0, 0.0]) - 0.5
    origins[:, 2] = 0.0
    return origins, upward(generator, count)


@settings(max_examples=6, deadline=None, derandomize=True)
@given(seed=st.integers(0, 10**6), faces=st.integers(1, 40))
def test_embree_equals_its_twin_away_from_edges(seed: int, faces: int) -> None:
    triangles = soup(seed, faces)
    origins, directions = rays_from_plane(seed, 800)
    frame = unit_frame(torch.cat([triangles.reshape(-1, 3), origins]))
    starts, towards = frame.to_unit(origins.numpy()).astype(np.float32), directions.numpy().astype(np.float32)
    fast, slow = (make(triangles, frame)(starts, towards, np.inf) for make in BACKENDS.values())
    # a ray is near an edge where triangles a thousandth larger or smaller give another answer
    grown, shrunk = (hits_any(about_centroids(triangles, f), origins, directions) for f in (1.001, 0.999))
    clear = (grown == shrunk).numpy()
    assert clear.mean() > 0.9
    np.testing.assert_array_equal(fast[clear], slow[clear])
    np.testing.assert_array_equal(slow[clear], grown.numpy()[clear])


def test_the_twin_meets_a_triangle_by_hand() -> None:
    triangle = torch.tensor([[[0.0, 0, 2], [1, 0, 2], [0, 1, 2]]], dtype=torch.float64)
    origins = torch.tensor([[0.2, 0.2, 0], [0.6, 0.6, 0], [0.2, 0.2, 3], [-1.8, 0.2, 0]], dtype=torch.float64)
    directions = torch.tensor([[0.0, 0, 1], [0, 0, 1], [0, 0, 1], [1, 0, 1]], dtype=torch.float64)
    assert hits_any(triangle, origins, directions).tolist() == [True, False, False, True]
    edge_on = torch.tensor([[1.0, 0, 0]], dtype=torch.float64)
    assert hits_any(triangle, torch.tensor([[-1.0, 0.2, 2.0]], dtype=torch.float64), edge_on).tolist() == [False]


@pytest.mark.parametrize("make", BACKENDS.values(), ids=BACKENDS)
def test_rays_end_at_their_reach(make: Callable[[Tensor, visibility.UnitFrame], RayTest]) -> None:
    triangle = torch.tensor([[[-1.0, -1, 0.5], [1, -1, 0.5], [0, 1, 0.5]]], dtype=torch.float64)
    hits = make(triangle, visibility.UnitFrame((0.0, 0.0, 0.0), 1.0))
    origin, up = np.zeros((1, 3), dtype=np.float32), np.array([[0, 0, 1]], dtype=np.float32)
    assert [bool(hits(origin, up, reach)[0]) for reach in (0.49, 0.51, np.inf)] == [False, True, True]


def plate(width: float, depth: float, height: float, center: tuple[float, float]) -> Tensor:
    x, y = center
    corners = torch.tensor(
        [[x - width / 2, y - depth / 2, height], [x + width / 2, y - depth / 2, height],
         [x + width / 2, y + depth / 2, height], [x - width / 2, y + depth / 2, height]], dtype=torch.float64
    )  # fmt: skip
    return corners[torch.tensor([[0, 1, 2], [0, 2, 3]])]


def plane_grid(receiver_size: float, count: int) -> np.ndarray:
    axis = (np.arange(count) + 0.437) / count * receiver_size - receiver_size / 2
    x, y = np.meshgrid(axis, axis)
    return np.stack([x.ravel(), y.ravel(), np.zeros(count**2)], axis=1)


@pytest.mark.parametrize("name", BACKENDS)
def test_a_plate_at_height_h_shifts_its_rectangle(name: str) -> None:
    """Point q is hidden from direction d exactly where q + h (dx, dy) / dz lies in the plate's rectangle."""
    height, center, half = 0.7, (0.1, -0.2), np.array([0.4, 0.25])
    triangles = plate(0.8, 0.5, height, center)
    frame = unit_frame(torch.cat([triangles.reshape(-1, 3), torch.tensor([[-2.0, -2, 0], [2, 2, 0]])]))
    test = OcclusionTest(frame, BACKENDS[name](triangles, frame))
    points = plane_grid(4.0, 60)
    directions = upward(torch.Generator().manual_seed(3), 25, lowest=0.25).numpy()
    found = test.hidden_on_plane(points, directions, np.zeros((25, 2)))
    landed = points[None, :, :2] + height * (directions[:, None, :2] / directions[:, None, 2:]) - np.array(center)
    margin = (half - np.abs(landed)).min(axis=-1)
    clear = np.abs(margin) > 1e-5 * 4.0  # of the scene's size: float32, and origins lifted by 2e-6
    assert clear.mean() > 0.99
    assert (margin > 0).mean() > 0.02
    np.testing.assert_array_equal(found[clear], (margin > 0)[clear])


def slab_hidden(
    size: np.ndarray, turn: float, move: np.ndarray, points: np.ndarray, direction: np.ndarray
) -> np.ndarray:
    """Whether a block that stands on the plane hides the direction from each point, by Kay and Kajiya's slabs."""
    cos, sin = np.cos(turn), np.sin(turn)
    into = np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]])
    origin = (points - np.append(move, size[2] / 2)) @ into.T
    towards = into @ direction
    near = (-size / 2 * np.sign(towards) - origin) / towards
    far = (size / 2 * np.sign(towards) - origin) / towards
    return np.minimum.reduce(far, axis=1) > np.maximum(np.maximum.reduce(near, axis=1), 0)


@pytest.mark.parametrize("name", BACKENDS)
def test_a_block_has_the_shadow_of_the_slab_test(name: str) -> None:
    """No mismatch farther than 1e-5 of the scene's size from the shadow's edge."""
    size, turn, move = np.array([1.0, 0.6, 1.2]), np.radians(20.0), np.array([0.3, -0.4])
    triangles = transform(primitives.box((1.0, 0.6, 1.2)), 1.0, (0.0, 0.0, 20.0), (0.3, -0.4, 0.0))
    frame = unit_frame(torch.cat([triangles.reshape(-1, 3), torch.tensor([[-2.0, -2, 0], [2, 2, 0]])]))
    test = OcclusionTest(frame, BACKENDS[name](triangles, frame))
    points = plane_grid(4.0, 70)
    # a lift of 2e-6 moves the shadow by 2e-6 tan(theta): below z = 0.25 that alone would be near 1e-5
    directions = upward(torch.Generator().manual_seed(5), 20, lowest=0.25).numpy()
    found = test.hidden_on_plane(points, directions, np.zeros((20, 2)))
    around = 4.0e-5 * np.array([[np.cos(a), np.sin(a), 0] for a in np.arange(8) * np.pi / 4])
    for hidden, direction in zip(found, directions, strict=True):
        expected = slab_hidden(size, turn, move, points, direction)
        nearby = [slab_hidden(size, turn, move, points + shift, direction) for shift in around]
        clear = np.all(nearby == expected, axis=0)
        assert clear.mean() > 0.99
        assert expected.any()
        np.testing.assert_array_equal(hidden[clear], expected[clear])


def test_points_that_touch_a_standing_block_are_lifted_off_the_surface() -> None:
    """Every point under a block is dark from everywhere, also those exactly on the edges of its triangles."""
    test = occlusion_test(primitives.box((2.0, 2.0, 1.0)), torch.tensor([[-3.0, -3, 0], [3, 3, 0]]))
    axis = np.linspace(-0.95, 0.95, 39)
    points = np.stack([*(a.ravel() for a in np.meshgrid(axis, axis)), np.zeros(39**2)], axis=1)
    directions = upward(torch.Generator().manual_seed(11), 40, lowest=0.0).numpy()
    assert test.hidden_on_plane(points, directions, np.zeros((40, 2))).all()


@pytest.mark.parametrize("name", BACKENDS)
def test_a_sheet_that_lies_on_the_plane_hides_nothing(name: str) -> None:
    """Rays that started on it would meet it about half of the time."""
    triangles = torch.cat([plate(3.0, 2.0, 0.0, NO_OFFSET), plate(0.1, 0.1, 1.3, (3.0, 0.0))])
    frame = unit_frame(triangles.reshape(-1, 3))
    test = OcclusionTest(frame, BACKENDS[name](triangles, frame))
    directions = upward(torch.Generator().manual_seed(12), 5, lowest=0.7).numpy()
    assert not test.hidden_on_plane(plane_grid(1.9, 31), directions, np.zeros((5, 2))).any()


def test_no_point_of_an_empty_plane_is_hidden() -> None:
    scene = Scene(torch.zeros(0, 3, 3, dtype=torch.float64), Receiver((0.0, 0.0), (2.0, 1.0), (4, 2)))
    hidden = scene_occlusion(scene).hidden_on_plane(plane_grid(1.0, 3), np.array([[0.0, 0, 1]]), np.zeros((1, 2)))
    assert hidden.shape == (1, 9)
    assert not hidden.any()


def test_offsets_move_the_origins_of_each_direction() -> None:
    test = occlusion_test(plate(0.8, 0.5, 0.7, NO_OFFSET), torch.tensor([[-2.0, -2, 0], [2, 2, 0]]))
    points, up = plane_grid(2.0, 25), np.array([[0.0, 0, 1]] * 2)
    found = test.hidden_on_plane(points, up, np.array([[0.3, 0.0], [0.0, -0.2]]))
    inside = [
        (np.abs(points[:, 0] + 0.3) < 0.4) & (np.abs(points[:, 1]) < 0.25),
        (np.abs(points[:, 0]) < 0.4) & (np.abs(points[:, 1] - 0.2) < 0.25),
    ]
    np.testing.assert_array_equal(found, inside)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e4])
def test_a_ceiling_above_the_viewpoint_hides_nothing(scale: float) -> None:
    triangles = torch.cat([plate(10.0, 10.0, 5.0, NO_OFFSET), plate(1.0, 1.0, 1.0, (1.0, 0.0))]) * scale
    test = occlusion_test(triangles, torch.tensor([[-2.0, -2, 0], [2, 2, 0]]) * scale)
    points = np.array([[0.0, 0, 0], [1, 0, 0]]) * scale
    assert test.hidden_from(np.array([0.0, 0, 4]) * scale, points).tolist() == [False, True]
    assert test.hidden_from(np.array([0.0, 0, 6]) * scale, points).tolist() == [True, True]


@pytest.mark.parametrize("scale", [1e-4, 1.0, 1e5])
def test_the_unit_frame_holds_any_scene(scale: float) -> None:
    points = torch.tensor([[1.0, 2, 0], [5, 4, 1], [2, 3, -0.5]], dtype=torch.float64) * scale
    unit = unit_frame(points).to_unit(points.numpy())
    np.testing.assert_allclose(unit.max(axis=0) + unit.min(axis=0), 0, atol=1e-12)
    np.testing.assert_allclose(np.ptp(unit, axis=0), [1.0, 0.5, 0.375], rtol=1e-12)


def test_a_single_point_has_a_frame() -> None:
    assert unit_frame(torch.ones(1, 3, dtype=torch.float64)) == visibility.UnitFrame((1.0, 1.0, 1.0), 1.0)


def test_without_embree_the_twin_is_used_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    triangles, bounds = primitives.box((1.0, 0.6, 1.2)), torch.tensor([[-2.0, -2, 0], [2, 2, 0]])
    points, directions = plane_grid(4.0, 23), upward(torch.Generator().manual_seed(2), 10).numpy()
    expected = occlusion_test(triangles, bounds).hidden_on_plane(points, directions, np.zeros((10, 2)))
    assert embree_module.backend() == "embree"
    monkeypatch.setattr(embree_module, "rtcore_scene", None)
    assert embree_module.backend() == "raycast"
    with pytest.warns(TorchlightWarning, match="Embree is not installed .* the slow torch ray caster is used"):
        test = occlusion_test(triangles, bounds)
    np.testing.assert_array_equal(test.hidden_on_plane(points, directions, np.zeros((10, 2))), expected)
    with pytest.raises(ConfigError, match="use `raycast`"):
        embree(triangles, test.frame)
