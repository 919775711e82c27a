"""One Gram matrix for all photographs of a scene, and for those with masks of their own what differs from it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchlight.solvers.system import System
from torchlight.threads import single_threaded_map

COLUMNS_PER_TASK = 256
ITEMS_PER_PRODUCT = 64
MOST_CHANGED = 0.5  # of the samples: with more, the Gram matrix is made afresh
LOST = 0.01  # of a column's |a|^2: with less left after a downdate, its products are made afresh


@dataclass(frozen=True, eq=False)
class SharedGram:
    """Columns that some photograph sees, and their inner products under the weights that most photographs have.

    Attributes:
        index: which columns of the system, the longest first: whether a column is in use is in doubt where it is
            short, and factors change least where the last columns come and go.
        norms: what they were divided by: |V^(1/2) a_j|, V the largest weights of any photograph, sample by sample.
        columns: the columns divided by norms, without weights, float64.
        weights: diagonal of W, the median of the photographs' weights, sample by sample.
        gram: inner products of the columns under W.
    """

    index: Int[Tensor, " k"]
    norms: Float[Tensor, " k"]
    columns: Float[Tensor, "points k"]
    weights: Float[Tensor, " points"]
    gram: Float[Tensor, "k k"]


@dataclass(frozen=True, eq=False)
class UnitGram:
    """Inner products of columns scaled to norm 1.

    Attributes:
        gram: unit diagonal; the row of a column of norm 0 is 0 beside it.
        norms: what the columns were divided by.
        inverse: 1 / norms, 0 where those are.
    """

    gram: Float[Tensor, "k k"]
    norms: Float[Tensor, " k"]
    inverse: Float[Tensor, " k"]


def shared_gram(system: System, norms: Float[Tensor, " coeffs"]) -> SharedGram:
    """Returns the Gram matrix of the columns that some item sees, by their `largest_norms`."""
    index = norms.argsort(descending=True, stable=True)[: int((norms > 0).sum())]
    weights = system.root.square().median(dim=0).values
    columns = system.matrix[:, index].to(torch.float64) / norms[index]
    return SharedGram(index, norms[index], columns, weights, weighted_gram(columns, weights))


def largest_norms(system: System) -> Float[Tensor, " coeffs"]:
    """Returns the norm of every column under the largest weights of any item, sample by sample."""
    root = system.root.amax(dim=0, keepdim=True)
    return System(system.matrix, root, system.targets[:1]).column_norms()[0]


def weighted_gram(columns: Float[Tensor, "points k"], weights: Float[Tensor, " points"]) -> Float[Tensor, "k k"]:
    """Returns C'WC, made above the diagonal and copied below; the same bits whatever the number of threads."""
    weighted = columns * weights[:, None]
    result = columns.new_empty(columns.shape[1], columns.shape[1])
    for _ in single_threaded_map(partial(fill_block, columns, weighted, result), block_starts(columns)):
        pass
    return result


def unit_gram_under(shared: SharedGram, weights: Float[Tensor, " points"]) -> UnitGram | None:
    """Returns the Gram matrix under other weights W': G + C_d'(W' - W)_d C_d over the samples d where they differ.

    None where they do not. Exact but for rounding: an entry is off by at most some 1e-14, since a column that loses
    more than 0.99 of its |a|^2 gets its products from the samples themselves.
    """
    from torchlight.solvers.mirror_kernel import mirror  # numba is imported only where it is used

    change = weights - shared.weights
    differ = change.nonzero()[:, 0]
    if differ.shape[0] == 0:
        return None
    if differ.shape[0] > MOST_CHANGED * change.shape[0]:
        gram = lower_sum(torch.zeros_like(shared.gram), shared.columns, weights)
    else:
        gram = lower_sum(lower_sum(shared.gram, shared.columns, change), shared.columns, -change, sign=-1)
        lost = (gram.diagonal() < LOST * shared.gram.diagonal()).nonzero()[:, 0]
        if lost.shape[0] > 0:
            afresh = shared.columns.T @ (shared.columns[:, lost] * weights[:, None])
            gram[:, lost], gram[lost] = afresh, afresh.T
    norms, inverse = lengths(gram)
    mirror(gram.numpy(), inverse.numpy())
    gram.diagonal().fill_(1.0)
    return UnitGram(gram, norms, inverse)


def lower_sum(
    gram: Float[Tensor, "k k"], columns: Float[Tensor, "points k"], weights: Float[Tensor, " points"], sign: int = 1
) -> Float[Tensor, "k k"]:
    """Returns G + sign C'WC with the positive weights only, on and below the diagonal; what is above has no meaning."""
    some = (weights > 0).nonzero()[:, 0]
    if some.shape[0] == 0:
        return gram
    rows = columns[some].mul_(weights[some].sqrt()[:, None])
    result = torch.empty_like(gram)
    for start in block_starts(columns):
        stop = start + COLUMNS_PER_TASK
        here = slice(start, stop)
        torch.addmm(gram[here, :stop], rows[:, here].T, rows[:, :stop], alpha=sign, out=result[here, :stop])
    return result


def block_starts(columns: Float[Tensor, "points k"]) -> range:
    """Returns where blocks of columns begin."""
    return range(0, columns.shape[1], COLUMNS_PER_TASK)


def fill_block(
    columns: Float[Tensor, "points k"], weighted: Float[Tensor, "points k"], result: Float[Tensor, "k k"], start: int
) -> None:
    """Sets the inner products of a block of columns with the weighted ones from there on, and mirrors them."""
    here = slice(start, start + COLUMNS_PER_TASK)
    block = columns[:, here].T @ weighted[:, start:]
    square = block[:, : block.shape[0]].triu()
    block[:, : block.shape[0]] = square + square.triu(1).T
    result[here, start:] = block
    result[start:, here] = block.T


def unit_gram(gram: Float[Tensor, "k k"]) -> UnitGram:
    """Returns the Gram matrix of the columns divided by their lengths."""
    norms, inverse = lengths(gram)
    scaled = gram * inverse[:, None] * inverse
    scaled.diagonal().fill_(1.0)
    return UnitGram(scaled, norms, inverse)


def lengths(gram: Float[Tensor, "k k"]) -> tuple[Float[Tensor, " k"], Float[Tensor, " k"]]:
    """Returns the columns' lengths, and what they are to be multiplied by: 1 / length, 0 where that is 0."""
    norms = gram.diagonal().clamp(min=0).sqrt()
    return norms, torch.where(norms > 0, 1 / norms, 0.0)


def correlations(shared: SharedGram, system: System) -> Float[Tensor, "items k"]:
    """Returns C'W b of every item, under its own weights.

    In products of one size on one thread each, so that an item gets the same bits alone and among others.
    """
    result = system.targets.new_empty(system.targets.shape[0], shared.columns.shape[1])

    def fill(start: int) -> None:
        stop = min(start + ITEMS_PER_PRODUCT, result.shape[0])
        right = system.targets.new_zeros(ITEMS_PER_PRODUCT, system.targets.shape[1])
        root = system.root if system.root.shape[0] == 1 else system.root[start:stop]
        right[: stop - start] = system.targets[start:stop] * root
        result[start:stop] = (right @ shared.columns)[: stop - start]

    for _ in single_threaded_map(fill, range(0, result.shape[0], ITEMS_PER_PRODUCT)):
        pass
    return result
