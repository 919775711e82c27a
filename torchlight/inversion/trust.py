"""How much each of several photographs of one light counts beside the others.

A photograph whose samples have noise of standard deviation n_i counts with weights (min n / n_i)^2: then a sample of
weight 1 has the noise min n, and the weighted samples of all have the same. n_i is measured in the photograph itself,
for what a light leaves that is as fine as the photographs tell is noise. A photograph that it explains much worse than
its noise, while it explains another, is not to be trusted so far: its pose is off, or something else shades the plane.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchlight.photo.noise import brightest_used, noise_share
from torchlight.photo.observation import Observation

UNEVEN = 1.5  # residual / noise of a photograph, in those of the best explained: more is not chance


def own_noise(
    observations: Sequence[Observation], grids: Sequence[tuple[int, int]], stated: float | None
) -> Float[Tensor, " photos"]:
    """Returns the standard deviation of a sample's noise of each photograph, in the unit of its samples, float64.

    Args:
        observations: of one unit.
        grids: columns and rows of each receiver.
        stated: noise as a share of each photograph's brightest sample; None = as measured.
    """
    deviations = [
        (noise_share(seen, grid) if stated is None else stated) * brightest_used(seen)
        for seen, grid in zip(observations, grids, strict=True)
    ]
    return torch.stack(deviations).double()


def distrusted(
    noise: Float[Tensor, " photos"],
    observations: Sequence[Observation],
    predicted: Sequence[Float[Tensor, "channels _"]],
) -> Float[Tensor, " photos"]:
    """Returns the noise, larger for photographs whose residual exceeds theirs by more than the best explained one's.

    n_i c_i / min c where that is more than 1.5 n_i, c_i = root mean square residual / n_i over the used samples.
    """
    pairs = zip(predicted, observations, strict=True)
    excess = torch.stack([rms_residual(shown, seen) for shown, seen in pairs]) / noise
    ratio = excess / excess.min()
    return torch.where(ratio > UNEVEN, noise * ratio, noise)


def rms_residual(shown: Float[Tensor, "channels points"], seen: Observation) -> Float[Tensor, ""]:
    """Returns the root mean square residual over used samples and channels, float64."""
    used = seen.weights > 0
    return (shown - seen.samples)[:, used].double().square().mean().sqrt()


def weighted_by(observations: Sequence[Observation], noise: Float[Tensor, " photos"]) -> list[Observation]:
    """Returns the photographs with weights (min n / n_i)^2 times their own."""
    trust = (noise.min() / noise) ** 2
    pairs = zip(observations, trust, strict=True)
    return [replace(seen, weights=seen.weights * share.to(seen.weights)) for seen, share in pairs]
