"""What the unshadowed plane would look like: fall-off that is not a shadow is divided out before solving."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchlight.photo.observation import Observation

STEPS = 50
SHADOW_DEVIATIONS = 2.0  # below the fit by more than this many deviations: shadow
GLINT_DEVIATIONS = 4.0
MIN_SAMPLES = 24
LEAST_DEVIATION = 1e-3  # 0.1 % in log brightness: below the noise of any photograph


@dataclass(frozen=True, eq=False)
class Reference:
    """The fall-off of the unshadowed plane.

    Attributes:
        falloff: factor that multiplies the plane, mean 1 over the used samples.
    """

    falloff: Float[Tensor, "*batch channels points"]


def smooth(observation: Observation, positions: Float[Tensor, "points 2"]) -> Reference:
    """Returns a smooth fall-off, exp of a quadratic in x and y, fitted to log brightness outside the shadow.

    Robust and one-sided: samples below the fit by more than two robust deviations are taken as shadow and left out,
    until the set no longer changes. Each channel has its own fit. A wide, soft shadow that covers most of the plane
    cannot be told from a fall-off; use `uniform` there.

    Args:
        observation: samples and weights.
        positions: x and y of the samples, any unit.
    """
    lead = observation.samples.shape[:-2]
    samples = observation.samples.reshape(-1, *observation.samples.shape[-2:])
    weights = observation.weights.reshape(-1, observation.weights.shape[-1])
    terms = quadratic_terms(positions.to(samples))
    falloff = torch.ones_like(samples)
    for item in range(samples.shape[0]):
        for channel in range(samples.shape[1]):
            usable = (weights[item] > 0) & (samples[item, channel] > 0)
            falloff[item, channel] = fit_falloff(samples[item, channel], usable, terms)
    return Reference(falloff.reshape(*lead, *samples.shape[1:]))


def divide(observation: Observation, reference: Reference) -> Observation:
    """Returns the observation with the fall-off divided out."""
    return Observation(observation.samples / reference.falloff, observation.weights)


def quadratic_terms(positions: Float[Tensor, "points 2"]) -> Float[Tensor, "points 6"]:
    """Returns 1, x, y, x^2, x y, y^2 of the positions scaled to about [-1, 1]."""
    low, high = positions.amin(dim=0), positions.amax(dim=0)
    x, y = ((2 * positions - low - high) / (high - low).clamp(min=1e-30)).unbind(dim=-1)
    return torch.stack([torch.ones_like(x), x, y, x * x, x * y, y * y], dim=-1)


def fit_falloff(
    values: Float[Tensor, " points"], usable: Bool[Tensor, " points"], terms: Float[Tensor, "points 6"]
) -> Float[Tensor, " points"]:
    """Returns the fitted fall-off of one channel, mean 1 over the usable samples; 1 where too few are usable."""
    if int(usable.sum()) < MIN_SAMPLES:
        return torch.ones_like(values)
    log = torch.where(usable, values, torch.ones_like(values)).double().log()
    terms = terms.double()
    kept, fit = usable, log
    for _ in range(STEPS):
        # by singular values: torch's lstsq goes wrong where terms vanish, as on a receiver one sample wide
        fit = terms @ (torch.linalg.pinv(terms[kept]) @ log[kept])
        residual = log - fit
        deviation = 1.4826 * residual[kept].abs().median().clamp(min=LEAST_DEVIATION)
        inside = (residual > -SHADOW_DEVIATIONS * deviation) & (residual < GLINT_DEVIATIONS * deviation)
        updated = usable & inside
        if int(updated.sum()) < MIN_SAMPLES or bool((updated == kept).all()):
            break
        kept = updated
    falloff = fit.exp()
    return (falloff / falloff[usable].mean()).to(values)
