"""The shadow of a block in closed form: ground truth that shares nothing with the solver's transport.

A block hides the direction d from a plane point exactly where the point lies inside the parallel projection of the
block along d. The block is the sum of three segments, so its projection is the sum of three plane segments g1, g2,
g3 about a centre c, a hexagon, which is the intersection of three slabs:

    |n_k . (q - c)| <= (|n_k . g_i| + |n_k . g_j|) / 2,   n_k perpendicular to g_k.

On a line of constant y each slab is one interval, and so is their intersection; its overlap with a sample's
footprint is exact in x. Along y a footprint is cut into `lines` lines.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchlight.geometry.receiver import Receiver

CHUNK_VALUES = 2_000_000  # interval ends x columns held at once: small enough for the processor's cache
FLAT = 1e-12  # a slab parallel to the lines: its interval is everything or nothing


@dataclass(frozen=True)
class Block:
    """A block that stands on z = 0: centred, turned about z, then moved.

    Attributes:
        size: extent along its own x, y and z.
        rotation_degrees: turn about +z.
        translation: x and y of its centre.
    """

    size: tuple[float, float, float]
    rotation_degrees: float = 0.0
    translation: tuple[float, float] = (0.0, 0.0)


def block_axes(block: Block) -> Float[Tensor, "3 3"]:
    """Returns the block's three edge vectors as rows, in float64."""
    cos, sin = (f(math.radians(block.rotation_degrees)) for f in (math.cos, math.sin))
    width, depth, height = block.size
    rows = [[width * cos, width * sin, 0.0], [-depth * sin, depth * cos, 0.0], [0.0, 0.0, height]]
    return torch.tensor(rows, dtype=torch.float64)


def shadow_intervals(
    block: Block, directions: Float[Tensor, "dirs 3"], y: Float[Tensor, "#dirs lines"]
) -> tuple[Float[Tensor, "dirs lines"], Float[Tensor, "dirs lines"]]:
    """Returns the first and last x of the block's shadow on each line y = const (first >= last: no shadow there).

    Args:
        block: the occluder.
        directions: unit vectors towards the light, all z > 0.
        y: the lines of each direction.
    """
    slope = directions[:, :2] / directions[:, 2:]
    axes = block_axes(block).to(directions)
    middle = torch.tensor(block.translation, dtype=torch.float64).to(directions) - slope * (block.size[2] / 2)
    generators = axes[None, :, :2] - slope[:, None] * axes[None, :, 2:]
    first, last = torch.full_like(y, -torch.inf), torch.full_like(y, torch.inf)
    for k in range(3):
        normal = torch.stack([-generators[:, k, 1], generators[:, k, 0]], dim=-1)
        length = torch.linalg.vector_norm(normal, dim=-1)
        point = length <= FLAT * max(block.size)  # seen along its edge the segment is a point and bounds nothing
        normal = normal / torch.where(point, torch.ones_like(length), length)[:, None]
        half = (generators @ normal[:, :, None]).abs().sum(dim=(1, 2)) / 2
        across = torch.where(normal[:, 0].abs() < FLAT, torch.full_like(half, FLAT), normal[:, 0])
        at = (normal * middle).sum(dim=-1) / across
        center = torch.addcmul(at[:, None], (normal[:, 1] / across)[:, None], y, value=-1)
        reach = torch.where(point, torch.full_like(half, torch.inf), half / across.abs())[:, None]
        first = torch.maximum(first, center - reach)
        last = torch.minimum(last, center + reach)
    return first, last


def interval_coverage(
    first: Float[Tensor, "*batch lines"], last: Float[Tensor, "*batch lines"], columns: int
) -> Float[Tensor, "*batch lines columns"]:
    """Returns the share of each unit cell [i, i + 1) that lies inside [first, last] (in cells; exact)."""
    cells = torch.arange(columns, dtype=first.dtype, device=first.device)
    last = torch.maximum(first, last)
    return (last[..., None] - cells).clamp_(0, 1).sub_((first[..., None] - cells).clamp_(0, 1))


def line_positions(receiver: Receiver, lines: int, directions: Float[Tensor, "dirs 3"]) -> Float[Tensor, "dirs rows"]:
    """Returns the y of every line: `lines` per row of samples, shifted within its stratum from direction to direction.

    The shift is the fractional part of the direction's number x the golden ratio, so that the mean over many
    directions has no preferred line.
    """
    rows = receiver.samples[1] * lines
    bottom = receiver.center[1] - receiver.size[1] / 2
    index = torch.arange(rows, dtype=torch.float64, device=directions.device)
    number = torch.arange(len(directions), dtype=torch.float64, device=directions.device)
    shift = (0.5 + number * 0.6180339887498949) % 1.0
    return (bottom + (index + shift[:, None]) * receiver.footprint[1] / lines).to(directions)


def shadow_coverage(
    block: Block, directions: Float[Tensor, "dirs 3"], receiver: Receiver, lines: int = 2
) -> Float[Tensor, "dirs points"]:
    """Returns the share of every sample's footprint that the block hides from each direction.

    Exact along x; along y the mean over `lines` lines per sample.
    """
    columns, rows = receiver.samples
    first, last = shadow_intervals(block, directions, line_positions(receiver, lines, directions))
    left = receiver.center[0] - receiver.size[0] / 2
    scale = 1 / receiver.footprint[0]
    coverage = interval_coverage((first - left) * scale, (last - left) * scale, columns)
    return coverage.reshape(len(directions), rows, lines, columns).mean(dim=2).reshape(len(directions), -1)


def block_irradiance(
    block: Block,
    directions: Float[Tensor, "dirs 3"],
    fluxes: Float[Tensor, "dirs channels"],
    receiver: Receiver,
    lines: int = 2,
) -> Float[Tensor, "channels points"]:
    """Returns E(x) = sum over directions of flux (1 - coverage(x)), in chunks of bounded memory.

    Args:
        block: the occluder.
        directions: unit vectors towards the light, all z > 0.
        fluxes: radiance x cos(theta) x solid angle of each direction.
        receiver: the plane's samples.
        lines: lines per sample and direction.
    """
    hidden = torch.zeros(fluxes.shape[1], receiver.points, dtype=torch.float64, device=directions.device)
    count = max(1, CHUNK_VALUES // (receiver.points * lines))
    for part, flux in zip(directions.split(count), fluxes.split(count), strict=True):
        hidden += flux.T @ shadow_coverage(block, part, receiver, lines)
    return (fluxes.double().sum(dim=0)[:, None] - hidden).to(fluxes.dtype)
