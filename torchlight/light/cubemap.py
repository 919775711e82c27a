"""The cube map: faces, texels, and the part of it a plane can see.

Faces come in the order +x -x +y -y +z -z; a plane's map has the first five. A point of a face has coordinates
u (to the right) and v (up) in [-1, 1] and lies in the direction `forward + u right + v up`, seen from inside:

    face    +x  -x  +y  -y  +z  -z
    right   -y  +y  +x  -x  -y  -y
    up      +z  +z  +z  +z  -x  +x

so the bottom row of +z touches the top row of +x. Texel (face, row, col) of an N x N map has the index
`face N^2 + row N + col` and the centre `u = 2 (col + 1/2) / N - 1`, `v = 1 - 2 (row + 1/2) / N`.

Radiance below the plane z = 0 is 0 by definition, so light over a plane is a vector over the visible texels only:
those with some part above z = 0, in the order of their five-face index (3 N^2 of them for an even N).
A texel that straddles the horizon (odd N) counts by its upper part.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchlight.errors import ShapeError

FACES = ("+x", "-x", "+y", "-y", "+z", "-z")
PLANE_FACES = 5
TOP_FACE = 4


def face_frames(
    *, dtype: torch.dtype = torch.float64, device: torch.device | str = "cpu"
) -> Float[Tensor, "6 axes=3 3"]:
    """Returns each face's right, up and forward vectors, as the rows of one matrix per face."""
    frames = [
        [[0, -1, 0], [0, 0, 1], [1, 0, 0]],
        [[0, 1, 0], [0, 0, 1], [-1, 0, 0]],
        [[1, 0, 0], [0, 0, 1], [0, 1, 0]],
        [[-1, 0, 0], [0, 0, 1], [0, -1, 0]],
        [[0, -1, 0], [-1, 0, 0], [0, 0, 1]],
        [[0, -1, 0], [1, 0, 0], [0, 0, -1]],
    ]
    return torch.tensor(frames, dtype=dtype, device=device)


def face_directions(
    face: Int[Tensor, "*batch"], u: Float[Tensor, "*batch"], v: Float[Tensor, "*batch"]
) -> Float[Tensor, "*batch 3"]:
    """Returns the unit direction of the point (u, v) of a face.

    Args:
        face: 0 to 5 in the order of `FACES`.
        u: to the right, in [-1, 1].
        v: up, in [-1, 1].
    """
    frames = face_frames(dtype=u.dtype, device=u.device)[face]
    local = torch.stack([u, v, torch.ones_like(u)], dim=-1)
    return torch.nn.functional.normalize((local[..., None, :] @ frames)[..., 0, :], dim=-1)


def locate(
    directions: Float[Tensor, "*batch 3"],
) -> tuple[Int[Tensor, "*batch"], Float[Tensor, "*batch"], Float[Tensor, "*batch"]]:
    """Returns (face, u, v) of each direction, the inverse of `face_directions`.

    Directions need not be unit vectors. Those on an edge go to the first of the faces that share it.
    Face 5 (-z) is not part of a plane's map: light there is 0.
    """
    frames = face_frames(dtype=directions.dtype, device=directions.device)
    face = (directions @ frames[:, 2].T).argmax(dim=-1)
    local = (frames[face] @ directions[..., None])[..., 0]
    return face, local[..., 0] / local[..., 2], local[..., 1] / local[..., 2]


def texel_index(directions: Float[Tensor, "*batch 3"], resolution: int) -> Int[Tensor, "*batch"]:
    """Returns the index, in the six-face map, of the texel that each direction falls into."""
    face, u, v = locate(directions)
    column = ((u + 1) * (resolution / 2)).long().clamp(0, resolution - 1)
    row = ((1 - v) * (resolution / 2)).long().clamp(0, resolution - 1)
    return (face * resolution + row) * resolution + column


