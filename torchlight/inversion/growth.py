"""Best-first growth by projected gain, in torch: what it does, readable; the oracle of what is fast.

Item by item the loop is

    fit       v = argmin |A v - b|^2 over v >= 0 on the leaves
    ask       which leaves may be divided, and whether their quarters are known
    gain      by how much dividing each of them would lower |b - A v|^2
    divide    the best few

until nothing gains enough, there is no room for more, or quarters must be cast first. Small trees may outgrow the
budget and are then pruned: quarters that explain least are joined again. Growth spends divisions before it can see what
pays only deeper; pruning takes back those that did not. `growth_kernel` is the same in compiled code, for the CPU;
`lockstep` is the same for many items at once, for other devices.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchlight.inversion.forest import RIDGE, Forest, Items
from torchlight.inversion.nodes import TEXEL, UNKNOWN
from torchlight.inversion.quadtree import WAVELETS
from torchlight.inversion.refinement import Bounds, Fate, determined
from torchlight.solvers.active_set import Limits, cholesky, minimize_nonnegative

LIMITS = Limits(tolerance=1e-11, max_steps=5000)
ALWAYS_ASKED = 4  # level down to which every leaf may be divided
ASKED_ENERGY = 100.0  # squared sigmas a deeper leaf must put into the photograph: dark ones are not worth their rays
LEAST_PRIOR = 0.3  # of the mean radiance: a dark leaf may still rise this much
LEAST_REACH = 0.05
REACH = 2.0
SMALL = 48  # leaves: only smaller trees outgrow the budget and are pruned
TRIED = 8  # the quarters that seem to explain least are joined by way of trial


@dataclass(frozen=True)
class Pace:
    """How growth goes on.

    Attributes:
        threshold: least gain of a trio, in squared sigmas.
        share: of the possible divisions made between two fits.
        room: leaves to grow to before a tree is pruned to the budget.
    """

    threshold: float
    share: float
    room: int


def grow(items: Items, forest: Forest, waiting: Int[Tensor, " k"], pace: Pace, bounds: Bounds) -> None:
    """Grows the trees of some items until they are done or ask for quarters that are not known, in place."""
    for item in waiting.tolist():
        forest.requests[item] = 0
        while True:
            fit(items, forest, item)
            candidates = ask(items, forest, item)
            if bool(forest.requests[item].any()):
                break
            gain, sound = projected_gain(items, forest, item, candidates, bounds.condition_limit)
            if not divide(items, forest, item, candidates, gain, sound, pace):
                prune(items, forest, item, bounds.budget)
                break


def leaves_of(forest: Forest, item: int) -> Int[Tensor, " leaves"]:
    """Returns the places of an item's leaves."""
    return forest.leaves[item, : int(forest.counts[item])]


def fit(items: Items, forest: Forest, item: int) -> None:
    """Sets the radiance of every channel to the non-negative least squares answer on the leaves, in place."""
    leaves = leaves_of(forest, item)
    gram = items.weighted.gram[leaves][:, leaves]
    norms = gram.diagonal().clamp(min=0).sqrt()
    seen = norms > 0
    unit = gram[seen][:, seen] / (norms[seen, None] * norms[seen])
    for channel in range(forest.values.shape[1]):
        size = nonzero_length(items.targets[item, channel])
        linear = items.correlations[item, channel, leaves][seen] / (norms[seen] * size)
        values = forest.values[item, channel, : leaves.shape[0]]
        x, steps = minimize_nonnegative(unit, linear, values[seen] * norms[seen] / size, RIDGE, LIMITS)
        values.zero_()
        values[seen] = x * size / norms[seen]
        forest.steps[item, channel] += steps


def nonzero_length(vector: Float[Tensor, " n"]) -> Float[Tensor, ""]:
    """Returns the length of a vector, 1 where it is 0."""
    length = torch.linalg.vector_norm(vector)
    return torch.where(length > 0, length, 1.0)


def ask(items: Items, forest: Forest, item: int) -> Int[Tensor, " candidates"]:
    """Returns which leaves may be divided; sets the fate of the others and requests quarters not known, in place.

    Below a level, only leaves that put more than noise into the photograph are asked about.
    """
    weighted, leaves = items.weighted, leaves_of(forest, item)
    squares = items.weighted.gram[leaves, leaves]
    energy = (forest.values[item, :, : leaves.shape[0]].square() * squares).amax(dim=0)
    quarters = weighted.children[leaves, 0]
    deep = weighted.source.tree.level[weighted.node[leaves]] >= ALWAYS_ASKED
    fate = torch.full_like(leaves, int(Fate.UNSOLVED))
    fate[deep & (energy < ASKED_ENERGY * items.sigmas[item] ** 2)] = int(Fate.BELOW_THRESHOLD)
    fate[squares == 0] = int(Fate.UNSEEN)
    fate[quarters == TEXEL] = int(Fate.RESOLVED)
    open_ones = fate == int(Fate.UNSOLVED)
    forest.requests[item, : leaves.shape[0]] = (open_ones & (quarters == UNKNOWN)).long()
    forest.fates[item, : leaves.shape[0]] = fate
    return open_ones.nonzero()[:, 0]


