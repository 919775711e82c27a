"""Best-first growth for all items at once, where there is no compiled code: on a GPU.

What `growth` does item by item is done here for many items in operations of fixed shapes; trees are padded to the
largest among them. Which leaves are divided, and how many, are tensors that the host never reads. It waits for the
fits (`solvers.device_steps`), for whether every block has a factor, and once a round for how many leaves each tree has
and which trees have ended.

    fit       v = argmin |A v - b|^2 over v >= 0 on the leaves             one program per item and channel
    gain      of all leaves, those that may not be divided included
    divide    leaf of rank r among the n that are divided: its first quarter takes its place, the others c + 3 r + 0..2
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchlight.inversion.forest import RIDGE, Forest, Items
from torchlight.inversion.growth import (
    ALWAYS_ASKED,
    ASKED_ENERGY,
    LEAST_PRIOR,
    LEAST_REACH,
    LIMITS,
    REACH,
    Pace,
    areas,
    prune,
    signs,
)
from torchlight.inversion.nodes import TEXEL, UNKNOWN
from torchlight.inversion.quadtree import WAVELETS
from torchlight.inversion.refinement import FLOOR, Bounds, Fate
from torchlight.solvers.certificate import nonzero_norm
from torchlight.solvers.device_steps import Programs, minimizers

ENTRIES_AT_ONCE = 2**22  # leaves x leaves of the trees that are worked on together; twenty tensors of up to 128 MiB


@dataclass(frozen=True, eq=False)
class Trees:
    """Some items and their trees as they are before a round, padded to the largest of them.

    Attributes:
        item: which items.
        leaves: places of the leaves, and of other squares in the padding.
        used: which of them are leaves.
        gram: inner products of the leaves' columns.
        norms: lengths of these columns, 0 in the padding.
    """

    item: Int[Tensor, " items"]
    leaves: Int[Tensor, "items width"]
    used: Bool[Tensor, "items width"]
    gram: Float[Tensor, "items width width"]
    norms: Float[Tensor, "items width"]

    @property
    def inverse(self) -> Float[Tensor, "items width"]:
        """What makes the columns unit vectors; 0 for those that are 0."""
        return torch.where(self.norms > 0, 1 / self.norms, 0.0)


def grow(items: Items, forest: Forest, waiting: Int[Tensor, " k"], pace: Pace, bounds: Bounds) -> None:
    """Grows the trees of some items until they are done or ask for quarters that are not known, in place."""
    forest.requests[waiting] = 0
    going = list(zip(waiting.tolist(), forest.counts[waiting].tolist(), strict=True))
    while going:
        rounds = [
            one_round(items, forest, torch.tensor(part, device=waiting.device), width, pace, bounds)
            for part, width in parts_of(going)
        ]
        verdicts = torch.cat(rounds).tolist()  # the one place where the host waits for the trees
        going = [(item, count) for item, count, goes_on in verdicts if goes_on]
    for item in waiting.tolist() if pace.room > bounds.budget else []:
        if not bool(forest.requests[item].any()):
            prune(items, forest, item, bounds.budget)


def parts_of(going: list[tuple[int, int]]) -> Iterator[tuple[list[int], int]]:
    """Yields items to be worked on together, trees of similar size, with the number of leaves of the largest."""
    waiting = sorted(going, key=lambda pair: (pair[1], pair[0]))
    while waiting:
        taken = 1
        while taken < len(waiting) and (taken + 1) * waiting[taken][1] ** 2 <= ENTRIES_AT_ONCE:
            taken += 1
        yield [item for item, _ in waiting[:taken]], waiting[taken - 1][1]
        waiting = waiting[taken:]


def one_round(
    items: Items, forest: Forest, index: Int[Tensor, " k"], width: int, pace: Pace, bounds: Bounds
) -> Int[Tensor, "k 3"]:
    """Fits some items, and divides their best leaves, in place; returns item, number of leaves, whether it goes on."""
    trees = trees_of(items, forest, index, width)
    values, steps = fitted(items, trees, forest.values[index, :, :width])
    forest.values[index, :, :width] = values
    forest.steps[index] += steps
    candidates, asked = ask(items, forest, trees, values)
    stuck = asked.any(dim=1, keepdim=True)
    gains, sound = projected_gains(items, trees, values, bounds.condition_limit)
    divided = divide(items, forest, trees, candidates & ~stuck, gains, sound, pace)
    return torch.stack([index, forest.counts[index], (divided > 0).to(index)], dim=1)


def trees_of(items: Items, forest: Forest, index: Int[Tensor, " k"], width: int) -> Trees:
    """Returns the trees of some items."""
    leaves = forest.leaves[index, :width]
    used = torch.arange(width, device=index.device) < forest.counts[index][:, None]
    gram = items.weighted.gram[leaves[:, :, None], leaves[:, None, :]]
    norms = torch.where(used, gram.diagonal(dim1=1, dim2=2).clamp(min=0).sqrt(), 0.0)
    return Trees(index, leaves, used, gram, norms)


def unit_gram(trees: Trees, free: Float[Tensor, "items width"]) -> Float[Tensor, "items width width"]:
    """Returns the inner products of columns multiplied by these numbers, with ones on the diagonal."""
    block = trees.gram * free[:, :, None] * free[:, None, :]
    block.diagonal(dim1=1, dim2=2).fill_(1.0)
    return block


def fitted(
    items: Items, trees: Trees, start: Float[Tensor, "k channels width"]
) -> tuple[Float[Tensor, "k channels width"], Int[Tensor, "k channels"]]:
    """Returns the non-negative least squares answers on the leaves, 0 in the padding, and the steps they took."""
    count, channels, width = start.shape
    inverse, size = trees.inverse[:, None], nonzero_norm(items.targets[trees.item])[..., None]
    linear = of_leaves(items, trees, trees.leaves) * inverse / size
    number = torch.arange(count * channels, device=start.device)
    programs = Programs(unit_gram(trees, trees.inverse), number // channels, number, channels, linear.flatten(0, 1))
    x, steps = minimizers(programs, (start * trees.norms[:, None] / size).flatten(0, 1), RIDGE, LIMITS)
    return x.view(count, channels, width) * inverse * size, steps.view(count, channels)


def of_leaves(items: Items, trees: Trees, places: Int[Tensor, "k *n"]) -> Float[Tensor, "k channels *n"]:
    """Returns A'b of some squares of every item."""
    known = items.correlations[trees.item]
    index = places.flatten(1)[:, None].expand(-1, known.shape[1], -1)
    return known.gather(2, index).unflatten(2, places.shape[1:])


