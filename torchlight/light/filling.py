"""What a light map may hold where nothing was determined: nothing, one value, or what the rest suggests.

Filling is cosmetics: it keeps a render from a black lower half. It adds no information, and where a pixel is known its
value stays.
"""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchlight.light import latlong

COARSE_ROWS = 64  # of the grid that Laplace's equation is solved on
TOLERANCE = 1e-5  # of the residual against the right side
MOST_STEPS = 2000


def constant_fill(
    radiance: Float[Tensor, "channels height width"], unknown: Bool[Tensor, "height width"]
) -> Float[Tensor, "channels height width"]:
    """Returns the map with its unknown pixels at the mean of the others over solid angle; 0 where none is known."""
    areas = latlong.row_solid_angles(radiance.shape[-2])[:, None] * (~unknown).double()
    mean = (radiance.double() * areas).sum(dim=(-2, -1)) / areas.sum().clamp(min=1e-300)
    return torch.where(unknown, mean.to(radiance)[:, None, None], radiance)


def smooth_fill(
    radiance: Float[Tensor, "channels height width"], unknown: Bool[Tensor, "height width"]
) -> Float[Tensor, "channels height width"]:
    """Returns the map with its unknown pixels harmonic on the sphere: the smoothest surface that meets the others.

    Laplace's equation, known pixels as boundary values, by finite volumes on a grid of 64 rows: between neighbours of
    a row flows d_theta / (sin theta d_phi) times their difference, between rows sin theta d_phi / d_theta. Solved by
    conjugate gradients; enlarged linearly. Its values lie between the least and the largest of the boundary's.
    """
    height = radiance.shape[-2]
    factor = max(1, height // COARSE_ROWS)
    known = (~unknown).double()[None, None]
    share = torch.nn.functional.avg_pool2d(known, factor)[0, 0]
    sums = torch.nn.functional.avg_pool2d(radiance.double()[None] * known[0], factor)[0]
    held = share > 0
    if not bool(held.any()) or bool(held.all()):
        return constant_fill(radiance, unknown)
    values = torch.where(held, sums / torch.where(held, share, 1.0), 0.0)
    solved = _harmonic(values, held)
    wrapped = torch.nn.functional.pad(solved[None], (1, 1, 0, 0), mode="circular")
    size = (solved.shape[-2] * factor, wrapped.shape[-1] * factor)
    enlarged = torch.nn.functional.interpolate(wrapped, size=size, mode="bilinear", align_corners=False)[0]
    enlarged = enlarged[:, :height, factor : factor + radiance.shape[-1]]
    return torch.where(unknown, enlarged.to(radiance), radiance)


def _harmonic(
    values: Float[Tensor, "channels rows columns"], held: Bool[Tensor, "rows columns"]
) -> Float[Tensor, "channels rows columns"]:
    """Returns values that are harmonic where they are not held."""
    free = (~held).double()
    across, down = _conductances(*held.shape)
    diagonal = 2 * across + down[:-1] + down[1:]
    right = _laplacian(values * held, across, down, diagonal) * -free
    x, residual = torch.zeros_like(values), right
    direction = scaled = residual / diagonal
    size = _inner(right, right / diagonal).clamp(min=1e-300)
    power = _inner(residual, scaled)
    for _ in range(MOST_STEPS):
        if bool((power <= TOLERANCE**2 * size).all()):
            break
        moved = _laplacian(direction, across, down, diagonal) * free
        step = power / _inner(direction, moved).clamp(min=1e-300)
        x, residual = x + step * direction, residual - step * moved
        scaled = residual / diagonal
        before, power = power, _inner(residual, scaled)
        direction = scaled + power / before.clamp(min=1e-300) * direction
    return torch.where(held, values, x)


def _conductances(rows: int, columns: int) -> tuple[Float[Tensor, "rows 1"], Float[Tensor, "edges 1"]]:
    """Returns those between neighbours of each row, and across the edges of rows, 0 at the poles."""
    edges = latlong.row_boundaries(rows).double()
    middle = (edges[1:] + edges[:-1]) / 2
    across, along = torch.pi / rows, 2 * torch.pi / columns
    down = edges.sin() * (along / across)
    down[0] = down[-1] = 0.0
    return (across / (middle.sin() * along))[:, None], down[:, None]


def _laplacian(
    values: Float[Tensor, "channels rows columns"],
    across: Float[Tensor, "rows 1"],
    down: Float[Tensor, "edges 1"],
    diagonal: Float[Tensor, "rows 1"],
) -> Float[Tensor, "channels rows columns"]:
    flow = diagonal * values - across * (values.roll(1, dims=-1) + values.roll(-1, dims=-1))
    flow[..., 1:, :] -= down[1:-1] * values[..., :-1, :]
    flow[..., :-1, :] -= down[1:-1] * values[..., 1:, :]
    return flow


def _inner(left: Tensor, right: Tensor) -> Float[Tensor, "channels 1 1"]:
    return (left * right).sum(dim=(-2, -1), keepdim=True)
