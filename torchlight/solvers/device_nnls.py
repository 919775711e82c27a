"""Non-negative least squares on one Gram matrix for many items where there is no compiled code: on a GPU.

What `batch.batch_minimizers` does on a CPU: rough supports for all items by matrix products (`modulus`), then exact
minimisers, here of all items in lockstep (`device_steps`). Items of other weights have Gram matrices of their own, made
afresh: a GPU multiplies faster than it picks samples.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchlight.solvers.active_set import Limits
from torchlight.solvers.batch import DAMPING
from torchlight.solvers.certificate import nonzero_norm
from torchlight.solvers.device_steps import ENTRIES_PER_CALL, Programs, alike, minimizers, padded
from torchlight.solvers.modulus import Modulus, modulus_of
from torchlight.solvers.shared_gram import SharedGram, UnitGram, correlations, unit_gram
from torchlight.solvers.system import System


def lockstep_minimizers(
    system: System, shared: SharedGram, ridge: float, limits: Limits
) -> tuple[Float[Tensor, "items k"], Int[Tensor, " items"]]:
    """Returns what `batch.batch_minimizers` does: minimisers over x >= 0 of the columns in use, and the steps."""
    size = nonzero_norm(system.targets)[:, None]
    linear, base = correlations(shared, system) / size, unit_gram(shared.gram)
    # a guess of more columns than there are samples begins on a singular face, and takes long to leave it
    guess = modulus_of(base.gram) if 0 < linear.shape[1] <= shared.columns.shape[0] else None
    if system.root.shape[0] == 1:
        c = linear * base.inverse
        start = torch.zeros_like(c) if guess is None else guess.minimizers(c)
        x, steps = minimizers(alike(base.gram, c), start, ridge, limits)
        return x * base.inverse / shared.norms * size, steps
    parts = [
        of_own_weights(shared, base, guess, system.root[items], linear[items], ridge, limits)
        for items in parts_of_equal_weights(system.root, linear.shape[1])
    ]
    x, steps = (torch.cat(part) for part in zip(*parts, strict=True))
    return x / shared.norms * size, steps


def parts_of_equal_weights(root: Float[Tensor, "items points"], columns: int) -> Iterator[slice]:
    """Yields neighbouring items, those of equal weights together, as many as Gram matrices of their own find room."""
    most = max(1, ENTRIES_PER_CALL // max(1, columns**2))
    starts = [0, *((root[1:] != root[:-1]).any(dim=1).nonzero()[:, 0] + 1).tolist(), root.shape[0]]
    bounds = [*starts[:-1:most], starts[-1]]
    yield from (slice(first, last) for first, last in pairwise(bounds))


def of_own_weights(
    shared: SharedGram,
    base: UnitGram,
    guess: Modulus | None,
    root: Float[Tensor, "items points"],
    linear: Float[Tensor, "items k"],
    ridge: float,
    limits: Limits,
) -> tuple[Float[Tensor, "items k"], Int[Tensor, " items"]]:
    """Returns minimisers, of the columns of `shared` times their norms, and steps for items with weights of their own.

    The Gram matrix of each group is made afresh. Supports are guessed under the one that most share, as
    `batch.guessed` does: the samples that an item lacks are filled in with what damped least squares predicts.
    """
    new = torch.cat([torch.ones_like(root[:1, 0], dtype=torch.bool), (root[1:] != root[:-1]).any(dim=1)])
    group, first = new.cumsum(dim=0) - 1, new.nonzero()[:, 0]
    grams = torch.stack([shared.columns.T @ (shared.columns * row[:, None]) for row in root[first].square()])
    rank = torch.arange(len(group), device=group.device) - first[group]
    most = int(rank.max()) + 1
    norms = grams.diagonal(dim1=1, dim2=2).clamp(min=0).sqrt()
    inverse = torch.where(norms > 0, 1 / norms, 0.0)
    programs = Programs(scaled(grams, inverse), group, group * most + rank, most, linear * inverse[group])
    start = torch.zeros_like(linear) if guess is None else filled_in(grams, base, guess, programs, linear)
    x, steps = minimizers(programs, start, ridge, limits)
    return x * inverse[group], steps


def filled_in(
    grams: Float[Tensor, "groups k k"],
    base: UnitGram,
    guess: Modulus,
    programs: Programs,
    linear: Float[Tensor, "items k"],
) -> Float[Tensor, "items k"]:
    """Returns where items of other weights are likely to end, by the Gram matrix that most share."""
    shifted = grams * base.inverse[:, None] * base.inverse
    shifted.diagonal(dim1=1, dim2=2).add_(DAMPING)
    right = padded(programs, linear * base.inverse)
    y = torch.cholesky_solve(right.mT, torch.linalg.cholesky_ex(shifted)[0]).mT.flatten(0, 1)[programs.slot]
    return guess.minimizers((y @ base.gram + DAMPING * y).nan_to_num())


def scaled(grams: Float[Tensor, "groups n n"], inverse: Float[Tensor, "groups n"]) -> Float[Tensor, "groups n n"]:
    """Returns the inner products of columns multiplied by these numbers; 1 on the diagonal."""
    result = grams * inverse[:, :, None] * inverse[:, None, :]
    result.diagonal(dim1=1, dim2=2).fill_(1.0)
    return result
