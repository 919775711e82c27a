"""Photographs of a block with known light, by its analytic shadow: ground truth for the demo and for accuracy claims.

Nothing here touches the solver's transport: directions are those of the environment map's own pixels, which no cube
map grid shares, bright pixels are cut finer, and the shadow is the closed form of `geometry.analytic_shadow`.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchlight.errors import SceneError
from torchlight.geometry.analytic_shadow import Block, block_irradiance
from torchlight.geometry.primitives import box
from torchlight.geometry.receiver import Receiver
from torchlight.geometry.scene import Scene
from torchlight.geometry.transforms import transform
from torchlight.light.directions import from_angles
from torchlight.light.environment import EnvironmentMap, flux, luminance

PART_SHARE = 1e-5  # no ray carries more of the flux than this, unless a pixel has been cut MAX_PARTS x MAX_PARTS
MAX_PARTS = 64
EXPOSED = 250.0 / 255.0  # the brightest sample of a synthetic photograph: below saturation


@dataclass(frozen=True, eq=False)
class Rays:
    """Directions and fluxes (integral of L max(0, z) d omega) that stand for a light over a plane."""

    directions: Float[Tensor, "rays 3"]
    fluxes: Float[Tensor, "rays 3"]


def pixel_rays(environment: EnvironmentMap) -> Rays:
    """Returns one ray for every pixel above the horizon, k x k rays for a pixel that holds more than its share.

    Each ray goes through a shifted point of its part of the pixel (a rank-1 lattice), so that rays do not line up.

    Raises:
        SceneError: the map is black above the horizon.
    """
    height = environment.height
    fluxes = flux(environment)[:, : height // 2].double()
    share = luminance(fluxes.abs().flatten(start_dim=1)).reshape(height // 2, 2 * height)
    if not bool(share.sum() > 0):
        raise SceneError("the environment map is black above the horizon; choose a map with light there")
    parts = (share / (share.sum() * PART_SHARE)).sqrt().ceil().clamp(1, MAX_PARTS).long()
    rows, columns, flows = [], [], []
    for k in parts.unique().tolist():
        row, column = torch.nonzero(parts == k, as_tuple=True)
        sub = torch.arange(k * k)
        rows.append((row[:, None] + (sub // k + _shift(len(row), k, 0)) / k).reshape(-1))
        columns.append((column[:, None] + (sub % k + _shift(len(row), k, 1)) / k).reshape(-1))
        flows.append((fluxes[:, row, column, None] / (k * k)).expand(-1, -1, k * k).reshape(3, -1))
    theta = torch.cat(rows) * (torch.pi / height)
    phi = torch.pi * (1 - torch.cat(columns) / height)
    return Rays(from_angles(theta, phi), torch.cat(flows, dim=1).T.contiguous())


def _shift(pixels: int, parts: int, axis: int) -> Float[Tensor, "pixels parts"]:
    step = (0.7548776662466927, 0.5698402909980532)[axis]
    return ((torch.arange(pixels * parts * parts, dtype=torch.float64) + 0.5) * step % 1.0).reshape(pixels, -1)


def block_scene(block: Block, receiver: Receiver) -> Scene:
    """Returns the scene of a block without a camera: photographs are rectified receiver images."""
    turned = transform(box(block.size), 1.0, (0.0, 0.0, block.rotation_degrees), (*block.translation, 0.0))
    return Scene(turned, receiver, encoding="linear")


def block_values(block: Block, receiver: Receiver, rays: Rays, lines: int = 2) -> Float[Tensor, "3 points"]:
    """Returns v = E / pi of every sample by the analytic shadow, for albedo 1."""
    directions, fluxes = rays.directions.float(), rays.fluxes.float()
    return block_irradiance(block, directions, fluxes, receiver, lines).double() / torch.pi


def expose(values: Float[Tensor, "3 points"], used: Bool[Tensor, " points"]) -> float:
    """Returns the exposure that brings the brightest used sample just below saturation.

    Raises:
        SceneError: no used sample receives light.
    """
    brightest = values[:, used].max().item()
    if not brightest > 0:
        raise SceneError("the light leaves the receiver black; choose an environment map with light above the horizon")
    return EXPOSED / brightest


def eight_bit(values: Float[Tensor, "3 points"]) -> Float[Tensor, "3 points"]:
    """Returns values in [0, 1] as an 8-bit linear photograph stores them."""
    return (values.clamp(0, 1) * 255).round() / 255


def receiver_image(values: Float[Tensor, "*batch points"], receiver: Receiver) -> Float[Tensor, "*batch rows columns"]:
    """Returns samples as a rectified picture, row 0 at the largest y."""
    columns, rows = receiver.samples
    return values.reshape(*values.shape[:-1], rows, columns).flip(-2)
