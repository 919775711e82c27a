"""How much of the light that leaves an object's faces arrives on the plane: Lambert's closed form for triangles.

A point of the plane z = 0 that faces up receives from a triangle of radiosity B (flux per area, the same all over it)
the irradiance F B with the form factor

    F = 1 / (2 pi) sum over edges (p, q) of angle(p, q) (p x q)_z / |p x q|,

p and q being the corners seen from the point. J. H. Lambert, Photometria, 1760; D. R. Baum et al., "Improving
Radiosity Solutions Through the Use of Analytically Determined Form-Factors", SIGGRAPH 1989, eq. 4.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

TINY = 1e-12  # corners this near to one line with the point span no angle


def form_factors(
    triangles: Float[Tensor, "faces 3 3"], points: Float[Tensor, "points 3"]
) -> Float[Tensor, "points faces"]:
    """Returns the form factor of every triangle at every point of the plane; 0 where the point is behind it.

    Args:
        triangles: in z >= 0, corners counter-clockwise as seen from outside.
        points: on z = 0; the plane faces up. Other faces in between are not looked for: exact for a convex object.
    """
    corners = triangles.to(points)[None] - points[:, None, None]
    following = corners.roll(-1, dims=2)
    across = torch.linalg.cross(corners, following)
    size = torch.linalg.vector_norm(across, dim=-1)
    angle = torch.atan2(size, (corners * following).sum(dim=-1))
    total = (angle * across[..., 2] / size.clamp(min=TINY)).sum(dim=-1) / (2 * torch.pi)
    normal = torch.linalg.cross(corners[:, :, 1] - corners[:, :, 0], corners[:, :, 2] - corners[:, :, 0])
    in_front = (normal * corners[:, :, 0]).sum(dim=-1) < 0
    return torch.where(in_front, total.abs(), torch.zeros_like(total))
