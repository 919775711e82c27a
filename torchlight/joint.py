"""Several photographs of one light, the object elsewhere in each, solved together.

    v_i = s_i albedo_i / pi (T_i L + noise of standard deviation n_i)

for photograph i: its samples v_i, its scene's transport T_i, the light L >= 0 of all, and its exposure s_i, which is
given or found (`inversion.scales`). Brought to one exposure, v_i / s_i, the samples of all photographs stand side by
side like those of one receiver, with weights (min n / n_i)^2, and the light is found as from one photograph.

For `AdaptiveHaar`, whose light is as fine as the photographs tell, n_i is measured in each (or stated), and min n is
the noise of a sample of weight 1; where one photograph is explained much worse than another, the light is found once
more without trusting it as much (`inversion.trust`). For a light of given fineness n_i is the residual of the solve
that finds the exposures, relative to the brightness of v_i: what such a light cannot show counts as noise.

The light is in units of the exposures that are given; where none is, in those of the first photograph. Where albedo is
unknown, s_i is exposure x albedo.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchlight import metrics
from torchlight.analysis.confidence import Found, confidence
from torchlight.analysis.observability import coarsened
from torchlight.errors import ConfigError, SceneError
from torchlight.geometry.contours import scene_contours
from torchlight.geometry.scene import Scene
from torchlight.inversion.adaptive import AdaptiveHaar
from torchlight.inversion.nodes import NodeColumns
from torchlight.inversion.robust import robust_weights
from torchlight.inversion.scales import Scales, find_scales
from torchlight.inversion.trust import distrusted, own_noise, weighted_by
from torchlight.light.bases import Basis
from torchlight.light.synthesis import synthesize
from torchlight.observing import observe
from torchlight.photo.noise import brightest_used
from torchlight.photo.observation import LinearPhoto, Observation, linear_photo
from torchlight.pipeline import ROBUST_ROUNDS, Estimate, FoundLight, find_light, find_peaks, resolve_method
from torchlight.precomputation import Columns, dense_resolution, precompute
from torchlight.relighting import albedo_over_pi
from torchlight.solvers import Solver
from torchlight.transfer import Transfer, square_columns

SCALE_RESOLUTION = 16  # texels along a face's edge of the light that exposures are found with
LEVELLED = ("smooth", "stack", "photo")  # references that change a photograph's level by an amount of their own


@dataclass(frozen=True, eq=False)
class View:
    """One photograph of the light.

    Attributes:
        scene: what it is a photograph of.
        observation: what it shows, as `observe` returns it.
        scale: its exposure; None = to be found.
    """

    scene: Scene
    observation: Observation
    scale: float | None = None


@dataclass(frozen=True, eq=False)
class Poses:
    """What a solve takes of several scenes.

    Attributes:
        transfers: the dense transport of each.
        columns: of all their samples, side by side as of one receiver.
    """

    transfers: tuple[Transfer, ...]
    columns: Columns


@dataclass(frozen=True, eq=False)
class JointEstimate:
    """The light of several photographs, and the evidence for it.

    Attributes:
        estimate: the light as found from all samples side by side, at one exposure.
        views: the photographs; their weights are those of the solve.
        scales: the exposure of each.
        predicted: what each shows under the light, at its own exposure.
        trust: weight of each photograph's samples, 1 for the one that counts most.
    """

    estimate: Estimate
    views: tuple[View, ...]
    scales: Scales
    predicted: tuple[Float[Tensor, "3 _"], ...]
    trust: Float[Tensor, " photos"]

    @property
    def rms_255(self) -> Float[Tensor, " photos"]:
        """RMS residual of each photograph over valid samples, in units of its brightest valid one / 255."""
        both = zip(self.predicted, (view.observation for view in self.views), strict=True)
        return torch.stack([metrics.rms_255(shown, seen.samples, seen.weights) for shown, seen in both])


def estimate_together(
    photos: Sequence[LinearPhoto | Float[Tensor, "3 height width"]],
    scenes: Sequence[Scene],
    basis: Basis | None = None,
    solver: Solver | AdaptiveHaar | None = None,
    scales: Sequence[float | None] | None = None,
) -> JointEstimate:
    """Returns the one light that explains several linear photographs, each of its own scene.

    Args:
        photos: linear photographs, one per scene.
        scenes: occluders, receiver and camera of each.
        basis: what light is made of; None = Haar functions chosen by the photographs (`AdaptiveHaar`).
        solver: None = exact and non-negative.
        scales: exposure of each photograph, None where it is to be found; by default all are, relative to the first.
    """
    basis, solver = resolve_method(basis, solver)
    known = [None] * len(photos) if scales is None else scales
    both = zip(photos, scenes, known, strict=True)
    views = [View(scene, observe(linear(photo), scene), scale) for photo, scene, scale in both]
    transfers = [precompute(scene, dense_resolution(basis, solver)) for scene in scenes]
    return explain_together(views, side_by_side(scenes, transfers, solver), basis, solver)


def linear(photo: LinearPhoto | Float[Tensor, "3 height width"]) -> LinearPhoto:
    """Returns a linear photograph, all of whose finite pixels may be used where it does not say."""
    return photo if isinstance(photo, LinearPhoto) else linear_photo(photo)


def side_by_side(scenes: Sequence[Scene], transfers: Sequence[Transfer], solver: Solver | AdaptiveHaar) -> Poses:
    """Returns the transports of several scenes as of one receiver, for `AdaptiveHaar` with columns on demand beside."""
    dense = Transfer(torch.cat([transfer.transport for transfer in transfers]), transfers[0].resolution)
    if not isinstance(solver, AdaptiveHaar):
        return Poses(tuple(transfers), dense)
    contours = [scene_contours(scene) for scene in scenes]

    def cast(squares: Int[Tensor, "squares 4"], cells: int) -> Float[Tensor, "squares points"]:
        parts = zip(scenes, contours, strict=True)
        return torch.cat([square_columns(scene, squares, cells, edges) for scene, edges in parts], dim=1)

    return Poses(tuple(transfers), NodeColumns(dense.to("cpu"), solver.max_resolution, cast))


def explain_together(views: Sequence[View], poses: Poses, basis: Basis, solver: Solver | AdaptiveHaar) -> JointEstimate:
    """Returns the light that explains several photographs, their exposures and what each shows under it.

    Raises:
        ConfigError: fewer than two photographs, or an exposure that is not positive.
        SceneError: the scenes' lengths are in different units, or a photograph is black.
        SolveError: the photographs do not determine an exposure.
    """
    check_views(views)
    factors = [albedo_of(view) for view in views]
    scales = exposures(views, poses, factors)
    received = at_one_exposure(views, scales, factors)
    found, noise = found_together(views, poses, basis, received, solver, scales)
    kept = weighted_by(received, noise)
    seen = [replace(part, samples=part.samples * factor) for part, factor in zip(kept, factors, strict=True)]
    predicted = [part.to(factor) * factor for part, factor in zip(split(found.irradiance, views), factors, strict=True)]
    light = replace(synthesize(basis, found.solution.coefficients), plane=views[0].scene.light_plane)
    peaks = find_peaks(basis, found.solution, light)
    together = torch.cat(predicted, dim=-1)
    estimate = Estimate(light, found.solution, basis, stacked(seen), together, peaks, found.refinement, found.noise)
    own = tuple(part * scale.to(part) for part, scale in zip(predicted, scales.values, strict=True))
    return JointEstimate(estimate, tuple(views), scales, own, (noise.min() / noise) ** 2)


def with_confidence(joint: JointEstimate, poses: Poses, solver: Solver | AdaptiveHaar) -> JointEstimate:
    """Returns the estimate with how far its light can be trusted (`analysis.confidence`), of all samples together.

    The noise is that of the photograph that counts most; the weights say how much more the others' is. How uncertain
    the exposures are that were found is not accounted for.

    Args:
        joint: as `explain_together` returns it.
        poses: the columns that the light was found with.
        solver: it was found with.
    """
    estimate, factors = joint.estimate, [albedo_of(view) for view in joint.views]
    sizes = [view.scene.receiver.points for view in joint.views]
    factor = torch.cat([part.expand(-1, size) for part, size in zip(factors, sizes, strict=True)], dim=-1)
    received = replace(estimate.observation, samples=estimate.observation.samples / factor)
    if estimate.noise is None:
        apart = at_one_exposure(joint.views, joint.scales, factors)
        own = own_noise(apart, [view.scene.receiver.samples for view in joint.views], None)
        noise = own[joint.trust.argmax()] / brightest_used(received)
    else:
        noise = estimate.noise
    kept = None if estimate.refinement is None else estimate.refinement.kept
    coefficients, predicted = estimate.solution.coefficients, estimate.predicted / factor
    found = Found(received, predicted, estimate.basis, solver, coefficients, kept, float(noise))
    return replace(joint, estimate=replace(estimate, confidence=confidence(poses.columns, found)))


def albedo_of(view: View) -> Float[Tensor, "3 _"]:
    """Returns albedo over pi of a photograph's samples, or of all of them."""
    return albedo_over_pi(view.scene.receiver, view.observation.samples)


