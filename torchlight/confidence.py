"""How far a light can be trusted, as files say it: confidence.exr, figures for result.json, and what fills the rest."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from torchlight.analysis.confidence import Confidence
from torchlight.analysis.observability import DETERMINED, texel_solid_angles
from torchlight.io.exr import write_channels
from torchlight.light.environment import LUMINANCE, EnvironmentMap, luminance
from torchlight.light.filling import constant_fill, smooth_fill
from torchlight.light.latlong import row_solid_angles


def filled(light: EnvironmentMap, found: Confidence | None, fill: str) -> EnvironmentMap:
    """Returns a light with what its photograph says nothing about filled; its other pixels stay as they are."""
    if fill == "none" or found is None:
        return light
    method = constant_fill if fill == "constant" else smooth_fill
    radiance = method(light.radiance.detach().cpu(), found.unseen_map(light.height))
    return replace(light, radiance=radiance, nonnegative=bool((radiance >= 0).all()))


def write_confidence(path: Path, confidence: Confidence, height: int, metadata: Mapping[str, Any]) -> None:
    """Writes confidence.exr: `observability` and `deviation.R`, `.G`, `.B`, pixel by pixel as light.exr."""
    planes = {f"deviation.{name}": plane for name, plane in zip("RGB", confidence.deviation_map(height), strict=True)}
    planes["observability"] = confidence.observability_map(height)
    said = {
        "deviation": "standard deviation of the radiance under noise; infinite where nothing was observed",
        "observability": f"share of structure that is determined, on {confidence.coarse} texels along a face's edge",
        "noise": confidence.noise,
        "convention": "torchlight",
    }
    write_channels(path, planes, {**metadata, **said})


def trusted(found: Confidence | None, light: EnvironmentMap) -> dict[str, Any] | None:
    """Returns how far a light can be trusted, ready for JSON; None where that was not asked."""
    if found is None:
        return None
    return {
        "determined_share": found.determined_share,
        "determined_from": DETERMINED,
        "texels_per_edge": found.coarse,
        "degrees_of_freedom": found.degrees_of_freedom,
        "noise": found.noise,
        "deviation_median": deviation_median(found, light),
    }


def deviation_median(found: Confidence, light: EnvironmentMap) -> float | None:
    """Returns the median over the directions above the plane of the luminance's deviation, of the mean luminance.

    The channels' noise is independent: variances add with the squares of the channels' weights in luminance.
    """
    weights = torch.tensor(LUMINANCE, dtype=torch.float64)
    deviation = torch.linalg.vector_norm(weights[:, None] * found.deviation.double(), dim=0)
    rows = row_solid_angles(light.height)[: light.height // 2]
    brightness = luminance(light.radiance[:, : light.height // 2].cpu().double().mean(dim=-1))
    mean = float((brightness * rows).sum() / rows.sum())
    angles = texel_solid_angles(found.resolution)
    order = deviation.argsort()
    middle = int(torch.searchsorted(angles[order].cumsum(0), angles.sum() / 2))
    found_there = float(deviation[order[middle]])
    return found_there / mean if mean > 0 and found_there < torch.inf else None
