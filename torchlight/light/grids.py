"""How the sphere is parted into pixels: lat-long, cube map, angular map.

A grid knows for each pixel its exact solid angle and directions inside it, and for each direction the pixel. That is
all that resampling needs. Values over a grid are a vector over its pixels; `shape` is the form of its picture.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchlight.errors import ShapeError
from torchlight.light import cubemap, latlong
from torchlight.light.angular import angular_directions, angular_owners, angular_pixels, angular_solid_angles
from torchlight.light.directions import from_angles

INSET = 1e-4  # of a pixel


@runtime_checkable
class Grid(Protocol):
    """A partition of the sphere into pixels."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Form of the values; its product is the number of pixels."""
        ...

    @property
    def rows(self) -> int:
        """Rows of a lat-long that is about as fine."""
        ...

    def solid_angles(self) -> Float[Tensor, " pixels"]:
        """Returns the exact solid angle of each pixel, 4 pi in all; 0 for pixels that hold no light."""
        ...

    def locate(self, directions: Float[Tensor, "*batch 3"]) -> Int[Tensor, "*batch"]:
        """Returns the pixel that holds each direction."""
        ...

    def owners(self, pixels: Int[Tensor, " some"]) -> Int[Tensor, " some"]:
        """Returns the pixels that hold the light of some squares of the picture."""
        ...

    def parts(
        self, pixels: Int[Tensor, " some"], count: int
    ) -> tuple[Float[Tensor, "some parts 3"], Float[Tensor, "some parts"]]:
        """Returns count x count unit vectors inside each of some pixels, and the solid angle each stands for, about."""
        ...


@dataclass(frozen=True)
class LatlongGrid:
    """The lat-long in torchlight's convention, with a number of rows and twice as many columns."""

    height: int

    def __post_init__(self) -> None:
        _check_size("lat-long", self.height)

    @property
    def shape(self) -> tuple[int, ...]:
        """Rows and columns."""
        return self.height, 2 * self.height

    @property
    def rows(self) -> int:
        """The height."""
        return self.height

    def solid_angles(self) -> Float[Tensor, " pixels"]:
        """Returns `latlong.row_solid_angles` of every pixel."""
        return latlong.row_solid_angles(self.height).repeat_interleave(2 * self.height)

    def locate(self, directions: Float[Tensor, "*batch 3"]) -> Int[Tensor, "*batch"]:
        """Returns row * width + column."""
        row, column = latlong.pixel_indices(directions, self.height)
        return row * (2 * self.height) + column

    def owners(self, pixels: Int[Tensor, " some"]) -> Int[Tensor, " some"]:
        """Returns its argument."""
        return pixels

    def parts(
        self, pixels: Int[Tensor, " some"], count: int
    ) -> tuple[Float[Tensor, "some parts 3"], Float[Tensor, "some parts"]]:
        """Returns directions spread evenly over solid angle."""
        row, column = pixels // (2 * self.height), pixels % (2 * self.height)
        down, right, shares = _steps(count)
        edges = torch.cos(latlong.row_boundaries(self.height))
        top, bottom = edges[row][:, None], edges[row + 1][:, None]
        theta = torch.acos(top + (bottom - top) * down)
        directions = from_angles(theta, math.pi * (1 - (column[:, None] + right) / self.height))
        return directions, latlong.row_solid_angles(self.height)[row][:, None] * shares


