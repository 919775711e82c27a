"""Where the samples lie, in literal values, and receivers that cannot be."""

from __future__ import annotations

import math

import pytest
import torch
from torch.testing import assert_close

from torchlight.errors import SceneError
from torchlight.geometry.receiver import Receiver, receiver_corners, sample_centers
from torchlight.geometry.scene import Scene


def test_samples_are_numbered_row_by_row_from_the_smallest_y() -> None:
    receiver = Receiver((1.0, 10.0), (6.0, 4.0), (3, 2))
    expected = [[-1.0, 9.0], [1.0, 9.0], [3.0, 9.0], [-1.0, 11.0], [1.0, 11.0], [3.0, 11.0]]
    assert_close(sample_centers(receiver), torch.tensor(expected, dtype=torch.float64))
    assert sample_centers(receiver, dtype=torch.float32).dtype == torch.float32
    assert receiver.footprint == (2.0, 2.0)
    assert receiver.points == 6


def test_corners_lie_on_the_plane() -> None:
    expected = [[-2.0, 8, 0], [4, 8, 0], [-2, 12, 0], [4, 12, 0]]
    found = receiver_corners(Receiver((1.0, 10.0), (6.0, 4.0), (3, 2)))
    assert_close(found, torch.tensor(expected, dtype=torch.float64))


@pytest.mark.parametrize(
    ("center", "size", "samples", "albedo", "key"),
    [
        ((0.0, 0.0), (1.0, 1.0), (0, 4), None, "samples"),
        ((0.0, 0.0), (1.0, 1.0), (4, -1), None, "samples"),
        ((0.0, 0.0), (1.0, 1.0), (3000, 3000), None, "samples"),
        ((0.0, 0.0), (0.0, 1.0), (4, 4), None, "size"),
        ((0.0, 0.0), (1.0, math.nan), (4, 4), None, "size"),
        ((0.0, 0.0), (1.0, math.inf), (4, 4), None, "size"),
        ((math.nan, 0.0), (1.0, 1.0), (4, 4), None, "center"),
        ((0.0, math.inf), (1.0, 1.0), (4, 4), None, "center"),
        ((0.0, 0.0), (1.0, 1.0), (4, 4), (0.5, 0.0, 0.5), "albedo"),
        ((0.0, 0.0), (1.0, 1.0), (4, 4), (0.5, 1.1, 0.5), "albedo"),
    ],
)
def test_impossible_receivers_are_refused_in_one_line(
    center: tuple[float, float],
    size: tuple[float, float],
    samples: tuple[int, int],
    albedo: tuple[float, float, float] | None,
    key: str,
) -> None:
    with pytest.raises(SceneError, match=rf"^receiver\.{key}: [^\n]*$"):
        Receiver(center, size, samples, albedo)


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_scene_refuses_vertices_that_are_no_numbers(value: float) -> None:
    triangles = torch.zeros(2, 3, 3)
    triangles[1, 2, 0] = value
    with pytest.raises(SceneError, match=r"^triangles: some vertices are NaN or infinite[^\n]*$"):
        Scene(triangles, Receiver((0.0, 0.0), (1.0, 1.0), (2, 2)))
