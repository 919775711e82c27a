"""Signed contour crossings as tensor operations: the transport of `geometry.contour_kernel` where torch computes.

`geometry.contours` states the method. Nothing here loops over edges, directions or lines:

    pairs      an edge and a square of directions for some of which it may be a contour
    meetings   a pair and a direction for which it is one, and meets lines of the grid
    crossings  a meeting and one of its lines: the place, and what it adds to the number of sheets

Sorted by line and place, the running sum of the steps is the number of sheets right of each crossing (over a whole line
they add up to 0, so that no line disturbs the next). Where it leaves 0 or returns, the hidden share of each sample to
the right changes: two integers into a table of differences, whose sum along a row is the shadow. Integers add up to the
same in any order, so the sums do not depend on how a GPU takes them.

A face's sign must come out equal to the bit for all its edges. It is therefore written as products and sums of whole
tensors, each of which rounds every element alike; a matrix product may not.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchlight.geometry.crossings import UNIT, Grid, GridContours, Rectangles

CERTAIN = 1e-11  # of n . d for a unit normal and a direction to a face of the cube: beyond it a sign is known
PAIRS_AT_ONCE = 2**24  # of all edges with squares: 128 MiB a tensor
DIRECTIONS_AT_ONCE = 2**22  # of pairs with the directions of their squares: 32 MiB a tensor, a dozen tensors


@dataclass(frozen=True, eq=False)
class DeviceContours:
    """Edges on a receiver's grid (`crossings.GridContours`), as tensors.

    Attributes:
        grid: the receiver's coordinates.
        ends: x, y, z of both ends.
        normals: of the first and the second face; an open edge has its one twice.
        sides: o_ef of these faces; 0 for no face.
    """

    grid: Grid
    ends: Float[Tensor, "2 3 edges"]
    normals: Float[Tensor, "2 3 edges"]
    sides: Float[Tensor, "2 edges"]

    def component(
        self, face: int, edge: Int[Tensor, " pairs"], slopes: Float[Tensor, "pairs d 2"]
    ) -> Float[Tensor, "pairs d"]:
        """Returns n . (x, y, 1) of a face of each edge."""
        x, y, z = self.normals[face][:, edge, None]
        return x * slopes[..., 0] + y * slopes[..., 1] + z


def on_device(shape: GridContours, device: torch.device | str) -> DeviceContours:
    """Returns the edges on a device."""
    edges = torch.from_numpy(np.ascontiguousarray(shape.edges[: len(shape.contours.ends), :14].T)).to(device)
    return DeviceContours(shape.grid, edges[:6].unflatten(0, (2, 3)), edges[6:12].unflatten(0, (2, 3)), edges[12:])


def visible_integrals(shape: DeviceContours, rectangles: Rectangles) -> Float[Tensor, "squares points"]:
    """Returns what `crossings.visible_integrals` does, on the device of its arguments, where the host waits for sizes.

    It waits a few times for every `DIRECTIONS_AT_ONCE`.
    """
    grid, scales = shape.grid, rectangles.weights.sum(dim=(1, 2))
    weights = (rectangles.weights / scales[:, None, None] * (UNIT / grid.lines)).round().long().flatten(1)
    slopes = grid_slopes(grid, rectangles.directions).flatten(1, 2)
    shifts = rectangles.shifts.flatten(1)
    parts = []
    for part, square, edge in pairs(shape, rectangles):
        hidden = shadows(shape, square, edge, slopes[part], shifts[part], weights[part])
        total = weights[part].sum(dim=1)[:, None, None] * grid.lines
        share = (total - hidden).double() / total.double()
        parts.append((scales[part, None, None] * share).flatten(1))
    return torch.cat(parts)


def grid_slopes(grid: Grid, directions: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 2"]:
    """Returns dx / dz and dy / dz in the grid's coordinates, rounded as `Grid.slopes` rounds them."""
    scaled = torch.stack([directions[..., axis] * grid.scale[axis] for axis in range(2)], dim=-1)
    return scaled / directions[..., 2:]


