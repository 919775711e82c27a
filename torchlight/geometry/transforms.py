"""Placing triangles in the world: rotations about fixed axes, similarity and affine transforms of column vectors."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from torchlight.errors import SceneError


def rotation_matrix(
    rotation_degrees: tuple[float, float, float],
    *,
    dtype: torch.dtype = torch.float64,
    device: torch.device | str = "cpu",
) -> Float[Tensor, "3 3"]:
    """Returns Rz Ry Rx: a turn about the fixed x axis, then y, then z, counter-clockwise seen from each axis' tip."""
    angles = torch.deg2rad(torch.tensor(rotation_degrees, dtype=torch.float64))
    (cx, cy, cz), (sx, sy, sz) = angles.cos().tolist(), angles.sin().tolist()
    about_x = torch.tensor([[1, 0, 0], [0, cx, -sx], [0, sx, cx]], dtype=torch.float64)
    about_y = torch.tensor([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]], dtype=torch.float64)
    about_z = torch.tensor([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]], dtype=torch.float64)
    return (about_z @ about_y @ about_x).to(dtype=dtype, device=device)


def transform(
    triangles: Float[Tensor, "faces 3 3"],
    scale: float,
    rotation_degrees: tuple[float, float, float],
    translation: tuple[float, float, float],
) -> Float[Tensor, "faces 3 3"]:
    """Returns the triangles scaled, then rotated (see `rotation_matrix`), then moved: p' = R (s p) + t."""
    rotation = rotation_matrix(rotation_degrees, dtype=triangles.dtype, device=triangles.device)
    offset = torch.tensor(translation, dtype=triangles.dtype, device=triangles.device)
    return _oriented(triangles @ (scale * rotation).T + offset, mirrored=scale < 0)


def apply_matrix(triangles: Float[Tensor, "faces 3 3"], matrix: Float[Tensor, "4 4"]) -> Float[Tensor, "faces 3 3"]:
    """Returns the triangles under the affine map [A|t; 0 0 0 1]; a mirroring A keeps outward faces outward.

    Raises:
        SceneError: the last row is not 0 0 0 1, an entry is not finite, or A flattens space.
    """
    values = matrix.to(triangles)
    linear = values[:3, :3]
    if not bool(torch.isfinite(values).all()) or values[3].tolist() != [0.0, 0.0, 0.0, 1.0]:
        raise SceneError(f"matrix: expected finite rows [A|t] and a last row [0, 0, 0, 1], got {matrix.tolist()}")
    stretch = torch.linalg.svdvals(linear)
    if stretch[2] <= 1e-9 * stretch[0]:
        raise SceneError(
            f"matrix: flattens the mesh (singular); expected an invertible 3 x 3 part, got {linear.tolist()}"
        )
    mirrored = bool(torch.linalg.det(linear) < 0)
    return _oriented(triangles @ linear.T + values[:3, 3], mirrored=mirrored)


def _oriented(triangles: Float[Tensor, "faces 3 3"], *, mirrored: bool) -> Float[Tensor, "faces 3 3"]:
    """Returns the triangles with their corners in reverse order if the map that made them was mirroring."""
    return triangles.flip(1) if mirrored else triangles
