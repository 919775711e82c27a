"""lamps.json: the strongest lights in words and numbers, and how sure the photograph is of each direction."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from torchlight.export.handover import AXES, diameter_degrees
from torchlight.light.directions import to_angles
from torchlight.light.environment import EnvironmentMap, irradiance
from torchlight.light.lamps import Lamp, disc_mean

CONFIDENCE = "mean R_ii over the lamp's disc of the observability: 1 = the photograph told, 0 = the prior did"
UNKNOWN = "null: neither confidence.exr (torchlight estimate) nor observability.exr (torchlight analyze) was at hand"


def lamps_content(
    light: EnvironmentMap,
    rest: EnvironmentMap,
    lamps: Sequence[Lamp],
    taken: bool,
    observability: Float[Tensor, "height width"] | None,
) -> dict[str, Any]:
    """Returns what lamps.json holds.

    Args:
        light: the whole.
        rest: the light without the lamps.
        lamps: strongest first.
        taken: whether pictures are of the rest, and targets have the lamps.
        observability: R_ii in torchlight's convention, where known.
    """
    return {
        "frame": AXES,
        "units": light.units,
        "lamps_are": "taken out of the pictures" if taken else "still in the pictures",
        "plane_irradiance": irradiance(light).tolist(),
        "plane_irradiance_without_lamps": irradiance(rest).tolist(),
        "confidence_is": UNKNOWN if observability is None else CONFIDENCE,
        "lamps": [_described(lamp, observability) for lamp in lamps],
    }


def _described(lamp: Lamp, observability: Float[Tensor, "height width"] | None) -> dict[str, Any]:
    theta, phi = to_angles(torch.tensor(lamp.direction, dtype=torch.float64))
    return {
        "direction": list(lamp.direction),
        "azimuth_degrees": math.degrees(float(phi)),
        "elevation_degrees": 90 - math.degrees(float(theta)),
        "solid_angle_steradians": lamp.solid_angle,
        "diameter_degrees": diameter_degrees(lamp),
        "colour": list(lamp.colour),
        "irradiance_facing": list(lamp.irradiance),
        "irradiance_on_plane": list(lamp.plane_irradiance),
        "radiance": list(lamp.radiance),
        "share": lamp.share,
        "confidence": None if observability is None else float(disc_mean(lamp, observability)),
    }
