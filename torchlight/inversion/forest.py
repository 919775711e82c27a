"""The trees of many items while they grow, and what they become: light, functions in use, fates."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchlight.inversion.nodes import WeightedNodes, product
from torchlight.inversion.outcome import Outcome
from torchlight.inversion.quadtree import Quadtree, spread
from torchlight.inversion.refinement import Fate, all_trios
from torchlight.light import haar
from torchlight.solvers.certificate import gap_along, kkt_residual, nonzero_norm

RIDGE = 1e-12  # of the fits, on columns of length 1


@dataclass(frozen=True, eq=False)
class Items:
    """Photographs of equal weights, ready to be fitted. An item is what shares one tree: one channel, or all of them.

    Attributes:
        weighted: the columns.
        targets: W^(1/2) b.
        correlations: A'b of every square known; `follow` extends them.
        sigmas: standard deviation of the noise of a sample of weight 1.
    """

    weighted: WeightedNodes
    targets: Float[Tensor, "items channels points"]
    correlations: Float[Tensor, "items channels slots"]
    sigmas: Float[Tensor, " items"]


@dataclass(frozen=True, eq=False)
class Forest:
    """One tree per item; growing changes it in place.

    Attributes:
        leaves: places of the leaves in `WeightedNodes`, as many as `counts` says.
        counts: number of leaves, which is the number of functions: trees grow by whole trios.
        values: radiance on the leaves.
        fates: a `Fate` for every leaf: why it is not divided.
        requests: 1 where the quarters of a leaf must be known before its item can grow on.
        steps: factorisations spent.
    """

    leaves: Int[Tensor, "items room"]
    counts: Int[Tensor, " items"]
    values: Float[Tensor, "items channels room"]
    fates: Int[Tensor, "items room"]
    requests: Int[Tensor, "items room"]
    steps: Int[Tensor, "items channels"]


def seedlings(items: Items, room: int) -> Forest:
    """Returns one tree of nine roots per item, all bright."""
    roots = items.weighted.roots
    count, channels, _ = items.targets.shape
    leaves = roots.new_zeros(count, room)
    leaves[:, : len(roots)] = roots
    values = items.targets.new_zeros(count, channels, room)
    values[..., : len(roots)] = 1.0
    return Forest(
        leaves=leaves,
        counts=roots.new_full((count,), len(roots)),
        values=values,
        fates=torch.zeros_like(leaves),
        requests=torch.zeros_like(leaves),
        steps=roots.new_zeros(count, channels),
    )


def in_use(forest: Forest) -> Bool[Tensor, "items room"]:
    """Returns which entries of the padded rows are leaves."""
    return torch.arange(forest.leaves.shape[1], device=forest.counts.device) < forest.counts[:, None]


def on_places(forest: Forest, places: int) -> Float[Tensor, "items channels slots"]:
    """Returns the radiance of the leaves at their places among the known squares, 0 elsewhere."""
    values = torch.where(in_use(forest)[:, None], forest.values, 0.0)
    index = forest.leaves[:, None].expand_as(values)
    return values.new_zeros(*values.shape[:2], places).scatter_add_(-1, index, values)


def on_texels(forest: Forest, weighted: WeightedNodes) -> Float[Tensor, "items channels texels"]:
    """Returns the radiance of every texel of the finest level."""
    values = torch.where(in_use(forest)[:, None], forest.values, 0.0)
    tree = weighted.source.tree
    index = weighted.node[forest.leaves][:, None].expand_as(values)
    whole = values.new_zeros(*values.shape[:2], tree.size).scatter_add_(-1, index, values)
    return spread(whole, tree.resolution)


def divided_nodes(forest: Forest, weighted: WeightedNodes) -> Bool[Tensor, "items nodes"]:
    """Returns the squares that are cut into four: everything above the leaves."""
    tree = weighted.source.tree
    inner = torch.zeros(forest.leaves.shape[0], tree.size + 1, dtype=torch.bool, device=tree.level.device)
    above = torch.where(in_use(forest), tree.parent[weighted.node[forest.leaves]], -1)
    while bool((above >= 0).any()):
        inner.scatter_(1, torch.where(above >= 0, above, tree.size), torch.ones_like(above, dtype=torch.bool))
        above = torch.where(above >= 0, tree.parent[above.clamp(min=0)], -1)
    return inner[:, :-1]


def functions_in_use(tree: Quadtree, divided: Bool[Tensor, "items nodes"]) -> Bool[Tensor, "items coeffs"]:
    """Returns the nine constants and the three wavelets of every divided square."""
    kept = torch.zeros(divided.shape[0], 3 * tree.resolution**2, dtype=torch.bool, device=divided.device)
    kept[:, tree.root_coefficients] = True
    kept[:, all_trios(tree)] = divided[:, tree.supports, None]
    return kept


def fates_of_supports(
    forest: Forest, weighted: WeightedNodes, divided: Bool[Tensor, "items nodes"]
) -> Int[Tensor, "items supports"]:
    """Returns a `Fate` per support: RESOLVED where divided, UNSEEN where no sample sees it, else that of its leaf."""
    tree = weighted.source.tree
    fate = torch.full(divided.shape, int(Fate.UNSOLVED), dtype=torch.int8, device=divided.device)
    unused = ~in_use(forest)
    node = weighted.node[forest.leaves]
    index = torch.where(unused, node[:, :1], node)
    fate.scatter_(1, index, torch.where(unused, forest.fates[:, :1], forest.fates).to(torch.int8))
    fate[divided] = int(Fate.RESOLVED)
    for level in range(1, int(tree.level.max().item())):
        here = ((tree.level == level) & (tree.parent >= 0)).nonzero()[:, 0]
        above = tree.parent[here]
        fate[:, here] = torch.where(divided[:, above], fate[:, here], fate[:, above])
    unseen = weighted.node[weighted.gram.diagonal() == 0]
    fate[:, unseen] = int(Fate.UNSEEN)
    return fate[:, tree.supports]


def coefficients(
    tree: Quadtree, texels: Float[Tensor, "items channels texels"], kept: Bool[Tensor, "items coeffs"]
) -> Float[Tensor, "items channels coeffs"]:
    """Returns the Haar coefficients, exactly 0 for functions not in use."""
    return torch.where(kept[:, None], haar.analysis(texels, tree.resolution), 0.0)


def certificates(
    items: Items, forest: Forest, fitted: Float[Tensor, "items channels points"]
) -> Float[Tensor, "items channels 3"]:
    """Returns relative residual, KKT residual and duality gap on the leaves, from the columns rather than their Gram.

    Args:
        items: what was to be explained.
        forest: the answers.
        fitted: W^(1/2) A v.
    """
    weighted, used = items.weighted, in_use(forest)[:, None]
    residual = items.targets - fitted
    slopes = product(residual.flatten(0, 1), weighted.columns).unflatten(0, residual.shape[:2])
    index = forest.leaves[:, None].expand_as(forest.values)
    norms = weighted.gram.diagonal().clamp(min=0).sqrt()[index]
    w = torch.where(used, slopes.gather(-1, index), 0.0)
    v = torch.where(used, forest.values, 0.0)
    size = nonzero_norm(items.targets)
    norms = torch.where(used, norms, 0.0)
    worst = kkt_residual(v, w - RIDGE * norms.square() * v, norms, size)
    along = torch.where(used, product(weighted.root[None], weighted.columns)[0][index], 0.0)
    gap = gap_along(items.targets, residual, w, norms, along, weighted.root)
    return torch.stack([torch.linalg.vector_norm(residual, dim=-1) / size, worst, gap], dim=-1)


def harvest(items: Items, forest: Forest, shape: tuple[int, int]) -> Outcome:
    """Returns what the trees amount to, for every photograph and channel."""
    weighted, tree = items.weighted, items.weighted.source.tree
    places = on_places(forest, weighted.node.shape[0])
    irradiance = product(places.flatten(0, 1), weighted.unweighted().T).unflatten(0, places.shape[:2])
    divided = divided_nodes(forest, weighted)
    kept = functions_in_use(tree, divided)
    channels = forest.values.shape[1]

    def shaped(tensor: Tensor) -> Tensor:
        return tensor.reshape(*shape, *tensor.shape[2:])

    def for_channels(tensor: Tensor) -> Tensor:
        return shaped(tensor[:, None].expand(-1, channels, *tensor.shape[1:]))

    return Outcome(
        coefficients=shaped(coefficients(tree, on_texels(forest, weighted), kept)),
        irradiance=shaped(irradiance),
        figures=shaped(certificates(items, forest, irradiance * weighted.root)),
        steps=shaped(forest.steps),
        kept=for_channels(kept),
        fate=for_channels(fates_of_supports(forest, weighted, divided)),
        regions=for_channels(forest.counts),
    )
