"""The story: a photograph of a shadow in, an environment map out. Read me first.

linear      = linearize(photo, scene)               [*batch 3 height width], relative radiance
observation = observe(linear, scene)                samples [*batch 3 points], weights [*batch points]
transfer    = columns_for(scene, basis, solver)     T [points texels], shared by every photograph
solution    = find_light(transfer, basis, ...)      coefficients, status, certificate
light       = synthesize(basis, coefficients)       EnvironmentMap
predicted   = albedo / pi * T c                     what the receiver would show under that light
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchlight import metrics
from torchlight.camera import project
from torchlight.errors import CalibrationError, ConfigError, SceneError, TorchlightError
from torchlight.geometry.contours import scene_contours
from torchlight.geometry.footprints import footprint_points, subpoints_for, visible_samples
from torchlight.geometry.receiver import sample_centers
from torchlight.geometry.scene import Scene
from torchlight.inversion.adaptive import AdaptiveHaar, solve_adaptive
from torchlight.inversion.linear import default_solver, solve_light
from torchlight.inversion.nodes import NodeColumns
from torchlight.inversion.refinement import Refinement
from torchlight.inversion.robust import robust_weights
from torchlight.io import cache
from torchlight.io.images import Photo, read_photo
from torchlight.light.bases import Basis, SphericalHarmonics
from torchlight.light.environment import EnvironmentMap
from torchlight.light.peaks import Peaks, environment_peaks, texel_peaks
from torchlight.light.synthesis import synthesize
from torchlight.photo import radiometry, reference
from torchlight.photo.observation import LinearPhoto, Observation, linear_photo
from torchlight.photo.rectification import from_camera, from_rectified
from torchlight.relighting import albedo_over_pi, irradiance
from torchlight.solvers import Solution, Solver
from torchlight.transfer import ALGORITHM, Transfer, square_columns, transport

DIRECTIONS_PER_EDGE = 192  # see docs/convergence.md
ROBUST_ROUNDS = 4
Columns = Transfer | NodeColumns
Progress = Callable[[int, int], None]


@dataclass(frozen=True, eq=False)
class Estimate:
    """Light, and the evidence for it.

    Attributes:
        light: the recovered environment map.
        solution: coefficients, status and certificates per photograph and channel.
        basis: what the coefficients multiply.
        observation: what the photographs showed, after the reference was divided out.
        predicted: what the receiver shows under the light, same units as the observation.
        peaks: directions of the strongest sources.
        refinement: functions in use and why no others, of the adaptive method; else None.
    """

    light: EnvironmentMap
    solution: Solution
    basis: Basis
    observation: Observation
    predicted: Float[Tensor, "*batch 3 points"]
    peaks: Peaks
    refinement: Refinement | None = None

    @property
    def rms_255(self) -> Float[Tensor, "*batch"]:
        """RMS residual over valid samples in units of the brightest valid one / 255."""
        return metrics.rms_255(self.predicted, self.observation.samples, self.observation.weights)


@dataclass(frozen=True, eq=False)
class FoundLight:
    """Coefficients, and what they entail.

    Attributes:
        solution: coefficients and certificates.
        irradiance: E of every sample under that light.
        refinement: functions in use and why no others, of the adaptive method; else None.
    """

    solution: Solution
    irradiance: Float[Tensor, "*batch 3 points"]
    refinement: Refinement | None = None


def estimate(
    photos: LinearPhoto | Float[Tensor, "*batch 3 height width"],
    scene: Scene,
    basis: Basis | None = None,
    solver: Solver | AdaptiveHaar | None = None,
    transfer: Columns | None = None,
) -> Estimate:
    """Returns the light that explains linear photographs of a scene, all of them and all channels at once.

    Args:
        photos: linear photographs (`linearize`), or rectified receiver images where the scene has no camera.
        scene: occluders, receiver, camera.
        basis: what light is made of; None = Haar functions chosen by the photograph (`AdaptiveHaar`).
        solver: None = exact and non-negative.
        transfer: from `columns_for`, or from `precompute`, at the basis' resolution or for `AdaptiveHaar` coarser;
            computed when absent.
    """
    basis, solver = resolve_method(basis, solver)
    linear = photos if isinstance(photos, LinearPhoto) else linear_photo(photos)
    observation = observe(linear, scene)
    transfer = columns_for(scene, basis, solver) if transfer is None else transfer
    return explain(observation, scene, transfer, basis, solver)


def resolve_method(basis: Basis | None, solver: Solver | AdaptiveHaar | None) -> tuple[Basis, Solver | AdaptiveHaar]:
    """Returns basis and solver with what was left open filled in.

    Raises:
        ConfigError: the basis is not that of the adaptive method, or a solver is given without a basis.
    """
    if isinstance(solver, AdaptiveHaar):
        if basis is not None and basis != solver.basis:
            raise ConfigError(f"AdaptiveHaar works on {solver.basis}, got the basis {basis}; leave the basis away")
        return solver.basis, solver
    if basis is not None:
        return basis, default_solver(basis) if solver is None else solver
    if solver is not None:
        raise ConfigError(f"{type(solver).__name__} needs a basis: for example Texels(16)")
    return AdaptiveHaar().basis, AdaptiveHaar()


def columns_for(
    scene: Scene,
    basis: Basis,
    solver: Solver | AdaptiveHaar,
    use_cache: bool = True,
    progress: Progress | None = None,
    device: torch.device | str = "cpu",
) -> Columns:
    """Returns what a solve takes of a scene: its dense transport, or for `AdaptiveHaar` columns on demand beside it.

    Keep it for all photographs of the scene: `NodeColumns` remember what they have cast.
    """
    if not isinstance(solver, AdaptiveHaar):
        return precompute(scene, basis.resolution, use_cache=use_cache, progress=progress).to(device)
    dense = precompute(scene, solver.dense_resolution, use_cache=use_cache, progress=progress).to(device)
    return deepened(scene, dense, solver.max_resolution)


def deepened(scene: Scene, dense: Transfer, resolution: int) -> NodeColumns:
    """Returns the columns of all squares down to a resolution, those finer than the dense transport cast on demand."""
    contours = functools.cache(lambda: scene_contours(scene))
    return NodeColumns(dense, resolution, lambda squares, cells: square_columns(scene, squares, cells, contours()))


def explain(
    observation: Observation, scene: Scene, transfer: Columns, basis: Basis, solver: Solver | AdaptiveHaar
) -> Estimate:
    """Returns the light that explains observations of one scene, with its prediction."""
    transfer = fitting(scene, transfer, solver, observation.samples.device)
    factor = albedo_over_pi(scene.receiver, observation.samples)
    received = replace(observation, samples=observation.samples / factor)
    found = find_light(transfer, basis, received, solver)
    light = synthesize(basis, found.solution.coefficients)
    peaks = find_peaks(basis, found.solution, light)
    predicted = factor * found.irradiance.to(factor)
    return Estimate(light, found.solution, basis, observation, predicted, peaks, found.refinement)


def fitting(scene: Scene, transfer: Columns, solver: Solver | AdaptiveHaar, device: torch.device) -> Columns:
    """Returns what the solver takes: a dense transport on the observation's device, deepened where it is too coarse."""
    if not isinstance(transfer, Transfer):
        return transfer
    transfer = transfer.to(device=device)
    if isinstance(solver, AdaptiveHaar) and transfer.resolution < solver.max_resolution:
        return deepened(scene, transfer, solver.max_resolution)
    return transfer


