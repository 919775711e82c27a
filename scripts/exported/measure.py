"""How far a program's shadow is turned against torchlight's, and how its irradiance differs.

A program's picture p of the plane is explained, per channel c, by torchlight's own rendering v under the light turned
by a small vector w (degrees about x, y, z), with a gain for each channel:

    p_c = g_c v_c + sum over k of w_k dv_c / dw_k,      least squares over all samples that a camera above sees,

where the derivatives are central differences of the block's analytic shadow under rays that are turned by one degree.
|w| is how far shadows are turned. For a lamp alone, v is the analytic shadow under a uniform disc, and w has two
components. `own_error` says what the measure makes of turns that are known.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from exported.setting import BLOCK, RECEIVER
from torchlight.geometry.analytic_shadow import block_irradiance
from torchlight.geometry.footprints import visible_samples
from torchlight.io.exr import read_exr
from torchlight.light import latlong
from torchlight.light.cubature import cubature
from torchlight.light.environment import EnvironmentMap, irradiance, radiance_at
from torchlight.light.lamps import Lamp
from torchlight.relighting import relight
from torchlight.synthetic import block_scene

SCENE = block_scene(BLOCK, RECEIVER)
RAYS = 32_768
SLOPE_RAYS = 8192
FINE_ROWS = 1024
STEP = math.radians(1.0)
DISC_POINTS = 64


@dataclass(frozen=True, eq=False)
class Rendering:
    """What torchlight shows, and how it changes when the light is turned.

    Attributes:
        values: E / pi of every sample.
        slopes: their derivatives with respect to angles, per radian.
    """

    values: Float[Tensor, "3 points"]
    slopes: list[Float[Tensor, "3 points"]]


@dataclass(frozen=True)
class Agreement:
    """A picture against torchlight's.

    Attributes:
        degrees: by which shadows are turned.
        gain: largest |g_c - 1|.
        rms_percent: what is left after turn and gain, of the mean.
    """

    degrees: float
    gain: float
    rms_percent: float


def plane(path: Path) -> Float[Tensor, "3 points"]:
    """Returns a picture from above as samples of the receiver."""
    image, _ = read_exr(path)
    return image.flip(1).reshape(3, -1).double()


def brightness_error(path: Path, light: EnvironmentMap) -> float:
    """Returns the largest |E / E_exact - 1| over channels, of a picture of the empty plane."""
    exact = irradiance(replace(light, radiance=light.radiance.double()))
    return float((plane(path).mean(dim=1) * math.pi / exact - 1).abs().max())


def under_light(light: EnvironmentMap) -> Rendering:
    """Returns torchlight's own rendering of the block under a light; slopes by the analytic shadow of turned rays."""
    rays = cubature(light, count=SLOPE_RAYS)
    directions, fluxes = rays.directions.double(), rays.fluxes.double()

    def values(axis: int, angle: float) -> Float[Tensor, "3 points"]:
        moved = directions @ rotation(axis, angle).T
        above = moved[:, 2] > 0
        flows = fluxes * (moved[:, 2] / directions[:, 2])[:, None]
        return block_irradiance(BLOCK, moved[above], flows[above], RECEIVER) / math.pi

    slopes = [_slope(lambda angle, axis=axis: values(axis, angle)) for axis in range(3)]
    return Rendering(relight(SCENE, light, RAYS).double(), slopes)


def under_lamp(lamp: Lamp, *, hard: bool = False) -> Rendering:
    """Returns the block's analytic shadow under the disc of a lamp, or under its middle where it is to be hard."""
    towards = torch.tensor(lamp.direction, dtype=torch.float64)
    across, up = tangents(towards)
    radius = 0.0 if hard else lamp.radius
    irradiance_facing = torch.tensor(lamp.irradiance, dtype=torch.float64)

    def values(shift: Float[Tensor, "3"]) -> Float[Tensor, "3 points"]:
        middle = torch.nn.functional.normalize(towards + shift, dim=-1)
        rays = disc(middle, radius)
        fluxes = rays[:, 2:] * irradiance_facing / rays[:, 2:].sum() * middle[2]
        return block_irradiance(BLOCK, rays, fluxes, RECEIVER, lines=8) / math.pi

    zero = torch.zeros(3, dtype=torch.float64)
    slopes = [_slope(lambda angle, along=along: values(along * math.tan(angle))) for along in (across, up)]
    return Rendering(values(zero), slopes)


