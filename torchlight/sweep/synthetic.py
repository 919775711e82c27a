"""A trial on synthetic data: the light from the photograph of one pose, scored on the shadows of poses never shown.

photograph = round(255 (s v + n)) / 255           v: analytic shadow, s: exposure, n: Gaussian noise
light      = explain(photograph)                  all lights at once
score      = rms_255(relight(pose, light), s v)   every other pose, without noise and rounding
"""

from __future__ import annotations

import time
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from torchlight import metrics
from torchlight.batch.ending import unusable_channels
from torchlight.config import Config
from torchlight.errors import SolveError
from torchlight.geometry.footprints import visible_samples
from torchlight.geometry.receiver import Receiver
from torchlight.io.sweep_data import Source, Synthetic
from torchlight.light.environment import EnvironmentMap
from torchlight.method import named_device, named_method
from torchlight.observing import observe
from torchlight.photo.observation import linear_photo
from torchlight.pipeline import Estimate, explain, explain_robustly
from torchlight.precomputation import columns_for
from torchlight.relighting import relight
from torchlight.results import select
from torchlight.solvers import Status
from torchlight.sweep.truth import truth
from torchlight.synthetic import EXPOSED, block_scene, eight_bit, expose, receiver_image

RELIGHT_RAYS = 32_768  # per pose, a quarter of the usual: 0.1 of 255, the same for all trials


@dataclass(frozen=True)
class Measured:
    """What came of a trial.

    Attributes:
        figures: of all lights or photographs together; no time is among them.
        each: of every light or photograph, by name.
        seconds: by stage.
    """

    figures: dict[str, Any]
    each: dict[str, dict[str, Any]]
    seconds: dict[str, float]


def measure_synthetic(config: Config, data: Synthetic, folder: Path) -> Measured:
    """Returns what a configuration makes of synthetic data.

    Args:
        config: the settings.
        data: the lights, the poses and the photograph.
        folder: where ground truth is kept.

    Raises:
        TorchlightError: the settings contradict each other, or a light cannot be used.
    """
    receiver = Receiver((0.0, 0.0), data.plane, (data.samples, data.samples))
    scene = block_scene(data.seen, receiver)
    basis, solver = named_method(config)
    device = named_device(config.compute.device, solver)
    shown = [photograph(light, data, receiver, folder) for light in data.lights]
    photos = torch.stack([receiver_image(photo, receiver) for photo, _ in shown]).float()
    observation = observe(linear_photo(photos.to(device)), scene)
    begun = time.perf_counter()
    columns = columns_for(scene, basis, solver, not config.compute.no_cache, device=device)
    cast = time.perf_counter()
    method = explain_robustly if config.solver.robust else explain
    estimate = method(observation, scene, columns, basis, solver)
    solved = time.perf_counter()
    each = {}
    for item, (light, (_, exposure)) in enumerate(zip(data.lights, shown, strict=True)):
        one = select(estimate, item)
        why = unusable_channels(one)
        if why:
            raise SolveError(f"{light.name}: {why}")
        scores = held_out(one.light, light, data, exposure, folder)
        each[light.name] = {
            "held_out_rms_255": fmean(scores),
            "worst_rms_255": max(scores),
            "fit_rms_255": one.rms_255.item(),
            **solution_figures(one),
        }
    seconds = {"transport": cast - begun, "solve": solved - cast}
    return Measured(together(each, ("held_out_rms_255", "fit_rms_255", "functions")), each, seconds)


def photograph(
    light: Source, data: Synthetic, receiver: Receiver, folder: Path
) -> tuple[Float[Tensor, "3 points"], float]:
    """Returns the 8-bit photograph of the pose that is shown, and its exposure.

    Noise depends on the seed and the light's name alone: settings are compared on the same photograph.
    """
    values = truth(light, data.seen, receiver, folder)
    exposure = expose(values, visible_samples(block_scene(data.seen, receiver)))
    # one number of 32 bits for name and seed: torch's generator takes no notice of higher ones
    generator = torch.Generator().manual_seed(zlib.crc32(light.name.encode(), data.seed))
    drawn = torch.randn(values.shape, generator=generator, dtype=values.dtype)
    return eight_bit(values * exposure + data.noise * EXPOSED * drawn), exposure


def held_out(found: EnvironmentMap, light: Source, data: Synthetic, exposure: float, folder: Path) -> list[float]:
    """Returns the RMS of 255 of every pose that was never shown, against its analytic shadow."""
    receiver = Receiver((0.0, 0.0), data.plane, (data.samples, data.samples))
    scores = []
    for block in data.held_out:
        scene = block_scene(block, receiver)
        expected = (truth(light, block, receiver, folder) * exposure).float()
        shown = relight(scene, found, RELIGHT_RAYS)
        scores.append(metrics.rms_255(shown.cpu(), expected, visible_samples(scene).float()).item())
    return scores


def solution_figures(estimate: Estimate) -> dict[str, Any]:
    """Returns how many functions a light is made of (most per channel), and how well the solve ended.

    Functions are those in use, of the adaptive method; else all of the basis.
    """
    chosen, solution = estimate.refinement, estimate.solution
    return {
        "functions": estimate.basis.size if chosen is None else int(chosen.functions.max()),
        "kkt_residual": solution.kkt_residual.max().item(),
        "converged": bool((solution.status == Status.CONVERGED).all()),
    }


def together(each: dict[str, dict[str, Any]], means: Sequence[str]) -> dict[str, Any]:
    """Returns the figures of all lights or photographs: some as means, others as the worst."""
    rows = list(each.values())
    found: dict[str, Any] = {key: fmean(row[key] for row in rows) for key in means}
    for key in rows[0]:
        if key == "converged":
            found[key] = all(row[key] for row in rows)
        elif key not in means:
            found[key] = max(row[key] for row in rows)
    return found