def explain_robustly(
    observation: Observation, scene: Scene, transfer: Columns, basis: Basis, solver: Solver | AdaptiveHaar
) -> Estimate:
    """Returns `explain`, repeated with the weights of `robust_weights`; what it let go of has the weight 0."""
    estimate = explain(observation, scene, transfer, basis, solver)
    for _ in range(ROBUST_ROUNDS):
        estimate = explain(robust_weights(observation, estimate.predicted), scene, transfer, basis, solver)
    return estimate


def find_light(transfer: Columns, basis: Basis, observation: Observation, solver: Solver | AdaptiveHaar) -> FoundLight:
    """Returns the coefficients of the light, what the receiver shows under it, and what the adaptive method decided.

    Raises:
        ConfigError: the basis is not that of the adaptive method, or the columns are for another method.
    """
    if isinstance(solver, AdaptiveHaar):
        resolve_method(basis, solver)
        found = solve_adaptive(transfer, observation, solver)
        return FoundLight(found.solution, found.irradiance, found.refinement)
    if not isinstance(transfer, Transfer):
        raise ConfigError(f"{type(solver).__name__} needs a dense transport; make it with precompute")
    solution = solve_light(transfer, basis, observation, solver)
    shown = irradiance(transfer.project(basis), solution.coefficients).to(observation.samples)
    return FoundLight(solution, shown)


