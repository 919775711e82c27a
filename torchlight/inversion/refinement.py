"""What an adaptive solve decided: which Haar functions are used, and why no others."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchlight.inversion.leaf_program import Fitted, Item
from torchlight.inversion.quadtree import WAVELETS, Quadtree

FLOOR = 1e-9  # part of a trio's own energy that must be left by what others explain, whatever the noise


class Fate(IntEnum):
    """Why a support carries wavelets or not."""

    RESOLVED = 0
    BELOW_THRESHOLD = 1
    ILL_CONDITIONED = 2
    UNSEEN = 3
    LIMIT = 4
    UNSOLVED = 5


NAMES = {
    Fate.RESOLVED: "resolved",
    Fate.BELOW_THRESHOLD: "below threshold",
    Fate.ILL_CONDITIONED: "ill-conditioned",
    Fate.UNSEEN: "unseen",
    Fate.LIMIT: "limit",
    Fate.UNSOLVED: "unsolved",
}


@dataclass(frozen=True, eq=False)
class Refinement:
    """Functions in use and the fate of every support, per photograph and channel.

    RESOLVED supports carry one to three wavelets. The others carry none: their wavelets would not have paid
    (BELOW_THRESHOLD), could not be told apart from the functions in use (ILL_CONDITIONED), belong to a region that no
    sample sees (UNSEEN), or would have exceeded the budget (LIMIT). A support within an undivided one shares its fate.
    UNSOLVED: the whole item failed.

    Attributes:
        kept: Haar functions in use, in coefficient order; the nine constants always are.
        fate: a `Fate` for every support, in the order of `Quadtree.supports`.
        regions: number of squares on which the light is constant.
    """

    kept: Bool[Tensor, "*batch channels coeffs"]
    fate: Int[Tensor, "*batch channels supports"]
    regions: Int[Tensor, "*batch channels"]

    @property
    def functions(self) -> Int[Tensor, "*batch channels"]:
        """Number of Haar functions in use: constants and wavelets."""
        return self.kept.sum(dim=-1)


@dataclass(frozen=True)
class Bounds:
    """What any rule must respect.

    Attributes:
        budget: most functions.
        condition_limit: kappa of `determined`.
    """

    budget: int
    condition_limit: float


@dataclass(frozen=True, eq=False)
class Grown:
    """The state of one item: the tree, the functions in use, why others are not, and the fit.

    Attributes:
        divided: supports that are cut into four.
        kept: functions in use.
        fate: of every support.
        fitted: the best radiance with these functions.
    """

    divided: Bool[Tensor, " supports"]
    kept: Bool[Tensor, " coeffs"]
    fate: Int[Tensor, " supports"]
    fitted: Fitted


def constants(tree: Quadtree) -> Bool[Tensor, " coeffs"]:
    """Returns which coefficients are scaling coefficients of roots."""
    kept = torch.zeros(3 * tree.resolution**2, dtype=torch.bool, device=tree.level.device)
    kept[tree.root_coefficients] = True
    return kept


def trios(tree: Quadtree, supports: Int[Tensor, " k"]) -> Int[Tensor, "k 3"]:
    """Returns the coefficients of the wavelets of supports."""
    return tree.trios[supports][:, None] + torch.arange(WAVELETS, device=supports.device)


def all_trios(tree: Quadtree) -> Int[Tensor, "supports 3"]:
    """Returns the coefficients of the wavelets of every support."""
    return trios(tree, torch.arange(tree.supports.shape[0], device=tree.supports.device))


def carrying(tree: Quadtree, kept: Bool[Tensor, " coeffs"]) -> Bool[Tensor, " supports"]:
    """Returns the supports with at least one wavelet in use."""
    return kept[all_trios(tree)].any(dim=1)


def needed(tree: Quadtree, kept: Bool[Tensor, " coeffs"]) -> Bool[Tensor, " supports"]:
    """Returns the smallest tree that holds the wavelets in use: supports with one on them or within them."""
    inner = torch.zeros(tree.size, dtype=torch.bool, device=kept.device)
    inner[tree.supports] = carrying(tree, kept)
    for level in range(int(tree.level.max().item()), 0, -1):
        here = (tree.level == level) & inner & (tree.parent >= 0)
        inner[tree.parent[here]] = True
    return inner[tree.supports]


def fate_counts(
    tree: Quadtree, kept: Bool[Tensor, " coeffs"], fate: Int[Tensor, " supports"]
) -> Int[Tensor, "levels fates"]:
    """Returns the number of supports per level and `Fate` that were asked: the roots, and quarters of divided ones.

    Level j holds squares of 2^-j times a face's side; side faces begin at level 1 with their upper half. Supports
    within an undivided one share its fate and are not counted.
    """
    divided = torch.zeros_like(tree.level, dtype=torch.bool)
    divided[tree.supports] = needed(tree, kept)
    parent = tree.parent[tree.supports]
    asked = (parent < 0) | divided[parent.clamp(min=0)]
    levels = int(tree.level.max())
    index = tree.level[tree.supports][asked] * len(Fate) + fate[asked]
    return torch.bincount(index, minlength=levels * len(Fate)).reshape(levels, len(Fate))


def unseen_supports(item: Item) -> Bool[Tensor, " supports"]:
    """Returns the supports whose light reaches no sample."""
    return item.columns.norms[item.columns.tree.supports] == 0


def inherited(
    tree: Quadtree, fate: Int[Tensor, " supports"], divided: Bool[Tensor, " supports"]
) -> Int[Tensor, " supports"]:
    """Returns the fates with that of every undivided support handed down to the supports within it, UNSEEN excepted."""
    node_fate = torch.full_like(tree.level, int(Fate.UNSOLVED))
    node_fate[tree.supports] = fate
    inner = torch.zeros(tree.size, dtype=torch.bool, device=fate.device)
    inner[tree.supports] = divided
    for level in range(1, int(tree.level.max().item())):
        nodes = ((tree.level == level) & (tree.parent >= 0)).nonzero()[:, 0]
        above = tree.parent[nodes]
        passed_on = ~inner[above] & (node_fate[nodes] != int(Fate.UNSEEN))
        node_fate[nodes[passed_on]] = node_fate[above[passed_on]]
    return node_fate[tree.supports]


def determined(
    innovation: Float[Tensor, "*batch 3 3"],
    energy: Float[Tensor, "*batch"],
    step: Float[Tensor, "*batch"],
    sigma: float,
) -> Bool[Tensor, "*batch"]:
    """Returns whether the data determine a trio of wavelets beside the functions in use.

        lambda_min(S) step^2 >= sigma^2,   lambda_min(S) > 1e-9 |A psi|^2

    A change of the wavelets by one step moves the photograph by at least one sigma in a way that no other function in
    use can.

    Args:
        innovation: S, the Schur complement of the functions in use in the Gram matrix; wavelets of values +-1.
        energy: largest |A psi|^2 of the trio.
        step: kappa (mean radiance + radiance of the support).
        sigma: noise of a sample.
    """
    smallest = torch.linalg.eigvalsh(innovation)[..., 0]
    return (smallest * step.square() >= sigma**2) & (smallest > FLOOR * energy)
