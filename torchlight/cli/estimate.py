"""`torchlight estimate`: photographs in, one folder per photograph out; no photograph stops the others."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from jaxtyping import Bool
from torch import Tensor

from torchlight.analysis.verdict import excess
from torchlight.cli import NOTHING_STARTED, arguments, fail
from torchlight.cli.doubts import warn_of_near_light, warn_of_rejections, warn_of_tone_mapping
from torchlight.cli.progress import progress_bar
from torchlight.errors import ConfigError, FormatError, TorchlightError
from torchlight.geometry.scene import Scene
from torchlight.inversion.adaptive import AdaptiveHaar, named_rule
from torchlight.inversion.linear import named_solver
from torchlight.io.atomic import check_writable
from torchlight.io.exif import Exif
from torchlight.io.files import read_bytes, sha256_of
from torchlight.io.images import Photo, read_photo
from torchlight.io.scene_file import load_scene
from torchlight.light.bases import Basis, HaarCubemap, SphericalHarmonics, Texels
from torchlight.light.cubemap import texel_count
from torchlight.near_light.verdict import near_light
from torchlight.observing import check_lit, empty_plane, linearize, observe, placed, visible_part
from torchlight.photo.observation import Observation
from torchlight.pipeline import Estimate, explain, explain_robustly
from torchlight.placement import Placement, refine, sentence
from torchlight.precomputation import Columns, columns_for
from torchlight.results import Provenance, select, write_result
from torchlight.solvers import Solver, Status
from torchlight.solvers.solution import CAUSE_AND_CURE
from torchlight.transfer import Transfer, check_budget

PHOTOS_PER_SOLVE = 8  # results appear block by block; the exact solver gains nothing from more at once
DEFAULT_RESOLUTION = 16
DEFAULT_ADAPTIVE_RESOLUTION = 128
DEFAULT_HARMONICS_RESOLUTION = 32  # harmonics vary within a texel: a finer transport keeps that below 0.1 of 255
SOME_FAILED = 1


@dataclass(frozen=True, eq=False)
class Job:
    """One photograph on its way: what it showed and how long that took."""

    photo: Path
    sha256: str
    observation: Observation
    seconds: float
    exif: Exif
    scene: Scene
    placement: Placement | None = None


@dataclass(frozen=True, eq=False)
class Plan:
    """What all photographs of a call share."""

    command: arguments.Estimate
    scene: Scene
    scene_sha256: str
    basis: Basis
    solver: Solver | AdaptiveHaar
    device: torch.device
    visible: Bool[Tensor, " points"]
    empty: Observation | None
    columns: Columns
    seconds: dict[str, float]


def run(command: arguments.Estimate) -> int:
    """Returns 0 when every photograph is done, 1 when some failed, 2 when none could be used.

    Raises:
        TorchlightError: nothing could start.
    """
    check_places(command)
    plan = prepare(command)
    visible, points = int(plan.visible.sum()), plan.scene.receiver.points
    print(f"{command.scene}: {visible} of {points} samples visible ({visible / points:.1%})")
    if isinstance(plan.columns, Transfer):  # the adaptive method takes no more than the shadows determine
        too_much = excess(plan.columns, plan.visible, plan.basis, command.solver != "ridge")
        if too_much is not None:
            fail(f"warning: {too_much}")
    usable, done = 0, 0
    for start in range(0, len(command.photos), PHOTOS_PER_SOLVE):
        jobs = list(observed(plan, command.photos[start : start + PHOTOS_PER_SOLVE]))
        usable += len(jobs)
        done += sum(solve_and_write(*alike) for alike in sharing(plan, jobs))
    if not usable:
        return NOTHING_STARTED
    failed = len(command.photos) - done
    if failed and len(command.photos) > 1:
        fail(f"{failed} of {len(command.photos)} photographs failed; the others are complete in {command.out}")
    return SOME_FAILED if failed else 0


def check_places(command: arguments.Estimate) -> None:
    """Raises ConfigError or FormatError where results would collide with each other or with what is there."""
    if not command.photos:
        raise ConfigError("no photograph given; usage: torchlight estimate SCENE PHOTO... --out DIR")
    by_stem: dict[str, Path] = {}
    for photo in command.photos:
        if photo.stem in ("", ".", ".."):
            raise ConfigError(f"{photo}: its name without suffix cannot name a folder; rename it")
        other = by_stem.setdefault(photo.stem, photo)
        if other is not photo:
            raise ConfigError(
                f"{other} and {photo} would both be written to {command.out / photo.stem}; "
                "rename one or estimate them in separate calls"
            )
    check_writable(command.out)
    existing = [command.out / stem for stem in by_stem if os.path.lexists(command.out / stem)]
    if existing and not command.overwrite:
        more = f" and {len(existing) - 1} more" if len(existing) > 1 else ""
        raise FormatError(f"{existing[0]}{more}: already there; pass --overwrite to replace, or choose another --out")
    for folder in existing:
        if not (folder / "result.json").is_file():
            raise FormatError(f"{folder}: not a result of torchlight, so --overwrite leaves it; choose another --out")


def prepare(command: arguments.Estimate) -> Plan:
    """Returns what all photographs share: the scene, the settings, the visible samples and the transport."""
    seconds: dict[str, float] = {}
    basis, solver = named_method(command)
    device = named_device(command.device)
    with timed(seconds, "scene"):
        scene = load_scene(command.scene)
        dense = solver.dense_resolution if isinstance(solver, AdaptiveHaar) else basis.resolution
        check_budget(scene.receiver.points, texel_count(dense))
        visible = visible_part(scene)
        empty = empty_plane(scene, visible, command.photos)
    with timed(seconds, "transport"), progress_bar("transport") as progress:
        columns = columns_for(scene, basis, solver, not command.no_cache, progress, device)
    digest = sha256_of(read_bytes(command.scene))
    return Plan(command, scene, digest, basis, solver, device, visible, empty, columns, seconds)


def named_method(command: arguments.Estimate) -> tuple[Basis, Solver | AdaptiveHaar]:
    """Returns what light is made of and how it is found."""
    if command.method == "adaptive":
        solver = adaptive_method(command)
        return solver.basis, solver
    basis = named_basis(command)
    return basis, named_solver(command.solver, basis)


def adaptive_method(command: arguments.Estimate) -> AdaptiveHaar:
    """Returns the adaptive method that the options describe.

    Raises:
        ConfigError: a setting is out of range, or another solver than "nnls" is asked for.
    """
    if command.solver != "nnls":
        raise ConfigError(f"--solver {command.solver}: --method adaptive has a solver of its own; leave --solver away")
    usual = DEFAULT_ADAPTIVE_RESOLUTION if command.rule == "gain" else DEFAULT_RESOLUTION
    resolution = usual if command.resolution is None else command.resolution
    return AdaptiveHaar(resolution, command.functions, command.noise, named_rule(command.rule))


def named_basis(command: arguments.Estimate) -> Basis:
    """Returns the basis that the options name."""
    if command.method == "sh":
        default = DEFAULT_HARMONICS_RESOLUTION
        return SphericalHarmonics(command.degree, default if command.resolution is None else command.resolution)
    resolution = DEFAULT_RESOLUTION if command.resolution is None else command.resolution
    return Texels(resolution) if command.method == "texels" else HaarCubemap(resolution)


def named_device(name: str) -> torch.device:
    """Returns the device that an option names; "auto" is the GPU where there is one.

    Raises:
        ConfigError: "cuda" without a usable GPU.
    """
    if name == "cuda" and not torch.cuda.is_available():
        raise ConfigError("--device cuda: this torch finds no GPU; use --device auto or cpu")
    return torch.device("cuda" if name != "cpu" and torch.cuda.is_available() else "cpu")


def observed(plan: Plan, photos: Sequence[Path]) -> Iterator[Job]:
    """Yields what each photograph shows; a photograph that cannot be used is reported in one line and left out."""
    for photo in photos:
        start = time.perf_counter()
        try:
            stored = read_photo(photo)
            scene = placed(plan.scene, stored, str(photo))
            visible = plan.visible if scene is plan.scene else visible_part(scene)
            observation = observe(linearize(stored, scene), scene, visible, plan.empty)
            check_lit(observation)
            placement = None
            if plan.command.refine_pose:
                scene, observation, placement = replaced(plan, photo, stored, scene, observation)
            warn_of_tone_mapping(photo, stored, observation, scene)
        except TorchlightError as error:
            fail(str(error) if str(photo) in str(error) else f"{photo}: {error}")
            continue
        yield Job(photo, stored.sha256, observation, time.perf_counter() - start, stored.exif, scene, placement)


def replaced(
    plan: Plan, path: Path, photo: Photo, scene: Scene, observation: Observation
) -> tuple[Scene, Observation, Placement]:
    """Returns scene and observation with the object where its shadow says it is, and says in one line what moved."""
    linear, stated = linearize(photo, scene), scene

    def look(scene: Scene) -> Observation:
        return observation if scene is stated else observe(linear, scene, visible_part(scene), plan.empty)

    found, placement = refine(scene, look, AdaptiveHaar(noise=plan.command.noise))
    print(f"{path}: {sentence(placement, scene.units)}")
    return found, look(found), placement


def sharing(plan: Plan, jobs: list[Job]) -> Iterator[tuple[Plan, Sequence[Job]]]:
    """Yields the photographs that share a transport, with it; one whose object was moved has its own."""
    alike = [job for job in jobs if job.placement is None or not job.placement.changed]
    if alike:
        yield plan, alike
    for job in jobs:
        if job.placement is not None and job.placement.changed:
            seconds = dict(plan.seconds)
            with timed(seconds, "transport"):
                cached = not plan.command.no_cache
                columns = columns_for(job.scene, plan.basis, plan.solver, cached, device=plan.device)
            yield replace(plan, scene=job.scene, columns=columns, seconds=seconds), [job]


def solve_and_write(plan: Plan, jobs: Sequence[Job]) -> int:
    """Solves photographs together, writes each one's folder, and returns how many are done."""
    start = time.perf_counter()
    shown = [job.observation for job in jobs]
    parts = ([one.samples for one in shown], [one.weights for one in shown], [one.rejections for one in shown])
    observation = Observation(*(torch.stack(part).to(plan.device) for part in parts))
    solve = explain_robustly if plan.command.robust else explain
    estimate = solve(observation, plan.scene, plan.columns, plan.basis, plan.solver)
    share = (time.perf_counter() - start) / len(jobs)
    return sum(write(plan, job, select(estimate, item), share) for item, job in enumerate(jobs))


