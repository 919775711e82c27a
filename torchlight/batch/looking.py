"""One photograph: what it shows of its scene's receiver, and what it says about the scene itself."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from torchlight import doubts
from torchlight.batch.scenes import Setting
from torchlight.config import Config
from torchlight.errors import CalibrationError
from torchlight.geometry.scene import Scene
from torchlight.inversion.adaptive import AdaptiveHaar
from torchlight.io.exif import Exif
from torchlight.io.images import Photo
from torchlight.near_light.height import height_sentence, lit_as_found
from torchlight.near_light.verdict import NearLight, near_light
from torchlight.observing import check_lit, linearize, observe, placed, visible_part
from torchlight.photo.observation import LinearPhoto, Observation
from torchlight.photo.radiometry import resolve_encoding
from torchlight.placement import shadow, silhouette
from torchlight.placement.report import Placement, sentence
from torchlight.report.jpegs import photograph


@dataclass(frozen=True, eq=False)
class Looked:
    """What one photograph showed.

    Attributes:
        photo: the file.
        sha256: of it.
        exif: what the camera wrote beside it.
        observation: samples and weights.
        scene: with this photograph's camera, and its object where that was moved.
        placement: how far the object was moved; None where that was not asked for.
        near: what it tells of the distance of its light, where that was asked before the light was sought.
        seconds: spent on it.
        notes: what was found about the scene, one line each.
        warnings: what is doubtful about it, one line each.
        picture: of it, small, for its report (JPEG); empty where there is to be none.
    """

    photo: Path
    sha256: str
    exif: Exif
    observation: Observation
    scene: Scene
    placement: Placement | None = None
    near: NearLight | None = None
    seconds: float = 0.0
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    picture: bytes = b""


def look(setting: Setting, path: Path, stored: Photo, exposure: float | str | None = None) -> Looked:
    """Returns what a photograph shows.

    Args:
        setting: of its scene.
        path: names it in errors.
        stored: as read.
        exposure: what linear values are divided by; "exif" = what the camera recorded; None = 1.

    Raises:
        TorchlightError: it cannot be used.
    """
    start = time.perf_counter()
    scene = placed(setting.scene, stored, str(path))
    visible = setting.visible if scene is setting.scene else visible_part(scene)
    linear = exposed(linearize(stored, scene), factor(exposure, stored.exif))
    observation = observe(linear, scene, visible, setting.empty)
    check_lit(observation)
    looked = Looked(path, stored.sha256, stored.exif, observation, scene)
    for refinement in refinements(setting.config):
        looked = refinement(setting, looked, linear)
    said = (doubts.stretched(stored, scene), doubts.tone_mapped(stored, looked.observation, looked.scene))
    warnings = tuple(line for line in said if line)
    small = shown(stored, scene) if setting.config.output.reports else b""
    return replace(looked, seconds=time.perf_counter() - start, warnings=warnings, picture=small)


def shown(stored: Photo, scene: Scene) -> bytes:
    """Returns a photograph as its report shows it."""
    return photograph(stored.pixels, resolve_encoding(scene.encoding, stored.bits) in ("linear", "raw"))


def refinements(config: Config) -> Iterator[Callable[[Setting, Looked, LinearPhoto], Looked]]:
    """Yields what a photograph is asked about its scene, in order: the outline needs no light, the shadow does."""
    if config.checks.refine_pose == "silhouette":
        yield moved_by_silhouette
    if config.checks.estimate_height:
        yield lit_from_a_height
    if config.checks.refine_pose == "shadow":
        yield moved_by_shadow


def moved_by_silhouette(setting: Setting, looked: Looked, linear: LinearPhoto) -> Looked:
    """Returns the photograph with the object where its outline in the picture says it is."""
    scene, placement = silhouette.refine(looked.scene, linear)
    return moved(looked, scene, placement, seen_as(setting, looked, linear, scene))


def moved_by_shadow(setting: Setting, looked: Looked, linear: LinearPhoto) -> Looked:
    """Returns the photograph with the object where its shadow says it is."""

    def seen(scene: Scene) -> Observation:
        return seen_as(setting, looked, linear, scene)

    scene, placement = shadow.refine(looked.scene, seen, AdaptiveHaar(noise=setting.config.adaptive.noise))
    return moved(looked, scene, placement, seen(scene))


def lit_from_a_height(setting: Setting, looked: Looked, linear: LinearPhoto) -> Looked:
    """Returns the photograph with its light at the height that the near-light test finds, where it finds one."""
    near = near_light(looked.scene, looked.observation)
    scene = lit_as_found(looked.scene, near)
    return replace(looked, scene=scene, near=near, notes=(*looked.notes, height_sentence(scene, near)))


def moved(looked: Looked, scene: Scene, placement: Placement, observation: Observation) -> Looked:
    """Returns a photograph with its object moved, and the sentence that says by how much."""
    notes = (*looked.notes, sentence(placement, scene.units))
    return replace(looked, scene=scene, observation=observation, placement=placement, notes=notes)


def seen_as(setting: Setting, looked: Looked, linear: LinearPhoto, scene: Scene) -> Observation:
    """Returns what a photograph shows of a scene that may differ from the one it was looked at with."""
    return looked.observation if scene is looked.scene else observe(linear, scene, visible_part(scene), setting.empty)


def factor(exposure: float | str | None, exif: Exif) -> float:
    """Returns what linear values are divided by.

    Raises:
        CalibrationError: the exposure is to be that of EXIF, which records none.
    """
    if exposure is None or isinstance(exposure, int | float):
        return 1.0 if exposure is None else float(exposure)
    if exif.exposure is None:
        raise CalibrationError("exposure: exif, but the file records no exposure time; give a number")
    return exif.exposure


def exposed(photo: LinearPhoto, exposure: float) -> LinearPhoto:
    """Returns a photograph in units of its exposure."""
    return photo if exposure == 1.0 else replace(photo, radiance=photo.radiance / exposure)
