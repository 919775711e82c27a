"""The three-sphere protocol: spheres of three materials relit by two lights, and the errors of their pictures.

Published evaluations agree on the idea and differ in everything else; what they differ in are the fields of `Protocol`.
docs/metrics.md says which values give whose numbers, and what is not reproduced.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchlight.errors import ConfigError
from torchlight.light.environment import EnvironmentMap
from torchlight.light_metrics import spheres
from torchlight.light_metrics.grid import check_height, resampled
from torchlight.light_metrics.radiance import vector_angles
from torchlight.light_metrics.spheres import SphereView, sphere_view

MATERIALS = ("mirror", "matte", "diffuse")
Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Tone:
    """A curve that a map goes through before it lights anything: a L^(1 / gamma), each map with an a of its own.

    Attributes:
        gamma: of the curve.
        percentile: of the positive values after the power, all channels together.
        level: the value that a gives to that percentile.
    """

    gamma: float = 2.4
    percentile: float = 50.0
    level: float = 0.5


@dataclass(frozen=True)
class Protocol:
    """How spheres are lit, seen and scored.

    Attributes:
        map_height: rows that both maps are averaged to first; None = as they are.
        tone: the curve that both maps go through, each for itself; None = linear radiance.
        view: from the sphere towards the viewer.
        size: pixels along the picture's edge.
        albedo: what all spheres reflect of the light.
        roughness: of the matte sphere.
        clip: pictures are clipped to [0, clip] before they are scored; None = HDR.
        pixels: which count: those of the sphere, or the whole picture with a black background.
        frame: width and height of the whole picture in radii of the sphere, for `pixels` and `percentiles`.
        per: squared errors are divided by the number of "value"s, or of "pixel"s: sqrt(3) larger.
        percentiles: of all values of a whole picture that norm-RMSE brings to 0 and 1, each picture for itself.
        black: pixels without a colour are left out of the angular error ("skip"), or count as right ("zero").
    """

    map_height: int | None = 128
    tone: Tone | None = None
    view: tuple[float, float, float] = (0.0, -16.0, 2.0)
    size: int = 64
    albedo: float = 1.0
    roughness: float = spheres.GGX_ROUGHNESS
    clip: float | None = None
    pixels: Literal["sphere", "image"] = "sphere"
    frame: tuple[float, float] = (2.0, 2.0)
    per: Literal["value", "pixel"] = "value"
    percentiles: tuple[float, float] = (0.01, 99.9)
    black: Literal["skip", "zero"] = "skip"


# camera 85 mm before a sensor of 36 x 20.25 mm, 16.12 radii away: the sphere's outline has a radius of 5.28 mm
STYLELIGHT = Protocol(tone=Tone(), albedo=0.8, frame=(6.82, 3.83), per="pixel", black="zero")
PROTOCOLS = {"plain": Protocol(), "stylelight": STYLELIGHT, "diffusionlight": STYLELIGHT}


@dataclass(frozen=True, eq=False)
class SphereScore:
    """The errors of one material's picture.

    Attributes:
        rmse: of the pictures, in units of the (toned) radiance.
        si_rmse: after the one scale of all channels that makes it smallest.
        scale: that scale, for the light.
        norm_rmse: after each picture's percentiles are brought to 0 and 1; NaN for a picture of one value.
        angle: mean angle between the RGB vectors, in degrees.
    """

    rmse: Float[Tensor, "*batch"]
    si_rmse: Float[Tensor, "*batch"]
    scale: Float[Tensor, "*batch"]
    norm_rmse: Float[Tensor, "*batch"]
    angle: Float[Tensor, "*batch"]


@dataclass(frozen=True, eq=False)
class SphereTest:
    """Spheres under a light and under its reference.

    Attributes:
        scores: by material.
        light: what the sphere's pixels show under the light, by material, before any clipping.
        reference: likewise.
        inside: where in the picture these pixels are.
    """

    scores: dict[str, SphereScore]
    light: dict[str, Tensor]
    reference: dict[str, Tensor]
    inside: Bool[Tensor, "size size"]


def sphere_test(
    light: EnvironmentMap, reference: EnvironmentMap, protocol: Protocol, progress: Progress | None = None
) -> SphereTest:
    """Returns the three spheres under two lights, with their errors.

    Raises:
        ConfigError: a setting out of range.
    """
    check_protocol(protocol)
    view = sphere_view(protocol.size, protocol.view, device=light.radiance.device)
    both = torch.stack([prepared(light, protocol), prepared(reference, protocol)], dim=-4)
    lights = EnvironmentMap(both, nonnegative=bool((both >= 0).all()))
    drawn = {
        "mirror": spheres.mirror_sphere(lights, view),
        "matte": spheres.matte_sphere(lights, view, protocol.roughness, progress),
        "diffuse": spheres.diffuse_sphere(lights, view, progress),
    }
    drawn = {name: protocol.albedo * values for name, values in drawn.items()}
    first = {name: values[..., 0, :, :] for name, values in drawn.items()}
    second = {name: values[..., 1, :, :] for name, values in drawn.items()}
    scores = {name: sphere_score(first[name], second[name], protocol, view) for name in MATERIALS}
    return SphereTest(scores, first, second, view.inside)


def prepared(environment: EnvironmentMap, protocol: Protocol) -> Float[Tensor, "*batch 3 height width"]:
    """Returns the radiance that lights the spheres, in float64."""
    radiance = environment.radiance.double()
    if protocol.map_height is not None:
        radiance = resampled(radiance, protocol.map_height)
    return radiance if protocol.tone is None else toned(radiance, protocol.tone)


def toned(radiance: Float[Tensor, "*batch 3 height width"], tone: Tone) -> Float[Tensor, "*batch 3 height width"]:
    """Returns a max(L, 0)^(1 / gamma) with level = a times the percentile of what is positive; black stays black."""
    powers = radiance.clamp(min=0) ** (1 / tone.gamma)
    flat = torch.where(powers > 0, powers, torch.nan).flatten(start_dim=-3)
    mark = torch.nanquantile(flat, tone.percentile / 100, dim=-1)
    scale = tone.level / torch.where(mark > 0, mark, 1.0)
    return scale[..., None, None, None] * powers


def sphere_score(
    light: Float[Tensor, "*batch 3 pixels"],
    reference: Float[Tensor, "*batch 3 pixels"],
    protocol: Protocol,
    view: SphereView,
) -> SphereScore:
    """Returns the errors of one sphere's pixels, as the protocol counts them."""
    x, y = light.double(), reference.double()
    if protocol.clip is not None:
        x, y = x.clamp(0, protocol.clip), y.clamp(0, protocol.clip)
    background = background_pixels(view, protocol.frame)
    counted = float(x.shape[-1]) + (background if protocol.pixels == "image" else 0.0)
    count = counted * (x.shape[-2] if protocol.per == "value" else 1)
    square = x.square().sum(dim=(-2, -1))
    scale = torch.where(square > 0, (x * y).sum(dim=(-2, -1)) / torch.where(square > 0, square, 1.0), 0.0)
    return SphereScore(
        rmse=_root(x - y, count),
        si_rmse=_root(scale[..., None, None] * x - y, count),
        scale=scale,
        norm_rmse=_norm_rmse(x, y, protocol, background),
        angle=_angle(x, y, protocol.black, counted),
    )


