"""Weights that let go of what no light explains: thin foreign shadows, glints, dirt.

Iteratively reweighted least squares for P. Huber's loss (Robust Statistics, 1981, chapter 7): samples whose residual
exceeds a few deviations count in inverse proportion to it, and those far beyond not at all.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from torchlight.photo.observation import Observation, Rejection

HUBER = 1.345  # deviations; 95 % as efficient as least squares where the noise is normal
REJECTED = 5.0  # deviations; one normal residual in two million is farther
LEAST_DEVIATION = 0.5 / 255  # of the brightest sample: rounding, which must not be taken for an outlier


def robust_weights(
    observation: Observation,
    predicted: Float[Tensor, "*batch channels points"],
    samples: tuple[int, int] | None = None,
) -> Observation:
    """Returns the observation with weights times min(1, 1.345 s / r), and 0 where r > 5 s, which `rejected` says.

    r is the root mean square of a sample's residual over channels and s = 1.4826 median(r) over the samples of weight
    above 0, at least half a 255th of the brightest one. (For three channels of equal noise median(r) is 0.89 of its
    deviation, so that s is 1.3 times as large: somewhat lenient.)

    Where the grid is given, s^2 grows by the square of half the prediction's range over a sample and its eight
    neighbours: an object's own shadow whose edge lies half a sample elsewhere, since the pose is off or the lamp is
    near, is no outlier, while a foreign shadow lies where the prediction is smooth.

    Args:
        observation: samples and their original weights.
        predicted: what the receiver shows under the current light.
        samples: the receiver's columns and rows; None where the samples are of several receivers.
    """
    used = observation.weights > 0
    residual = (predicted - observation.samples).square().mean(dim=-2).sqrt()
    known = torch.where(used, residual, torch.full_like(residual, torch.nan))
    deviation = 1.4826 * known.nanmedian(dim=-1, keepdim=True).values
    lit = torch.where(used[..., None, :], observation.samples, torch.zeros_like(observation.samples))
    least = LEAST_DEVIATION * lit.amax(dim=(-2, -1))[..., None]
    deviation = torch.maximum(deviation, least)
    if samples is not None:
        deviation = torch.hypot(deviation, half_range(predicted.mean(dim=-2), samples))
    ratio = residual / deviation
    factor = torch.where(ratio > REJECTED, torch.zeros_like(ratio), (HUBER / ratio).clamp(max=1))
    weights = torch.where(used & factor.isfinite(), observation.weights * factor.to(observation.weights), 0.0)
    lost = used & (weights == 0)
    rejected = torch.where(lost, Rejection.ROBUST.value, observation.rejections).to(torch.uint8)
    return Observation(observation.samples, weights, rejected)


def half_range(values: Float[Tensor, "*batch points"], samples: tuple[int, int]) -> Float[Tensor, "*batch points"]:
    """Returns half of largest minus smallest value over each sample and its neighbours, corners included.

    Args:
        values: of a receiver's samples.
        samples: its columns and rows.
    """
    grid = values.reshape(-1, 1, samples[1], samples[0])
    largest, negated = (torch.nn.functional.max_pool2d(part, 3, stride=1, padding=1) for part in (grid, -grid))
    return ((largest + negated) / 2).reshape(values.shape)
