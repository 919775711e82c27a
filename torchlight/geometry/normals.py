"""Normals of a triangle soup: of its faces, and smoothed over the edges that are not creases."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float, Int
from torch import Tensor

CREASE_DEGREES = 40.0  # between the normals of two faces: beyond it an edge is meant to be seen
PAIRS_AT_ONCE = 4_000_000


def face_normals(triangles: Float[Tensor, "faces 3 3"]) -> Float[Tensor, "faces 3"]:
    """Returns unit normals, counter-clockwise from outside; 0 where a face has no area."""
    normal = torch.linalg.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    return torch.nn.functional.normalize(normal, dim=-1, eps=1e-300)


def corner_normals(
    triangles: Float[Tensor, "faces 3 3"], crease_degrees: float = CREASE_DEGREES
) -> Float[Tensor, "faces 3 3"]:
    """Returns a unit normal for every corner of every face, float64, for shading a curved surface made of faces.

    It is the mean of the normals of all faces that have this corner and lie within the crease angle of this face,
    weighted by their angles there (Thuermer and Wuethrich 1998). Corners are the same where their coordinates are.
    """
    corners = triangles.double()
    normals = face_normals(corners)
    _, vertex = corners.reshape(-1, 3).unique(dim=0, return_inverse=True)
    weighted = corner_angles(corners).reshape(-1, 1) * normals.repeat_interleave(3, dim=0)
    order = vertex.argsort(stable=True)
    counts = torch.bincount(vertex)
    starts = counts.cumsum(0) - counts
    smooth = torch.empty_like(weighted)
    # so many corners at once that their pairs with all corners of the same vertex stay few
    ends = counts[vertex].cumsum(0)
    cuts = torch.searchsorted(ends, torch.arange(1, int(ends[-1]) // PAIRS_AT_ONCE + 1) * PAIRS_AT_ONCE)
    for part in torch.arange(len(vertex)).tensor_split(cuts.unique()):
        smooth[part] = _smoothed(part, vertex, order, starts, counts, normals, weighted, crease_degrees)
    return torch.nn.functional.normalize(smooth, dim=-1, eps=1e-300).reshape(-1, 3, 3)


def corner_angles(corners: Float[Tensor, "faces 3 3"]) -> Float[Tensor, "faces 3"]:
    """Returns the angle of each face at each of its corners, in radians."""
    onward = torch.nn.functional.normalize(corners.roll(-1, 1) - corners, dim=-1, eps=1e-300)
    back = torch.nn.functional.normalize(corners.roll(1, 1) - corners, dim=-1, eps=1e-300)
    return torch.acos((onward * back).sum(dim=-1).clamp(-1, 1))


def _smoothed(
    part: Int[Tensor, " some"],
    vertex: Int[Tensor, " corners"],
    order: Int[Tensor, " corners"],
    starts: Int[Tensor, " vertices"],
    counts: Int[Tensor, " vertices"],
    normals: Float[Tensor, "faces 3"],
    weighted: Float[Tensor, "corners 3"],
    crease_degrees: float,
) -> Float[Tensor, "some 3"]:
    """Returns the sums of the weighted normals round some corners."""
    number = counts[vertex[part]]
    mine = torch.arange(len(part)).repeat_interleave(number)
    within = torch.arange(len(mine)) - (number.cumsum(0) - number)[mine]
    other = order[starts[vertex[part]][mine] + within]
    cosine = (normals[part[mine] // 3] * normals[other // 3]).sum(dim=-1)
    smooth = cosine >= math.cos(math.radians(crease_degrees)) - 1e-12
    total = torch.zeros(len(part), 3, dtype=weighted.dtype)
    return total.index_add(0, mine[smooth], weighted[other[smooth]])
