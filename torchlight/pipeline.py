"""The story: a photograph of a shadow in, an environment map out. Read me first.

linear      = linearize(photo, scene)               [*batch 3 height width], relative radiance
observation = observe(linear, scene)                samples [*batch 3 points], weights [*batch points]
transfer    = columns_for(scene, basis, solver)     T [points texels], shared by every photograph
solution    = find_light(transfer, basis, ...)      coefficients, status, certificate
light       = synthesize(basis, coefficients)       EnvironmentMap
predicted   = albedo / pi * T c                     what the receiver would show under that light
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from jaxtyping import Float
from torch import Tensor

from torchlight import metrics
from torchlight.analysis.confidence import Confidence, Found, confidence
from torchlight.errors import ConfigError
from torchlight.geometry.scene import Scene
from torchlight.inversion.adaptive import AdaptiveHaar, solve_adaptive
from torchlight.inversion.linear import default_solver, solve_light
from torchlight.inversion.refinement import Refinement
from torchlight.inversion.robust import robust_weights
from torchlight.light.bases import Basis, SphericalHarmonics
from torchlight.light.environment import EnvironmentMap
from torchlight.light.peaks import Peaks, environment_peaks, texel_peaks
from torchlight.light.synthesis import synthesize
from torchlight.observing import observe
from torchlight.photo.noise import noise_share
from torchlight.photo.observation import LinearPhoto, Observation, linear_photo
from torchlight.precomputation import Columns, columns_for, fitting
from torchlight.relighting import albedo_over_pi, irradiance
from torchlight.solvers import Solution, Solver
from torchlight.transfer import Transfer

ROBUST_ROUNDS = 4


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
        noise: of a sample, as a share of the brightest, that the adaptive method was told or measured; else None.
        confidence: how far the light can be trusted, of one photograph (`with_confidence`); None = not asked.
    """

    light: EnvironmentMap
    solution: Solution
    basis: Basis
    observation: Observation
    predicted: Float[Tensor, "*batch 3 points"]
    peaks: Peaks
    refinement: Refinement | None = None
    noise: Float[Tensor, "*batch"] | None = None
    confidence: Confidence | None = None

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
        noise: of a sample, as a share of the brightest, that the adaptive method was told or measured; else None.
    """

    solution: Solution
    irradiance: Float[Tensor, "*batch 3 points"]
    refinement: Refinement | None = None
    noise: Float[Tensor, "*batch"] | None = None


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


def explain(
    observation: Observation, scene: Scene, transfer: Columns, basis: Basis, solver: Solver | AdaptiveHaar
) -> Estimate:
    """Returns the light that explains observations of one scene, with its prediction."""
    transfer = fitting(scene, transfer, solver, observation.samples.device)
    factor = albedo_over_pi(scene.receiver, observation.samples)
    received = replace(observation, samples=observation.samples / factor)
    noise = noise_share(received, scene.receiver.samples)
    found = find_light(transfer, basis, received, solver, noise)
    light = replace(synthesize(basis, found.solution.coefficients), plane=scene.light_plane)
    peaks = find_peaks(basis, found.solution, light)
    predicted = factor * found.irradiance.to(factor)
    return Estimate(light, found.solution, basis, observation, predicted, peaks, found.refinement, found.noise)


def with_confidence(
    estimate: Estimate, scene: Scene, transfer: Columns, solver: Solver | AdaptiveHaar | None = None
) -> Estimate:
    """Returns the estimate of one photograph with how far its light can be trusted (`analysis.confidence`).

    Args:
        estimate: of one photograph.
        scene: of the photograph.
        transfer: the columns that the light was found with.
        solver: it was found with; None = as for `estimate`.
    """
    if solver is None:
        adaptive = estimate.refinement is not None
        solver = AdaptiveHaar(estimate.basis.resolution) if adaptive else default_solver(estimate.basis)
    if isinstance(solver, AdaptiveHaar):
        transfer = fitting(scene, transfer, solver, estimate.observation.samples.device)
    observation = estimate.observation
    factor = albedo_over_pi(scene.receiver, observation.samples)
    received = replace(observation, samples=observation.samples / factor)
    noise = noise_share(received, scene.receiver.samples) if estimate.noise is None else estimate.noise
    found = Found(
        received,
        estimate.predicted / factor,
        estimate.basis,
        solver,
        estimate.solution.coefficients,
        None if estimate.refinement is None else estimate.refinement.kept,
        float(noise),
    )
    return replace(estimate, confidence=confidence(transfer, found))


def explain_robustly(
    observation: Observation, scene: Scene, transfer: Columns, basis: Basis, solver: Solver | AdaptiveHaar
) -> Estimate:
    """Returns `explain`, repeated with the weights of `robust_weights`; what it let go of has the weight 0."""
    estimate = explain(observation, scene, transfer, basis, solver)
    for _ in range(ROBUST_ROUNDS):
        weighted = robust_weights(observation, estimate.predicted, scene.receiver.samples)
        estimate = explain(weighted, scene, transfer, basis, solver)
    return estimate


def find_light(
    transfer: Columns,
    basis: Basis,
    observation: Observation,
    solver: Solver | AdaptiveHaar,
    noise: Float[Tensor, "*batch"] | None = None,
) -> FoundLight:
    """Returns the coefficients of the light, what the receiver shows under it, and what the adaptive method decided.

    Args:
        transfer: of the scene.
        basis: what light is made of.
        observation: irradiance samples.
        solver: how the light is found.
        noise: of each photograph's samples, as measured (`noise_share`), for `AdaptiveHaar` where it states none.

    Raises:
        ConfigError: the basis is not that of the adaptive method, or the columns are for another method.
    """
    if isinstance(solver, AdaptiveHaar):
        resolve_method(basis, solver)
        found = solve_adaptive(transfer, observation, solver, noise)
        return FoundLight(found.solution, found.irradiance, found.refinement, found.noise)
    if not isinstance(transfer, Transfer):
        raise ConfigError(f"{type(solver).__name__} needs a dense transport; make it with precompute")
    solution = solve_light(transfer, basis, observation, solver)
    shown = irradiance(transfer.project(basis), solution.coefficients).to(observation.samples)
    return FoundLight(solution, shown)


def find_peaks(basis: Basis, solution: Solution, light: EnvironmentMap) -> Peaks:
    """Returns the strongest sources: on the solver's texels where the basis has them, else on the map."""
    if isinstance(basis, SphericalHarmonics):
        return environment_peaks(light)
    return texel_peaks(basis.synthesis(solution.coefficients), basis.resolution)
