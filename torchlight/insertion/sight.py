"""The pixels of a photograph as rays: through the camera's lens, or straight down on the receiver."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchlight.camera import Camera, pixel_directions, project
from torchlight.errors import CalibrationError
from torchlight.geometry.receiver import Receiver, receiver_points
from torchlight.geometry.scene import Scene

SUBPIXELS = 4  # along a pixel's edge


@dataclass(frozen=True)
class Sight:
    """How a photograph sees the scene.

    Attributes:
        camera: of the photograph; None = it is a rectified picture of the receiver, seen from straight above.
        receiver: the rectangle that a rectified picture shows.
        size: columns and rows of the photograph.
        top: height from which the rays of a rectified picture start.
        step: photograph pixels along the edge of one cell; above 1 for what need not be as fine as the photograph.
    """

    camera: Camera | None
    receiver: Receiver
    size: tuple[int, int]
    top: float
    step: int = 1

    @property
    def grid(self) -> tuple[int, int]:
        """Columns and rows of cells."""
        return -(-self.size[0] // self.step), -(-self.size[1] // self.step)

    @property
    def cells(self) -> int:
        """Number of cells, counted row by row."""
        return self.grid[0] * self.grid[1]

    def coarser(self, step: int) -> Sight:
        """Returns the same view in cells of step x step pixels."""
        return replace(self, step=step)


def sight_of(scene: Scene, size: tuple[int, int], top: float) -> Sight:
    """Returns how a photograph of a size sees a scene.

    Args:
        scene: receiver, and the camera if there is one.
        size: columns and rows of the photograph.
        top: a height above everything that stands on the plane.

    Raises:
        CalibrationError: the photograph's size is not the camera's.
    """
    if scene.camera is not None and size != scene.camera.image_size:
        raise CalibrationError(
            f"the photograph has {size[0]} x {size[1]} pixels but camera.image_size says "
            f"{scene.camera.image_size[0]} x {scene.camera.image_size[1]}; use the size the camera was calibrated at, "
            "not cropped, not turned"
        )
    return Sight(scene.camera, scene.receiver, size, top)


def receiver_pixels(sight: Sight) -> Bool[Tensor, "height width"]:
    """Returns on which pixels the centre of a receiver's sample falls; all of a rectified picture's."""
    width, height = sight.size
    if sight.camera is None:
        return torch.ones(height, width, dtype=torch.bool)
    pixels = project(sight.camera, torch.from_numpy(receiver_points(sight.receiver)))
    columns, rows = pixels.nan_to_num(-1.0).round().long().unbind(dim=-1)
    inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
    result = torch.zeros(height, width, dtype=torch.bool)
    result[rows[inside], columns[inside]] = True
    return result


def cell_rays(
    sight: Sight, index: Int[Tensor, " cells"], subpixels: int = SUBPIXELS
) -> tuple[Float[Tensor, "cells sub 3"], Float[Tensor, "cells sub 3"]]:
    """Returns origins and unit directions of subpixels x subpixels rays through each cell, the most central first.

    Over a cell the lens is taken as bilinear between its corners.
    """
    corners = torch.tensor([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]], dtype=torch.float64)
    shares = subpixel_places(subpixels)
    weights = torch.stack([(corner * shares + (1 - corner) * (1 - shares)).prod(dim=-1) for corner in corners], dim=1)
    columns = sight.grid[0]
    upper_left = torch.stack([index % columns, index // columns], dim=-1).double()
    last = torch.tensor(sight.size, dtype=torch.float64)
    pixels = ((upper_left[:, None] + corners) * sight.step).minimum(last) - 0.5
    if sight.camera is None:
        origins = weights @ on_receiver(sight, pixels)
        return origins, torch.tensor([0.0, 0.0, -1.0], dtype=torch.float64).expand_as(origins)
    directions = torch.nn.functional.normalize(weights @ pixel_directions(sight.camera, pixels), dim=-1)
    return sight.camera.position.to(directions).expand_as(directions), directions


def subpixel_places(subpixels: int) -> Float[Tensor, "sub 2"]:
    """Returns x and y of points spread evenly over the unit square, the most central first."""
    steps = (torch.arange(subpixels, dtype=torch.float64) + 0.5) / subpixels
    places = torch.cartesian_prod(steps, steps).reshape(-1, 2)
    return places[(places - 0.5).square().sum(dim=-1).argsort(stable=True)]


def on_receiver(sight: Sight, pixels: Float[Tensor, "cells sub 2"]) -> Float[Tensor, "cells sub 3"]:
    """Returns the points at the height `top` over the pixels of a rectified picture, whose row 0 is the largest y."""
    size = torch.tensor(sight.receiver.size, dtype=torch.float64)
    share = (pixels + 0.5) / torch.tensor(sight.size, dtype=torch.float64) - 0.5
    xy = torch.tensor(sight.receiver.center, dtype=torch.float64) + share * size * torch.tensor([1.0, -1.0]).double()
    return torch.cat([xy, torch.full_like(xy[..., :1], sight.top)], dim=-1)
