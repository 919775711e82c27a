"""Cube maps of other programs: six square faces in one picture, cut up, turned and put in other places.

Described in the Y-up frame of Debevec's probes, (x, y, z) -> (x, z, -y) of torchlight's world: the middle of a cross
looks along -Z, which is +Y of the world. All are seen from inside and not mirrored, but for OpenGL's: its cube map is
a left-handed one, so that a shader's texture(cube, d) finds the light from d only in mirrored faces.

    cross             vertical, 3 F x 4 F: +Y above -X -Z +X, then -Y, then +Z upside down
    horizontal-cross  4 F x 3 F: +Y above -X -Z +X +Z, -Y below; +Y and -Y stand over and under -Z
    strip             6 F x F: +X -X +Y -Y +Z -Z, the horizontal cross cut up
    opengl-strip      6 F x F: the same order, each face as OpenGL, Vulkan and DirectX hold it

References:
    Debevec, Light Probe Image Gallery (1999). The OpenGL 4.6 specification (2022), table 8.19.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchlight.errors import ShapeError
from torchlight.light import cubemap
from torchlight.light.directions import to_y_up

Vectors = tuple[tuple[int, int, int], ...]


@dataclass(frozen=True)
class Layout:
    """Where the faces +X -X +Y -Y +Z -Z of the Y-up frame lie in a picture, and how they are turned.

    Attributes:
        rows: of the picture, in faces.
        columns: of the picture, in faces.
        places: row and column of each face.
        right: the direction to the right in each face's picture.
        up: the direction upwards.
    """

    rows: int
    columns: int
    places: tuple[tuple[int, int], ...]
    right: Vectors
    up: Vectors


_UPRIGHT_RIGHT: Vectors = ((0, 0, 1), (0, 0, -1), (1, 0, 0), (1, 0, 0), (-1, 0, 0), (1, 0, 0))
_UPRIGHT_UP: Vectors = ((0, 1, 0), (0, 1, 0), (0, 0, 1), (0, 0, -1), (0, 1, 0), (0, 1, 0))
_IN_A_ROW = tuple((0, face) for face in range(6))
LAYOUTS = {
    "cross": Layout(
        4,
        3,
        places=((1, 2), (1, 0), (0, 1), (2, 1), (3, 1), (1, 1)),
        right=((0, 0, 1), (0, 0, -1), (1, 0, 0), (1, 0, 0), (1, 0, 0), (1, 0, 0)),
        up=((0, 1, 0), (0, 1, 0), (0, 0, 1), (0, 0, -1), (0, -1, 0), (0, 1, 0)),
    ),
    "horizontal-cross": Layout(
        3, 4, ((1, 2), (1, 0), (0, 1), (2, 1), (1, 3), (1, 1)), right=_UPRIGHT_RIGHT, up=_UPRIGHT_UP
    ),
    "strip": Layout(1, 6, _IN_A_ROW, right=_UPRIGHT_RIGHT, up=_UPRIGHT_UP),
    "opengl-strip": Layout(
        1,
        6,
        _IN_A_ROW,
        right=((0, 0, -1), (0, 0, 1), (1, 0, 0), (1, 0, 0), (1, 0, 0), (-1, 0, 0)),
        up=((0, 1, 0), (0, 1, 0), (0, 0, -1), (0, 0, 1), (0, 1, 0), (0, 1, 0)),
    ),
}


def face_edge(name: str, rows: int, columns: int) -> int:
    """Returns F, the edge of a face in pixels, of a picture in a layout.

    Raises:
        ShapeError: the picture's shape is another.
    """
    layout = LAYOUTS[name]
    edge = rows // layout.rows
    if edge < 1 or (rows, columns) != (layout.rows * edge, layout.columns * edge):
        raise ShapeError(
            f"{name}: expected {layout.columns} F x {layout.rows} F pixels, got {columns} x {rows}; crop or resample it"
        )
    return edge


def picture_to_faces(
    image: Float[Tensor, "*batch rows columns"], name: str
) -> Float[Tensor, "*batch 6 resolution resolution"]:
    """Returns the six faces, in torchlight's frame and order, of a picture in a layout; exact.

    Pixels outside the faces (captions) are not light.
    """
    resolution = face_edge(name, image.shape[-2], image.shape[-1])
    places = _pixels(name, resolution).to(image.device)
    return image.flatten(start_dim=-2)[..., places].unflatten(-1, (6, resolution, resolution))


def faces_to_picture(
    faces: Float[Tensor, "*batch 6 resolution resolution"], name: str
) -> Float[Tensor, "*batch rows columns"]:
    """Returns the picture of six faces in a layout, 0 outside them; the inverse of `picture_to_faces`."""
    layout, resolution = LAYOUTS[name], faces.shape[-1]
    rows, columns = layout.rows * resolution, layout.columns * resolution
    image = faces.new_zeros(*faces.shape[:-3], rows * columns)
    places = _pixels(name, resolution).to(faces.device)
    return image.index_copy(-1, places, faces.flatten(start_dim=-3)).unflatten(-1, (rows, columns))


@lru_cache(maxsize=8)
def _pixels(name: str, resolution: int) -> Int[Tensor, " texels"]:
    """Returns row * columns + column of the picture for each texel of the six faces."""
    layout = LAYOUTS[name]
    directions = to_y_up(cubemap.texel_directions(resolution))
    # Faces are named alike in both frames, up to the turn: take the largest component in the probe's own.
    axes = torch.stack([directions, -directions], dim=-1).flatten(start_dim=-2)
    length, face = axes.max(dim=-1)
    u = (directions * _vectors(layout.right)[face]).sum(dim=-1) / length
    v = (directions * _vectors(layout.up)[face]).sum(dim=-1) / length
    place = torch.tensor(layout.places)[face] * resolution
    row = place[:, 0] + ((1 - v) * (resolution / 2)).long()
    column = place[:, 1] + ((1 + u) * (resolution / 2)).long()
    return row * (layout.columns * resolution) + column


def _vectors(rows: Vectors) -> Float[Tensor, "rows 3"]:
    return torch.tensor(rows, dtype=torch.float64)
