"""What photographs of one scene share: what they are looked at with, and what they are solved with."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from jaxtyping import Bool
from torch import Tensor

from torchlight.config import Config
from torchlight.errors import ConfigError
from torchlight.geometry.scene import Scene
from torchlight.inversion.adaptive import AdaptiveHaar
from torchlight.io.files import read_bytes, sha256_of
from torchlight.io.images import read_mask
from torchlight.io.scene_file import load_scene
from torchlight.light.bases import Basis
from torchlight.light.cubemap import texel_count
from torchlight.method import named_device, named_method
from torchlight.observing import empty_plane, visible_part
from torchlight.photo.observation import Observation
from torchlight.placement import silhouette
from torchlight.precomputation import Columns, Progress, columns_for, dense_resolution, fitting
from torchlight.solvers import Solver
from torchlight.transfer import Transfer, check_budget


@dataclass(frozen=True, eq=False)
class Setting:
    """What all photographs of a scene are looked at with.

    Attributes:
        config: the settings.
        scene: the scene.
        scene_sha256: of its file.
        visible: samples that a photograph can show.
        empty: what the plane shows without the object; None = the scene needs none.
    """

    config: Config
    scene: Scene
    scene_sha256: str
    visible: Bool[Tensor, " points"]
    empty: Observation | None


@dataclass(frozen=True, eq=False)
class Shared:
    """What all photographs of a scene are solved with.

    Attributes:
        setting: what they are looked at with.
        basis: what light is made of.
        solver: how it is found.
        device: where.
        columns: the transport.
        seconds: spent on this, by stage.
    """

    setting: Setting
    basis: Basis
    solver: Solver | AdaptiveHaar
    device: torch.device
    columns: Columns
    seconds: Mapping[str, float]


def setting_of(path: Path, config: Config, photos: Sequence[Path] = ()) -> Setting:
    """Returns what photographs of a scene are looked at with.

    Args:
        path: the scene file.
        config: the settings.
        photos: of the call, of which the reference "stack" is made where the scene lists none.

    Raises:
        TorchlightError: the scene cannot be used.
    """
    scene = load_scene(path)
    return setting_with(scene, path, config, photos)


def setting_with(scene: Scene, path: Path, config: Config, photos: Sequence[Path]) -> Setting:
    """Returns `setting_of` for a scene that is loaded."""
    check_options(config, scene)
    visible = visible_part(scene)
    return Setting(config, scene, sha256_of(read_bytes(path)), visible, empty_plane(scene, visible, photos))


def check_options(config: Config, scene: Scene) -> None:
    """Raises ConfigError where settings contradict the scene or each other."""
    checks = config.checks
    if config.output.fill != "none" and config.output.skip_confidence:
        raise ConfigError("--fill needs to know what was not determined; leave --skip-confidence away")
    if checks.refine_pose == "silhouette":
        silhouette.check_seen(scene)
    if checks.estimate_height and scene.light_plane is not None:
        raise ConfigError("--estimate-height: the scene states light.height; keep one of them")
    if checks.estimate_height and scene.occluder_albedo > 0:
        raise ConfigError("--estimate-height: the scene states occluder_albedo, which is for distant light; keep one")
    if checks.estimate_height and checks.skip_near_test:
        raise ConfigError("--estimate-height needs the near-light test; leave --skip-near-test away")


def prepare(
    path: Path,
    config: Config,
    photos: Sequence[Path] = (),
    use_cache: bool = True,
    progress: Progress | None = None,
    dense: Transfer | None = None,
) -> Shared:
    """Returns what all photographs of a scene share.

    Args:
        path: the scene file.
        config: the settings.
        photos: as for `setting_of`.
        use_cache: read and write the transport on disk.
        progress: called with (work done, work).
        dense: the transport, where it is there already.

    Raises:
        TorchlightError: the scene or a setting cannot be used.
    """
    seconds: dict[str, float] = {}
    basis, solver = named_method(config)
    device = named_device(config.compute.device, solver)
    with timed(seconds, "scene"):
        scene = load_scene(path)
        check_budget(scene.receiver.points, texel_count(dense_resolution(basis, solver)))
        setting = setting_with(scene, path, config, photos)
    with timed(seconds, "transport"):
        if dense is None:
            columns = columns_for(scene, basis, solver, use_cache, progress, device)
        else:
            columns = fitting(scene, dense, solver, device)
    return Shared(setting, basis, solver, device, columns, seconds)


def with_mask(setting: Setting, mask: Path | None) -> Setting:
    """Returns the same with a mask of its own."""
    if mask is None:
        return setting
    scene = replace(setting.scene, mask=read_mask(mask))
    return replace(setting, scene=scene, visible=visible_part(scene))


@contextmanager
def timed(seconds: dict[str, float], stage: str) -> Iterator[None]:
    """Adds the seconds spent in a block under a stage's name."""
    start = time.perf_counter()
    yield
    seconds[stage] = time.perf_counter() - start