def exposures(views: Sequence[View], poses: Poses, factors: Sequence[Float[Tensor, "3 1"]]) -> Scales:
    """Returns the exposure of every photograph; those that are not given are found on texels of the dense transport."""
    received = [
        replace(view.observation, samples=view.observation.samples / factor)
        for view, factor in zip(views, factors, strict=True)
    ]
    coarse = [coarsened(part, min(part.resolution, SCALE_RESOLUTION)).transport for part in poses.transfers]
    return find_scales(coarse, received, [view.scale for view in views])


def at_one_exposure(
    views: Sequence[View], scales: Scales, factors: Sequence[Float[Tensor, "3 1"]]
) -> list[Observation]:
    """Returns irradiance samples of all photographs at exposure 1."""
    parts = zip((view.observation for view in views), scales.values, factors, strict=True)
    return [replace(seen, samples=seen.samples / (factor * scale.to(factor))) for seen, scale, factor in parts]


def found_together(
    views: Sequence[View],
    poses: Poses,
    basis: Basis,
    received: Sequence[Observation],
    solver: Solver | AdaptiveHaar,
    scales: Scales,
) -> tuple[FoundLight, Float[Tensor, " photos"]]:
    """Returns the light of irradiance samples at exposure 1, and the noise that weighs the photographs."""
    if not isinstance(solver, AdaptiveHaar):
        return find_light(poses.columns, basis, stacked(weighted_by(received, scales.noise)), solver), scales.noise

    def under(noise: Float[Tensor, " photos"]) -> FoundLight:
        together = stacked(weighted_by(received, noise))
        return find_light(poses.columns, basis, together, solver, noise.min() / brightest_used(together))

    noise = own_noise(received, [view.scene.receiver.samples for view in views], solver.noise)
    found = under(noise)
    trusted = distrusted(noise, received, split(found.irradiance, views))
    return (found, noise) if torch.equal(trusted, noise) else (under(trusted), trusted)