def turned(light: EnvironmentMap, axis: int, angle: float) -> EnvironmentMap:
    """Returns a light turned about an axis: nearest pixels of the old map, on one of at least FINE_ROWS rows."""
    rows = light.height * math.ceil(FINE_ROWS / light.height)
    directions = latlong.pixel_directions(rows) @ rotation(axis, angle)  # the inverse turn of each
    return replace(light, radiance=radiance_at(light, directions))


def rotation(axis: int, angle: float) -> Float[Tensor, "3 3"]:
    """Returns the matrix that turns column vectors about x, y or z, in radians."""
    i, j = [(1, 2), (2, 0), (0, 1)][axis]
    matrix = torch.eye(3, dtype=torch.float64)
    matrix[i, i] = matrix[j, j] = math.cos(angle)
    matrix[i, j], matrix[j, i] = -math.sin(angle), math.sin(angle)
    return matrix


def disc(middle: Float[Tensor, "3"], radius: float) -> Float[Tensor, "points 3"]:
    """Returns directions that cover a disc evenly."""
    if radius == 0:
        return middle[None]
    across, up = tangents(middle)
    index = torch.arange(DISC_POINTS, dtype=torch.float64)
    angle = radius * ((index + 0.5) / DISC_POINTS).sqrt()
    azimuth = index * math.pi * (3 - math.sqrt(5))
    sideways = azimuth.cos()[:, None] * across + azimuth.sin()[:, None] * up
    return angle.cos()[:, None] * middle + angle.sin()[:, None] * sideways


def tangents(towards: Float[Tensor, "3"]) -> tuple[Float[Tensor, "3"], Float[Tensor, "3"]]:
    """Returns two unit vectors that are perpendicular to a direction and to each other."""
    across = torch.linalg.cross(torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64), towards)
    across = torch.nn.functional.normalize(across, dim=-1)
    return across, torch.linalg.cross(towards, across)


def agreement(picture: Float[Tensor, "3 points"], rendering: Rendering) -> Agreement:
    """Returns the turn and the gains that explain a picture."""
    base, slopes = rendering.values, rendering.slopes
    used = visible_samples(SCENE)
    channels = base[:, used]
    columns = [torch.diag_embed(channels.T).permute(2, 1, 0).reshape(3, -1)]
    columns += [slope[:, used].reshape(1, -1) for slope in slopes]
    matrix = torch.cat(columns).T
    target = picture[:, used].reshape(-1)
    lit = channels.abs().sum(dim=1) > 0
    keep = torch.cat([lit, torch.ones(len(slopes), dtype=torch.bool)])
    found = torch.linalg.lstsq(matrix[:, keep], target[:, None]).solution[:, 0]
    gains, turn = found[: int(lit.sum())], found[int(lit.sum()) :]
    left = (target - matrix[:, keep] @ found).square().mean().sqrt() / target.mean()
    return Agreement(math.degrees(float(turn.norm())), float((gains - 1).abs().max()), 100 * float(left))


def _slope(values: Callable[[float], Tensor]) -> Float[Tensor, "3 points"]:
    """Returns the derivative of a rendering with respect to an angle, per radian."""
    return (values(STEP).double() - values(-STEP).double()) / (2 * STEP)


def own_error(light: EnvironmentMap, rendering: Rendering, degrees: float = 1.0) -> list[float]:
    """Returns what the measure finds, in degrees, where torchlight's own light is turned about x, y and z."""
    pictures = (relight(SCENE, turned(light, axis, math.radians(degrees)), SLOPE_RAYS).double() for axis in range(3))
    return [agreement(picture, rendering).degrees for picture in pictures]
