"""What `torchlight estimate` says about a photograph that it uses, but that may mislead: one line each."""

from __future__ import annotations

from pathlib import Path

import torch

from torchlight.cli import fail
from torchlight.geometry.receiver import sample_centers
from torchlight.geometry.scene import Scene
from torchlight.io.images import Photo
from torchlight.near_light.verdict import NearLight
from torchlight.photo.observation import Observation, Rejection
from torchlight.photo.tone import HALO, halo
from torchlight.pipeline import Estimate

SHADOW = 0.9  # of the brightest sample predicted: what is darker is the object's own shadow
MANY = 0.1  # of the shadow's samples, or of all: a stick's shadow or a stain is less


def warn_of_tone_mapping(path: Path, photo: Photo, observation: Observation, scene: Scene) -> None:
    """Says so in one line where the plane is brightest beside the shadow, which only a local tone map does."""
    if photo.is_linear:
        return
    excess = halo(observation, sample_centers(scene.receiver), scene.receiver.samples).item()
    if excess > HALO:
        fail(
            f"warning: {path}: the plane is {excess:.1%} brighter beside the shadow than far from it: the camera's "
            "local tone mapping (switch HDR off, or photograph RAW), a near lamp, or a second object"
        )


def warn_of_near_light(path: Path, near: NearLight | None, unit: str) -> None:
    """Says so in one line where the light's direction drifts over the plane."""
    if near is not None and near.flagged:
        fail(
            f"warning: {path}: the light is near: its direction turns by {near.drift_degrees:.0f} +- "
            f"{near.deviation_degrees:.0f} degrees over the receiver (a lamp about {near.distance:.2g} {unit} away); "
            "the recovered light is a mean over the plane and does not relight other places exactly"
        )


def warn_of_rejections(path: Path, estimate: Estimate) -> None:
    """Says so in one line where the robust loss let go of more than a tenth of the object's shadow, or of all."""
    observation = estimate.observation
    lost, kept = observation.rejections == Rejection.ROBUST, observation.weights > 0
    brightness = estimate.predicted.mean(dim=-2)
    shadow = brightness < SHADOW * brightness[kept].max()
    for where, name in ((shadow, "the object's own shadow"), (torch.ones_like(shadow), "the receiver")):
        share = int((where & lost).sum()) / max(1, int((where & (lost | kept)).sum()))
        if share > MANY:
            fail(
                f"warning: {path}: --robust let go of {share:.0%} of {name} (its fit picture shows where): the "
                "object's size or place, the pose or a near lamp does not fit; compare with the result without --robust"
            )
            return
