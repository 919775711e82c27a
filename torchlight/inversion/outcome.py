"""What a rule is given, and what it returns: photographs of one scene that share their weights."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchlight.inversion.nodes import WeightedNodes

TOLERANCE = 1e-9  # on the KKT residual


@dataclass(frozen=True, eq=False)
class Group:
    """Photographs of equal weights, ready to be fitted.

    Attributes:
        weighted: the columns.
        targets: W^(1/2) b, of order one.
        sigmas: standard deviation of the noise of a sample of weight 1.
    """

    weighted: WeightedNodes
    targets: Float[Tensor, "photos channels points"]
    sigmas: Float[Tensor, " photos"]


@dataclass(frozen=True, eq=False)
class Outcome:
    """What was found for every photograph and channel.

    Attributes:
        coefficients: Haar coefficients, exactly 0 for functions not in use.
        irradiance: E of every sample under the light.
        figures: relative residual, KKT residual and duality gap, as in `Solution`.
        steps: factorisations spent.
        kept: functions in use.
        fate: a `Fate` per support.
        regions: number of squares on which the light is constant.
    """

    coefficients: Float[Tensor, "photos channels coeffs"]
    irradiance: Float[Tensor, "photos channels points"]
    figures: Float[Tensor, "photos channels 3"]
    steps: Int[Tensor, "photos channels"]
    kept: Bool[Tensor, "photos channels coeffs"]
    fate: Int[Tensor, "photos channels supports"]
    regions: Int[Tensor, "photos channels"]


def stacked(outcomes: list[Outcome], photos: int) -> Outcome:
    """Returns the outcomes of single items (leading axes of length 1), put together photo by photo."""
    names = Outcome.__dataclass_fields__
    joined = {name: torch.cat([getattr(outcome, name) for outcome in outcomes]) for name in names}
    return Outcome(**{name: tensor.unflatten(0, (photos, -1))[:, :, 0] for name, tensor in joined.items()})