def projected_gain(
    items: Items, forest: Forest, item: int, candidates: Int[Tensor, " k"], condition_limit: float
) -> tuple[Float[Tensor, " k"], Bool[Tensor, " k"]]:
    """Returns by how much dividing each candidate lowers |b - A v|^2, in squared sigmas, and whether it is determined.

    With W = A psi the three columns of the wavelets of values +-1 on the support and P the columns of the leaves that
    are not 0, eliminated:

        g = W'(b - A v),   S = W'W - W'P (P'P)^-1 P'W
        y = (S + (sigma / max(v_k, 0.3 mean))^2 1)^-1 g         a step no larger than the radiance there
        s = min(1, 2 max(v_k, 0.05 mean) / max |y|)
        gain = (2 s - s^2) g'y / sigma^2

    Channels that share a tree add their gains; one that determines the trio is enough. Nothing is to be gained on a
    black picture.
    """
    gains = torch.zeros(candidates.shape[0], dtype=torch.float64, device=candidates.device)
    sound = torch.zeros_like(candidates, dtype=torch.bool)
    for channel in range(forest.values.shape[1]):
        gain, determines = gain_of_channel(items, forest, item, channel, candidates, condition_limit)
        gains += torch.where(determines, gain, 0.0)
        sound |= determines
    return gains, sound


def gain_of_channel(
    items: Items, forest: Forest, item: int, channel: int, candidates: Int[Tensor, " k"], condition_limit: float
) -> tuple[Float[Tensor, " k"], Bool[Tensor, " k"]]:
    """Returns the gain of every candidate in one channel, and whether this channel determines it."""
    weighted, gram, sigma = items.weighted, items.weighted.gram, float(items.sigmas[item])
    leaves = leaves_of(forest, item)
    values = forest.values[item, channel, : leaves.shape[0]]
    mean = (values * areas(items)[leaves]).sum()
    here = values[candidates]
    used, amounts = leaves[values > 0], values[values > 0]
    if used.shape[0] == 0:
        return torch.zeros_like(here), torch.ones_like(here, dtype=torch.bool)
    norms = gram.diagonal()[used].sqrt()
    quarters = weighted.children[leaves[candidates]]
    h = signs(norms)

    residual = items.correlations[item, channel, quarters] - amounts @ gram[used[:, None, None], quarters].movedim(0, 1)
    g = residual @ h.T
    own = h @ gram[quarters[:, :, None], quarters[:, None, :]] @ h.T
    across = (gram[used[:, None, None], quarters] @ h.T) / norms[:, None, None]
    innovation = own - explained(gram[used][:, used] / (norms[:, None] * norms), across)
    energy = own.diagonal(dim1=-2, dim2=-1).amax(dim=-1)
    sound = determined(innovation, energy, condition_limit * (mean + here), sigma)

    prior = (sigma / torch.maximum(here, LEAST_PRIOR * mean)).square()
    innovation.diagonal(dim1=-2, dim2=-1).add_(prior[:, None])
    y = torch.linalg.solve(innovation, g[..., None])[..., 0]
    largest = y.abs().amax(dim=-1)
    reach = REACH * torch.maximum(here, LEAST_REACH * mean)
    step = torch.where(largest > reach, reach / largest, 1.0)
    return (2 * step - step.square()) * (g * y).sum(dim=-1) / sigma**2, sound


def areas(items: Items) -> Float[Tensor, " slots"]:
    """Returns the share of every known square in the area of all texels: three faces' worth."""
    weighted = items.weighted
    return 0.25 ** weighted.source.tree.level[weighted.node].to(torch.float64) / 3


def signs(like: Tensor) -> Float[Tensor, "3 4"]:
    """Returns the values of the horizontal, vertical and diagonal wavelet on the four quarters of their support."""
    rows = [[1, -1, 1, -1], [1, 1, -1, -1], [1, -1, -1, 1]]
    return torch.tensor(rows, dtype=like.dtype, device=like.device)


def explained(gram: Float[Tensor, "n n"], across: Float[Tensor, "n k 3"]) -> Float[Tensor, "k 3 3"]:
    """Returns W'P (P'P)^-1 P'W for every trio, from unit columns P."""
    shifted = gram.clone()
    shifted.diagonal().add_(RIDGE)
    y = torch.linalg.solve_triangular(cholesky(shifted, RIDGE), across.flatten(start_dim=1), upper=False)
    y = y.unflatten(1, across.shape[1:]).movedim(0, 1)
    return y.transpose(-1, -2) @ y


