"""How much of every sample the occluders hide, without a ray: contour crossings on the receiver's grid.

The number of sheets over a plane point (`geometry.contours`) changes only where a contour's projection is crossed.
Along a line of the grid the crossings, sorted by x, bound the hidden intervals: one begins where the number leaves 0
and ends where it returns. The share of each footprint that they cover is exact.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
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
        ends: a row per edge: x, y, z of both ends and two zeros.
        fields: a column per edge: y and z of both ends, two normals (an open edge has its one twice), two sides.
        clusters: the fields of each cluster of edges and x of both ends; 0 beyond the last edge.
        axes: of the clusters: x, y, z, and the sine and cosine of their spread; 2 and 0 where it may be any.
    """

    contours: Contours
    grid: Grid
    ends: Float[np.ndarray, "room 8"]
    fields: Float[np.ndarray, "12 room"]
    clusters: Float[np.ndarray, "clusters 14 cluster"]
    axes: Float[np.ndarray, "5 clusters"]


def on_grid(contours: Contours, receiver: Receiver, lines: int) -> GridContours:
    """Returns contours on a receiver's grid.

    Args:
        contours: of the occluders.
        receiver: whose samples are asked.
        lines: per row of samples; along them shares are exact, over them they are a mean.
    """
    grid, count = receiver_grid(receiver, lines), len(contours.ends)
    normals = grid.normals(contours.normals)
    normals[:, 1] = np.where(contours.sides[:, 1:] == 0, normals[:, 0], normals[:, 1])
    room = count // 512 * 512 + 552  # rows fall into different sets of the processor's cache
    ends, fields = np.zeros((room, 8)), np.zeros((12, room))
    ends[:count, :6] = grid.places(contours.ends).reshape(count, 6)
    fields[:4] = ends.T[[1, 2, 4, 5]]
    fields[4:10, :count] = normals.reshape(count, 6).T
    fields[10:, :count] = contours.sides.T
    full = len(contours.axes) * CLUSTER
    clusters = np.concatenate([fields[:, :full], ends[:full].T[[0, 3]]]).reshape(14, -1, CLUSTER).transpose(1, 0, 2)
    return GridContours(contours, grid, ends, fields, np.ascontiguousarray(clusters), cluster_axes(contours))


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
    room = len(shape.clusters)*CLUSTER+40
    at,most=256,32
    ar=[np.empty((7,room)),*(np.empty((12,room),np.float32) for _ in range(3)),np.arange(room).astype(np.uint32),*(np.empty(room,np.uint32) for _ in range(2)),np.empty(room,np.float32),np.empty((2,room),np.uint32),np.empty(shape.axes.shape[1]),np.empty(shape.axes.shape[1],np.uint32),
       np.empty((grid.rows*grid.lines,most),np.int64),np.zeros(grid.rows*grid.lines,np.int64),np.empty(at,np.uint32),np.empty(at,np.int32),np.empty(at,np.int32),np.empty(at,np.int64),np.empty(at),np.empty((3,3)),np.empty(4),
       np.empty((grid.rows,grid.columns+1),np.int64),np.empty((4,64),np.int32),np.empty((room,16))]
    done=0
    E=len(contours.ends)
    if not hasattr(shape,'slim'):
        object.__setattr__(shape,'slim',np.ascontiguousarray(shape.clusters[:,:12]).astype(np.float32))
        object.__setattr__(shape,'edges',np.concatenate([shape.ends[:,:6],shape.fields[4:].T,np.zeros((shape.ends.shape[0],2))],1))
        y=shape.ends[:E][:,[1,4]]
        object.__setattr__(shape,'box',np.array([y.min(),y.max(),shape.ends[:E][:,[2,5]].max(),abs(y).max(),abs(shape.fields[[4,7]]).max(),abs(shape.fields[[5,8]]).max()]))
    while done<len(slopes):
      done=kernel.visible_integrals(
        shape.axes,
        shape.slim,
        shape.edges,
        shape.box,
        cones(rectangles).numpy(),
        grid.directions(torch.stack([rectangles.center, rectangles.right, rectangles.up], dim=1).numpy()),
        slopes,
        shifts,
        (rectangles.weights / scales[:, None, None] * (UNIT / grid.lines)).round().long().numpy(),
        scales.numpy(),
        grid.columns,
        grid.lines,
        result,
        *ar,done,
    )
      most*=2
      ar[11]=np.empty((grid.rows*grid.lines,most),np.int64); ar[12][:]=0
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
    """Returns the unit axis and the half angle, in radians, of a cone about each rectangle."""
    axis = torch.nn.functional.normalize(rectangles.center, dim=-1)
    signs = [(a, b) for a in (-1, 1) for b in (-1, 1)]
    corners = torch.stack([rectangles.center + a * rectangles.right + b * rectangles.up for a, b in signs], dim=1)
    sine = torch.linalg.vector_norm(torch.linalg.cross(axis[:, None].expand_as(corners), corners, dim=-1), dim=-1)
    angle = torch.atan2(sine, (corners * axis[:, None]).sum(dim=-1)).amax(dim=1)
    return torch.cat([axis, angle.cos()[:, None], angle.sin()[:, None]], dim=1)
