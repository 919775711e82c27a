"""The Haar wavelets of a plane's cube map: a fast, orthonormal, two-dimensional, non-standard transform.

Roots. Light below the horizon is 0 by definition. Were a whole side face the coarsest support, its scaling function
and its vertical wavelet would agree on the upper half and be collinear. So each side face has two roots, the squares
that make up its upper half, and the top face is one root: nine in all, in the order
+x left, +x right, -x left, -x right, +y left, +y right, -y left, -y right, +z.

Scale. Functions are orthonormal over unit face area, <f, g> = sum over texels of f g / N^2, so that coefficients do
not depend on the resolution: a constant L has the scaling coefficient L on the top root, L / 2 on each side root
(a support of a quarter of the face), and every wavelet coefficient 0. Solid angles are not part of the basis, which
is therefore not orthonormal over the sphere; they are part of the transport.

Order. Roots follow each other; within a root the scaling coefficient comes first, then the levels from coarse to
fine, within a level the supports row by row from the upper left, and for each support its three wavelets:
horizontal (left half minus right half), vertical (upper minus lower), diagonal. At level j a support's side is 2^-j
of the face's.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchlight.errors import ConfigError, ShapeError

SCALING, HORIZONTAL, VERTICAL, DIAGONAL = range(4)
SIDE_ROOTS = 8


@dataclass(frozen=True, eq=False)
class Supports:
    """What each coefficient stands for, in coefficient order.

    Attributes:
        root: 0 to 8.
        face: 0 to 4, in the order +x -x +y -y +z.
        level: j; the support is a square of 2^-j times the face's side.
        row: the support's row among the face's 2^j, 0 = top.
        column: the support's column among the face's 2^j, 0 = left.
        kind: SCALING, HORIZONTAL, VERTICAL or DIAGONAL.
    """

    root: Int[Tensor, " coeffs"]
    face: Int[Tensor, " coeffs"]
    level: Int[Tensor, " coeffs"]
    row: Int[Tensor, " coeffs"]
    column: Int[Tensor, " coeffs"]
    kind: Int[Tensor, " coeffs"]


def check_resolution(resolution: int) -> None:
    """Raises ConfigError unless the resolution is a power of two of at least 2."""
    if resolution < 2 or resolution & (resolution - 1):
        raise ConfigError(f"resolution: Haar wavelets need a power of two from 2, got {resolution}; for example 16")


def block_analysis(values: Float[Tensor, "*batch side side"]) -> Float[Tensor, "*batch side**2"]:
    """Returns the orthonormal Haar coefficients of square blocks whose side is a power of two."""
    details: list[Tensor] = []
    while values.shape[-1] > 1:
        left, right = values[..., 0::2], values[..., 1::2]
        mean, slope = left + right, left - right
        upper, lower = mean[..., 0::2, :], mean[..., 1::2, :]
        upper_slope, lower_slope = slope[..., 0::2, :], slope[..., 1::2, :]
        trio = (upper_slope + lower_slope, upper - lower, upper_slope - lower_slope)
        details.append(0.5 * torch.stack(trio, dim=-1).flatten(start_dim=-3))
        values = 0.5 * (upper + lower)
    return torch.cat([values[..., 0], *reversed(details)], dim=-1)


def block_synthesis(coefficients: Float[Tensor, "*batch coeffs"]) -> Float[Tensor, "*batch side side"]:
    """Returns the square blocks with the given Haar coefficients, the inverse and transpose of `block_analysis`."""
    values = coefficients[..., :1, None]
    start = 1
    while start < coefficients.shape[-1]:
        side = values.shape[-1]
        trio = coefficients[..., start : 4 * start].unflatten(-1, (side, side, 3))
        horizontal, vertical, diagonal = 0.5 * trio[..., 0], 0.5 * trio[..., 1], 0.5 * trio[..., 2]
        mean = 0.5 * values
        upper = _interleave(mean + horizontal + vertical + diagonal, mean - horizontal + vertical - diagonal)
        lower = _interleave(mean + horizontal - vertical - diagonal, mean - horizontal - vertical + diagonal)
        values = torch.stack([upper, lower], dim=-2).flatten(start_dim=-3, end_dim=-2)
        start *= 4
    return values


def _interleave(even: Float[Tensor, "*batch n"], odd: Float[Tensor, "*batch n"]) -> Float[Tensor, "*batch m"]:
    """Returns the two sequences merged: even columns from the first, odd columns from the second."""
    return torch.stack([even, odd], dim=-1).flatten(start_dim=-2)


def analysis(texels: Float[Tensor, "*batch texels"], resolution: int) -> Float[Tensor, "*batch texels"]:
    """Returns the coefficients of radiance given at the visible texels: <f, basis function> for each.

    Raises:
        ConfigError: the resolution is not a power of two from 2.
        ShapeError: the last axis is not 3 N^2 long.
    """
    return _orthogonal_analysis(texels, resolution) / resolution


def synthesis(coefficients: Float[Tensor, "*batch coeffs"], resolution: int) -> Float[Tensor, "*batch coeffs"]:
    """Returns the radiance at the visible texels, the inverse of `analysis`.

    Raises:
        ConfigError: the resolution is not a power of two from 2.
        ShapeError: the last axis is not 3 N^2 long.
    """
    _check(coefficients, resolution)
    half = resolution // 2
    sides = coefficients[..., : SIDE_ROOTS * half**2].unflatten(-1, (4, 2, half**2))
    sides = block_synthesis(sides).movedim(-3, -2).flatten(start_dim=-4)
    top = block_synthesis(coefficients[..., SIDE_ROOTS * half**2 :]).flatten(start_dim=-2)
    return resolution * torch.cat([sides, top], dim=-1)


def project(transport: Float[Tensor, "*batch texels"], resolution: int) -> Float[Tensor, "*batch texels"]:
    """Returns T S, where the columns of S are the basis functions at the visible texels.

    With synthesis S = N H' and H orthogonal, a row t of the transport becomes t S = N (H t)': one fast transform
    along the last axis, no product.

    Raises:
        ConfigError: the resolution is not a power of two from 2.
        ShapeError: the last axis is not 3 N^2 long.
    """
    return _orthogonal_analysis(transport, resolution) * resolution


def _orthogonal_analysis(texels: Float[Tensor, "*batch texels"], resolution: int) -> Float[Tensor, "*batch texels"]:
    """Returns H f, the nine block transforms with H H' = 1."""
    _check(texels, resolution)
    half = resolution // 2
    sides = texels[..., : SIDE_ROOTS * half**2].unflatten(-1, (4, half, 2, half)).movedim(-2, -3)
    top = texels[..., SIDE_ROOTS * half**2 :].unflatten(-1, (resolution, resolution))
    return torch.cat([block_analysis(sides).flatten(start_dim=-3), block_analysis(top)], dim=-1)


