"""Non-negative least squares for many items whose columns are few enough for a Gram matrix of all of them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchlight.solvers.active_set import Limits
from torchlight.solvers.certificate import nonzero_norm
from torchlight.solvers.device_steps import alike, minimizers
from torchlight.solvers.filling import Filling, filling_of
from torchlight.solvers.modulus import Modulus, modulus_of
from torchlight.solvers.shared_gram import SharedGram, UnitGram, correlations, gram_under, scaled_to_unit, unit_gram
from torchlight.solvers.system import System, same_rows
from torchlight.threads import single_threaded_map

ITEMS_PER_TASK = 48
SMALL = 1024  # columns: a start by products pays for a single item up to here, and
ENOUGH = 8  # items: for these beyond
MOST_LACKING = 0.5  # of the columns: with more samples lacking, a factor of all columns costs less
ENOUGH_MASKS = 16  # photographs: for these the products that all masks share pay
DAMPING = 1e-5  # of the unit diagonal: what fills in the samples that a photograph lacks

Group = Int[Tensor, " _"]


@dataclass(frozen=True, eq=False)
class Batch:
    """What all tasks read.

    Attributes:
        system: the items.
        shared: the Gram matrix that most have.
        base: the same of columns scaled to norm 1.
        guess: rough minimisers under `base`; None where it costs more than it saves.
        filling: what photographs that lack samples share; None where few do.
        linear: A'W b / |b| of every item, of the columns of `shared`.
        ridge: weight of sum_j |a_j|^2 x_j^2 / 2.
        limits: when to stop.
    """

    system: System
    shared: SharedGram
    base: UnitGram
    guess: Modulus | None
    filling: Filling | None
    linear: Float[Tensor, "items k"]
    ridge: float
    limits: Limits


def batch_minimizers(
    system: System, shared: SharedGram, ridge: float, limits: Limits
) -> tuple[Float[Tensor, "items k"], Int[Tensor, " items"]]:
    """Returns the minimiser over x >= 0 of the columns in use, and the steps, of every item.

    The objective is |A x - b|^2 / 2 + ridge sum_j |a_j|^2 x_j^2 / 2 under each item's weights. Supports are guessed
    for many items at once, by the Gram matrix that most share (`modulus`); an exact method then ends each.
    """
    if system.targets.device.type != "cpu":
        from torchlight.solvers.device_nnls import lockstep_minimizers  # it takes from here what both share

        return lockstep_minimizers(system, shared, ridge, limits)
    size = nonzero_norm(system.targets)[:, None]
    linear = correlations(shared, system) / size
    base = unit_gram(shared.gram)
    worth_it = linear.shape[1] > 0 and (linear.shape[1] <= SMALL or linear.shape[0] >= ENOUGH)
    guess = modulus_of(base.gram) if worth_it else None
    many = system.root.shape[0] >= ENOUGH_MASKS
    filling = None if guess is None or not many else filling_of(shared.columns * base.inverse, guess, DAMPING)
    batch = Batch(system, shared, base, guess, filling, linear, ridge, limits)
    x = torch.zeros_like(linear)
    steps = torch.zeros(x.shape[0], dtype=torch.int64, device=x.device)

    def fill(groups: list[Group]) -> None:
        for items, found, spent in solved(batch, groups):
            x[items], steps[items] = found * size[items], spent

    for _ in single_threaded_map(fill, tasks(system)):
        pass
    return x, steps


def tasks(system: System) -> list[list[Group]]:
    """Returns groups of items with equal weights, collected to some 48 items."""
    if system.root.shape[0] == 1:
        everything = torch.arange(system.targets.shape[0], device=system.root.device)
        return [[part] for part in everything.split(ITEMS_PER_TASK)]
    return list(collected(part for items in same_rows(system.root) for part in items.split(ITEMS_PER_TASK)))


def collected(groups: Iterable[Group]) -> Iterator[list[Group]]:
    """Yields lists of groups that hold at most 48 items together."""
    some: list[Group] = []
    for group in groups:
        if some and sum(len(one) for one in some) + len(group) > ITEMS_PER_TASK:
            yield some
            some = []
        some.append(group)
    if some:
        yield some


def solved(
    batch: Batch, groups: list[Group]
) -> Iterator[tuple[Group, Float[Tensor, "items k"], Int[Tensor, " items"]]]:
    """Yields the items, their minimisers for |b| = 1 and their steps, group by group."""
    owns = [own_gram(batch, group) for group in groups]
    starts = guessed(batch, groups, owns).split([len(group) for group in groups])
    for group, own, start in zip(groups, owns, starts, strict=True):
        found, spent = minimize(own, batch.linear[group] * own.inverse, start, batch.ridge, batch.limits)
        yield group, found * own.inverse / batch.shared.norms, spent


def own_gram(batch: Batch, group: Group) -> UnitGram:
    """Returns the Gram matrix under the weights of a group."""
    if batch.system.root.shape[0] == 1:
        return batch.base
    gram = gram_under(batch.shared, batch.system.root[group[0]].square())
    return batch.base if gram is batch.shared.gram else scaled_to_unit(gram)


def guessed(batch: Batch, groups: list[Group], owns: list[UnitGram]) -> Float[Tensor, "items k"]:
    """Returns where the items are likely to end, from the Gram matrix that most share.

    An item of other weights, with the Gram matrix H, is taken for the photograph that samples where others do. Those
    that it lacks are filled in with what damped least squares y = (H + d 1)^-1 c predicts of them: c becomes
    c + (G - H) y, which is (G + d 1) y.
    """
    linear = batch.linear[torch.cat(groups)] * batch.base.inverse
    if batch.guess is None:
        return torch.zeros_like(linear)
    for own, group, c in zip(owns, groups, linear.split([len(group) for group in groups]), strict=True):
        if own is not batch.base:
            y = damped(batch, group, own, c)
            c.copy_(y @ batch.base.gram + DAMPING * y)
    start = torch.zeros_like(linear)
    lit = (linear > 0).any(dim=1)
    if bool(lit.any()):
        start[lit] = batch.guess.minimizers(linear[lit])
    return start


def damped(batch: Batch, group: Group, own: UnitGram, linear: Float[Tensor, "items k"]) -> Float[Tensor, "items k"]:
    """Returns (H + d 1)^-1 c of every item of a group, by the samples that it lacks where they are few."""
    change = batch.system.root[group[0]].square() - batch.shared.weights
    lacking = change.nonzero()[:, 0]
    few = lacking.shape[0] <= MOST_LACKING * linear.shape[1]
    if batch.filling is not None and few and bool((change <= 0).all()):
        return batch.filling.damped(lacking, -change[lacking], linear)
    scale = own.norms * batch.base.inverse
    return solved_directly(own.gram * scale[:, None] * scale, linear)


def solved_directly(gram: Float[Tensor, "k k"], linear: Float[Tensor, "items k"]) -> Float[Tensor, "items k"]:
    """Returns (H + d 1)^-1 c of every row: in compiled code on a CPU."""
    if gram.device.type == "cpu":
        from torchlight.solvers.factor_kernel import solve_items  # numba is imported only where it is used

        x = torch.empty_like(linear)
        solve_items(gram.numpy(), linear.numpy(), DAMPING, x.numpy())
        return x
    shifted = gram + DAMPING * torch.eye(gram.shape[0], dtype=gram.dtype, device=gram.device)
    return torch.cholesky_solve(linear.T, torch.linalg.cholesky(shifted)).T


def minimize(
    unit: UnitGram,
    linear: Float[Tensor, "items k"],
    start: Float[Tensor, "items k"],
    ridge: float,
    limits: Limits,
    cosine: float = 0.0,
) -> tuple[Float[Tensor, "items k"], Int[Tensor, " items"]]:
    """Returns the minimisers of x'Gx/2 - c'x + ridge |x|^2/2 over x >= 0, and the steps.

    On a CPU by compiled code, item by item, where a `cosine` above 0 lets an item of |b| = 1 end early
    (`nnls_kernel.minimize_items`); elsewhere all items in lockstep.
    """
    if linear.device.type == "cpu":
        from torchlight.solvers.nnls_kernel import minimize_items

        x, steps = start.clone(memory_format=torch.contiguous_format), torch.zeros(len(start), dtype=torch.int64)
        gram, c = unit.gram.contiguous(), linear.contiguous()
        most = limits.max_steps
        minimize_items(gram.numpy(), c.numpy(), ridge, limits.tolerance, cosine, most, x.numpy(), steps.numpy())
        return x, steps
    return minimizers(alike(unit.gram, linear), start, ridge, limits)