def pairs(
    shape: DeviceContours, rectangles: Rectangles
) -> Iterator[tuple[slice, Int[Tensor, " pairs"], Int[Tensor, " pairs"]]]:
    """Yields some squares, and which edges may be contours within which of them (numbered from the first)."""
    squares, along = rectangles.weights.shape[:2]
    edges = shape.sides.shape[1]
    step = max(1, PAIRS_AT_ONCE // max(1, edges))
    for start in range(0, squares, step):
        chosen = may_be_contours(shape, rectangles, slice(start, min(start + step, squares)))
        counts = chosen.sum(dim=1).tolist()
        first = 0
        while first < len(counts):
            last, left = first + 1, DIRECTIONS_AT_ONCE // along**2 - counts[first]
            while last < len(counts) and counts[last] <= left:
                left -= counts[last]
                last += 1
            square, edge = chosen[first:last].nonzero(as_tuple=True)
            yield slice(start + first, start + last), square, edge
            first = last


def may_be_contours(shape: DeviceContours, rectangles: Rectangles, part: slice) -> Bool[Tensor, "squares edges"]:
    """Returns which edges may separate faces turned towards the light from others, for some direction of a square."""
    scale = rectangles.center.new_tensor([*shape.grid.scale, 1.0])
    center, right, up = (each[part] * scale for each in (rectangles.center, rectangles.right, rectangles.up))
    facing = []
    for normals in shape.normals:
        middle, reach = center @ normals, (right @ normals).abs() + (up @ normals).abs() + CERTAIN
        facing.append((middle > reach).to(middle) - (middle < -reach).to(middle))
    known = shape.sides[0] * facing[0] + shape.sides[1] * facing[1]
    return (facing[0] == 0) | (facing[1] == 0) | (known != 0)


def shadows(
    shape: DeviceContours,
    square: Int[Tensor, " pairs"],
    edge: Int[Tensor, " pairs"],
    slopes: Float[Tensor, "squares d 2"],
    shifts: Float[Tensor, "squares d"],
    weights: Int[Tensor, "squares d"],
) -> Int[Tensor, "squares rows columns"]:
    """Returns the weight of the directions from which each sample is hidden, shares of footprints included."""
    grid = shape.grid
    line, place, step = crossings(shape, square, edge, slopes, shifts)
    order = place.argsort()
    line, by_line = line[order].sort(stable=True)
    place, step = place[order][by_line], step[order][by_line]
    sheets = step.cumsum(dim=0)
    begins, ends = (sheets == step) & (sheets != 0), (sheets != step) & (sheets == 0)
    weight = weights.flatten()[line // (grid.rows * grid.lines)] * (begins.long() - ends.long())
    row = line // (slopes.shape[1] * grid.rows * grid.lines) * grid.rows + line // grid.lines % grid.rows
    column = place.floor()
    left = (weight * (column + 1 - place)).round().long()
    cell = row * (grid.columns + 2) + column.long()  # two columns more, for what begins or ends right of the grid
    table = weight.new_zeros(len(slopes) * grid.rows * (grid.columns + 2))
    table.index_add_(0, cell, left).index_add_(0, cell + 1, weight - left)
    return table.view(len(slopes), grid.rows, -1)[..., : grid.columns].cumsum(dim=-1)


def crossings(
    shape: DeviceContours,
    square: Int[Tensor, " pairs"],
    edge: Int[Tensor, " pairs"],
    slopes: Float[Tensor, "squares d 2"],
    shifts: Float[Tensor, "squares d"],
) -> tuple[Int[Tensor, " crossings"], Float[Tensor, " crossings"], Int[Tensor, " crossings"]]:
    """Returns where contours cross lines of the grid: the line, the place on it and the step in the number of sheets.

    Lines are numbered through all directions of all squares; places beyond the grid's sides lie on them.
    """
    grid, seen = shape.grid, slopes[square]
    lines = grid.rows * grid.lines
    sides = shape.sides[:, edge, None]
    one, two = (torch.where(shape.component(k, edge, seen) > 0, sides[k], -sides[k]) for k in range(2))
    y, shift = seen[..., 1], shifts[square]
    (x0, y0, z0), (x1, y1, z1) = (end[:, edge, None] for end in shape.ends)
    t0, t1 = y0 - y * z0 - shift, y1 - y * z1 - shift
    begin = torch.minimum(t0, t1).ceil().clamp(0, lines)
    count = (torch.maximum(t0, t1).ceil().clamp(0, lines) - begin).long() * (one + two != 0)
    pair, direction = count.nonzero(as_tuple=True)
    met = pair, direction
    count, begin, t0, t1 = count[met], begin[met].long(), t0[met], t1[met]
    step = torch.where(t0 < t1, -(one + two)[met], (one + two)[met]).long()
    x = seen[..., 0][met]
    x0, x1 = x0[pair, 0] - x * z0[pair, 0], x1[pair, 0] - x * z1[pair, 0]
    slope = (x1 - x0) / (t1 - t0)

    meeting = torch.repeat_interleave(torch.arange(len(pair), device=edge.device), count)
    line = torch.arange(len(meeting), device=edge.device) - (count.cumsum(dim=0) - count - begin)[meeting]
    place = (x0[meeting] + (line - t0[meeting]) * slope[meeting]).clamp(0, grid.columns)
    number = square[pair] * slopes.shape[1] + direction
    return number[meeting] * lines + line, place, step[meeting]
