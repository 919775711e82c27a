"""Form factors from triangles to the plane, against closed forms and a sum over directions."""

from __future__ import annotations

import math

import torch
from torch.testing import assert_close

from torchlight.geometry.form_factors import form_factors

ORIGIN = torch.zeros(1, 3, dtype=torch.float64)


def test_a_rectangle_straight_above_is_the_textbook_s() -> None:
    """A corner of a parallel a x b rectangle at height c (Howell's catalogue, B-3)."""
    a, b, c = 1.3, 0.7, 0.9
    corners = torch.tensor([[0, 0, c], [0, b, c], [a, b, c], [a, 0, c]], dtype=torch.float64)
    faces = corners[torch.tensor([[0, 1, 2], [0, 2, 3]])]  # counter-clockwise from below, where the plane is
    x, y = a / c, b / c
    first = x / math.hypot(1, x) * math.atan(y / math.hypot(1, x))
    second = y / math.hypot(1, y) * math.atan(x / math.hypot(1, y))
    assert_close(form_factors(faces, ORIGIN).sum().item(), (first + second) / (2 * math.pi), rtol=1e-12, atol=0)


def test_an_endless_wall_at_one_s_feet_is_half_of_all_there_is() -> None:
    wall = torch.tensor(
        [[[1e-6, 1e6, 0], [1e-6, -1e6, 0], [1e-6, -1e6, 1e6]], [[1e-6, 1e6, 0], [1e-6, -1e6, 1e6], [1e-6, 1e6, 1e6]]],
        dtype=torch.float64,
    )
    facing = wall.flip(1)
    both = form_factors(torch.cat([wall, facing]), ORIGIN).reshape(2, 2).sum(dim=1)
    assert_close(both.amax(), torch.tensor(0.5, dtype=torch.float64), rtol=1e-5, atol=0)
    assert both.amin() == 0  # seen from behind


def test_a_tilted_triangle_is_the_sum_over_directions() -> None:
    triangle = torch.tensor([[[0.5, -0.4, 0.0], [0.9, 0.8, 0.3], [0.4, 0.2, 1.1]]], dtype=torch.float64)
    point = torch.tensor([[-0.3, 0.1, 0.0]], dtype=torch.float64)
    found = form_factors(torch.cat([triangle, triangle.flip(1)]), point).amax().item()
    index = torch.arange(400_000, dtype=torch.float64) + 0.5  # cosine-weighted spiral: F = the share that hits
    radius, phi = (index / len(index)).sqrt(), index * math.pi * (3 - math.sqrt(5))
    d = torch.stack([radius * phi.cos(), radius * phi.sin(), (1 - radius**2).sqrt()], dim=1)
    a, b, c = (triangle[0] - point).unbind()
    sides = torch.stack([(torch.linalg.cross(p, q)[None] * d).sum(dim=1) for p, q in ((a, b), (b, c), (c, a))])
    hit = (sides > 0).all(dim=0) | (sides < 0).all(dim=0)
    assert_close(found, hit.double().mean().item(), rtol=2e-3, atol=0)  # of the spiral