def _check(values: Float[Tensor, "*batch texels"], resolution: int) -> None:
    """Raises unless the resolution suits Haar wavelets and the last axis holds its visible texels."""
    check_resolution(resolution)
    if values.shape[-1] != 3 * resolution**2:
        raise ShapeError(
            f"Haar transform: resolution {resolution} has {3 * resolution**2} visible texels, got {values.shape[-1]}; "
            "pass the resolution the values were made for"
        )


def supports(resolution: int, *, device: torch.device | str = "cpu") -> Supports:
    """Returns face, root, level, position and kind of every coefficient.

    Raises:
        ConfigError: the resolution is not a power of two from 2.
    """
    check_resolution(resolution)
    half = resolution // 2
    side, top = _block_supports(half), _block_supports(resolution)
    rows = []
    for root in range(SIDE_ROOTS):
        level, row, column, kind = side.unbind(dim=-1)
        fixed = torch.full_like(level, root)
        rows.append(torch.stack([fixed, fixed // 2, level + 1, row, column + root % 2 * 2**level, kind], dim=-1))
    fixed = torch.full_like(top[:, :1], SIDE_ROOTS)
    rows.append(torch.cat([fixed, fixed // 2, top], dim=-1))
    return Supports(*torch.cat(rows).to(device).unbind(dim=-1))


def _block_supports(side: int) -> Int[Tensor, "coeffs 4"]:
    """Returns (level, row, column, kind) of the coefficients of one block, level 0 being the block itself."""
    index = torch.arange(side**2)
    level = torch.zeros_like(index)
    for start in (4**j for j in range(1, side.bit_length())):
        level += index >= start
    within = index - 4**level
    support, kind = within // 3, within % 3 + HORIZONTAL
    table = torch.stack([level, support // 2**level, support % 2**level, kind], dim=-1)
    table[0] = torch.tensor([0, 0, 0, SCALING])
    return table
