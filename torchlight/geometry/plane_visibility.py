"""Which samples of the receiver's plane an occluder hides from each of many directions, without a ray."""

from __future__ import annotations

from types import ModuleType

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchlight.geometry import contour_twin
from torchlight.geometry.contours import morton
from torchlight.geometry.crossings import GridContours
from torchlight.geometry.crossings import compiled_kernel as kernel_or_none
from torchlight.threads import ordered_map

BUNDLE = 32  # neighbouring directions that look through the clusters of edges together
SLACK = 1e-9
QUICK = 2**22  # samples and edges looked at: about a millisecond, less than other threads take to start


def hidden_samples(shape: GridContours, directions: Float[Tensor, "directions 3"]) -> Bool[Tensor, "directions points"]:
    """Returns whether an occluder hides each direction from the centre of each of the receiver's samples.

    Directions with z <= 0 are hidden from every sample: the plane itself is in the way.

    Args:
        shape: the contours on the receiver's grid, with one line per row of samples.
        directions: towards the light, of any length.
    """
    towards = torch.nn.functional.normalize(directions.detach().double().cpu(), dim=-1).numpy()
    grid, kernel = shape.grid, kernel_or_none()
    result = np.zeros((len(towards), grid.rows * grid.columns), dtype=bool)
    result[towards[:, 2] <= 0] = True
    upward = np.flatnonzero(towards[:, 2] > 0)
    if kernel is None:
        faces, slopes = grid.places(shape.contours.faces), grid.slopes(towards[upward])
        result[upward] = contour_twin.hidden_samples(faces, slopes, grid.rows, grid.columns)
    else:
        mark(kernel, shape, towards, upward[np.argsort(morton(towards[upward]), kind="stable")], result)
    return torch.from_numpy(result)


def mark(
    kernel: ModuleType,
    shape: GridContours,
    directions: Float[np.ndarray, "directions 3"],
    order: Int[np.ndarray, " upward"],
    result: Bool[np.ndarray, "directions points"],
) -> None:
    """Marks what is hidden from directions taken in an order that keeps neighbours together, a bundle per thread."""
    contours, grid = shape.contours, shape.grid

    def fill(begin: int, count: int = BUNDLE) -> None:
        numbers = order[begin : begin + count]
        bundle = directions[numbers]
        kernel.hidden_samples(
            contours.axes,
            contours.spread,
            shape.normals,
            shape.sides,
            shape.ends,
            cone_about(bundle),
            bundle,
            grid.slopes(bundle),
            numbers,
            grid.columns,
            result,
        )

    if len(order) == 0:
        return
    work = len(order) * (grid.rows * grid.columns + len(shape.ends))
    if work < QUICK:
        fill(0, len(order))
        return
    for _ in ordered_map(fill, range(0, len(order), BUNDLE)):
        pass


def cone_about(directions: Float[np.ndarray, "directions 3"]) -> Float[np.ndarray, " 4"]:
    """Returns the axis and the half angle of a cone that holds upward unit directions."""
    axis = directions.sum(axis=0)
    axis /= np.linalg.norm(axis)
    return np.r_[axis, np.arccos(np.clip((directions @ axis).min(), -1.0, 1.0)) + SLACK]
