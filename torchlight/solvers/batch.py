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
from torchlight.solvers.filling import Filling, Lacking, filling_of
from torchlight.solvers.modulus import Modulus, modulus_of
from torchlight.solvers.shared_gram import SharedGram, UnitGram, correlations, unit_gram, unit_gram_under
from torchlight.solvers.system import System, same_rows
from torchlight.threads import single_threaded_map

ITEMS_PER_TASK = 48
SMALL = 1024  # columns: a start by products pays for a single item up to here, and
ENOUGH = 8  # items: for these beyond
MOST_LACKING = 0.5  # of the columns: with more samples lacking, a factor of all columns costs less
ENOUGH_MASKS = 16  # photographs: for these the products that all masks share pay
NEAR = 1e-3  # of the tolerance, for items whose Gram matrix rounds by their company: 1e-14, far below a ridge of 1e-12
DAMPING = 3e-5  # of the unit diagonal: what fills in the samples that a photograph lacks

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
    alike = equal_weights(system)
    fills = guess is not None and fill_pays(system, shared, alike)
    filling = filling_of(shared.columns * base.inverse, guess, DAMPING) if guess is not None and fills else None
    batch = Batch(system, shared, base, guess, filling, linear, ridge, limits)
    x = torch.zeros_like(linear)
    steps = torch.zeros(x.shape[0], dtype=torch.int64, device=x.device)

    def fill(groups: list[Group]) -> None:
        for items, found, spent in solved(batch, groups):
            x[items], steps[items] = found * size[items], spent

    for _ in single_threaded_map(fill, tasks(alike)):
        pass
    return x, steps


def fill_pays(system: System, shared: SharedGram, alike: list[Group]) -> bool:
    """Returns whether so many photographs lack few samples that what they share is worth its products."""
    if len(alike) < ENOUGH_MASKS:
        return False
    few = (lacking_of(shared, system.root[items[0]].square(), len(items)) for items in alike)
    return sum(lacking is not None for lacking in few) >= ENOUGH_MASKS


def equal_weights(system: System) -> list[Group]:
    """Returns the items, those of equal weights together."""
    if system.root.shape[0] == 1:
        return [torch.arange(system.targets.shape[0], device=system.root.device)]
    return same_rows(system.root)


def tasks(alike: list[Group]) -> list[list[Group]]:
    """Returns groups of items with equal weights, collected to some 48 items."""
    return list(collected(part for items in alike for part in items.split(ITEMS_PER_TASK)))


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
    """Yields the items, their minimisers for |b| = 1 and their steps, group by group.

    A Gram matrix that the guess does not need is made just before its use: its memory is the last one's.
    """
    lacking = [lacking_of_group(batch, group) for group in groups]
    owns = [None if filled else own_gram(batch, group) for group, filled in zip(groups, lacking, strict=True)]
    starts = guessed(batch, groups, lacking, owns).split([len(group) for group in groups])
    for number, (group, start) in enumerate(zip(groups, starts, strict=True)):
        own = owns[number] or own_gram(batch, group)
        near = 0.0 if own is batch.base else NEAR * batch.limits.tolerance
        linear = batch.linear[group] * own.inverse
        found, spent = minimize(own, linear, start, batch.ridge, batch.limits, near=near)
        owns[number] = None
        yield group, found * own.inverse / batch.shared.norms, spent


def own_gram(batch: Batch, group: Group) -> UnitGram:
    """Returns the Gram matrix under the weights of a group."""
    if batch.system.root.shape[0] == 1:
        return batch.base
    own = unit_gram_under(batch.shared, batch.system.root[group[0]].square())
    return batch.base if own is None else own


def guessed(
    batch: Batch, groups: list[Group], lacking: list[Lacking | None], owns: list[UnitGram | None]
) -> Float[Tensor, "items k"]:
    """Returns where the items are likely to end, from the Gram matrix that most share.

    An item of other weights, with the Gram matrix H, is taken for the photograph that samples where others do. Those
    that it lacks are filled in with what damped least squares y = (H + d 1)^-1 c predicts of them: c becomes
    c + (G - H) y, which is (G + d 1) y.
    """
    linear = batch.linear[torch.cat(groups)] * batch.base.inverse
    start = torch.zeros_like(linear)
    if batch.guess is None:
        return start
    others = torch.tensor([own is not batch.base for own, group in zip(owns, groups, strict=True) for _ in group])
    if bool(others.any()):
        y = damped(batch, groups, lacking, owns, linear)[others]
        linear[others] = y @ batch.base.gram + DAMPING * y
    lit = (linear > 0).any(dim=1)
    if bool(lit.any()):
        start[lit] = batch.guess.minimizers(linear[lit])
    return start


