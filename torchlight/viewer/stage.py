"""What is looked at: a scene, its light, and the shadow that the light throws, at any turn of it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchlight.geometry.scene import Scene
from torchlight.light import overlap
from torchlight.light.environment import EnvironmentMap, rotate_about_z
from torchlight.light_metrics.grid import resampled
from torchlight.preview import preview
from torchlight.relighting import albedo_over_pi
from torchlight.transfer import Transfer
from torchlight.viewer.pictures import Image, dome_picture, plane_picture, residual_picture, white_scale

Layer = Literal["observed", "predicted", "residual"]
MAP_ROWS = 256  # of the light that is turned: overlaps of finer maps take long to find


@dataclass(frozen=True, eq=False)
class Stage:
    """A scene with its light.

    Attributes:
        scene: what is seen.
        light: at any resolution.
        transfer: of the scene: the shadow is its product with the light.
        observed: linear samples of the photograph; None without one.
        used: samples that count.
        lines: facts to show beside the picture.
    """

    scene: Scene
    light: EnvironmentMap
    transfer: Transfer
    observed: Float[Tensor, "3 points"] | None
    used: Bool[Tensor, " points"]
    lines: tuple[str, ...] = ()

    @property
    def layers(self) -> tuple[Layer, ...]:
        """What the plane can show."""
        return ("predicted",) if self.observed is None else ("observed", "predicted", "residual")


def predicted(stage: Stage, degrees: float) -> Float[Tensor, "3 points"]:
    """Returns albedo E / pi of every sample, E = T x, with the light turned about +z, counter-clockwise from above."""
    turned = rotate_about_z(stage.light, degrees) if degrees else stage.light
    texels = overlap.latlong_to_texels(turned.radiance.to(stage.transfer.transport), stage.transfer.resolution)
    values = stage.transfer.mv(texels)
    return values * albedo_over_pi(stage.scene.receiver, values)


def plane(stage: Stage, layer: Layer, degrees: float, stops: float) -> Image:
    """Returns what the plane shows.

    Args:
        stage: what is looked at.
        layer: one of `stage.layers`.
        degrees: the light is turned by.
        stops: exposure: 0 = the brightest sample of the photograph, or of the shadow without a turn, is white.
    """
    scale = exposure(stage) * 2**stops
    receiver = stage.scene.receiver
    if layer == "observed" and stage.observed is not None:
        return plane_picture(stage.observed, stage.used, receiver, scale)
    shadow = predicted(stage, degrees)
    if layer == "residual" and stage.observed is not None:
        return residual_picture(shadow, stage.observed, stage.used, receiver, scale)
    return plane_picture(shadow, None, receiver, scale)


def exposure(stage: Stage) -> float:
    """Returns the factor from samples to white at 0 stops."""
    shown = predicted(stage, 0.0) if stage.observed is None else stage.observed
    return white_scale(shown, stage.used)


def dome(stage: Stage, stops: float) -> Image:
    """Returns the light's upper half, at the exposure of its preview times 2^stops."""
    return dome_picture(stage.light, preview(stage.light).scale * 2**stops)


def manageable(light: EnvironmentMap) -> EnvironmentMap:
    """Returns the light with whole pixels averaged until it has few rows enough to be turned at the speed of a hand."""
    factor = light.height // MAP_ROWS
    if factor < 2 or light.height % factor:
        return light
    return replace(light, radiance=resampled(light.radiance.double(), light.height // factor).to(light.radiance))


def of_results(tensors: dict[str, Tensor], points: int) -> tuple[Tensor, Tensor] | None:
    """Returns the samples and which are used of `estimate.safetensors`; None where they are of another receiver."""
    samples, weights = tensors.get("samples"), tensors.get("weights")
    if samples is None or weights is None or samples.shape != (3, points) or weights.shape != (points,):
        return None
    return samples.float(), weights > 0


def everything(points: int) -> Bool[Tensor, " points"]:
    """Returns that every sample counts."""
    return torch.ones(points, dtype=torch.bool)