def split(values: Float[Tensor, "3 points"], views: Sequence[View]) -> tuple[Float[Tensor, "3 _"], ...]:
    """Returns the values of all samples side by side, photograph by photograph."""
    return values.split([view.scene.receiver.points for view in views], dim=-1)


def stacked(observations: Sequence[Observation]) -> Observation:
    """Returns the samples of several photographs side by side, as of one receiver."""
    parts = zip(*((part.samples, part.weights, part.rejections) for part in observations), strict=True)
    return Observation(*(torch.cat(part, dim=-1) for part in parts))


def explain_together_robustly(
    views: Sequence[View], poses: Poses, basis: Basis, solver: Solver | AdaptiveHaar
) -> JointEstimate:
    """Returns `explain_together`, repeated with the weights of `robust_weights`, exposures and all.

    Each photograph is held to its own residuals: a noisy one beside a good one is not let go of for its noise.
    """
    joint = explain_together(views, poses, basis, solver)
    for _ in range(ROBUST_ROUNDS):
        kept = [weighted(view, shown) for view, shown in zip(views, joint.predicted, strict=True)]
        joint = explain_together(kept, poses, basis, solver)
    return joint


def weighted(view: View, shown: Float[Tensor, "3 points"]) -> View:
    """Returns the photograph with the weights that its residuals give it."""
    return replace(view, observation=robust_weights(view.observation, shown, view.scene.receiver.samples))


def check_views(views: Sequence[View]) -> None:
    """Raises ConfigError or SceneError where photographs cannot be solved together."""
    if len(views) < 2:
        raise ConfigError(f"a joint solve takes at least two photographs, got {len(views)}; use estimate for one")
    units = sorted({view.scene.units for view in views})
    if len(units) > 1:
        raise SceneError(f"the scenes' lengths are in different units, {' and '.join(units)}; write all in one")
    if len({view.scene.light_plane for view in views}) > 1:
        raise SceneError(
            "the scenes' light does not stand in one place; write the same light.height and light.center in all"
        )
    for index, view in enumerate(views):
        if view.scale is not None and not 0 < view.scale < float("inf"):
            raise ConfigError(f"photograph {index + 1}: its exposure must be a positive number, got {view.scale}")
        if view.scale is not None and view.scene.reference in LEVELLED:
            raise ConfigError(
                f"photograph {index + 1}: reference {view.scene.reference} changes its level, so that a stated "
                "exposure does not hold; let it be estimated"
            )