def ask(
    items: Items, forest: Forest, trees: Trees, values: Float[Tensor, "k channels width"]
) -> tuple[Bool[Tensor, "k width"], Bool[Tensor, "k width"]]:
    """Returns which leaves may be divided and which quarters must be known first; sets the other fates in place."""
    weighted, width = items.weighted, trees.leaves.shape[1]
    level = weighted.source.tree.level[weighted.node[trees.leaves]]
    quarters = weighted.children[trees.leaves, 0]
    energy = (values * trees.norms[:, None]).square().amax(dim=1)
    dim = (level >= ALWAYS_ASKED) & (energy < ASKED_ENERGY * items.sigmas[trees.item, None].square())
    fate = torch.where(dim, int(Fate.BELOW_THRESHOLD), int(Fate.UNSOLVED))
    fate = torch.where(trees.norms == 0, int(Fate.UNSEEN), fate)
    fate = torch.where(quarters == TEXEL, int(Fate.RESOLVED), fate)
    forest.fates[trees.item, :width] = torch.where(trees.used, fate, 0)
    open_ones = trees.used & (quarters != TEXEL) & (trees.norms > 0) & ~dim
    asked = open_ones & (quarters == UNKNOWN)
    forest.requests[trees.item, :width] = asked.to(forest.requests)
    return open_ones & ~asked, asked


def projected_gains(
    items: Items, trees: Trees, values: Float[Tensor, "k channels width"], condition_limit: float
) -> tuple[Float[Tensor, "k width"], Bool[Tensor, "k width"]]:
    """Returns what `growth.projected_gain` does for every leaf whose quarters are known, and anything for others."""
    gram, h = items.weighted.gram, signs(trees.gram)
    quarters = items.weighted.children[trees.leaves].clamp(min=0)
    own = h @ gram[quarters[..., :, None], quarters[..., None, :]] @ h.T
    across = gram[trees.leaves[:, :, None, None], quarters[:, None]] @ h.T
    correlated = of_leaves(items, trees, quarters) @ h.T
    gains, sound = torch.zeros_like(trees.norms), torch.zeros_like(trees.used)
    for channel in range(values.shape[1]):
        slopes = correlated[:, channel] - torch.einsum("na,nakw->nkw", values[:, channel], across)
        here = Wavelets(own, across, slopes, items.sigmas[trees.item, None])
        gain, determines = gain_of_channel(items, trees, values[:, channel], here, condition_limit)
        gains = gains + torch.where(determines, gain, 0.0)
        sound = sound | determines
    return gains, sound


@dataclass(frozen=True, eq=False)
class Wavelets:
    """The three wavelets of every leaf, of values +-1, in one channel.

    Attributes:
        own: W'W.
        across: A'W with the columns of all leaves (the second axis).
        slopes: W'(b - A v).
        sigma: noise of a sample.
    """

    own: Float[Tensor, "items width 3 3"]
    across: Float[Tensor, "items width width 3"]
    slopes: Float[Tensor, "items width 3"]
    sigma: Float[Tensor, "items 1"]


