"""What the unshadowed plane would look like: fall-off that is not a shadow is divided out before solving."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchlight.errors import ConfigError
from torchlight.photo.observation import Observation

STEPS = 50
SHADOW_DEVIATIONS = 2.0  # below the fit by more than this many deviations: shadow
GLINT_DEVIATIONS = 4.0
MIN_SAMPLES = 24
STACK_STEPS = 4
MIN_STACK = 3  # of two photographs no majority can tell which one is in shadow
LEAST_DEVIATION = 1e-3  # 0.1 % in log brightness: below the noise of any photograph


@dataclass(frozen=True, eq=False)
class Reference:
    """The fall-off of the unshadowed plane.

    Attributes:
        falloff: factor that multiplies the plane, mean 1 over the used samples (of an albedo map: the albedo); NaN or
            0 where it is not known.
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
    """Returns the observation with the fall-off divided out; samples without one are left out."""
    falloff = reference.falloff
    known = (falloff > 0) & falloff.isfinite()
    samples = torch.where(known, observation.samples / torch.where(known, falloff, torch.ones_like(falloff)), 0.0)
    weights = observation.weights * known.all(dim=-2).to(observation.weights)
    return replace(observation, samples=samples, weights=weights)


def photographed(empty: Observation, observation: Observation) -> Reference:
    """Returns the fall-off that a photograph of the empty plane shows.

    Under one distant light the empty plane shows albedo(x) vignetting(x) E / pi, and dividing by it leaves what the
    object took away; of a near light's fall-off it removes what is not direction. The exposures may differ: the mean
    over the samples that both photographs show is 1 in every channel.
    """
    shown = (empty.weights[..., None, :] > 0) & (empty.samples > 0)
    both = shown & (observation.weights[..., None, :] > 0)
    total = torch.where(both, empty.samples, torch.zeros_like(empty.samples)).sum(dim=-1, keepdim=True)
    mean = total / both.sum(dim=-1, keepdim=True)
    return Reference(torch.where(shown, empty.samples, torch.full_like(empty.samples, torch.nan)) / mean)


def stack(observations: Observation) -> Observation:
    """Returns what the plane shows without the object, from photographs between which it moved.

    Every sample's upper median over the photographs that show it, each brought to the exposure of all by the median
    ratio per channel: right where a sample is out of the shadow in more than half of them. Samples that fewer than
    three photographs show have the weight 0.

    Args:
        observations: photographs of one camera and light along the first axis, before any reference.

    Raises:
        ConfigError: fewer than three photographs.
    """
    if observations.samples.ndim != 3 or len(observations.samples) < MIN_STACK:
        raise ConfigError(f"reference: stack needs at least {MIN_STACK} photographs in which the object moved")
    shown = (observations.weights[:, None] > 0) & (observations.samples > 0)
    samples = torch.where(shown, observations.samples, torch.full_like(observations.samples, torch.nan))
    plane = upper_median(samples / exposures(samples))
    for _ in range(STACK_STEPS):
        plane = upper_median(samples / (samples / plane).nanmedian(dim=-1, keepdim=True).values)
    enough = (shown.sum(dim=0) >= MIN_STACK).all(dim=0) & plane.isfinite().all(dim=0)
    return Observation(torch.where(enough, plane, torch.zeros_like(plane)), enough.to(observations.weights))


def exposures(samples: Float[Tensor, "photos channels points"]) -> Float[Tensor, "photos channels 1"]:
    """Returns the exposure of every photograph: the mean over all others of the median logarithmic ratio to them.

    Shadow over light is as frequent as light over shadow, so that between two photographs the median holds even where
    the shadows together cover most of the plane.
    """
    logarithms = samples.log()
    ratios = [(logarithms - other).nanmedian(dim=-1, keepdim=True).values for other in logarithms]
    return torch.stack(ratios).nanmean(dim=0).exp()


def upper_median(samples: Float[Tensor, "photos channels points"]) -> Float[Tensor, "channels points"]:
    """Returns the median over photographs, of an even number the larger middle one; NaN does not count."""
    falling = samples.nan_to_num(nan=-torch.inf).sort(dim=0, descending=True).values
    middle = ((samples.isfinite().sum(dim=0, keepdim=True) - 1) // 2).clamp(min=0)
    found = falling.gather(0, middle)[0]
    return torch.where(found.isfinite(), found, torch.nan)


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
