"""Latitude-longitude images of the sphere: row 0 is the zenith, the image centre looks along +X.

u = 1/2 - phi / 2 pi and v = theta / pi, with theta from +Z and phi = atan2(y, x): the left quarter
looks along +Y, the right quarter along -Y, both edges along -X. An image of H rows has 2 H columns;
pixel (row, column) covers the rectangle [row, row + 1] x [column, column + 1] and is centred at the halves.
"""

from __future__ import annotations

import math

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchlight.errors import ShapeError
from torchlight.light.directions import from_angles, to_angles


def check_latlong(height: int, width: int) -> None:
    """Raises ShapeError unless the image is twice as wide as high."""
    if height < 1 or width != 2 * height:
        raise ShapeError(f"lat-long image: expected a width of twice the height, got {width} x {height}; resample it")


def row_boundaries(
    height: int, *, dtype: torch.dtype = torch.float64, device: torch.device | str = "cpu"
) -> Float[Tensor, " edges"]:
    """Returns theta of the height + 1 row edges, from 0 to pi, in radians."""
    edges = torch.arange(height + 1, dtype=torch.float64) * (math.pi / height)
    return edges.to(dtype=dtype, device=device)


def column_boundaries(
    width: int, *, dtype: torch.dtype = torch.float64, device: torch.device | str = "cpu"
) -> Float[Tensor, " edges"]:
    """Returns phi of the width + 1 column edges, from +pi down to -pi, in radians."""
    edges = math.pi * (1 - 2 * torch.arange(width + 1, dtype=torch.float64) / width)
    return edges.to(dtype=dtype, device=device)


def pixel_directions(
    height: int, *, dtype: torch.dtype = torch.float64, device: torch.device | str = "cpu"
) -> Float[Tensor, "height width 3"]:
    """Returns the unit vector towards every pixel's centre."""
    theta = (torch.arange(height, dtype=torch.float64) + 0.5)[:, None] * (math.pi / height)
    phi = math.pi * (1 - (torch.arange(2 * height, dtype=torch.float64) + 0.5) / height)
    return from_angles(theta, phi).to(dtype=dtype, device=device)


def image_coordinates(
    directions: Float[Tensor, "*batch 3"], height: int
) -> tuple[Float[Tensor, "*batch"], Float[Tensor, "*batch"]]:
    """Returns the continuous row in [0, H] and column in [0, 2 H) of directions of any length.

    Pixel (i, j) has its centre at (i + 1/2, j + 1/2).
    """
    theta, phi = to_angles(directions)
    scale = height / math.pi
    return theta * scale, torch.remainder(height - phi * scale, 2 * height)


def pixel_indices(
    directions: Float[Tensor, "*batch 3"], height: int
) -> tuple[Int[Tensor, "*batch"], Int[Tensor, "*batch"]]:
    """Returns the row and column of the pixel that contains each direction."""
    rows, columns = image_coordinates(directions, height)
    return rows.floor().long().clamp(0, height - 1), columns.floor().long().clamp(0, 2 * height - 1)


def row_solid_angles(
    height: int, *, dtype: torch.dtype = torch.float64, device: torch.device | str = "cpu"
) -> Float[Tensor, " height"]:
    """Returns the exact solid angle of one pixel of each row, in steradians.

    (pi / H) (cos theta_i - cos theta_i+1), written as a product of sines: the difference would cancel at the poles.
    """
    half_step = math.pi / (2 * height)
    middle = (torch.arange(height, dtype=torch.float64) + 0.5) * (math.pi / height)
    angles = (math.pi / height) * 2 * math.sin(half_step) * middle.sin()
    return angles.to(dtype=dtype, device=device)


def row_projected_solid_angles(
    height: int, *, dtype: torch.dtype = torch.float64, device: torch.device | str = "cpu"
) -> Float[Tensor, " height"]:
    """Returns the exact integral of max(0, z) d omega over one pixel of each row, in steradians.

    (pi / H) [sin^2 theta / 2] between the row's edges above the horizon, which sums to pi over the image.
    """
    edges = row_boundaries(height).clamp(max=math.pi / 2)
    # sin^2 b - sin^2 a = sin(b + a) sin(b - a)
    weights = (math.pi / height) * 0.5 * torch.sin(edges[1:] + edges[:-1]) * torch.sin(edges[1:] - edges[:-1])
    return weights.clamp(min=0).to(dtype=dtype, device=device)
