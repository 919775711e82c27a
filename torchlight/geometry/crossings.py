"""How much of every sample the occluders hide, without a ray: contour crossings on the receiver's grid.

The number of sheets over a plane point (`geometry.contours`) changes only where a contour's projection is crossed.
Along a line of the grid the crossings, sorted by x, bound the hidden intervals: one begins where the number leaves 0
and ends where it returns. The share of each footprint that they cover is exact.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from types import ModuleType

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchlight.errors import TorchlightWarning
from torchlight.geometry import contour_twin
from torchlight.geometry.contours import CLUSTER, Contours
from torchlight.geometry.receiver import Receiver

UNIT = 2.0**56  # integer weights of a square add up to this
ROOM = 32  # for the crossings of one line at first; doubled when it is not enough
FIELDS = [1, 2, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13]  # of an edge: the rows of a cluster's table


@dataclass(frozen=True, eq=False)
class Rectangles:
    """Directions in s x s equal cells of rectangles on a plane, `center + a right + b up` with |a|, |b| <= 1.

    Attributes:
        center: of each rectangle.
        right: half its width.
        up: half its height.
        directions: unit, with z > 0, row by row from the upper left.
        weights: of the directions.
        shifts: where in its stratum each direction's lines lie, in [0, 1).
    """

    center: Float[Tensor, "squares 3"]
    right: Float[Tensor, "squares 3"]
    up: Float[Tensor, "squares 3"]
    directions: Float[Tensor, "squares s s 3"]
    weights: Float[Tensor, "squares s s"]
    shifts: Float[Tensor, "squares s s"]


@dataclass(frozen=True)
class Grid:
    """The receiver's coordinates: x in columns of samples, y in lines, z in the scene's unit.

    Attributes:
        corner: x and y of the receiver's lower left corner, in the scene's unit.
        scale: columns and lines per unit of length.
        columns: samples in x.
        lines: per row of samples.
        rows: of samples.
    """

    corner: tuple[float, float]
    scale: tuple[float, float]
    columns: int
    lines: int
    rows: int

    def places(self, points: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 3"]:
        """Returns points in the grid's coordinates."""
        return self.directions(points - np.array([*self.corner, 0.0]))

    def directions(self, vectors: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 3"]:
        """Returns vectors in the grid's coordinates."""
        return vectors * np.array([*self.scale, 1.0])

    def normals(self, normals: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 3"]:
        """Returns normals of any length in the grid's coordinates: n . d stays what it is."""
        return normals / np.array([*self.scale, 1.0])

    def slopes(self, directions: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 2"]:
        """Returns dx / dz and dy / dz in the grid's coordinates."""
        return np.ascontiguousarray(self.directions(directions)[..., :2] / directions[..., 2:])


def receiver_grid(receiver: Receiver, lines: int) -> Grid:
    """Returns the grid of a receiver with so many lines per row of samples."""
    (x, y), (width, height) = receiver.center, receiver.size
    step_x, step_y = receiver.footprint
    columns, rows = receiver.samples
    return Grid((x - width / 2, y - height / 2), (1 / step_x, lines / step_y), columns, lines, rows)


@dataclass(frozen=True, eq=False)
class GridContours:
    """The contours on a receiver's grid, as the kernels read them.

    Attributes:
        contours: the edges, in the scene's unit.
        grid: the receiver's coordinates.
        edges: a row per edge: x, y, z of both ends (0 to 5), two normals (6 to 11; an open edge has its one twice), the
            sides of the two faces (12, 13) and two zeros; zeros alone beyond the last edge.
        narrow: a table per cluster, in float32: a column per edge, and for rows y and z of both ends (0 to 3), the two
            normals (4 to 9) and the sides (10, 11).
        axes: of the clusters: x, y, z, and the sine and cosine of their spread; 2 and 0 where it may be any.
        reach: the least and the largest y, the largest z, the largest |y|, and the largest |x| and |y| of a normal.
    """

    contours: Contours
    grid: Grid
    edges: Float[np.ndarray, "room 16"]
    narrow: Float[np.ndarray, "clusters 12 cluster"]
    axes: Float[np.ndarray, "5 clusters"]
    reach: Float[np.ndarray, " 6"]

    @cached_property
    def clusters(self) -> Float[np.ndarray, "clusters 14 cluster"]:
        """The tables in float64, and x of both ends (12, 13)."""
        return by_cluster(self.edges, [*FIELDS, 0, 3], torch.float64)


def on_grid(contours: Contours, receiver: Receiver, lines: int) -> GridContours:
    """Returns contours on a receiver's grid.

    Args:
        contours: of the occluders.
        receiver: whose samples are asked.
        lines: per row of samples; along them shares are exact, over them they are a mean.
    """
    grid, count = receiver_grid(receiver, lines), len(contours.ends)
    edges = np.zeros((len(contours.axes) * CLUSTER, 16))
    edges[:count, :6] = grid.places(contours.ends).reshape(count, 6)
    edges[:count, 6:12] = grid.normals(contours.normals).reshape(count, 6)
    edges[:count, 12:14] = contours.sides
    single = np.flatnonzero(contours.sides[:, 1] == 0)
    edges[single, 9:12] = edges[single, 6:9]
    narrow = by_cluster(edges, FIELDS, torch.float32)
    return GridContours(contours, grid, edges, narrow, cluster_axes(contours), reach_of(edges[:count]))


def by_cluster(
    edges: Float[np.ndarray, "room 16"], fields: list[int], dtype: torch.dtype
) -> Float[np.ndarray, "clusters fields cluster"]:
    """Returns some columns of all edges as a table per cluster."""
    tables = torch.from_numpy(edges).to(dtype).reshape(-1, CLUSTER, edges.shape[1]).transpose(1, 2)
    return tables[:, fields].contiguous().numpy()


def reach_of(edges: Float[np.ndarray, "edges 16"]) -> Float[np.ndarray, " 6"]:
    """Returns the least and the largest y, the largest z, the largest |y|, and the largest |x| and |y| of a normal."""
    if len(edges) == 0:
        return np.zeros(6)
    low, high = torch.from_numpy(edges).amin(dim=0).numpy(), torch.from_numpy(edges).amax(dim=0).numpy()
    largest = np.maximum(-low, high)
    least, most = low[[1, 4]].min(), high[[1, 4]].max()
    across, along = largest[[6, 9]].max(), largest[[7, 10]].max()
    return np.array([least, most, high[[2, 5]].max(), max(-least, most), across, along])


def cluster_axes(contours: Contours) -> Float[np.ndarray, "5 clusters"]:
    """Returns the axes of clusters with sine and cosine of their spread; 2 and 0 from a right angle on."""
    narrow = contours.spread < np.pi / 2
    sine = np.where(narrow, np.sin(contours.spread), 2.0)
    cosine = np.where(narrow, np.cos(contours.spread), 0.0)
    return np.vstack([contours.axes.T, sine, cosine])


def visible_integrals(shape: GridContours, rectangles: Rectangles) -> Float[Tensor, "squares points"]:
    """Returns the sum over each rectangle's directions of weight x visible share of every footprint, float64."""
    contours, grid = shape.contours, shape.grid
    slopes, shifts = grid.slopes(rectangles.directions.numpy()), rectangles.shifts.numpy()
    scales = rectangles.weights.sum(dim=(1, 2))
    kernel = compiled_kernel("contour_kernel")
    if kernel is None:
        size = (grid.rows, grid.columns, grid.lines)
        faces, weights = grid.places(contours.faces), rectangles.weights.numpy()
        return torch.from_numpy(contour_twin.visible_integrals(faces, slopes, shifts, weights, size))
    result = np.empty((len(scales), grid.rows * grid.columns))
    lit = (rectangles.weights / scales[:, None, None] * (UNIT / grid.lines)).round().long().numpy()
    frames = grid.directions(torch.stack([rectangles.center, rectangles.right, rectangles.up], dim=1).numpy())
    scene = (shape.axes, shape.narrow, shape.edges, shape.reach)
    squares = (cones(rectangles).numpy(), frames, slopes, shifts, lit, scales.numpy())
    tables, room, done = kernel.empty_tables(len(shape.axes.T)), ROOM, 0
    while done < len(result):
        lists = kernel.empty_lists(grid.rows, grid.columns, grid.lines, room)
        done = kernel.visible_integrals(*scene, *squares, grid.columns, grid.lines, *tables, *lists, done, result)
        room *= 2  # it stopped where a line had more crossings
    return torch.from_numpy(result)


def compiled_kernel(name: str) -> ModuleType | None:
    """Returns a compiled kernel, or None with a warning where numba has no wheel: the twin is the stated fallback."""
    try:
        return import_module(f"torchlight.geometry.{name}")
    except ImportError:
        message = "numba is not installed: shadows are found by the slow twin of the compiled kernel"
        warnings.warn(message, TorchlightWarning, stacklevel=3)
        return None


def cones(rectangles: Rectangles) -> Float[Tensor, "squares 5"]:
    """Returns the unit axis of a cone about each rectangle, and the cosine and the sine of its half angle."""
    axis = torch.nn.functional.normalize(rectangles.center, dim=-1)
    signs = [(a, b) for a in (-1, 1) for b in (-1, 1)]
    corners = torch.stack([rectangles.center + a * rectangles.right + b * rectangles.up for a, b in signs], dim=1)
    sine = torch.linalg.vector_norm(torch.linalg.cross(axis[:, None].expand_as(corners), corners, dim=-1), dim=-1)
    angle = torch.atan2(sine, (corners * axis[:, None]).sum(dim=-1)).amax(dim=1)
    return torch.cat([axis, angle.cos()[:, None], angle.sin()[:, None]], dim=1)