def background_pixels(view: SphereView, frame: tuple[float, float]) -> float:
    """Returns how many pixels of the sphere's size the rest of a picture of `frame` radii holds; all are black."""
    size = view.inside.shape[0]
    return frame[0] * frame[1] / 4 * size**2 - int(view.inside.sum())


def normalised(
    values: Float[Tensor, "*batch 3 pixels"], percentiles: tuple[float, float], background: float
) -> tuple[Float[Tensor, "*batch 3 pixels"], Float[Tensor, "*batch"]]:
    """Returns (v - p) / (q - p) with the percentiles p and q of a picture with a black background, and that of 0."""
    zeros = values.new_zeros(*values.shape[:-1], max(0, round(background)))
    whole = torch.cat([values, zeros], dim=-1).flatten(start_dim=-2)
    low, high = (torch.quantile(whole, q / 100, dim=-1) for q in percentiles)
    span = torch.where(high > low, high - low, torch.nan)
    return (values - low[..., None, None]) / span[..., None, None], -low / span


def check_protocol(protocol: Protocol) -> None:
    """Raises ConfigError for settings out of range."""
    if protocol.map_height is not None:
        check_height(protocol.map_height)
    if protocol.clip is not None and not 0 < protocol.clip < math.inf:
        raise ConfigError(f"clip: expected a positive value, got {protocol.clip}; 1 is usual")
    if not 1 <= protocol.size <= 1024:
        raise ConfigError(f"sphere size: expected 1 to 1024 pixels, got {protocol.size}; 64 is usual")
    if min(protocol.frame) < 2:
        raise ConfigError(f"frame: a picture of {protocol.frame} radii does not hold the sphere; expected 2 or more")


def named_protocol(name: str) -> Protocol:
    """Returns one of `PROTOCOLS`; raises ConfigError for another name."""
    if name not in PROTOCOLS:
        raise ConfigError(f"protocol: unknown name {name!r}; choose one of {', '.join(PROTOCOLS)}")
    return replace(PROTOCOLS[name])


def _root(values: Float[Tensor, "*batch 3 pixels"], count: float) -> Float[Tensor, "*batch"]:
    return (values.square().sum(dim=(-2, -1)) / count).sqrt()


def _norm_rmse(x: Tensor, y: Tensor, protocol: Protocol, background: float) -> Float[Tensor, "*batch"]:
    (first, first_black), (second, second_black) = (normalised(v, protocol.percentiles, background) for v in (x, y))
    channels, pixels = x.shape[-2], float(x.shape[-1])
    square = (first - second).square().sum(dim=(-2, -1))
    if protocol.pixels == "image":
        square = square + background * channels * (first_black - second_black).square()
        pixels = pixels + background
    return (square / (pixels * (channels if protocol.per == "value" else 1))).sqrt()


def _angle(x: Tensor, y: Tensor, black: str, counted: float) -> Float[Tensor, "*batch"]:
    """Returns the mean angle between RGB vectors, over the pixels that have a colour or over all that are counted."""
    angle, coloured = vector_angles(x.mT, y.mT)
    total = torch.where(coloured, angle, 0.0).sum(dim=-1)
    return total / (coloured.sum(dim=-1) if black == "skip" else counted)
