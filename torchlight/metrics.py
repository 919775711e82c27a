"""How well a prediction explains a photograph."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor


def rms_255(
    predicted: Float[Tensor, "*batch channels points"],
    observed: Float[Tensor, "*batch channels points"],
    weights: Float[Tensor, "*batch points"],
) -> Float[Tensor, "*batch"]:
    """Returns 255 sqrt(mean over valid points and channels of (predicted - observed)^2) / (largest valid observed).

    Linear values, no free scale; NaN where no point is valid or the photograph is black there.
    """
    return 255.0 * _rms(predicted - observed, weights) / brightest(observed, weights)


def rms_relative(
    predicted: Float[Tensor, "*batch channels points"],
    observed: Float[Tensor, "*batch channels points"],
    weights: Float[Tensor, "*batch points"],
) -> Float[Tensor, "*batch"]:
    """Returns the root mean square of the residual divided by that of the observed values, over valid points."""
    return _rms(predicted - observed, weights) / _rms(observed, weights)


def fit_scale(
    predicted: Float[Tensor, "*batch channels points"],
    observed: Float[Tensor, "*batch channels points"],
    weights: Float[Tensor, "*batch points"],
) -> Float[Tensor, "*batch channels"]:
    """Returns the factor per channel that brings the prediction closest to the observation in least squares."""
    valid = (weights > 0)[..., None, :]
    cross = torch.where(valid, predicted.double() * observed.double(), 0.0).sum(dim=-1)
    square = torch.where(valid, predicted.double().square(), 0.0).sum(dim=-1)
    return (cross / square).to(predicted)


def brightest(
    observed: Float[Tensor, "*batch channels points"], weights: Float[Tensor, "*batch points"]
) -> Float[Tensor, "*batch"]:
    """Returns the largest valid observed value; NaN where nothing is valid or it is not positive."""
    valid = (weights > 0)[..., None, :]
    largest = torch.where(valid, observed, torch.full_like(observed, -torch.inf)).amax(dim=(-2, -1))
    return torch.where(largest > 0, largest, torch.full_like(largest, torch.nan))


def _rms(
    values: Float[Tensor, "*batch channels points"], weights: Float[Tensor, "*batch points"]
) -> Float[Tensor, "*batch"]:
    valid = (weights > 0)[..., None, :]
    square = torch.where(valid, values, torch.zeros_like(values)).double().square().sum(dim=(-2, -1))
    count = (weights > 0).sum(dim=-1).double() * values.shape[-2]
    return (square / count).sqrt().to(values)
