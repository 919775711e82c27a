"""One analysed set of photographs: a scene alone, or several under one light, with all that is shown of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchlight.analysis.nullity import Nullity, equations, nullity
from torchlight.analysis.observability import Observability, coarsened, observability, stacked, whitened
from torchlight.analysis.spectrum import (
    Slices,
    energy_per_degree,
    representative_samples,
    slices,
    total_energy,
    transfer_harmonics,
)
from torchlight.analysis.verdict import camera_azimuth, verdict
from torchlight.errors import SceneError
from torchlight.geometry.footprints import shown_samples
from torchlight.geometry.scene import Scene
from torchlight.observing import sample_photo, visible_part
from torchlight.photo.observation import linear_photo
from torchlight.transfer import Transfer

DETAIL = 16  # texels along a face's edge of the observability map: "16x16" in the verdict


@dataclass(frozen=True, eq=False)
class View:
    """A scene and which of its samples are used.

    Attributes:
        path: the scene file.
        scene: the scene.
        used: samples that the camera sees and the mask allows.
        uncovered: samples on which no occluder stands: what an ideal photograph would show.
        transfer: the transport of all samples.
    """

    path: Path
    scene: Scene
    used: Bool[Tensor, " points"]
    uncovered: Bool[Tensor, " points"]
    transfer: Transfer


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Energy of the transfer function, and what it looks like at some samples.

    Attributes:
        energy: per degree l of every used sample.
        total: over all degrees.
        slices: at three samples of the first scene.
    """

    energy: Float[Tensor, "points degrees"]
    total: Float[Tensor, " points"]
    slices: Slices


@dataclass(frozen=True, eq=False)
class Case:
    """What one scene, or several under one light, can determine.

    Attributes:
        name: of the scene file, or "all together".
        views: the scenes.
        curve: nullity of the samples that are used.
        ideal: nullity if all samples but those under an occluder were seen.
        seen: observability at 16 x 16.
        spectrum: of the used samples.
        lines: the verdict.
    """

    name: str
    views: tuple[View, ...]
    curve: Nullity
    ideal: Nullity
    seen: Observability
    spectrum: Spectrum
    lines: list[str]


def used_samples(scene: Scene) -> Bool[Tensor, " points"]:
    """Returns the samples that a photograph of the scene can show and its mask allows.

    Raises:
        SceneError: none.
    """
    visible = visible_part(scene)
    if scene.camera is None or scene.mask is None:
        return visible
    width, height = scene.camera.image_size
    used = sample_photo(linear_photo(torch.ones(3, height, width)), scene, visible).weights > 0
    if not bool(used.any()):
        raise SceneError("no visible sample of the receiver is left by the mask; check the mask")
    return used


def view(path: Path, scene: Scene, transfer: Transfer) -> View:
    """Returns a scene with the samples that count."""
    return View(path, scene, used_samples(scene), shown_samples(replace(scene, camera=None)), transfer)


def cases(
    views: Sequence[View], bandwidth_max: int, rotations: Float[Tensor, "rotations 3 3"], noise: float
) -> list[Case]:
    """Returns each scene's case and, for several scenes, that of all together."""
    harmonics = [transfer_harmonics(item.transfer, bandwidth_max - 1) for item in views]
    groups = [[i] for i in range(len(views))] + ([list(range(len(views)))] if len(views) > 1 else [])
    return [_case([views[i] for i in group], [harmonics[i] for i in group], rotations, noise) for group in groups]


def _case(
    views: Sequence[View],
    harmonics: Sequence[Float[Tensor, "points coeffs"]],
    rotations: Float[Tensor, "rotations 3 3"],
    noise: float,
) -> Case:
    rows = [equations(part, len(item.used)) for part, item in zip(harmonics, views, strict=True)]
    curve = nullity(torch.cat([part[item.used] for part, item in zip(rows, views, strict=True)]), rotations)
    ideal = nullity(torch.cat([part[item.uncovered] for part, item in zip(rows, views, strict=True)]), rotations)
    seen = observability(stacked([whitened(coarsened(item.transfer, DETAIL), item.used, noise) for item in views]))
    azimuth = camera_azimuth(views[0].scene) if len(views) == 1 else None
    name = views[0].path.stem if len(views) == 1 else "all together"
    lines = verdict(curve, seen, azimuth, noise)
    return Case(name, tuple(views), curve, ideal, seen, _spectrum(views, harmonics), lines)


def _spectrum(views: Sequence[View], harmonics: Sequence[Float[Tensor, "points coeffs"]]) -> Spectrum:
    used = [Transfer(item.transfer.transport[item.used], item.transfer.resolution) for item in views]
    energy = [energy_per_degree(part[item.used]) for part, item in zip(harmonics, views, strict=True)]
    first = views[0]
    chosen = representative_samples(first.transfer, first.used.nonzero()[:, 0])
    return Spectrum(torch.cat(energy), torch.cat([total_energy(part) for part in used]), slices(first.scene, chosen))