def damped(
    batch: Batch,
    groups: list[Group],
    lacking: list[Lacking | None],
    owns: list[UnitGram | None],
    linear: Float[Tensor, "items k"],
) -> Float[Tensor, "items k"]:
    """Returns (H + d 1)^-1 c of every item of other weights than most, by the samples it lacks where they are few."""
    y = torch.zeros_like(linear)
    filled: list[Lacking] = []
    places: list[Tensor] = []
    for own, lacks, place in zip(owns, lacking, places_of(groups), strict=True):
        if lacks is not None:
            filled.append(lacks)
            places.append(place)
        elif own is not None and own is not batch.base:
            y[place] = solved_directly(own, batch.base, linear[place])
    if batch.filling is not None and filled:
        place = torch.cat(places)
        y[place] = batch.filling.damped(filled, linear[place])
    return y


def places_of(groups: list[Group]) -> Iterable[Tensor]:
    """Returns where the items of each group are if one group follows another."""
    sizes = [len(group) for group in groups]
    return torch.arange(sum(sizes)).split(sizes)


def lacking_of_group(batch: Batch, group: Group) -> Lacking | None:
    """Returns what is to be filled in by the samples that a group lacks; None where it is not, or there is nothing."""
    if batch.filling is None:
        return None
    return lacking_of(batch.shared, batch.system.root[group[0]].square(), len(group))


def lacking_of(shared: SharedGram, weights: Float[Tensor, " points"], items: int) -> Lacking | None:
    """Returns what items of these weights lack; None where that is nothing, or much, or where they have more."""
    change = weights - shared.weights
    samples = change.nonzero()[:, 0]
    few = 0 < samples.shape[0] <= MOST_LACKING * shared.columns.shape[1]
    return Lacking(items, samples, -change[samples]) if few and bool((change <= 0).all()) else None


def solved_directly(own: UnitGram, base: UnitGram, linear: Float[Tensor, "items k"]) -> Float[Tensor, "items k"]:
    """Returns (H + d 1)^-1 c of every row, H = S G S with G the items' own matrix of unit diagonal.

    It is S^-1 (G + d S^-2)^-1 S^-1 c; a column that the items do not see gets 0.
    """
    from torchlight.solvers.factor_kernel import solve_items  # numba is imported only where it is used

    scale = own.norms * base.inverse
    smaller = torch.where(scale > 0, 1 / scale, 0.0)
    x = torch.empty_like(linear)
    solve_items(own.gram.numpy(), (DAMPING * smaller.square()).numpy(), (linear * smaller).numpy(), x.numpy())
    return x * smaller


def minimize(
    unit: UnitGram,
    linear: Float[Tensor, "items k"],
    start: Float[Tensor, "items k"],
    ridge: float,
    limits: Limits,
    cosine: float = 0.0,
    near: float = 0.0,
) -> tuple[Float[Tensor, "items k"], Int[Tensor, " items"]]:
    """Returns the minimisers of x'Gx/2 - c'x + ridge |x|^2/2 over x >= 0, and the steps.

    On a CPU by compiled code, item by item, where a `cosine` above 0 lets an item of |b| = 1 end early and a `near`
    above 0 spares the last factor (`nnls_kernel.minimize_items`); elsewhere all items in lockstep.
    """
    if linear.device.type == "cpu":
        from torchlight.solvers.nnls_kernel import minimize_items

        x, steps = start.clone(memory_format=torch.contiguous_format), torch.zeros(len(start), dtype=torch.int64)
        gram, c = unit.gram.contiguous(), linear.contiguous()
        most, tolerance = limits.max_steps, limits.tolerance
        minimize_items(gram.numpy(), c.numpy(), ridge, tolerance, cosine, near, most, x.numpy(), steps.numpy())
        return x, steps
    return minimizers(alike(unit.gram, linear), start, ridge, limits)
