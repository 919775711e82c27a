"""The rule "gain": best-first growth by projected gain, then pruning by effect."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchlight.errors import ConfigError
from torchlight.inversion.leaf_program import RIDGE, Fitted, Item, fit, leaf_wavelets, texels_of
from torchlight.inversion.quadtree import WAVELETS, Quadtree
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

LEAST_PRIOR = 0.3  # of the mean radiance: a dark leaf may still rise this much
LEAST_REACH = 0.05
REACH = 2.0


@dataclass(frozen=True)
class ProjectedGain:
    """Divides the leaf that lowers the squared residual most, again and again; all leaves stay candidates.

    Two answers are found: whole trios grown to the budget, and the same grown further and pruned, wavelet by wavelet.
    The one that explains the photograph better is taken.

    Attributes:
        threshold: tau: least gain of a trio, in squared sigmas.
        share: of the possible divisions made between two solves; smaller is greedier and slower.
        overgrowth: the tree grows to this many times the budget before it is pruned.
        pruned: share of the wavelets dropped between two solves.
    """

    threshold: float = 20.0
    share: float = 0.15
    overgrowth: float = 1.5
    pruned: float = 0.2

    def __post_init__(self) -> None:
        if not 0.0 <= self.threshold < float("inf"):
            raise ConfigError(f"ProjectedGain.threshold: expected a number of at least 0, got {self.threshold}")
        for name, value in (("share", self.share), ("pruned", self.pruned)):
            if not 0.0 < value <= 1.0:
                raise ConfigError(f"ProjectedGain.{name}: expected a number in (0, 1], got {value}")
        if not 1.0 <= self.overgrowth < float("inf"):
            raise ConfigError(f"ProjectedGain.overgrowth: expected a number of at least 1, got {self.overgrowth}")

    def refine(self, item: Item, bounds: Bounds) -> Grown:
        """Returns the tree, the functions in use and the light of one item."""
        nothing = torch.zeros_like(item.columns.tree.supports, dtype=torch.bool)
        whole = grow(item, nothing, bounds, self)
        room = replace(bounds, budget=int(bounds.budget * self.overgrowth))
        pruned = prune(item, grow(item, whole.divided, room, self), bounds.budget, self)
        return min(whole, pruned, key=lambda grown: squared_residual(item, grown.fitted))


def squared_residual(item: Item, fitted: Fitted) -> float:
    """Returns |b - A v|^2."""
    return (item.target - item.columns.nodes[:, fitted.leaves] @ fitted.values).square().sum().item()


def grow(item: Item, start: Bool[Tensor, " supports"], bounds: Bounds, rule: ProjectedGain) -> Grown:
    """Returns whole trios grown best first from a tree, to the budget or until no division gains enough."""
    tree = item.columns.tree
    divided = start.clone()
    kept = constants(tree).index_fill(0, trios(tree, divided.nonzero()[:, 0]).reshape(-1), True)
    unseen = unseen_supports(item)
    light = torch.zeros(3 * tree.resolution**2, dtype=torch.float64, device=kept.device)
    while True:
        fitted = fit(item, divided, kept, light)
        light = texels_of(item, fitted)
        fate = torch.where(unseen, int(Fate.UNSEEN), int(Fate.RESOLVED))
        candidates = leaf_supports(tree, fitted, unseen)
        if candidates.shape[0] == 0:
            break
        gain, sound = projected_gain(item, fitted, candidates, bounds.condition_limit)
        open_ones = sound & (gain > rule.threshold)
        fate[candidates] = torch.where(sound, int(Fate.BELOW_THRESHOLD), int(Fate.ILL_CONDITIONED))
        fate[candidates[open_ones]] = int(Fate.LIMIT)
        functions = int(kept.sum())
        count = min(max(1, int(rule.share * functions / WAVELETS)), (bounds.budget - functions) // WAVELETS)
        chosen = best(torch.where(open_ones, gain, -torch.inf), min(count, int(open_ones.sum())))
        if chosen.shape[0] == 0:
            break
        divided[candidates[chosen]] = True
        kept[trios(tree, candidates[chosen])] = True
    return Grown(divided, kept, inherited(tree, fate, divided), fitted)


def leaf_supports(tree: Quadtree, fitted: Fitted, unseen: Bool[Tensor, " supports"]) -> Int[Tensor, " candidates"]:
    """Returns the supports that are leaves and that some sample sees."""
    supports = tree.support_of[fitted.leaves]
    supports = supports[supports >= 0]
    return supports[~unseen[supports]]


def best(values: Float[Tensor, " n"], count: int) -> Int[Tensor, " k"]:
    """Returns the places of the largest values, the first of equal ones."""
    return torch.sort(values, descending=True, stable=True).indices[: max(0, count)]


def signs(like: Tensor) -> Float[Tensor, "3 4"]:
    """Returns the values of the horizontal, vertical and diagonal wavelet on the four quarters of their support."""
    rows = [[1, -1, 1, -1], [1, 1, -1, -1], [1, -1, -1, 1]]
    return torch.tensor(rows, dtype=like.dtype, device=like.device)


def projected_gain(
    item: Item, fitted: Fitted, candidates: Int[Tensor, " k"], condition_limit: float
) -> tuple[Float[Tensor, " k"], Bool[Tensor, " k"]]:
    """Returns by how much dividing each candidate lowers |b - A v|^2, in squared sigmas, and whether it is determined.

    With W = A psi the three columns of the wavelets of values +-1 on the support and P the columns of the leaves that
    are not 0, eliminated:

        g = W'(b - A v),   S = W'W - W'P (P'P)^-1 P'W
        y = (S + (sigma / max(v_k, 0.3 mean))^2 1)^-1 g         a step no larger than the radiance there
        s = min(1, 2 max(v_k, 0.05 mean) / max |y|)
        gain = (2 s - s^2) g'y / sigma^2

    Nothing is to be gained on a black picture.
    """
    columns, tree = item.columns, item.columns.tree
    mean = (fitted.values * columns.areas[fitted.leaves]).sum()
    radiance = torch.zeros_like(columns.norms).index_copy(0, fitted.leaves, fitted.values)
    here = radiance[tree.supports[candidates]]
    used = fitted.leaves[fitted.values > 0]
    if used.shape[0] == 0:
        return torch.zeros_like(here), torch.ones_like(here, dtype=torch.bool)
    norms = columns.norms[used]
    quarters = tree.children[candidates]
    h = signs(norms)

    residual = item.correlations - radiance[used] @ columns.gram[used]
    g = residual[quarters] @ h.T
    own = h @ columns.gram[quarters[:, :, None], quarters[:, None, :]] @ h.T
    across = (columns.gram[used[:, None, None], quarters] @ h.T) / norms[:, None, None]
    innovation = own - explained(columns.gram[used][:, used] / (norms[:, None] * norms), across)
    energy = own.diagonal(dim1=-2, dim2=-1).amax(dim=-1)
    sound = determined(innovation, energy, condition_limit * (mean + here), item.sigma)

    prior = (item.sigma / torch.maximum(here, LEAST_PRIOR * mean)).square()
    innovation.diagonal(dim1=-2, dim2=-1).add_(prior[:, None])
    y = torch.linalg.solve(innovation, g[..., None])[..., 0]
    largest = y.abs().amax(dim=-1)
    reach = REACH * torch.maximum(here, LEAST_REACH * mean)
    step = torch.where(largest > reach, reach / largest, 1.0)
    return (2 * step - step.square()) * (g * y).sum(dim=-1) / item.sigma**2, sound


def explained(gram: Float[Tensor, "n n"], across: Float[Tensor, "n k 3"]) -> Float[Tensor, "k 3 3"]:
    """Returns W'P (P'P)^-1 P'W for every trio, from unit columns P."""
    if gram.shape[0] == 0:
        return across.new_zeros(across.shape[1], 3, 3)
    gram = gram.clone()
    gram.diagonal().add_(RIDGE)
    y = torch.linalg.solve_triangular(cholesky(gram, RIDGE), across.flatten(start_dim=1), upper=False)
    y = y.unflatten(1, across.shape[1:]).movedim(0, 1)
    return y.transpose(-1, -2) @ y


def prune(item: Item, grown: Grown, budget: int, rule: ProjectedGain) -> Grown:
    """Returns the item with at most `budget` functions: wavelets of least effect c^2 |A psi|^2 leave."""
    tree = item.columns.tree
    norms = item.columns.wavelet_gram.diagonal()
    fate, kept, fitted, divided = grown.fate.clone(), grown.kept.clone(), grown.fitted, grown.divided
    fixed = constants(tree)
    while int(kept.sum()) > budget:
        effect = (fitted.values @ leaf_wavelets(tree, fitted.leaves)).square() * norms
        wavelets = (kept & ~fixed).nonzero()[:, 0]
        count = min(math.ceil(rule.pruned * wavelets.shape[0]), int(kept.sum()) - budget)
        kept[wavelets[best(-effect[wavelets], count)]] = False
        fate[divided & ~carrying(tree, kept)] = int(Fate.LIMIT)
        divided = needed(tree, kept)
        fitted = fit(item, divided, kept, texels_of(item, fitted))
    return Grown(divided, kept, inherited(tree, fate, divided), fitted)