def gain_of_channel(
    items: Items, trees: Trees, values: Float[Tensor, "k width"], wavelets: Wavelets, condition_limit: float
) -> tuple[Float[Tensor, "k width"], Bool[Tensor, "k width"]]:
    """Returns the gain of every leaf in one channel, and whether this channel determines its wavelets."""
    free = torch.where(values > 0, trees.inverse, 0.0)
    mean = (values * areas(items)[trees.leaves]).sum(dim=1, keepdim=True)
    innovation = wavelets.own - explained(unit_gram(trees, free), free, wavelets.across)
    energy = wavelets.own.diagonal(dim1=-2, dim2=-1).amax(dim=-1)
    step = condition_limit * (mean + values)
    sound = exceeds(innovation, torch.maximum((wavelets.sigma / step).square(), FLOOR * energy))

    prior = (wavelets.sigma / torch.maximum(values, LEAST_PRIOR * mean)).square()
    innovation.diagonal(dim1=-2, dim2=-1).add_(prior[..., None])
    y = torch.linalg.solve_ex(innovation, wavelets.slopes[..., None])[0][..., 0]
    largest = y.abs().amax(dim=-1)
    reach = REACH * torch.maximum(values, LEAST_REACH * mean)
    step = torch.where(largest > reach, reach / largest, 1.0)
    gain = (2 * step - step.square()) * (wavelets.slopes * y).sum(dim=-1) / wavelets.sigma.square()
    black = mean <= 0  # nothing is to be gained
    return torch.where(black, 0.0, gain), sound | black


def explained(
    block: Float[Tensor, "k width width"], free: Float[Tensor, "k width"], across: Float[Tensor, "k width width 3"]
) -> Float[Tensor, "k width 3 3"]:
    """Returns W'P (P'P)^-1 P'W of every leaf's wavelets, P the unit columns that are not 0."""
    right = (across * free[:, :, None, None]).flatten(2)
    y = torch.linalg.solve_triangular(factors(block), right, upper=False).unflatten(2, across.shape[2:])
    return torch.einsum("naku,nakw->nkuw", y, y)


def factors(block: Float[Tensor, "k width width"]) -> Float[Tensor, "k width width"]:
    """Returns Cholesky factors, each with the smallest ridge of 1e-12, 1e-11, ... that its block needs."""
    ridge = torch.full_like(block[:, 0, 0], RIDGE)
    while True:
        shifted = block.clone()
        shifted.diagonal(dim1=1, dim2=2).add_(ridge[:, None])
        factor, failed = torch.linalg.cholesky_ex(shifted)
        if not bool(failed.any()):
            return factor
        ridge = torch.where(failed > 0, 10 * ridge, ridge)


def exceeds(symmetric: Float[Tensor, "*batch 3 3"], least: Float[Tensor, "*batch"]) -> Bool[Tensor, "*batch"]:
    """Returns whether all eigenvalues exceed a number: whether S - least 1 has a Cholesky factor."""
    a, b, c = symmetric[..., 0, 0] - least, symmetric[..., 1, 0], symmetric[..., 2, 0]
    d = symmetric[..., 1, 1] - least - b * b / a
    e = symmetric[..., 2, 1] - b * c / a
    return (a > 0) & (d > 0) & (symmetric[..., 2, 2] - least - c * c / a - e * e / d > 0)


def divide(
    items: Items,
    forest: Forest,
    trees: Trees,
    candidates: Bool[Tensor, "k width"],
    gains: Float[Tensor, "k width"],
    sound: Bool[Tensor, "k width"],
    pace: Pace,
) -> Int[Tensor, " k"]:
    """Divides the leaves of largest gain and sets the fate of the other candidates, in place; returns how many."""
    index, (width, room) = trees.item, (trees.leaves.shape[1], forest.leaves.shape[1])
    worthy = candidates & sound & (gains > pace.threshold)
    fate = torch.where(sound, int(Fate.BELOW_THRESHOLD), int(Fate.ILL_CONDITIONED))
    fate = torch.where(worthy, int(Fate.LIMIT), fate)
    forest.fates[index, :width] = torch.where(candidates, fate, forest.fates[index, :width])
    functions = forest.counts[index]
    count = (pace.share * functions.double() / WAVELETS).long().clamp(min=1)
    count = torch.minimum(torch.minimum(count, (pace.room - functions) // WAVELETS), worthy.sum(dim=1))
    order = torch.sort(torch.where(worthy, gains, -torch.inf), dim=1, descending=True, stable=True).indices
    rank = torch.zeros_like(order).scatter(1, order, torch.arange(width, device=order.device).expand_as(order))
    chosen = rank < count[:, None]
    quarters = items.weighted.children[trees.leaves]
    leaves = torch.nn.functional.pad(forest.leaves[index], (0, 1))  # one place more, for what is not to be kept
    values = torch.nn.functional.pad(forest.values[index], (0, 1))
    for quarter in range(1, 4):
        place = torch.where(chosen, functions[:, None] + WAVELETS * rank + quarter - 1, room)
        leaves.scatter_(1, place, quarters[..., quarter])
        several = place[:, None].expand(-1, values.shape[1], -1)
        values.scatter_(2, several, forest.values[index, :, :width])
    leaves[:, :width] = torch.where(chosen, quarters[..., 0], leaves[:, :width])
    forest.leaves[index], forest.values[index] = leaves[:, :room], values[..., :room]
    forest.counts[index] = functions + WAVELETS * count
    return count
