"""The pixels of a photograph as rays: through the camera's lens, or straight down on the receiver."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchlight.camera import Camera, pixel_directions
from torchlight.errors import CalibrationError
from torchlight.geometry.receiver import Receiver
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


def cell_rays(
    sight: Sight, index: Int[Tensor, " cells"], subpixels: int = SUBPIXELS
) -> tuple[Float[Tensor, "cells sub 3"], Float[Tensor, "cells sub 3"]]:
    """Returns origins and unit directions of subpixels x subpixels rays through each cell, the most central first."""
    pixels = (cell_places(sight, index, subpixels) * sight.step - 0.5).clamp(
        max=torch.tensor(sight.size, dtype=torch.float64) - 0.5
    )
    if sight.camera is None:
        origins = on_receiver(sight, pixels)
        return origins, torch.tensor([0.0, 0.0, -1.0], dtype=torch.float64).expand_as(origins)
    directions = pixel_directions(sight.camera, pixels)
    return sight.camera.position.to(directions).expand_as(directions), directions


def cell_places(sight: Sight, index: Int[Tensor, " cells"], subpixels: int) -> Float[Tensor, "cells sub 2"]:
    """Returns x and y of the rays in cells, counted from the upper left corner of the first cell."""
    steps = (torch.arange(subpixels, dtype=torch.float64) + 0.5) / subpixels
    offsets = torch.cartesian_prod(steps, steps).reshape(-1, 2)
    offsets = offsets[(offsets - 0.5).square().sum(dim=-1).argsort(stable=True)]
    columns = sight.grid[0]
    corner = torch.stack([index % columns, index // columns], dim=-1).double()
    return corner[:, None] + offsets


def on_receiver(sight: Sight, pixels: Float[Tensor, "cells sub 2"]) -> Float[Tensor, "cells sub 3"]:
    """Returns the points at the height `top` over the pixels of a rectified picture, whose row 0 is the largest y."""
    size = torch.tensor(sight.receiver.size, dtype=torch.float64)
    share = (pixels + 0.5) / torch.tensor(sight.size, dtype=torch.float64) - 0.5
    xy = torch.tensor(sight.receiver.center, dtype=torch.float64) + share * size * torch.tensor([1.0, -1.0]).double()
    return torch.cat([xy, torch.full_like(xy[..., :1], sight.top)], dim=-1)
