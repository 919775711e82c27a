from __future__ import annotations

import math

import pytest
import torch
from torch.testing import assert_close

from torchlight.errors import ShapeError
from torchlight.light import latlong

PI = math.pi


def test_the_image_looks_along_the_named_axes():
    axes = torch.tensor([[1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=torch.float64)
    rows, columns = latlong.image_coordinates(axes, 8)
    assert_close(rows, torch.tensor([4.0, 4, 4, 0, 8]).double())
    assert_close(columns[:3], torch.tensor([8.0, 4, 12]).double())
    _, edge = latlong.image_coordinates(torch.tensor([[-1.0, 1e-9, 0], [-1, -1e-9, 0]], dtype=torch.float64), 8)
    assert_close(edge, torch.tensor([0.0, 16]).double(), atol=1e-7, rtol=0)


def test_pixel_centres_have_literal_directions():
    directions = latlong.pixel_directions(2)
    h = math.sqrt(0.5)
    assert_close(directions[0, 0], torch.tensor([-0.5, 0.5, h], dtype=torch.float64))
    assert_close(directions[1, 2], torch.tensor([0.5, -0.5, -h], dtype=torch.float64))


@pytest.mark.parametrize("height", [1, 2, 7, 64])
def test_pixels_find_themselves(height):
    directions = latlong.pixel_directions(height)
    rows, columns = latlong.pixel_indices(3.0 * directions, height)
    assert_close(rows, torch.arange(height)[:, None].expand(height, 2 * height))
    assert_close(columns, torch.arange(2 * height).expand(height, 2 * height))


def test_poles_and_seam_stay_inside_the_image():
    nasty = torch.tensor([[0, 0, 1.0], [0, 0, -1], [-1, -0.0, 0], [-1, 0.0, 0], [-1, -1e-20, 0]])
    rows, columns = latlong.pixel_indices(nasty, 8)
    assert rows.tolist() == [0, 7, 4, 4, 4]
    assert all(0 <= column < 16 for column in columns.tolist())


def test_boundaries_enclose_the_centres():
    rows, columns = latlong.row_boundaries(4), latlong.column_boundaries(8)
    assert_close(rows, torch.tensor([0, PI / 4, PI / 2, 3 * PI / 4, PI], dtype=torch.float64))
    assert_close(columns[[0, 2, 4, 8]], torch.tensor([PI, PI / 2, 0, -PI], dtype=torch.float64))


@pytest.mark.parametrize("height", [1, 2, 7, 64, 1000])
def test_solid_angles_are_exact(height):
    angles = latlong.row_solid_angles(height)
    edges = torch.arange(height + 1, dtype=torch.float64) * (PI / height)
    assert_close(angles, (PI / height) * (edges[:-1].cos() - edges[1:].cos()), atol=1e-16, rtol=1e-9)
    assert_close(2 * height * angles.sum().item(), 4 * PI, atol=0, rtol=1e-13)


def test_moments_of_the_sphere():
    directions, angles = latlong.pixel_directions(256), latlong.row_solid_angles(256)
    weights = angles[:, None].expand(256, 512)
    first = torch.einsum("hw,hwi->i", weights, directions)
    second = torch.einsum("hw,hwi,hwj->ij", weights, directions, directions)
    assert_close(first, torch.zeros(3, dtype=torch.float64), atol=1e-12, rtol=0)
    # Centres instead of integrals over the pixels: (pi / H)^2 / 24 relative
    assert_close(second, 4 * PI / 3 * torch.eye(3, dtype=torch.float64), atol=6e-5, rtol=0)


@pytest.mark.parametrize("height", [1, 2, 7, 64])
def test_projected_solid_angles_sum_to_pi(height):
    weights = latlong.row_projected_solid_angles(height)
    assert_close(2 * height * weights.sum().item(), PI, atol=0, rtol=1e-13)
    assert_close(weights[(height + 1) // 2 :], torch.zeros(height // 2, dtype=torch.float64))


def test_projected_solid_angles_against_quadrature():
    height, fine = 6, 20_000
    theta = (torch.arange(height * fine, dtype=torch.float64) + 0.5) * (PI / (height * fine))
    integrand = (theta.cos().clamp(min=0) * theta.sin()).reshape(height, fine).sum(1) * (PI / (height * fine))
    assert_close(latlong.row_projected_solid_angles(height), integrand * (PI / height), atol=1e-9, rtol=0)


def test_other_shapes_are_refused():
    with pytest.raises(ShapeError, match="twice the height"):
        latlong.check_latlong(100, 100)
