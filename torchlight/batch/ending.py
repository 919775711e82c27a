"""Photographs of one scene: solved together, written one by one.

A photograph that cannot be used costs itself, never its neighbours: what it fails of is data (`Ended.reason`).
"""

from __future__ import annotations

import functools
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import torch

from torchlight import doubts
from torchlight.batch.looking import Looked
from torchlight.batch.scenes import Shared, timed
from torchlight.errors import TorchlightError
from torchlight.geometry.scene import Scene
from torchlight.io.files import one_line, reason
from torchlight.near_light.verdict import NearLight, near_light
from torchlight.photo.observation import Observation
from torchlight.pipeline import Estimate, explain, explain_robustly, with_confidence
from torchlight.precomputation import columns_for
from torchlight.results import Pages, Provenance, evidence, select, write_result
from torchlight.solvers import Status
from torchlight.solvers.solution import CAUSE_AND_CURE


@dataclass(frozen=True, eq=False)
class Ended:
    """How one photograph ended.

    Attributes:
        photo: the file.
        reason: why there is no result, one line; empty where there is one.
        result: what result.json holds; empty where there is none.
        warnings: what is to be said of it, one line each.
    """

    photo: Path
    reason: str = ""
    result: Mapping[str, Any] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()


def solved(shared: Shared, looked: Sequence[Looked]) -> Iterator[tuple[Shared, Looked, Estimate, float]]:
    """Yields each photograph's estimate with what it shared, and its part of the seconds."""
    for group, alike in sharing(shared, looked):
        start = time.perf_counter()
        shown = [one.observation for one in alike]
        parts = ([one.samples for one in shown], [one.weights for one in shown], [one.rejections for one in shown])
        observation = Observation(*(torch.stack(part).to(shared.device) for part in parts))
        method = explain_robustly if shared.setting.config.solver.robust else explain
        estimate = method(observation, group.setting.scene, group.columns, group.basis, group.solver)
        share = (time.perf_counter() - start) / len(alike)
        for item, one in enumerate(alike):
            yield group, one, select(estimate, item), share


def sharing(shared: Shared, looked: Sequence[Looked]) -> Iterator[tuple[Shared, Sequence[Looked]]]:
    """Yields the photographs that share a transport, with it; one whose object or light was moved has its own."""
    alike = [one for one in looked if casts_as_stated(shared.setting.scene, one)]
    if alike:
        yield shared, alike
    for one in looked:
        if not casts_as_stated(shared.setting.scene, one):
            seconds = dict(shared.seconds)
            with timed(seconds, "transport"):
                cached = not shared.setting.config.compute.no_cache
                columns = columns_for(one.scene, shared.basis, shared.solver, cached, device=shared.device)
            setting = replace(shared.setting, scene=one.scene)
            yield replace(shared, setting=setting, columns=columns, seconds=seconds), [one]


def casts_as_stated(scene: Scene, looked: Looked) -> bool:
    """Returns whether a photograph's shadows are those of the scene as its file states it."""
    moved = looked.placement is not None and looked.placement.changed
    return not moved and looked.scene.light_plane == scene.light_plane


def nearness(shared: Shared, looked: Looked) -> NearLight | None:
    """Returns what a photograph tells of the distance of its light; None where that is not asked."""
    if looked.near is not None or shared.setting.config.checks.skip_near_test:
        return looked.near
    return near_light(looked.scene, looked.observation)


def write(
    folder: Path,
    shared: Shared,
    looked: Looked,
    estimate: Estimate,
    near: NearLight | None,
    solve_seconds: float,
    overwrite: bool = False,
) -> Ended:
    """Writes one photograph's folder, complete or not at all, and returns how that ended.

    Raises:
        FormatError: the folder is there and `overwrite` is False, or it cannot be written.
    """
    config = shared.setting.config
    unusable = unusable_channels(estimate)
    if unusable:
        return Ended(looked.photo, unusable, warnings=looked.warnings)
    distance = doubts.near(near, looked.scene.units) if looked.scene.light_plane is None else ""
    said = (*looked.warnings, doubts.poorly_explained(estimate), doubts.rejections(estimate), distance)
    warnings = tuple(line for line in said if line)
    provenance = Provenance(
        shared.setting.scene_sha256,
        looked.sha256,
        str(looked.photo),
        config.light.method,
        config.solver.name,
        {**shared.seconds, "photograph": looked.seconds, "solve": solve_seconds},
        looked.exif,
        looked.placement,
        looked.scene.camera,
        near,
        warnings,
        config.output.fill,
    )
    pictures = {} if config.output.skip_pictures else evidence(estimate, shared.setting.scene, provenance)
    if not config.output.skip_confidence:
        estimate = with_confidence(estimate, shared.setting.scene, shared.columns, shared.solver)
    pages = pages_of(shared.setting.scene, looked) if config.output.reports else None
    result = write_result(folder, estimate, shared.setting.scene, provenance, overwrite, pictures, pages)
    return Ended(looked.photo, "", result, warnings)


def pages_of(scene: Scene, looked: Looked) -> Pages:
    """Returns what makes the report of a photograph."""
    from torchlight.report.page import photo_files  # at start-up nothing of it is needed

    return functools.partial(photo_files, looked.picture, scene.receiver)


def unusable_channels(estimate: Estimate) -> str:
    """Returns why a solve gave no light, or an empty string."""
    for value in estimate.solution.status.tolist():
        if Status(value) in (Status.NOT_FINITE, Status.NO_OBSERVATIONS):
            return CAUSE_AND_CURE[Status(value)]
    return ""


def failure(error: Exception) -> str:
    """Returns one line for what stopped a photograph; what torchlight does not raise on purpose says its class."""
    if isinstance(error, TorchlightError):
        return one_line(str(error), 1000)
    if isinstance(error, MemoryError):
        return "not enough memory; use a smaller photograph, or fewer workers"
    return f"unexpected {type(error).__name__}: {reason(error)}; please report it"
