"""Simple solids as closed triangle meshes, centred in x and y and resting on z = 0, oriented outwards.

Round solids are inscribed: their vertices lie on the true surface and everything else within it. With n segments a
cylinder or cone keeps sin(2 pi / n) / (2 pi / n) of its cross-section (4.0e-4 missing at n = 128), and a shadow's
edge lies at most radius (1 - cos(pi / n)) inside the true one (3.0e-4 of the radius). A sphere of n segments and n / 2
rings misses about 5 / n^2 x pi of its volume (1.0e-3 at n = 128).
"""

from __future__ import annotations

from itertools import pairwise

import torch
from jaxtyping import Float
from torch import Tensor

from torchlight.errors import SceneError

SEGMENTS = 128


def box(
    size: tuple[float, float, float], *, dtype: torch.dtype = torch.float64, device: torch.device | str = "cpu"
) -> Float[Tensor, "faces 3 3"]:
    """Returns the 12 triangles of a box of the given extents in x, y and z; SceneError unless all are positive."""
    _check_positive("box", size)
    half = torch.tensor([size[0] / 2, size[1] / 2, size[2]], dtype=torch.float64)
    signs = torch.tensor([[x, y, z] for z in (0, 1) for y in (-1, 1) for x in (-1, 1)], dtype=torch.float64)
    quads = torch.tensor([[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]])
    faces = torch.cat([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    return (signs * half)[faces].to(dtype=dtype, device=device)


def cylinder(
    radius: float,
    height: float,
    segments: int = SEGMENTS,
    *,
    dtype: torch.dtype = torch.float64,
    device: torch.device | str = "cpu",
) -> Float[Tensor, "faces 3 3"]:
    """Returns an upright prism over a regular polygon; raises SceneError unless radius and height are positive."""
    _check_positive("cylinder", (radius, height))
    bottom, top = _ring(radius, 0.0, segments), _ring(radius, height, segments)
    solid = torch.cat([_side(bottom, top), _fan(bottom, 0.0).flip(1), _fan(top, height)])
    return solid.to(dtype=dtype, device=device)


def cone(
    radius: float,
    height: float,
    segments: int = SEGMENTS,
    *,
    dtype: torch.dtype = torch.float64,
    device: torch.device | str = "cpu",
) -> Float[Tensor, "faces 3 3"]:
    """Returns a pyramid over a regular polygon, apex up; raises SceneError unless radius and height are positive."""
    _check_positive("cone", (radius, height))
    base = _ring(radius, 0.0, segments)
    return torch.cat([_fan(base, height), _fan(base, 0.0).flip(1)]).to(dtype=dtype, device=device)


def sphere(
    radius: float,
    segments: int = SEGMENTS,
    *,
    dtype: torch.dtype = torch.float64,
    device: torch.device | str = "cpu",
) -> Float[Tensor, "faces 3 3"]:
    """Returns a sphere centred at height `radius`, of `segments` meridians and `segments // 2` rings of latitude.

    Raises:
        SceneError: the radius is not positive.
    """
    _check_positive("sphere", (radius,))
    _check_segments(segments)
    latitude = torch.linspace(-torch.pi / 2, torch.pi / 2, segments // 2 + 1, dtype=torch.float64)[1:-1].tolist()
    angles = torch.tensor(latitude, dtype=torch.float64)
    heights, radii = (radius * (1 + angles.sin())).tolist(), (radius * angles.cos()).tolist()
    rings = [_ring(r, z, segments) for r, z in zip(radii, heights, strict=True)]
    bands = [_side(lower, upper) for lower, upper in pairwise(rings)]
    return torch.cat([_fan(rings[0], 0.0).flip(1), *bands, _fan(rings[-1], 2 * radius)]).to(dtype=dtype, device=device)


def _ring(radius: float, z: float, segments: int) -> Float[Tensor, "segments 3"]:
    """Returns the corners of a regular polygon, counter-clockwise seen from above."""
    _check_segments(segments)
    azimuth = torch.arange(segments, dtype=torch.float64) * (2 * torch.pi / segments)
    return torch.stack([radius * azimuth.cos(), radius * azimuth.sin(), torch.full_like(azimuth, z)], dim=1)


def _side(lower: Float[Tensor, "segments 3"], upper: Float[Tensor, "segments 3"]) -> Float[Tensor, "faces 3 3"]:
    """Returns the band between two rings, facing away from the axis."""
    lower_next, upper_next = lower.roll(-1, 0), upper.roll(-1, 0)
    return torch.cat(
        [torch.stack([lower, lower_next, upper_next], dim=1), torch.stack([lower, upper_next, upper], dim=1)]
    )


def _fan(ring: Float[Tensor, "segments 3"], apex: float) -> Float[Tensor, "segments 3 3"]:
    """Returns triangles from a ring to a point on the axis, facing up."""
    point = torch.zeros_like(ring)
    point[:, 2] = apex
    return torch.stack([ring, ring.roll(-1, 0), point], dim=1)


def _check_positive(solid: str, lengths: tuple[float, ...]) -> None:
    if not all(0.0 < length < float("inf") for length in lengths):
        raise SceneError(f"{solid}: expected positive, finite lengths, got {list(lengths)}")


def _check_segments(segments: int) -> None:
    if segments < 4 or segments % 2:
        raise SceneError(f"segments: expected an even number of at least 4, got {segments}")
