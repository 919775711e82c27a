"""Rotations of the world as matrices on column vectors; turns are counter-clockwise seen from the tip of the axis."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from torchlight.errors import ConfigError

AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
TOLERANCE = 1e-4  # of a matrix written with a few digits


def about_axis(axis: Sequence[float], degrees: float) -> Float[Tensor, "3 3"]:
    """Returns the turn by an angle about an axis of any length, float64.

        R = I + sin a K + (1 - cos a) K^2,   K v = axis x v

    Whole quarter turns about the coordinate axes are exact.

    Raises:
        ConfigError: the axis or the angle is not finite, or the axis is 0.

    References:
        Rodrigues (1840).
    """
    x, y, z = (float(part) for part in axis)
    length = math.hypot(x, y, z)
    if not (math.isfinite(degrees) and 0 < length < math.inf):
        raise ConfigError(f"rotation: expected a finite axis and angle, got {x:g},{y:g},{z:g} and {degrees:g}")
    cross = torch.tensor([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]], dtype=torch.float64) / length
    sine, cosine = _sine_cosine(degrees)
    return torch.eye(3, dtype=torch.float64) + sine * cross + (1 - cosine) * (cross @ cross)


def turns(steps: Sequence[tuple[str, float]]) -> Float[Tensor, "3 3"]:
    """Returns several turns, one after the other, about the fixed axes of the world (extrinsic Euler angles).

    Args:
        steps: x, y or z, and degrees; the first is done first.
    """
    total = torch.eye(3, dtype=torch.float64)
    for axis, degrees in steps:
        if axis not in AXES:
            raise ConfigError(f"rotation: expected an axis x, y or z, got {axis!r}")
        total = about_axis(AXES[axis], degrees) @ total
    return total


def parse_rotation(text: str) -> Float[Tensor, "3 3"]:
    """Returns the rotation that a text names.

    30 = about z; x:90,z:30 = about the world's x, then its z; 1,1,0,45 = about the axis (1, 1, 0) by 45 degrees; nine
    numbers = a matrix, row by row.

    Raises:
        ConfigError: none of these, or a matrix that is no rotation.
    """
    parts = [part.strip() for part in text.split(",")]
    try:
        if any(":" in part for part in parts):
            pairs = [part.split(":") for part in parts]
            return turns([(axis.strip(), float(degrees)) for axis, degrees in pairs])
        numbers = [float(part) for part in parts]
    except ValueError:
        numbers = []
    if len(numbers) == 1:
        return about_axis(AXES["z"], numbers[0])
    if len(numbers) == 4:
        return about_axis(numbers[:3], numbers[3])
    if len(numbers) == 9:
        return checked(torch.tensor(numbers, dtype=torch.float64).reshape(3, 3))
    raise ConfigError(f"rotation {text!r}: expected degrees about z, x:90,z:30, an axis x,y,z,degrees, or nine numbers")


def checked(matrix: Float[Tensor, "3 3"]) -> Float[Tensor, "3 3"]:
    """Returns the rotation nearest to a matrix that is one up to its digits.

    Raises:
        ConfigError: it is no rotation: scaled, sheared or mirrored.
    """
    product = matrix @ matrix.T
    distance = (product - torch.eye(3, dtype=matrix.dtype)).abs().max().item()
    if not distance < TOLERANCE or torch.linalg.det(matrix).item() < 0:
        raise ConfigError(
            f"rotation: R R' differs from 1 by {distance:.2g} and det R is {torch.linalg.det(matrix).item():.4g}; "
            "expected a rotation, without scale, shear or mirror"
        )
    left, _, right = torch.linalg.svd(matrix)
    return left @ right


def is_about_z(rotation: Float[Tensor, "3 3"]) -> bool:
    """Returns whether a rotation leaves the z axis where it is."""
    return abs(rotation[2, 2].item() - 1) < 1e-12


def _sine_cosine(degrees: float) -> tuple[float, float]:
    """Returns sine and cosine, exact at whole quarters."""
    quarters = degrees / 90
    if quarters == round(quarters):
        return ((0.0, 1.0), (1.0, 0.0), (0.0, -1.0), (-1.0, 0.0))[round(quarters) % 4]
    return math.sin(math.radians(degrees)), math.cos(math.radians(degrees))
