"""The main job on data of its own: a block's photograph, the light recovered from it, a second pose relit."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from torchlight import figures, fit, metrics
from torchlight.geometry.analytic_shadow import Block
from torchlight.geometry.footprints import visible_samples
from torchlight.geometry.receiver import Receiver
from torchlight.inversion.adaptive import AdaptiveHaar
from torchlight.io.atomic import make_folder, write_atomically
from torchlight.io.images import write_png
from torchlight.io.lights import write_light
from torchlight.light.environment import EnvironmentMap
from torchlight.photo.observation import Observation, linear_photo
from torchlight.pipeline import Estimate, estimate
from torchlight.precomputation import columns_for
from torchlight.relighting import relight
from torchlight.synthetic import block_scene, block_values, eight_bit, expose, pixel_rays, receiver_image

RECEIVER = Receiver(center=(0.0, 0.0), size=(4.0, 4.0), samples=(64, 64))
FIRST_POSE = Block((1.0, 0.6, 1.2), rotation_degrees=20.0)
METHOD = AdaptiveHaar()
RELIGHT_RAYS = 32_768  # a quarter of the default: 0.1 of 255, and the demo is to be quick
SECOND_POSE = Block((1.0, 0.6, 1.2), rotation_degrees=69.0, translation=(0.3, 0.2))
Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Outcome:
    """What the demo measured.

    Attributes:
        fit_rms_255: the photograph against the recovered light's prediction.
        relit_rms_255: the second pose, never shown to the solver, against its analytic truth.
        seconds: the recovery alone: transport and solve.
        files: the pictures, in the order to look at them.
    """

    fit_rms_255: float
    relit_rms_255: float
    seconds: float
    files: tuple[Path, ...]


def run_demo(out: Path, light: EnvironmentMap, progress: Progress | None = None) -> Outcome:
    """Photographs a block under a light, recovers the light, relights a second pose, and writes the pictures.

    The photograph is 8-bit; it and the truth of the second pose come from the block's analytic shadow.
    """
    make_folder(out)
    scene, second = block_scene(FIRST_POSE, RECEIVER), block_scene(SECOND_POSE, RECEIVER)
    rays = pixel_rays(light)
    values = block_values(FIRST_POSE, RECEIVER, rays)
    exposure = expose(values, visible_samples(scene))
    photo = receiver_image(eight_bit(values * exposure), RECEIVER).float()
    truth = (block_values(SECOND_POSE, RECEIVER, rays) * exposure).float()

    start = time.perf_counter()
    columns = columns_for(scene, METHOD.basis, METHOD, use_cache=False, progress=progress)
    found = estimate(linear_photo(photo), scene, solver=METHOD, transfer=columns)
    seconds = time.perf_counter() - start

    relit = relight(second, found.light, RELIGHT_RAYS, progress)
    judged = Observation(truth, visible_samples(second).float())
    relit_rms = metrics.rms_255(relit, truth, judged.weights).item()
    files = write_pictures(out, found, photo, light, exposure)
    title = f"a second pose, never shown to the solver, relit by the recovered light; RMS {relit_rms:.2f} of 255"
    picture = fit.fit_picture(judged, relit, RECEIVER, "units", title, ("truth", "relit"))
    write_atomically(out / "second_pose.png", picture)
    lights = (EnvironmentMap(above_horizon(light.radiance) * exposure), found.light)
    story = figures.overview(found.observation, lights, judged, relit, RECEIVER)
    write_atomically(out / "overview.png", story)
    files = (out / "overview.png", *files, out / "second_pose.png")
    return Outcome(found.rms_255.item(), relit_rms, seconds, files)


def write_pictures(
    out: Path, found: Estimate, photo: Float[Tensor, "3 rows columns"], light: EnvironmentMap, exposure: float
) -> tuple[Path, ...]:
    """Writes the photograph, the fit, and the true and recovered light; returns their paths."""
    pixels = (photo * 255).round().byte().permute(1, 2, 0).contiguous()
    write_png(out / "photo.png", pixels.numpy())
    title = f"the photograph and the recovered light's prediction; RMS {found.rms_255.item():.2f} of 255"
    write_atomically(out / "fit.png", fit.fit_picture(found.observation, found.predicted, RECEIVER, "units", title))
    true_light = EnvironmentMap(above_horizon(light.radiance) * exposure)
    write_atomically(out / "light.png", figures.light_comparison(true_light, found.light))
    write_light(out / "light.exr", found.light, {"method": "adaptive"})
    return tuple(out / name for name in ("photo.png", "fit.png", "light.png", "light.exr"))


def above_horizon(radiance: Float[Tensor, "3 height width"]) -> Float[Tensor, "3 height width"]:
    """Returns a map with black ground: the plane never sees what is below it."""
    upper = torch.arange(radiance.shape[-2], device=radiance.device) < radiance.shape[-2] // 2
    return radiance * upper[:, None]
