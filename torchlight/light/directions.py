"""Directions as unit vectors and as angles: theta from +Z, phi = atan2(y, x); and the frames of others, with Y up."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor


def from_angles(theta: Float[Tensor, "*#batch"], phi: Float[Tensor, "*#batch"]) -> Float[Tensor, "*batch 3"]:
    """Returns the unit vectors (sin theta cos phi, sin theta sin phi, cos theta).

    Args:
        theta: polar angle from +Z, in radians.
        phi: azimuth from +X towards +Y, in radians.
    """
    x, y, z = torch.broadcast_tensors(theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos())
    return torch.stack([x, y, z], dim=-1)


def to_angles(directions: Float[Tensor, "*batch 3"]) -> tuple[Float[Tensor, "*batch"], Float[Tensor, "*batch"]]:
    """Returns (theta, phi) in radians, theta in [0, pi] and phi in [-pi, pi]; phi is 0 or pi on the z axis.

    Directions need not be unit vectors. atan2 keeps full accuracy near the poles, where acos(z) loses half the digits.
    """
    x, y, z = directions.unbind(dim=-1)
    return torch.atan2(torch.hypot(x, y), z), torch.atan2(y, x)


def to_z_up(directions: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3"]:
    """Returns Y-up directions in torchlight's world: (x, y, z) -> (x, -z, y)."""
    x, y, z = directions.unbind(dim=-1)
    return torch.stack([x, -z, y], dim=-1)


def to_y_up(directions: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3"]:
    """Returns torchlight's directions in a Y-up world: (x, y, z) -> (x, z, -y)."""
    x, y, z = directions.unbind(dim=-1)
    return torch.stack([x, z, -y], dim=-1)