def write(plan: Plan, job: Job, estimate: Estimate, solve_seconds: float) -> bool:
    """Writes one photograph's folder and says so in one line; returns whether all went well."""
    command = plan.command
    seconds = {**plan.seconds, "photograph": job.seconds, "solve": solve_seconds}
    near = None if command.skip_near_test else near_light(job.scene, job.observation)
    provenance = Provenance(
        plan.scene_sha256, job.sha256, str(job.photo), command.method, command.solver, seconds, job.exif,
        job.placement, job.scene.camera, near,
    )  # fmt: skip
    unusable = unusable_channels(estimate)
    if unusable:
        fail(f"{job.photo}: {unusable}")
        return False
    try:
        result = write_result(command.out / job.photo.stem, estimate, plan.scene, provenance, command.overwrite)
    except TorchlightError as error:
        fail(f"{job.photo}: {error}")
        return False
    short = "" if set(result["status"]) == {"converged"} else "; the solver stopped short: see kkt_residual"
    print(
        f"{command.out / job.photo.stem}: RMS {result['rms_255']:.2f} of 255 on {result['visible']} samples, "
        f"{result['preview_clipped_flux']:.0%} of the flux clipped in light.png{short}"
    )
    warn_of_rejections(job.photo, estimate)
    warn_of_near_light(job.photo, near, job.scene.units)
    return True


def unusable_channels(estimate: Estimate) -> str:
    """Returns why a solve gave no light, or an empty string."""
    for value in estimate.solution.status.tolist():
        if Status(value) in (Status.NOT_FINITE, Status.NO_OBSERVATIONS):
            return CAUSE_AND_CURE[Status(value)]
    return ""


@contextmanager
def timed(seconds: dict[str, float], stage: str) -> Iterator[None]:
    """Adds the seconds spent in a block under a stage's name."""
    start = time.perf_counter()
    yield
    seconds[stage] = time.perf_counter() - start
