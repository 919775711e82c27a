"""What is said about a photograph that is used, but that may mislead: one line each, empty where there is no doubt."""

from __future__ import annotations

import torch

from torchlight.geometry.receiver import sample_centers
from torchlight.geometry.scene import Scene
from torchlight.io.images import Photo
from torchlight.near_light.verdict import NearLight
from torchlight.photo.observation import Observation, Rejection
from torchlight.photo.tone import HALO, halo
from torchlight.pipeline import Estimate

STRETCHED = 1.5  # sides of a pixel on the receiver: rectified photographs have square ones, about
SHADOW = 0.9  # of the brightest sample predicted: what is darker is the object's own shadow
POOR, NOISES = 5.0, 4.0  # of 255, and times the noise: an error that neither 8 bits nor small flaws of a model make
MANY = 0.1  # of the shadow's samples, or of all: a stick's shadow or a stain is less


def tone_mapped(photo: Photo, observation: Observation, scene: Scene) -> str:
    """Says that the plane is brightest beside the shadow, which only a local tone map does."""
    if photo.is_linear:
        return ""
    excess = halo(observation, sample_centers(scene.receiver), scene.receiver.samples).item()
    if not excess > HALO:  # NaN: too few samples to tell
        return ""
    return (
        f"the plane is {excess:.1%} brighter beside the shadow than far from it: the camera's "
        "local tone mapping (switch HDR off, or photograph RAW), a near lamp, or a second object"
    )


def stretched(photo: Photo, scene: Scene) -> str:
    """Says that a rectified photograph's pixels are far from square on the receiver."""
    height, width = photo.pixels.shape[-2:]
    across, along = scene.receiver.size[0] / width, scene.receiver.size[1] / height
    if scene.camera is not None or max(across, along) <= STRETCHED * min(across, along):
        return ""
    return (
        f"{width} x {height} pixels are spread over a receiver of {scene.receiver.size[0]:g} x "
        f"{scene.receiver.size[1]:g}: is it a rectified photograph of all of it?"
    )


def near(light: NearLight | None, unit: str) -> str:
    """Says that the light's direction drifts over the plane."""
    if light is None or not light.flagged:
        return ""
    return (
        f"the light is near: its direction turns by {light.drift_degrees:.0f} +- "
        f"{light.deviation_degrees:.0f} degrees over the receiver (a lamp about {light.distance:.2g} {unit} away); "
        "the recovered light is a mean over the plane and does not relight other places exactly"
    )


def poorly_explained(estimate: Estimate) -> str:
    """Says that the adaptive method, which makes the light as fine as it helps, leaves far more than noise."""
    if estimate.refinement is None or estimate.noise is None:
        return ""
    error, noise = float(estimate.rms_255), 255 * float(estimate.noise)
    if not error > max(POOR, NOISES * noise):
        return ""
    return (
        f"no light explains the photograph well (RMS {error:.1f} of 255, noise {noise:.1f}): is it this scene's? Check "
        "the object's size, place and turn, the camera, and photo.encoding"
    )


def rejections(estimate: Estimate) -> str:
    """Says that the robust loss let go of more than a tenth of the object's shadow, or of all."""
    observation = estimate.observation
    lost, kept = observation.rejections == Rejection.ROBUST, observation.weights > 0
    brightness = estimate.predicted.mean(dim=-2)
    shadow = brightness < SHADOW * brightness[kept].max()
    for where, name in ((shadow, "the object's own shadow"), (torch.ones_like(shadow), "the receiver")):
        share = int((where & lost).sum()) / max(1, int((where & (lost | kept)).sum()))
        if share > MANY:
            return (
                f"--robust let go of {share:.0%} of {name} (its fit picture shows where): the "
                "object's size or place, the pose or a near lamp does not fit; compare with the result without --robust"
            )
    return ""
