"""Weights that let go of what no light explains: thin foreign shadows, glints, dirt.

Iteratively reweighted least squares for P. Huber's loss (Robust Statistics, 1981, chapter 7): samples whose residual
exceeds a few deviations count in inverse proportion to it, and those far beyond not at all.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from torchlight.photo.observation import Observation

HUBER = 1.345  # deviations; 95 % as efficient as least squares where the noise is normal
REJECTED = 5.0  # deviations; one normal residual in two million is farther
LEAST_DEVIATION = 0.5 / 255  # of the brightest sample: rounding, which must not be taken for an outlier


def robust_weights(observation: Observation, predicted: Float[Tensor, "*batch channels points"]) -> Observation:
    """Returns the observation with weights times min(1, 1.345 s / r), and 0 where r > 5 s.

    r is the root mean square of a sample's residual over channels and s = 1.4826 median(r) over the samples of weight
    above 0, at least half a 255th of the brightest one. (For three channels of equal noise median(r) is 0.89 of its
    deviation, so that s is 1.3 times as large: somewhat lenient.)

    Args:
        observation: samples and their original weights.
        predicted: what the receiver shows under the current light.
    """
    used = observation.weights > 0
    residual = (predicted - observation.samples).square().mean(dim=-2).sqrt()
    known = torch.where(used, residual, torch.full_like(residual, torch.nan))
    deviation = 1.4826 * known.nanmedian(dim=-1, keepdim=True).values
    lit = torch.where(used[..., None, :], observation.samples, torch.zeros_like(observation.samples))
    least = LEAST_DEVIATION * lit.amax(dim=(-2, -1))[..., None]
    ratio = residual / torch.maximum(deviation, least)
    factor = torch.where(ratio > REJECTED, torch.zeros_like(ratio), (HUBER / ratio).clamp(max=1))
    weights = torch.where(used & factor.isfinite(), observation.weights * factor.to(observation.weights), 0.0)
    return Observation(observation.samples, weights)
