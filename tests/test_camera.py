"""Projection and its inverse against OpenCV, pixel centres, and what a camera refuses."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

from torchlight.camera import Camera, pixel_directions, project, to_camera
from torchlight.errors import CalibrationError
from torchlight.geometry.transforms import rotation_matrix

K = torch.tensor([[900.0, 0.0, 512.5], [0.0, 880.0, 380.25], [0.0, 0.0, 1.0]], dtype=torch.float64)
COEFFICIENTS = [-0.21, 0.07, 0.0012, -0.0008, -0.01, 0.02, -0.01, 0.004, 0.003, -0.001, 0.002, 0.0005, 0.02, -0.01]
NONE = torch.zeros(4, dtype=torch.float64)


def pose(rotation_degrees: tuple[float, float, float], translation: tuple[float, float, float]) -> Tensor:
    matrix = torch.eye(4, dtype=torch.float64)
    matrix[:3, :3] = rotation_matrix(rotation_degrees)
    matrix[:3, 3] = torch.tensor(translation, dtype=torch.float64)
    return matrix


def distorted(count: int) -> Tensor:
    values = COEFFICIENTS[:count] if count else [0.0] * 5
    return torch.tensor(values, dtype=torch.float64)


def plane_points() -> Tensor:
    x, y = torch.meshgrid(*[torch.linspace(-0.9, 0.9, 9, dtype=torch.float64)] * 2, indexing="xy")
    return torch.stack([x, y, torch.zeros_like(x)], dim=-1).reshape(-1, 3)


def tilted_camera(count: int) -> Camera:
    return Camera(K, pose((155.0, 8.0, 20.0), (0.05, -0.1, 2.5)), (1024, 768), distorted(count))


@pytest.mark.parametrize("count", [0, 4, 5, 8, 12, 14])
def test_projection_equals_opencv(count: int) -> None:
    camera = tilted_camera(count)
    rotation, _ = cv2.Rodrigues(camera.world_to_camera[:3, :3].numpy())
    translation = camera.world_to_camera[:3, 3].numpy()
    expected, _ = cv2.projectPoints(plane_points().numpy(), rotation, translation, K.numpy(), camera.distortion.numpy())
    assert_close(project(camera, plane_points()), torch.from_numpy(expected.reshape(-1, 2)), rtol=0, atol=1e-8)


@pytest.mark.parametrize("count", [0, 4, 5, 8, 12, 14])
def test_pixel_directions_equal_opencv_and_undo_the_projection(count: int) -> None:
    camera = tilted_camera(count)
    pixels = project(camera, plane_points())
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-14)
    ideal = cv2.undistortImagePoints(
        pixels.numpy().reshape(-1, 1, 2), K.numpy(), camera.distortion.numpy(), None, criteria
    ).reshape(-1, 2)
    local = np.concatenate([ideal, np.ones_like(ideal[:, :1])], axis=1) @ np.linalg.inv(K.numpy()).T
    local /= np.linalg.norm(local, axis=1, keepdims=True)
    expected = torch.from_numpy(local @ camera.world_to_camera[:3, :3].numpy())
    found = pixel_directions(camera, pixels)
    assert_close(found, expected, rtol=0, atol=1e-8)
    assert_close(found, torch.nn.functional.normalize(plane_points() - camera.position, dim=-1), rtol=0, atol=1e-8)


def test_pixel_centres_are_integers() -> None:
    """The principal ray of K with cx = 3 hits pixel 3, and one focal length to the side is fx pixels on."""
    intrinsics = torch.tensor([[10.0, 0, 3], [0, 20, 5], [0, 0, 1]], dtype=torch.float64)
    camera = Camera(intrinsics, torch.eye(4, dtype=torch.float64), (7, 11), NONE)
    points = torch.tensor([[0.0, 0, 2], [2, 0, 2], [0, 2, 2]], dtype=torch.float64)
    assert_close(project(camera, points), torch.tensor([[3.0, 5], [13, 5], [3, 25]], dtype=torch.float64))
    forward = torch.tensor([[0.0, 0.0, 1.0]], dtype=torch.float64)
    assert_close(pixel_directions(camera, torch.tensor([[3.0, 5.0]], dtype=torch.float64)), forward)


def test_opencv_axes() -> None:
    """A camera 5 above the origin that looks down with its image's top towards +y: +x is right, +y is up (row 0)."""
    camera = Camera(K, pose((180.0, 0.0, 0.0), (0.0, 0.0, 5.0)), (1024, 768), NONE)
    assert_close(camera.position, torch.tensor([0.0, 0.0, 5.0], dtype=torch.float64))
    local = to_camera(camera, torch.tensor([[1.0, 2.0, 0.0]], dtype=torch.float64))
    assert_close(local, torch.tensor([[1.0, -2.0, 5.0]], dtype=torch.float64))
    pixel = project(camera, torch.tensor([[1.0, 2.0, 0.0]], dtype=torch.float64))
    expected = torch.tensor([[512.5 + 900 / 5, 380.25 - 880 * 2 / 5]], dtype=torch.float64)
    assert_close(pixel, expected)


