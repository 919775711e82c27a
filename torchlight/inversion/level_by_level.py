"""The rule "paper": Section 4.2 of Okabe, Sato and Sato (2004), level by level."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchlight.errors import ConfigError
from torchlight.inversion.leaf_program import (
    RIDGE,
    Fitted,
    Item,
    certificate,
    fit,
    leaf_wavelets,
    scene_columns,
    texels_of,
)
from torchlight.inversion.outcome import Group, Outcome, stacked
from torchlight.inversion.quadtree import WAVELETS, Quadtree, pyramid
from torchlight.inversion.refinement import (
    Bounds,
    Fate,
    Grown,
    carrying,
    constants,
    determined,
    inherited,
    needed,
    trios,
    unseen_supports,
)
from torchlight.solvers.active_set import cholesky
from torchlight.threads import single_threaded


@dataclass(frozen=True)
class LevelByLevel:
    """Adds trios in ascending order of resolution, each support once, and keeps large coefficients.

    At every level, the supports asked are the roots of that level and the quarters of supports that carry wavelets. In
    their order, a trio joins if the problem stays well-conditioned with it, else the support is never divided. Then
    the coefficients of all functions in use are computed under non-negative radiance, and wavelets whose squared
    coefficient is below the threshold leave for good, the constants never. Where the paper is silent: a support of
    which all three wavelets leave is not divided; where more functions remain than the budget, those of least squared
    coefficient leave too.

    Attributes:
        threshold: least squared coefficient, as a share of the sum of all squared coefficients.
    """

    threshold: float = 1e-5

    def __post_init__(self) -> None:
        if not 0.0 <= self.threshold < 1.0:
            raise ConfigError(f"LevelByLevel.threshold: expected a number in [0, 1), got {self.threshold}")

    def refine(self, group: Group, bounds: Bounds) -> Outcome:
        """Returns the light, the functions in use and the certificates of every item of a group."""
        photos, channels, points = group.targets.shape
        sigmas = group.sigmas.repeat_interleave(channels).tolist()
        with single_threaded():
            columns = scene_columns(group.weighted)
            outcomes = [
                outcome(item, self.refine_item(item, bounds))
                for target, sigma in zip(group.targets.reshape(-1, points), sigmas, strict=True)
                for item in [Item(columns, target, target @ columns.nodes, sigma)]
            ]
        return stacked(outcomes, photos)

    def refine_item(self, item: Item, bounds: Bounds) -> Grown:
        """Returns the tree, the functions in use and the light of one item.

        References:
            Okabe, Sato and Sato, Spherical harmonics vs. Haar wavelets, CVPR 2004, section 4.2.
        """
        tree = item.columns.tree
        kept = constants(tree)
        divided = torch.zeros_like(tree.supports, dtype=torch.bool)
        fate = torch.where(unseen_supports(item), int(Fate.UNSEEN), int(Fate.BELOW_THRESHOLD))
        cut = torch.zeros_like(divided)
        light = torch.zeros_like(kept, dtype=torch.float64)
        fitted = fit(item, divided, kept, light)
        for level in range(int(tree.level.max().item())):
            candidates = asked(tree, kept, fate, level)
            sound = well_conditioned(item, kept, fitted, candidates, bounds.condition_limit)
            fate[candidates[~sound]] = int(Fate.ILL_CONDITIONED)
            added = candidates[sound]
            if added.shape[0] == 0:
                continue
            kept[trios(tree, added)] = True
            fitted = fit(item, needed(tree, kept), kept, texels_of(item, fitted))
            large, squares = outstanding(item, fitted, kept, self.threshold)
            kept = within_budget(tree, large, squares, bounds.budget)
            cut |= carrying(tree, large) & ~carrying(tree, kept)
            divided = needed(tree, kept)
            fitted = fit(item, divided, kept, texels_of(item, fitted))
        fate[cut] = int(Fate.LIMIT)
        fate[carrying(tree, kept)] = int(Fate.RESOLVED)
        return Grown(divided, kept, inherited(tree, fate, divided), fitted)


def asked(
    tree: Quadtree, kept: Bool[Tensor, " coeffs"], fate: Int[Tensor, " supports"], level: int
) -> Int[Tensor, " candidates"]:
    """Returns the seen supports of a level that are roots or quarters of a support with wavelets."""
    parent = tree.parent[tree.supports]
    allowed = (parent < 0) | carrying(tree, kept)[tree.support_of[parent.clamp(min=0)]]
    return ((tree.level[tree.supports] == level) & allowed & (fate != int(Fate.UNSEEN))).nonzero()[:, 0]


def well_conditioned(
    item: Item,
    kept: Bool[Tensor, " coeffs"],
    fitted: Fitted,
    candidates: Int[Tensor, " candidates"],
    condition_limit: float,
) -> Bool[Tensor, " candidates"]:
    """Returns which trios can join, one after another, each checked against all functions accepted before it.

    The factor of the Gram matrix of the functions in use, columns of length 1, grows by three rows for each trio.
    """
    columns, tree = item.columns, item.columns.tree
    gram = columns.wavelet_gram
    norms = gram.diagonal().clamp(min=0).sqrt()
    index = kept.nonzero()[:, 0]
    index = index[norms[index] > 0]
    block = gram[index][:, index] / (norms[index][:, None] * norms[index])
    block.diagonal().add_(RIDGE)
    factor = cholesky(block, RIDGE)
    light = texels_of(item, fitted)
    nodes = pyramid(light, tree.resolution) / (columns.areas * light.shape[0])
    steps = condition_limit * (light.mean() + nodes[tree.supports[candidates]])
    accepted = torch.zeros_like(candidates, dtype=torch.bool)
    for place, support in enumerate(candidates):
        trio = tree.trios[support] + torch.arange(WAVELETS, device=index.device)
        across = gram[index][:, trio] / norms[index][:, None]
        y = torch.linalg.solve_triangular(factor, across, upper=False)
        unit = wavelet_height(tree, support)
        innovation = (gram[trio][:, trio] - y.T @ y) / unit**2
        energy = gram[trio, trio].max() / unit**2
        if bool(determined(innovation, energy, steps[place], item.sigma)):
            accepted[place] = True
            scale = norms[trio]
            corner = cholesky(innovation * unit**2 / (scale[:, None] * scale), RIDGE)
            grown = factor.new_zeros(factor.shape[0] + WAVELETS, factor.shape[0] + WAVELETS)
            grown[: factor.shape[0], : factor.shape[0]] = factor
            grown[factor.shape[0] :, : factor.shape[0]] = (y / scale).T
            grown[factor.shape[0] :, factor.shape[0] :] = corner
            factor, index = grown, torch.cat([index, trio])
    return accepted


def wavelet_height(tree: Quadtree, support: Int[Tensor, ""]) -> float:
    """Returns the absolute value of the orthonormal wavelets on their support."""
    return 2.0 ** int(tree.level[tree.supports[support]].item())


def outstanding(
    item: Item, fitted: Fitted, kept: Bool[Tensor, " coeffs"], threshold: float
) -> tuple[Bool[Tensor, " coeffs"], Float[Tensor, " coeffs"]]:
    """Returns the functions in use that stay, and the squared coefficients of all."""
    tree = item.columns.tree
    squares = (fitted.values @ leaf_wavelets(tree, fitted.leaves)).square()
    return constants(tree) | (kept & (squares >= threshold * squares.sum())), squares


def within_budget(
    tree: Quadtree, kept: Bool[Tensor, " coeffs"], squares: Float[Tensor, " coeffs"], budget: int
) -> Bool[Tensor, " coeffs"]:
    """Returns the constants and the wavelets of largest squared coefficient, as many as the budget holds."""
    fixed = constants(tree)
    order = best(torch.where(kept & ~fixed, squares, -1.0), min(budget, int(kept.sum())) - int(fixed.sum()))
    return fixed.index_fill(0, order, True)


def best(values: Float[Tensor, " n"], count: int) -> Int[Tensor, " k"]:
    """Returns the places of the largest values, the first of equal ones."""
    return torch.sort(values, descending=True, stable=True).indices[: max(0, count)]


def outcome(item: Item, grown: Grown) -> Outcome:
    """Returns what was found for one item, as a photograph of one channel."""
    columns, fitted = item.columns, grown.fitted
    found = torch.where(grown.kept, fitted.values @ leaf_wavelets(columns.tree, fitted.leaves), 0.0)
    return Outcome(
        coefficients=found[None, None],
        irradiance=(columns.unweighted[fitted.leaves].T @ fitted.values)[None, None],
        figures=certificate(item, grown.divided, grown.kept, fitted)[None, None],
        steps=torch.tensor([[fitted.steps]], device=found.device),
        kept=grown.kept[None, None],
        fate=grown.fate.to(torch.int8)[None, None],
        regions=torch.tensor([[fitted.leaves.shape[0]]], device=found.device),
    )
