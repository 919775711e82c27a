"""Two lights on one lat-long grid, and the solid angle that each sample of it stands for."""

from __future__ import annotations

from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

from torchlight.errors import ConfigError
from torchlight.light import latlong
from torchlight.light.grids import LatlongGrid
from torchlight.light.resampling import resample

Part = Literal["upper", "sphere"]
MAX_HEIGHT = 4096


def common_height(light: int, reference: int) -> int:
    """Returns the rows of the grid on which two maps are compared: the fewer of the two, made even, at least 2.

    The finer map is averaged: to cut the coarser one up would claim a detail that it does not have.
    """
    smaller = min(light, reference)
    return max(2, smaller - smaller % 2)


def check_height(height: int) -> None:
    """Raises ConfigError unless the horizon lies between two rows of the grid, and the grid can be held."""
    if height < 2 or height % 2 or height > MAX_HEIGHT:
        raise ConfigError(
            f"height: expected an even number of rows from 2 to {MAX_HEIGHT}, got {height}; for example 128"
        )


def resampled(
    radiance: Float[Tensor, "*batch rows columns"], height: int
) -> Float[Tensor, "*batch {height} {2*height}"]:
    """Returns the area averages of a lat-long map over the pixels of another; the integral over the sphere is kept."""
    rows, columns = radiance.shape[-2:]
    latlong.check_latlong(rows, columns)
    if rows == height:
        return radiance
    return resample(radiance.flatten(-2), LatlongGrid(rows), LatlongGrid(height)).unflatten(-1, (height, 2 * height))


def sample_weights(height: int, part: Part, *, device: torch.device | str = "cpu") -> Float[Tensor, " samples"]:
    """Returns the solid angle of the pixels of an even grid, row by row; 0 below the horizon where `upper` counts.

    They sum to 4 pi, or to 2 pi.
    """
    rows = latlong.row_solid_angles(height, device=device)
    if part == "upper":
        rows = torch.where(torch.arange(height, device=device) < height // 2, rows, 0.0)
    return rows.repeat_interleave(2 * height)


def first_moments(height: int, *, device: torch.device | str = "cpu") -> Float[Tensor, "samples 3"]:
    """Returns the exact integral of the unit vector w over every pixel, in steradians, row by row.

    With A = [theta / 2 - sin 2 theta / 4] between a row's edges: (A [sin phi], -A [cos phi], [sin^2 theta / 2] dphi).
    """
    theta, phi = latlong.row_boundaries(height, device=device), latlong.column_boundaries(2 * height, device=device)
    flat = (theta[1:] - theta[:-1]) / 2 - (torch.sin(2 * theta[1:]) - torch.sin(2 * theta[:-1])) / 4
    upright = (theta[1:].sin().square() - theta[:-1].sin().square()) / 2 * (torch.pi / height)
    x = flat[:, None] * (phi[:-1].sin() - phi[1:].sin())
    y = flat[:, None] * (phi[1:].cos() - phi[:-1].cos())
    return torch.stack([x, y, upright[:, None].expand_as(x)], dim=-1).reshape(-1, 3)