def texel_directions(
    resolution: int, faces: int = 6, *, dtype: torch.dtype = torch.float64, device: torch.device | str = "cpu"
) -> Float[Tensor, "texels 3"]:
    """Returns the unit direction of every texel's centre, for the first five or for all six faces."""
    index = torch.arange(faces * resolution**2, device=device)
    u = 2 * ((index % resolution).double() + 0.5) / resolution - 1
    v = 1 - 2 * ((index // resolution % resolution).double() + 0.5) / resolution
    return face_directions(index // resolution**2, u, v).to(dtype)


def solid_angles(
    resolution: int, *, dtype: torch.dtype = torch.float64, device: torch.device | str = "cpu"
) -> Float[Tensor, "{resolution} {resolution}"]:
    """Returns the exact solid angle of every texel of one face, in steradians; the same for all faces."""
    edges = torch.linspace(-1, 1, resolution + 1, dtype=torch.float64, device=device)
    corner = _solid_angle_to(edges[:, None], edges[None, :])
    return corner.diff(dim=0).diff(dim=1).to(dtype)


def _solid_angle_to(u: Float[Tensor, "*#grid"], v: Float[Tensor, "*#grid"]) -> Float[Tensor, "*grid"]:
    """Returns the signed solid angle of the rectangle from (0, 0) to (u, v) at distance 1."""
    return torch.atan2(u * v, torch.sqrt(u * u + v * v + 1))


# --- the plane's unknowns ------------------------------------------------------------------------------------------


def visible_texels(resolution: int, *, device: torch.device | str = "cpu") -> Int[Tensor, " texels"]:
    """Returns the five-face indices of the texels that have some part above z = 0, in ascending order."""
    index = torch.arange(PLANE_FACES * resolution**2, device=device)
    on_top = index >= TOP_FACE * resolution**2
    row = index // resolution % resolution
    return index[on_top | (2 * row < resolution)]


def texel_count(resolution: int) -> int:
    """Returns the number of visible texels: 3 N^2 for an even N, 3 N^2 + 2 N for an odd one."""
    return resolution**2 + 4 * resolution * ((resolution + 1) // 2)


def scatter_to_faces(
    values: Float[Tensor, "*batch texels"], resolution: int
) -> Float[Tensor, "*batch 5 {resolution} {resolution}"]:
    """Returns the five faces that hold the given visible texels, 0 below the horizon."""
    if values.shape[-1] != texel_count(resolution):
        raise ShapeError(
            f"scatter_to_faces: resolution {resolution} has {texel_count(resolution)} visible texels, "
            f"got {values.shape[-1]}; pass the resolution the values were made for"
        )
    faces = values.new_zeros(*values.shape[:-1], PLANE_FACES * resolution**2)
    faces = faces.index_copy(-1, visible_texels(resolution, device=values.device), values)
    return faces.unflatten(-1, (PLANE_FACES, resolution, resolution))


def gather_from_faces(faces: Float[Tensor, "*batch faces rows rows"]) -> Float[Tensor, "*batch texels"]:
    """Returns the visible texels of a map of five or six faces, the inverse of `scatter_to_faces`."""
    visible = visible_texels(faces.shape[-1], device=faces.device)
    return faces.flatten(start_dim=-3).index_select(-1, visible)


# --- texels cut into cells -----------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Cells:
    """Axis-aligned rectangles on the faces: u runs from left to right, v from bottom to top, v >= 0 on side faces."""

    face: Int[Tensor, "*cells"]
    left: Float[Tensor, "*cells"]
    right: Float[Tensor, "*cells"]
    bottom: Float[Tensor, "*cells"]
    top: Float[Tensor, "*cells"]


def texel_cells(resolution: int, subsamples: int = 1, *, device: torch.device | str = "cpu") -> Cells:
    """Returns the visible part of every visible texel cut into subsamples x subsamples equal rectangles, in float64.

    The shape is [texels, subsamples^2]; cells of a texel run row by row from its upper left corner.
    """
    return cut(whole_texels(resolution, device=device), subsamples)


def whole_texels(resolution: int, *, device: torch.device | str = "cpu") -> Cells:
    """Returns the visible part of every visible texel, [texels], in float64."""
    index = visible_texels(resolution, device=device)
    row, column = index // resolution % resolution, index % resolution
    return _rectangles(index // resolution**2, row, column, torch.full_like(index, resolution))


def square_cells(squares: Int[Tensor, "squares 4"]) -> Cells:
    """Returns the visible part of squares (face, level, row, column), in float64: texels of a map of 2^level."""
    face, level, row, column = squares.unbind(dim=1)
    return _rectangles(face, row, column, 2**level)


def _rectangles(
    face: Int[Tensor, " cells"], row: Int[Tensor, " cells"], column: Int[Tensor, " cells"], edge: Int[Tensor, " cells"]
) -> Cells:
    """Returns the visible part of texels, each of a map with its own number of texels along an edge."""
    left = 2 * column.double() / edge - 1
    top = 1 - 2 * row.double() / edge
    bottom = top - 2 / edge.double()
    bottom = torch.where(face == TOP_FACE, bottom, bottom.clamp(min=0.0))
    return Cells(face, left, left + 2 / edge.double(), bottom, top)


def cut(cells: Cells, parts: int) -> Cells:
    """Returns every cell cut into parts x parts equal ones, [cells, parts^2], row by row from its upper left corner."""
    part = torch.arange(parts**2, device=cells.face.device)
    row, column = (part // parts).double(), (part % parts).double()
    left, top = cells.left[:, None], cells.top[:, None]
    width, height = (cells.right[:, None] - left) / parts, (top - cells.bottom[:, None]) / parts
    return Cells(
        face=cells.face[:, None].expand(-1, parts**2),
        left=left + column * width,
        right=left + (column + 1) * width,
        bottom=top - (row + 1) * height,
        top=top - row * height,
    )


def cell_directions(cells: Cells) -> Float[Tensor, "*cells 3"]:
    """Returns the unit direction of each cell's centre in face coordinates."""
    return face_directions(cells.face, (cells.left + cells.right) / 2, (cells.bottom + cells.top) / 2)


def cell_solid_angles(cells: Cells) -> Float[Tensor, "*cells"]:
    """Returns the exact solid angle of each cell, in steradians."""
    upper = _solid_angle_to(cells.right, cells.top) - _solid_angle_to(cells.left, cells.top)
    lower = _solid_angle_to(cells.right, cells.bottom) - _solid_angle_to(cells.left, cells.bottom)
    return upper - lower


def cell_cosine_weights(cells: Cells) -> Float[Tensor, "*cells"]:
    """Returns the exact integral of max(0, z) over each cell.

    With d omega = du dv / r^3 and r^2 = 1 + u^2 + v^2 the integrand is 1 / r^4 on the top face and v / r^4 on the
    sides; both have elementary antiderivatives (the first is the view factor of a parallel rectangle, the second of
    a perpendicular one).
    """
    on_top = cells.face == TOP_FACE
    signs = ((1, cells.right, cells.top), (-1, cells.left, cells.top), (-1, cells.right, cells.bottom))
    total = torch.where(on_top, _top_cosine_to(cells.left, cells.bottom), _side_cosine_to(cells.left, cells.bottom))
    for sign, u, v in signs:
        total = total + sign * torch.where(on_top, _top_cosine_to(u, v), _side_cosine_to(u, v))
    return total


def _top_cosine_to(u: Float[Tensor, "*cells"], v: Float[Tensor, "*cells"]) -> Float[Tensor, "*cells"]:
    """Returns the antiderivative of 1 / (1 + u^2 + v^2)^2 in u and v."""
    p, q = torch.sqrt(1 + u * u), torch.sqrt(1 + v * v)
    return 0.5 * (u / p * torch.atan(v / p) + v / q * torch.atan(u / q))


def _side_cosine_to(u: Float[Tensor, "*cells"], v: Float[Tensor, "*cells"]) -> Float[Tensor, "*cells"]:
    """Returns the antiderivative of v / (1 + u^2 + v^2)^2 in u and v."""
    q = torch.sqrt(1 + v * v)
    return -0.5 / q * torch.atan(u / q)


def texel_subdirections(
    resolution: int,
    subsamples: int,
    *,
    dtype: torch.dtype = torch.float64,
    device: torch.device | str = "cpu",
) -> tuple[Float[Tensor, "texels cells 3"], Float[Tensor, "texels cells"]]:
    """Returns the centre direction and the exact solid angle of each cell of each visible texel."""
    cells = texel_cells(resolution, subsamples, device=device)
    return cell_directions(cells).to(dtype), cell_solid_angles(cells).to(dtype)


def cosine_weights(
    resolution: int,
    subsamples: int,
    *,
    dtype: torch.dtype = torch.float64,
    device: torch.device | str = "cpu",
) -> Float[Tensor, "texels cells"]:
    """Returns the exact integral of max(0, z) over each cell of each visible texel; they sum to pi."""
    return cell_cosine_weights(texel_cells(resolution, subsamples, device=device)).to(dtype)


def gauss_nodes(cells: Cells, nodes: int) -> tuple[Float[Tensor, "*cells nodes 3"], Float[Tensor, "*cells nodes"]]:
    """Returns directions and solid-angle weights of a product Gauss-Legendre rule on each cell.

    The integral of a smooth f over a cell is the sum of `weight f(direction)` over its `nodes^2` points.
    """
    points, weights = (torch.from_numpy(a).to(cells.left) for a in np.polynomial.legendre.leggauss(nodes))
    v_point, u_point = (grid.reshape(-1) for grid in torch.meshgrid(points, points, indexing="ij"))
    width, height = (cells.right - cells.left)[..., None] / 2, (cells.top - cells.bottom)[..., None] / 2
    u = (cells.left + cells.right)[..., None] / 2 + width * u_point
    v = (cells.bottom + cells.top)[..., None] / 2 + height * v_point
    density = (1 + u * u + v * v) ** -1.5
    area = width * height * (weights[:, None] * weights).reshape(-1)
    return face_directions(cells.face[..., None].expand(u.shape), u, v), area * density
