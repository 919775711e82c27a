"""Angular maps: the whole sphere in a disc, the angle from the centre linear in the radius.

Pixels whose centre lies in the disc are light, all others are captions. The light of the slivers of the disc that lie
in captions belongs to the pixel beside them, so that the pixels part the sphere among them and nothing is lost.

References:
    Debevec, Light Probe Image Gallery (1999).
"""

from __future__ import annotations

import math
from functools import lru_cache

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchlight.light.directions import to_y_up, to_z_up

_RIM_PARTS = 16
_PARTS = 2


def angular_coordinates(
    directions: Float[Tensor, "*batch 3"],
) -> tuple[Float[Tensor, "*batch"], Float[Tensor, "*batch"]]:
    """Returns (u to the right, v up) in the unit disc of an angular map, of directions in torchlight's world.

    (u, v) = (Dx, Dy) acos(-Dz) / (pi sqrt(Dx^2 + Dy^2)) in the probe's frame (Y up): the centre looks along -Z, which
    is +Y of the world, and the rim behind. Of the two published formulas the one with +Dz would mirror the world;
    the cube cross of the same place and the sides of the church round Galileo's tomb agree with -Dz.
    """
    x, y, z = to_y_up(directions).unbind(dim=-1)
    sideways = torch.hypot(x, y)
    radius = torch.atan2(sideways, -z) / math.pi
    # Straight behind, any point of the rim will do: the one to the right.
    off_axis = sideways > 0
    length = torch.where(off_axis, sideways, 1)
    return torch.where(off_axis, x / length, 1) * radius, y / length * radius


def angular_directions(u: Float[Tensor, "*batch"], v: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch 3"]:
    """Returns the unit vectors, in torchlight's world, of points of the disc; the inverse of `angular_coordinates`."""
    radius = torch.hypot(u, v)
    sideways = math.pi * torch.sinc(radius)  # sin(pi r) / r
    return to_z_up(torch.stack([u * sideways, v * sideways, -torch.cos(math.pi * radius)], dim=-1))


def angular_pixels(directions: Float[Tensor, "*batch 3"], size: int) -> Int[Tensor, "*batch"]:
    """Returns row * size + column of the pixel that holds the light of each direction."""
    u, v = angular_coordinates(directions)
    row = ((1 - v) * (size / 2)).long().clamp(0, size - 1)
    column = ((1 + u) * (size / 2)).long().clamp(0, size - 1)
    return angular_owners(size).to(row.device)[row * size + column]


def angular_solid_angles(
    size: int, *, dtype: torch.dtype = torch.float64, device: torch.device | str = "cpu"
) -> Float[Tensor, "{size} {size}"]:
    """Returns the solid angle of each pixel of an angular map, 4 pi in all; 0 for captions.

    It is (2 pi / D)^2 sin(a) / a at a = pi r, averaged over the pixel; at the rim, over what lies in the disc, slivers
    beside it included.
    """
    return _solid_angles(size).to(dtype=dtype, device=device, copy=True)


@lru_cache(maxsize=4)
def _solid_angles(size: int) -> Float[Tensor, "{size} {size}"]:
    angles = _part_angles(torch.arange(size**2), size, _PARTS).sum(dim=-1)
    rim = torch.nonzero((_corner_radius(size) > 1) & (_inner_radius(size) < 1)).squeeze(-1)
    angles[rim] = _part_angles(rim, size, _RIM_PARTS).sum(dim=-1)
    whole = torch.zeros_like(angles).index_add(0, angular_owners(size), angles)
    return (whole * (4 * math.pi / whole.sum())).reshape(size, size)


def _part_angles(pixels: Int[Tensor, " some"], size: int, parts: int) -> Float[Tensor, "some parts2"]:
    """Returns the solid angle of parts x parts pieces of some pixels; 0 for pieces outside the disc."""
    step = (torch.arange(parts, dtype=torch.float64) + 0.5) / parts
    down, right = (grid.reshape(-1) for grid in torch.meshgrid(step, step, indexing="ij"))
    u = 2 * ((pixels % size)[:, None] + right) / size - 1
    v = 1 - 2 * ((pixels // size)[:, None] + down) / size
    radius = torch.hypot(u, v)
    angles = (2 * math.pi / (size * parts)) ** 2 * torch.sinc(radius)
    return torch.where(radius <= 1, angles, 0)


@lru_cache(maxsize=4)
def angular_owners(size: int) -> Int[Tensor, " pixels"]:
    """Returns for each pixel itself, or, where its centre lies outside the disc, the pixel beside it towards the
    centre: one step along the longer coordinate, and one along the other where that is not enough."""
    index = torch.arange(size)
    row, column = (grid.reshape(-1) for grid in torch.meshgrid(index, index, indexing="ij"))
    for _ in range(2):
        up, right = size - 1 - 2 * row, 2 * column + 1 - size
        outside = up**2 + right**2 > size**2
        tall = up.abs() >= right.abs()
        row = row + torch.where(outside & tall, up.sign(), 0)
        column = column - torch.where(outside & ~tall, right.sign(), 0)
    return row * size + column


def _corner_radius(size: int) -> Float[Tensor, " pixels"]:
    """Returns the distance of each pixel's outermost corner from the centre of the disc."""
    middle = ((2 * torch.arange(size, dtype=torch.float64) + 1) / size - 1).abs()
    return torch.hypot(middle[:, None] + 1 / size, middle + 1 / size).reshape(-1)


def _inner_radius(size: int) -> Float[Tensor, " pixels"]:
    """Returns the distance of each pixel's innermost point from the centre of the disc."""
    middle = ((2 * torch.arange(size, dtype=torch.float64) + 1) / size - 1).abs()
    nearest = (middle - 1 / size).clamp(min=0)
    return torch.hypot(nearest[:, None], nearest).reshape(-1)