def linearize(photo: Photo, scene: Scene) -> LinearPhoto:
    """Returns a stored photograph in linear units, with the pixels that saturation leaves.

    Raises:
        ConfigError: an 8- or 16-bit photograph whose encoding the scene does not state.
    """
    encoding = radiometry.resolve_encoding(scene.encoding, photo.bits)
    response = None if scene.response is None else radiometry.Response(scene.response)
    linear = linear_photo(radiometry.linearize(photo.pixels, encoding, scene.gamma, response))
    return LinearPhoto(linear.radiance, linear.usable & ~radiometry.saturated(photo.pixels, photo.bits))


def placed(scene: Scene, photo: Photo, name: str) -> Scene:
    """Returns the scene with the camera of one photograph; the scene as it is where all share one, or none.

    Raises:
        CalibrationError: the photograph does not show enough of the board.
    """
    if scene.finder is None:
        return scene
    return replace(scene, camera=scene.finder(photo.pixels, photo.is_linear, name), finder=None)


def observe(
    photo: LinearPhoto,
    scene: Scene,
    visible: Bool[Tensor, " points"] | None = None,
    empty: Observation | None = None,
) -> Observation:
    """Returns what photographs say about the receiver's samples, the scene's reference divided out.

    Args:
        photo: linear photographs.
        scene: receiver, camera, mask and reference.
        visible: from `visible_part`; computed when absent, worth keeping for many photographs.
        empty: from `empty_plane`, likewise.

    Raises:
        CalibrationError: the photograph's size is not the camera's.
        SceneError: no sample is visible. A photograph of which none is usable, or none is lit, is no error here, so
            that it harms no other of its batch; `check_lit` tells.
    """
    visible = visible_part(scene) if visible is None else visible
    observation = sample_photo(photo, scene, visible)
    if scene.albedo_map is not None:
        observation = reference.divide(observation, mapped_albedo(scene, scene.albedo_map, visible))
    if scene.reference == "smooth":
        return reference.divide(observation, reference.smooth(observation, sample_centers(scene.receiver)))
    if scene.reference == "stack" and not scene.reference_photos and empty is None:
        empty = reference.stack(observation)
    empty = empty_plane(scene, visible) if empty is None else empty
    return observation if empty is None else reference.divide(observation, reference.photographed(empty, observation))


def empty_plane(
    scene: Scene, visible: Bool[Tensor, " points"], photos: Sequence[str | Path] = ()
) -> Observation | None:
    """Returns what the plane shows without the object, as the references "photo" and "stack" find it; else None.

    Args:
        scene: receiver, camera, encoding, mask and reference.
        visible: from `visible_part`.
        photos: photographs of the call, of which "stack" is made where the scene lists none.

    Raises:
        TorchlightError: a photograph cannot be read or is not of the camera's size; too few for a stack.
    """
    if scene.reference not in ("photo", "stack"):
        return None
    shown = [sampled_file(file, scene, visible) for file in scene.reference_photos or photos]
    if scene.reference == "photo":
        return shown[0]
    if not shown:
        raise ConfigError("reference: stack has no photographs; list them as reference.photos")
    return reference.stack(Observation(*(torch.stack(part) for part in zip(*map(parts_of, shown), strict=True))))


def parts_of(observation: Observation) -> tuple[Tensor, Tensor]:
    """Returns samples and weights."""
    return observation.samples, observation.weights


def sampled_file(file: str | Path, scene: Scene, visible: Bool[Tensor, " points"]) -> Observation:
    """Returns what a photograph of the scene's camera shows of the receiver's samples; errors name the file."""
    try:
        photo = read_photo(file)
        here = placed(scene, photo, str(file))
        return sample_photo(linearize(photo, here), here, visible if here is scene else visible_part(here))
    except TorchlightError as error:
        raise type(error)(str(error) if str(file) in str(error) else f"reference: {file}: {error}") from error


def mapped_albedo(
    scene: Scene, albedo: Float[Tensor, "3 rows columns"], visible: Bool[Tensor, " points"]
) -> reference.Reference:
    """Returns the albedo of every sample, the exact mean of the map over it; 0 where any of it is unknown."""
    known = LinearPhoto(albedo, (albedo > 0).all(dim=0))
    return reference.Reference(from_rectified(known, scene.receiver.samples, visible).samples)


