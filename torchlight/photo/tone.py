"""Does a photograph show the halo of a phone's local tone mapping?

Under distant light the plane grows darker, never brighter, towards a shadow's edge. A local tone map brightens what
lies beside a dark region: the lit plane is then brightest next to the shadow.
"""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchlight.photo.observation import Observation
from torchlight.photo.reference import fit_falloff, quadratic_terms

SHADOW, LIT = -0.35, -0.12  # in ln brightness against the fall-off: darker than 70 %, brighter than 89 %
NEAR, FAR = (2, 5), (9, 64)  # samples from the shadow: rings that are compared
FEWEST = 40
HALO = 0.02  # in ln brightness; scripts/halo_rates.py measures what it flags


def halo(
    observation: Observation, positions: Float[Tensor, "points 2"], samples: tuple[int, int]
) -> Float[Tensor, "*batch"]:
    """Returns by how much, in ln brightness, the lit plane near the shadow outshines the lit plane far from it.

    Both are medians against a fall-off, exp of a quadratic, fitted to the lit plane alone. NaN where the photograph
    has no shadow that is dark enough, or too little lit plane near or far from it.

    Args:
        observation: samples and weights.
        positions: x and y of the samples.
        samples: the receiver's columns and rows.
    """
    lead = observation.samples.shape[:-2]
    grey = observation.samples.mean(dim=-2).reshape(-1, observation.samples.shape[-1])
    weights = observation.weights.reshape(-1, observation.weights.shape[-1])
    terms = quadratic_terms(positions.to(grey))
    found = [_halo(*item, terms, samples) for item in zip(grey, weights, strict=True)]
    return torch.stack(found).reshape(lead)


def _halo(
    grey: Float[Tensor, " points"],
    weights: Float[Tensor, " points"],
    terms: Float[Tensor, "points 6"],
    samples: tuple[int, int],
) -> Float[Tensor, ""]:
    usable = (weights > 0) & (grey > 0)
    level = (grey.clamp(min=1e-30) / fit_falloff(grey, usable, terms)).log()
    level = level - level[usable].quantile(0.75) if bool(usable.any()) else level
    shadow = usable & (level < SHADOW)
    lit = usable & (level > LIT)
    near, far = (lit & ring(shadow, reach, samples) for reach in (NEAR, FAR))
    if min(int(part.sum()) for part in (shadow, near, far)) < FEWEST:
        return grey.new_full((), torch.nan)
    return level[near].median() - level[far].median()


def ring(marked: Bool[Tensor, " points"], reach: tuple[int, int], samples: tuple[int, int]) -> Bool[Tensor, " points"]:
    """Returns the samples whose distance from the marked ones, the larger of x and y, lies within bounds."""
    grid = marked.reshape(1, 1, samples[1], samples[0]).float()

    def grown(by: int) -> Tensor:
        return torch.nn.functional.max_pool2d(grid, 2 * by + 1, stride=1, padding=by).flatten() > 0

    return grown(reach[1]) & ~grown(reach[0] - 1)