def divide(
    items: Items,
    forest: Forest,
    item: int,
    candidates: Int[Tensor, " k"],
    gain: Float[Tensor, " k"],
    sound: Bool[Tensor, " k"],
    pace: Pace,
) -> bool:
    """Divides the leaves of largest gain and sets the fate of the other candidates, in place; False = none left."""
    worthy = sound & (gain > pace.threshold)
    fate = torch.where(sound, int(Fate.BELOW_THRESHOLD), int(Fate.ILL_CONDITIONED))
    forest.fates[item, candidates] = torch.where(worthy, int(Fate.LIMIT), fate)
    functions = int(forest.counts[item])
    count = min(max(1, int(pace.share * functions / WAVELETS)), (pace.room - functions) // WAVELETS, int(worthy.sum()))
    order = torch.sort(torch.where(worthy, gain, -torch.inf), descending=True, stable=True).indices
    for place in candidates[order[:count]].tolist():
        leaves, end = forest.leaves[item], int(forest.counts[item])
        quarters = items.weighted.children[leaves[place]]
        leaves[place], leaves[end : end + WAVELETS] = quarters[0], quarters[1:]
        forest.values[item, :, end : end + WAVELETS] = forest.values[item, :, place, None]
        forest.counts[item] += WAVELETS
    return count > 0


def prune(items: Items, forest: Forest, item: int, budget: int) -> None:
    """Joins quarters, those that explain least when all is fitted anew, until the budget holds, in place."""
    while int(forest.counts[item]) > budget:
        leaves = leaves_of(forest, item)
        places = whole_quads(items, leaves)
        losses, joined = joining(items, forest, item, places)
        ranked = torch.sort(losses, stable=True).indices
        ranked = ranked[:TRIED]
        explained = torch.stack([explained_without(items, forest, item, places, joined, quad) for quad in ranked])
        join(items, forest, item, places, joined, ranked[explained.argmax()].reshape(1))
        fit(items, forest, item)


def whole_quads(items: Items, leaves: Int[Tensor, " leaves"]) -> Int[Tensor, "quads 4"]:
    """Returns the places in the list of leaves of four quarters of one square, by ascending squares."""
    above, order = torch.sort(items.weighted.parent[leaves], stable=True)
    distinct, counts = torch.unique_consecutive(above, return_counts=True)
    first = counts.cumsum(0) - counts
    return order[first[(counts == 4) & (distinct >= 0)][:, None] + torch.arange(4, device=leaves.device)]


def joining(
    items: Items, forest: Forest, item: int, places: Int[Tensor, "quads 4"]
) -> tuple[Float[Tensor, " quads"], Float[Tensor, "channels quads"]]:
    """Returns what joining four leaves costs, summed over the channels, and the radiance t they then share.

    All other leaves stay as they are. With d = t 1 - v on the four, G their Gram matrix and w = A'(b - A v):

        |b - A (v + d)|^2 - |b - A v|^2 = d'G d - 2 w'd,   least at t = max(0, 1'(G v + w) / 1'G 1)
    """
    leaves = leaves_of(forest, item)
    gram, values = items.weighted.gram[leaves][:, leaves], forest.values[item, :, : leaves.shape[0]]
    w = (items.correlations[item][:, leaves] - values @ gram)[:, places]
    four, v = gram[places[:, :, None], places[:, None, :]], values[:, places]
    curvature = four.sum(dim=(1, 2))
    slope = (w + torch.einsum("qij,cqj->cqi", four, v)).sum(dim=-1)
    t = torch.where(curvature > 0, slope / torch.where(curvature > 0, curvature, 1.0), 0.0).clamp(min=0)
    d = t[..., None] - v
    losses = torch.einsum("cqi,qij,cqj->q", d, four, d) - 2 * (w * d).sum(dim=(0, 2))
    return losses, t


def explained_without(
    items: Items,
    forest: Forest,
    item: int,
    places: Int[Tensor, "quads 4"],
    joined: Float[Tensor, "channels quads"],
    quad: Int[Tensor, ""],
) -> Float[Tensor, ""]:
    """Returns b'A v after four leaves are joined and all are fitted anew: the more, the smaller the residual."""
    trial = replace(forest, **{name: getattr(forest, name).clone() for name in ("leaves", "counts", "values", "fates")})
    join(items, trial, item, places, joined, quad.reshape(1))
    fit(items, trial, item)
    leaves = leaves_of(trial, item)
    return (items.correlations[item][:, leaves] * trial.values[item, :, : leaves.shape[0]]).sum()


def join(
    items: Items,
    forest: Forest,
    item: int,
    places: Int[Tensor, "quads 4"],
    joined: Float[Tensor, "channels quads"],
    chosen: Int[Tensor, " k"],
) -> None:
    """Replaces quarters by the square they make up, in place."""
    count = int(forest.counts[item])
    first = places[chosen, 0]
    forest.leaves[item, first] = items.weighted.parent[forest.leaves[item, first]]
    forest.fates[item, first] = int(Fate.LIMIT)
    forest.values[item][:, first] = joined[:, chosen]
    stay = torch.ones(count, dtype=torch.bool, device=first.device)
    stay[places[chosen, 1:].reshape(-1)] = False
    left = int(stay.sum())
    forest.leaves[item, :left] = forest.leaves[item, :count][stay]
    forest.fates[item, :left] = forest.fates[item, :count][stay]
    forest.values[item][:, :left] = forest.values[item][:, :count][:, stay]
    forest.counts[item] = left
