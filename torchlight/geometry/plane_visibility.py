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
from torchlight.threads import ordered_map, thread_count

BUNDLE = 32  # neighbouring directions that look through the clusters of edges together
QUICK = 2**22  # samples and edges looked at: about a millisecond, less than other threads take to start


def hidden_samples(shape: GridContours, directions: Float[Tensor, "directions 3"]) -> Bool[Tensor, "directions points"]:
    """Returns whether an occluder hides each direction from the centre of each of the receiver's samples.

    Directions with z <= 0 are hidden from every sample: the plane itself is in the way.

    Args:
        shape: the contours on the receiver's grid, with one line per row of samples.
        directions: towards the light, of any length.
    """
    towards = directions.detach().double().cpu().numpy()
    towards = towards / np.maximum(np.sqrt(np.einsum("di,di->d", towards, towards)), 1e-300)[:, None]
    grid, kernel = shape.grid, kernel_or_none("visibility_kernel")
    result = np.zeros((len(towards), grid.rows * grid.columns), dtype=bool)
    result[towards[:, 2] <= 0] = True
    upward = np.flatnonzero(towards[:, 2] > 0)
    if kernel is None:
        faces, slopes = grid.places(shape.contours.faces), grid.slopes(towards[upward])
        result[upward] = contour_twin.hidden_samples(faces, slopes, grid.rows, grid.columns)
    else:
        mark(kernel, shape, towards, neighbours_together(towards, upward, shape.axes.shape[1]), result)
    return torch.from_numpy(result)


def neighbours_together(
    directions: Float[np.ndarray, "directions 3"], upward: Int[np.ndarray, " upward"], clusters: int
) -> Int[np.ndarray, " upward"]:
    """Returns the same numbers of directions in an order that lets a bundle skip clusters, where it pays."""
    return upward[np.argsort(morton(directions[upward]), kind="stable")] if clusters > BUNDLE else upward


def mark(
    kernel: ModuleType,
    shape: GridContours,
    directions: Float[np.ndarray, "directions 3"],
    order: Int[np.ndarray, " upward"],
    result: Bool[np.ndarray, "directions points"],
) -> None:
    """Marks what is hidden from directions taken in an order that keeps neighbours together, a bundle at a time."""
    grid, ordered = shape.grid, directions[order]
    slopes, columns, clusters = grid.slopes(ordered), np.ascontiguousarray(ordered.T), shape.clusters

    def fill(begin: int) -> None:
        part = slice(begin, begin + BUNDLE)
        bundle = np.ascontiguousarray(columns[:, part])
        kernel.hidden_samples(shape.axes, clusters, bundle, slopes[part], order[part], grid.columns, result)

    work = len(order) * (grid.rows * grid.columns + len(shape.edges))
    for _ in ordered_map(fill, range(0, len(order), BUNDLE), 1 if work < QUICK else thread_count()):
        pass