def visible_part(scene: Scene) -> Bool[Tensor, " points"]:
    """Returns which samples a photograph of the scene can show; with no camera the scene's mask counts here.

    Raises:
        SceneError: none.
    """
    visible = visible_samples(scene)
    if scene.mask is not None and scene.camera is None and scene.finder is None:
        kept = from_rectified(
            LinearPhoto(scene.mask.float().expand(3, -1, -1), scene.mask), scene.receiver.samples, visible
        )
        visible = kept.weights > 0
    if not bool(visible.any()):
        seen = "is usable" if scene.camera is None else "that is usable"
        what = "no sample of the receiver" if scene.camera is None else "the camera sees no sample of the receiver"
        raise SceneError(f"{what} {seen}; check the pose, the receiver's place and size, and the mask")
    return visible


def sample_photo(photo: LinearPhoto, scene: Scene, visible: Bool[Tensor, " points"]) -> Observation:
    """Returns the photograph averaged over every sample's footprint, before any reference."""
    if scene.camera is None:
        return from_rectified(photo, scene.receiver.samples, visible)
    height, width = photo.radiance.shape[-2:]
    if (width, height) != scene.camera.image_size:
        raise CalibrationError(
            f"the photograph has {width} x {height} pixels but camera.image_size says "
            f"{scene.camera.image_size[0]} x {scene.camera.image_size[1]}; use the size the camera was calibrated at"
        )
    if scene.mask is not None:
        photo = masked(photo, scene.mask)
    points = footprint_points(scene.receiver, subpoints_for(scene.camera, scene.receiver))
    return from_camera(photo, project(scene.camera, points), visible)


def masked(photo: LinearPhoto, mask: Bool[Tensor, "height width"]) -> LinearPhoto:
    """Returns the photograph without the pixels that the mask forbids; ConfigError where their sizes differ."""
    if mask.shape != photo.usable.shape[-2:]:
        (height, width), (rows, columns) = photo.usable.shape[-2:], mask.shape
        raise ConfigError(
            f"mask: {columns} x {rows} pixels, but the photograph has {width} x {height}; "
            "draw the mask over the photograph at its full size"
        )
    return replace(photo, usable=photo.usable & mask.to(photo.usable.device))


def check_lit(observation: Observation) -> None:
    """Raises SceneError where a photograph has no usable sample or is black on all of them."""
    usable = observation.weights > 0
    if not bool(usable.any(dim=-1).all()):
        raise SceneError(
            "no sample of the photograph can be used: all are masked, saturated, not finite or hidden; "
            "check the mask, the exposure and the camera's pose"
        )
    brightest = metrics.brightest(observation.samples, observation.weights)
    if bool(brightest.isnan().any()):
        raise SceneError("the photograph is black on the receiver; check that it is the right file and its exposure")


def precompute(
    scene: Scene,
    resolution: int = 16,
    subsamples: int | None = None,
    use_cache: bool = True,
    progress: Progress | None = None,
) -> Transfer:
    """Returns the transport of a scene, from the disk cache if it is there: the slow part, shared by all photos.

    Args:
        scene: occluders and receiver; camera, mask, reference and albedo play no part.
        resolution: texels along a cube map face's edge.
        subsamples: directions along a texel's edge; None = as many as make 192 along a face's edge, at least 2.
        use_cache: False = neither read nor write the cache.
        progress: called with (work done, work).
    """
    count = subsamples if subsamples is not None else max(2, DIRECTIONS_PER_EDGE // resolution)
    if not use_cache:
        return transport(scene, resolution, count, progress)
    key = transport_key(scene, resolution, count)
    stored = cache.load(key)
    if stored is not None:
        return Transfer(stored["transport"], resolution)
    result = transport(scene, resolution, count, progress)
    cache.store(key, {"transport": result.transport}, {"algorithm": ALGORITHM, "resolution": str(resolution)})
    return result


def transport_key(scene: Scene, resolution: int, subsamples: int) -> str:
    """Returns the content key of a transport: everything its numbers depend on, and nothing else."""
    receiver = scene.receiver
    return cache.content_key(
        {
            "triangles": scene.triangles,
            "center": receiver.center,
            "size": receiver.size,
            "samples": receiver.samples,
            "resolution": resolution,
            "subsamples": subsamples,
            "algorithm": ALGORITHM,
        }
    )


def find_peaks(basis: Basis, solution: Solution, light: EnvironmentMap) -> Peaks:
    """Returns the strongest sources: on the solver's texels where the basis has them, else on the map."""
    if isinstance(basis, SphericalHarmonics):
        return environment_peaks(light)
    return texel_peaks(basis.synthesis(solution.coefficients), basis.resolution)
