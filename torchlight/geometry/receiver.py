"""The plane that is looked at: a rectangle of z = 0, cut into equal samples."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchlight.errors import SceneError

MAX_SAMPLES = 1_000_000


@dataclass(frozen=True)
class Receiver:
    """A rectangle of the plane z = 0; each sample stands for its whole footprint.

    Sample (column i, row j) is centred at `center - size / 2 + (index + 1/2) size / samples`,
    so row 0 has the smallest y. Samples are numbered row by row: `point = j * columns + i`.

    Attributes:
        center: x and y of the rectangle's middle, in the scene's unit.
        size: extent in x and in y, in the scene's unit.
        samples: number of samples in x and in y.
        albedo: Lambertian albedo, one number or one per RGB channel; None = unknown (taken as 1).
    """

    center: tuple[float, float]
    size: tuple[float, float]
    samples: tuple[int, int]
    albedo: tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        columns, rows = self.samples
        if columns < 1 or rows < 1:
            raise SceneError(
                f"receiver.samples: expected two positive integers, got {self.samples}; for example [64, 64]"
            )
        if columns * rows > MAX_SAMPLES:
            raise SceneError(
                f"receiver.samples: {columns} x {rows} is more than {MAX_SAMPLES:,} samples; "
                "a few thousand already determine the light, for example [128, 96]"
            )
        if not all(0.0 < extent < float("inf") for extent in self.size):
            raise SceneError(f"receiver.size: expected two positive lengths, got {self.size}")
        if not all(abs(value) < float("inf") for value in self.center):
            raise SceneError(f"receiver.center: expected two finite coordinates, got {self.center}")
        if self.albedo is not None and not all(0.0 < value <= 1.0 for value in self.albedo):
            raise SceneError(f"receiver.albedo: expected values in (0, 1], got {self.albedo}")

    @property
    def points(self) -> int:
        """Number of samples."""
        return self.samples[0] * self.samples[1]

    @property
    def footprint(self) -> tuple[float, float]:
        """Extent of one sample in x and y, in the scene's unit."""
        return self.size[0] / self.samples[0], self.size[1] / self.samples[1]


def sample_centers(
    receiver: Receiver, *, dtype: torch.dtype = torch.float64, device: torch.device | str = "cpu"
) -> Float[Tensor, "points 2"]:
    """Returns x and y of every sample's centre, row by row from the smallest y."""
    columns, rows = receiver.samples
    step_x, step_y = receiver.footprint
    x = receiver.center[0] - receiver.size[0] / 2 + (torch.arange(columns, dtype=torch.float64) + 0.5) * step_x
    y = receiver.center[1] - receiver.size[1] / 2 + (torch.arange(rows, dtype=torch.float64) + 0.5) * step_y
    grid_y, grid_x = torch.meshgrid(y, x, indexing="ij")
    return torch.stack([grid_x, grid_y], dim=-1).reshape(-1, 2).to(dtype=dtype, device=device)


def receiver_points(receiver: Receiver) -> np.ndarray:
    """Returns the sample centres as world points on z = 0, [points, 3]."""
    centers = sample_centers(receiver)
    return torch.cat([centers, torch.zeros_like(centers[:, :1])], dim=1).numpy()


def receiver_corners(receiver: Receiver) -> Float[Tensor, "4 3"]:
    """Returns the rectangle's corners on z = 0, in float64."""
    (x, y), (width, height) = receiver.center, receiver.size
    signs = torch.tensor([[-0.5, -0.5], [0.5, -0.5], [-0.5, 0.5], [0.5, 0.5]], dtype=torch.float64)
    corners = torch.tensor([x, y], dtype=torch.float64) + signs * torch.tensor([width, height], dtype=torch.float64)
    return torch.cat([corners, torch.zeros(4, 1, dtype=torch.float64)], dim=1)