def test_points_that_are_not_in_front_have_no_pixel() -> None:
    camera = Camera(K, torch.eye(4, dtype=torch.float64), (1024, 768), distorted(5))
    points = torch.tensor([[0.1, 0.0, -1.0], [0.1, 0.0, 0.0], [0.1, 0.0, 1.0]], dtype=torch.float64)
    found = project(camera, points)
    assert found.isnan().all(dim=-1).tolist() == [True, True, False]


@pytest.mark.parametrize("batch", [(), (2,), (2, 3)])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_batch_axes_and_precision_follow_the_points(batch: tuple[int, ...], dtype: torch.dtype) -> None:
    camera = tilted_camera(8)
    points = plane_points()[: math.prod(batch)].reshape(*batch, 3).to(dtype)
    pixels = project(camera, points)
    assert pixels.shape == (*batch, 2)
    assert pixels.dtype == dtype
    back = pixel_directions(camera, pixels)
    assert back.shape == (*batch, 3)
    assert back.dtype == dtype
    towards = torch.nn.functional.normalize(points - camera.position.to(dtype), dim=-1)
    assert_close(back, towards, rtol=0, atol=1e-8 if dtype == torch.float64 else 1e-5)


def with_entry(matrix: Tensor, row: int, column: int, value: float) -> Tensor:
    changed = matrix.clone()
    changed[row, column] = value
    return changed


@pytest.mark.parametrize(
    "intrinsics",
    [
        with_entry(K, 0, 2, float("nan")),
        with_entry(K, 0, 0, 0.0),
        with_entry(K, 1, 1, -880.0),
        with_entry(K, 1, 0, 1.0),
        K.T.contiguous(),
        K * 2,
    ],
)
def test_impossible_intrinsics_are_refused_in_one_line(intrinsics: Tensor) -> None:
    with pytest.raises(CalibrationError, match=r"^camera\.K: [^\n]*$"):
        Camera(intrinsics, torch.eye(4, dtype=torch.float64), (1024, 768), NONE)


MIRROR = torch.diag(torch.tensor([1.0, 1.0, -1.0, 1.0], dtype=torch.float64))


@pytest.mark.parametrize(
    "world_to_camera",
    [
        with_entry(torch.eye(4, dtype=torch.float64), 0, 0, 1.01),
        with_entry(torch.eye(4, dtype=torch.float64), 0, 3, float("inf")),
        with_entry(torch.eye(4, dtype=torch.float64), 3, 0, 0.1),
        MIRROR,
    ],
)
def test_poses_that_are_not_rigid_are_refused_in_one_line(world_to_camera: Tensor) -> None:
    with pytest.raises(CalibrationError, match=r"^camera\.world_to_camera: [^\n]*$"):
        Camera(K, world_to_camera, (1024, 768), NONE)


@pytest.mark.parametrize("distortion", [[], [0.1], [0.1] * 6, [0.1] * 13, [0.1, 0.0, 0.0, float("nan")]])
def test_distortion_of_another_length_is_refused_in_one_line(distortion: list[float]) -> None:
    with pytest.raises(CalibrationError, match=r"^camera\.distortion: expected 4, 5, 8, 12, 14 [^\n]*$"):
        Camera(K, torch.eye(4, dtype=torch.float64), (1024, 768), torch.tensor(distortion, dtype=torch.float64))