@dataclass(frozen=True)
class CubeGrid:
    """The six faces +x -x +y -y +z -z of `cubemap`."""

    resolution: int

    def __post_init__(self) -> None:
        _check_size("cube map", self.resolution)

    @property
    def shape(self) -> tuple[int, ...]:
        """Faces, rows and columns."""
        return 6, self.resolution, self.resolution

    @property
    def rows(self) -> int:
        """Two faces stand between the zenith and the nadir."""
        return 2 * self.resolution

    def solid_angles(self) -> Float[Tensor, " pixels"]:
        """Returns `cubemap.solid_angles` of all six faces."""
        return cubemap.solid_angles(self.resolution).reshape(-1).repeat(6)

    def locate(self, directions: Float[Tensor, "*batch 3"]) -> Int[Tensor, "*batch"]:
        """Returns face * resolution^2 + row * resolution + column."""
        return cubemap.texel_index(directions, self.resolution)

    def owners(self, pixels: Int[Tensor, " some"]) -> Int[Tensor, " some"]:
        """Returns its argument."""
        return pixels

    def parts(
        self, pixels: Int[Tensor, " some"], count: int
    ) -> tuple[Float[Tensor, "some parts 3"], Float[Tensor, "some parts"]]:
        """Returns directions on a regular grid in each texel."""
        down, right, shares = _steps(count)
        face = pixels // self.resolution**2
        u = 2 * ((pixels % self.resolution)[:, None] + right) / self.resolution - 1
        v = 1 - 2 * ((pixels // self.resolution % self.resolution)[:, None] + down) / self.resolution
        angles = (2 / self.resolution) ** 2 * (1 + u * u + v * v) ** -1.5 * shares
        return cubemap.face_directions(face[:, None].expand(u.shape), u, v), angles


@dataclass(frozen=True)
class AngularGrid:
    """The angular map of a diameter in pixels."""

    size: int

    def __post_init__(self) -> None:
        _check_size("angular map", self.size)

    @property
    def shape(self) -> tuple[int, ...]:
        """Rows and columns."""
        return self.size, self.size

    @property
    def rows(self) -> int:
        """The size, made even: its pixels are twice as large as a lat-long's at the centre, and finer behind."""
        return self.size + self.size % 2

    def solid_angles(self) -> Float[Tensor, " pixels"]:
        """Returns `angular_solid_angles`."""
        return angular_solid_angles(self.size).reshape(-1)

    def locate(self, directions: Float[Tensor, "*batch 3"]) -> Int[Tensor, "*batch"]:
        """Returns row * size + column."""
        return angular_pixels(directions, self.size)

    def owners(self, pixels: Int[Tensor, " some"]) -> Int[Tensor, " some"]:
        """Returns the pixels themselves, and for captions the pixel beside them that holds their sliver of the disc."""
        return angular_owners(self.size)[pixels]

    def parts(
        self, pixels: Int[Tensor, " some"], count: int
    ) -> tuple[Float[Tensor, "some parts 3"], Float[Tensor, "some parts"]]:
        """Returns directions in each square; those outside the disc stand for nothing."""
        down, right, shares = _steps(count)
        u = 2 * ((pixels % self.size)[:, None] + right) / self.size - 1
        v = 1 - 2 * ((pixels // self.size)[:, None] + down) / self.size
        radius = torch.hypot(u, v)
        angles = torch.where(radius < 1, (2 * math.pi / self.size) ** 2 * torch.sinc(radius) * shares, 0)
        return angular_directions(u, v), angles


def _steps(count: int) -> tuple[Float[Tensor, " parts"], Float[Tensor, " parts"], Float[Tensor, " parts"]]:
    """Returns how far down and how far right count x count points of a pixel lie, and their shares.

    The trapezoidal rule, with its ends drawn in a little: where the pixels of two grids share a sliver, one of them
    has a corner in it, and a point that finds it.
    """
    steps = torch.linspace(INSET, 1 - INSET, count, dtype=torch.float64)
    weights = torch.ones(count, dtype=torch.float64)
    weights[[0, -1]] = 0.5
    down, right = torch.meshgrid(steps, steps, indexing="ij")
    shares = torch.outer(weights, weights) / weights.sum() ** 2
    return down.reshape(-1), right.reshape(-1), shares.reshape(-1)


def _check_size(name: str, size: int) -> None:
    if size < 1:
        raise ShapeError(f"{name}: expected a size of 1 pixel or more, got {size}")
