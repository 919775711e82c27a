"""How noisy a photograph's samples are, from the photograph alone.

J. Immerkaer, "Fast Noise Variance Estimation", Computer Vision and Image Understanding 64(2), 1996: the mask

    N = [1 -2 1; -2 4 -2; 1 -2 1],   the second difference along x of the second difference along y,

gives 0 on every picture f(x) + g(y) + x h(y) + y k(x): on planes, ramps, and straight edges along an axis. On
independent noise of deviation s it has the deviation 6 s (the root of the sum of its squares, 36). Shadows' edges
excite it too, but few samples lie on them, and the median of |N * v| instead of its mean passes them over.
"""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchlight.errors import ShapeError
from torchlight.photo.observation import Observation

NORM = 6.0  # root of the sum of the mask's squares
MEDIAN_OF_NORMAL = 0.6744897501960817  # the median of |x| where x is normal with deviation 1
LEAST_PLACES = 100  # samples with eight used neighbours: s is known to 30 %
LEAST_NOISE = 0.4 / 255  # of the brightest sample: rounding to 8 bits (0.29 of 255) and what a transport leaves out


def noise_share(observation: Observation, samples: tuple[int, int]) -> Float[Tensor, "*batch"]:
    """Returns the standard deviation of a sample's noise as a share of the photograph's brightest used sample.

    The root mean square of `sample_noise` over the channels that it knows, divided by the largest |v| of weight above
    0, and at least 0.4 / 255; exactly that where no channel's noise is known or the photograph is black.

    Args:
        observation: samples and weights.
        samples: the receiver's columns and rows.

    Raises:
        ShapeError: the observation has another number of samples.
    """
    deviation = sample_noise(observation, samples).square().nanmean(dim=-1).sqrt()
    return (deviation / brightest_used(observation)).nan_to_num(0.0, 0.0).clamp(min=LEAST_NOISE)


def brightest_used(observation: Observation) -> Float[Tensor, "*batch"]:
    """Returns the largest |v| of weight above 0, over channels and samples; 0 where there is none."""
    used = (observation.weights > 0)[..., None, :]
    return torch.where(used, observation.samples, 0.0).abs().amax(dim=(-2, -1))


def sample_noise(observation: Observation, samples: tuple[int, int]) -> Float[Tensor, "*batch channels"]:
    """Returns the standard deviation of the samples' noise, in their own units; NaN where it cannot be measured.

    s = median |N * v| / (6 0.6745) over the samples whose eight neighbours have a weight above 0 too. Of n such places
    about n / 6 are independent, so that s is known to about 1.2 sqrt(6 / n): 5 % for 64 x 64 samples; fewer than 100
    tell nothing. Neighbours that share pixels of the photograph are correlated by c > 0, which makes s smaller by
    about 4 c / 3.

    Args:
        observation: samples and weights.
        samples: the receiver's columns and rows.

    Raises:
        ShapeError: the observation has another number of samples.
    """
    columns, rows = samples
    values = observation.samples
    if values.shape[-1] != columns * rows:
        raise ShapeError(f"noise: expected {columns} x {rows} samples, got {values.shape[-1]}")
    if min(samples) < 3:
        return torch.full_like(values[..., 0], torch.nan)
    pictures = values.double().unflatten(-1, (rows, columns))
    used = (observation.weights > 0).unflatten(-1, (rows, columns))[..., None, :, :]
    response = second_differences(second_differences(pictures).mT).abs().flatten(start_dim=-2)
    whole = threes(threes(used).mT).flatten(start_dim=-2)
    median = torch.where(whole, response, torch.nan).nanmedian(dim=-1).values
    enough = whole.sum(dim=-1) >= LEAST_PLACES
    return torch.where(enough, median / (NORM * MEDIAN_OF_NORMAL), torch.nan).to(values)


def second_differences(values: Float[Tensor, "*lines count"]) -> Float[Tensor, "*lines shorter"]:
    """Returns v[i - 1] - 2 v[i] + v[i + 1] along lines, which become two shorter."""
    return values[..., :-2] - 2 * values[..., 1:-1] + values[..., 2:]


def threes(used: Bool[Tensor, "*lines count"]) -> Bool[Tensor, "*lines shorter"]:
    """Returns where i - 1, i and i + 1 of a line are all used; lines become two shorter."""
    return used[..., :-2] & used[..., 1:-1] & used[..., 2:]
