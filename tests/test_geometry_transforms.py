from __future__ import annotations

import math

import pytest
import torch
from scipy.spatial.transform import Rotation
from torch.testing import assert_close

from torchlight.errors import SceneError
from torchlight.geometry.primitives import box
from torchlight.geometry.transforms import apply_matrix, rotation_matrix, transform


def volume(triangles: torch.Tensor) -> float:
    return (torch.linalg.det(triangles) / 6).sum().item()


@pytest.mark.parametrize(
    ("degrees", "start", "end"),
    [
        ((90.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
        ((0.0, 90.0, 0.0), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)),
        ((0.0, 0.0, 90.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
        ((90.0, 0.0, 90.0), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)),
        ((90.0, 90.0, 0.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0)),
    ],
)
def test_turns_by_a_right_angle(degrees: tuple[float, ...], start: tuple[float, ...], end: tuple[float, ...]) -> None:
    x, y, z = degrees
    turned = rotation_matrix((x, y, z)) @ torch.tensor(start, dtype=torch.float64)
    assert_close(turned, torch.tensor(end, dtype=torch.float64), rtol=0, atol=1e-15)


def test_rotation_agrees_with_scipy() -> None:
    for degrees in ((10.0, -20.0, 30.0), (170.0, 95.0, -260.0)):
        expected = torch.from_numpy(Rotation.from_euler("xyz", degrees, degrees=True).as_matrix())
        assert_close(rotation_matrix(degrees), expected, rtol=0, atol=1e-14)


def test_scale_then_rotate_then_translate() -> None:
    triangles = torch.tensor([[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]], dtype=torch.float64)
    moved = transform(triangles, 2.0, (0.0, 0.0, 90.0), (10.0, 20.0, 30.0))
    expected = torch.tensor([[[10.0, 22.0, 30.0], [8.0, 20.0, 30.0], [10.0, 20.0, 32.0]]], dtype=torch.float64)
    assert_close(moved, expected, rtol=0, atol=1e-14)


def test_matrix_does_the_same() -> None:
    solid = box((1.0, 2.0, 3.0))
    matrix = torch.eye(4, dtype=torch.float64)
    matrix[:3, :3] = 1.5 * rotation_matrix((5.0, 6.0, 7.0))
    matrix[:3, 3] = torch.tensor([1.0, 2.0, 3.0])
    assert_close(apply_matrix(solid, matrix), transform(solid, 1.5, (5.0, 6.0, 7.0), (1.0, 2.0, 3.0)))


def test_mirroring_keeps_faces_outward() -> None:
    solid = box((1.0, 2.0, 3.0))
    mirror = torch.diag(torch.tensor([1.0, -1.0, 2.0, 1.0], dtype=torch.float64))
    assert_close(volume(apply_matrix(solid, mirror)), 12.0)
    assert_close(volume(transform(solid, -1.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))), 6.0)


def test_dtype_follows_the_triangles() -> None:
    solid = box((1.0, 2.0, 3.0), dtype=torch.float32)
    assert transform(solid, 1.0, (1.0, 2.0, 3.0), (0.0, 0.0, 0.0)).dtype == torch.float32
    assert apply_matrix(solid, torch.eye(4, dtype=torch.float64)).dtype == torch.float32


@pytest.mark.parametrize(
    ("row", "column", "value", "message"),
    [(3, 0, 1.0, "last row"), (0, 0, math.nan, "finite"), (2, 2, 0.0, "flattens"), (1, 1, 1e-12, "flattens")],
)
def test_matrices_that_are_refused(row: int, column: int, value: float, message: str) -> None:
    matrix = torch.eye(4, dtype=torch.float64)
    matrix[row, column] = value
    with pytest.raises(SceneError, match=f"matrix: .*{message}"):
        apply_matrix(box((1.0, 1.0, 1.0)), matrix)
