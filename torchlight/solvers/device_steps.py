"""Non-negative least squares for many items in lockstep, where there is no compiled code: on a GPU.

Every item takes the steps of `active_set.minimize_nonnegative`, all of them together in operations of fixed shapes:
which columns come in, which point of the path is best and whether an item has ended are tensors that the host never
reads. It waits once in `STEPS_PER_CHECK` steps, to leave out the items that have ended and to make room.

    w = c - G x - ridge x                                            negative gradient, of all items
    F = the columns with x > 0 and a few of largest w                padded to `room` places
    H = (G + ridge 1)_FF, an identity in the padding                 [items, room, room]
    d = H^-1 w_F                                                     batched Cholesky
    x_F <- the best of a few max(0, x_F + t d)                       t = 1, 1/2, ..., and to the first bound
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchlight.solvers.active_set import AT_BOUND, FEW, SMALLEST_SHIFT, STEP_LENGTHS, Limits

STEPS_PER_CHECK = 8
LEAST_ROOM = 32
ENTRIES_PER_CALL = 2**26  # of the blocks that are factored together: 512 MiB


@dataclass(frozen=True, eq=False)
class Programs:
    """Minimise x'Gx/2 - c'x + ridge |x|^2/2 over x >= 0, for every item.

    Attributes:
        grams: G of every group of items, unit diagonal.
        group: which of them an item has.
        slot: the item's place where every group has as many: group x most + number within the group.
        most: items that a group has.
        linear: c, of order one.
    """

    grams: Float[Tensor, "groups n n"]
    group: Int[Tensor, " items"]
    slot: Int[Tensor, " items"]
    most: int
    linear: Float[Tensor, "items n"]


@dataclass(frozen=True, eq=False)
class Rules:
    """How steps are taken.

    Attributes:
        ridge: at least 0.
        limits: when to stop.
        lengths: of the path that are tried; on the device, where a step would otherwise have to send for them.
    """

    ridge: float
    limits: Limits
    lengths: Float[Tensor, " lengths"]


@dataclass(frozen=True, eq=False)
class State:
    """How far the items have come.

    Attributes:
        x: at least 0.
        w: c - G x - ridge x, brought up to date by every move: made afresh it would never be quiet.
        entrants: how many columns may come in with the next step.
        single_failed: whether letting a single column in has not helped.
        shift: what the diagonal needs beyond the ridge for a factor.
        ended: whether the item is left alone from now on.
        steps: taken.
    """

    x: Float[Tensor, "items n"]
    w: Float[Tensor, "items n"]
    entrants: Int[Tensor, " items"]
    single_failed: Bool[Tensor, " items"]
    shift: Float[Tensor, " items"]
    ended: Bool[Tensor, " items"]
    steps: Int[Tensor, " items"]


def alike(gram: Float[Tensor, "n n"], linear: Float[Tensor, "items n"]) -> Programs:
    """Returns the programs of items that share their Gram matrix."""
    item = torch.arange(linear.shape[0], device=linear.device)
    return Programs(gram[None], torch.zeros_like(item), item, linear.shape[0], linear)


def minimizers(
    programs: Programs, start: Float[Tensor, "items n"], ridge: float, limits: Limits
) -> tuple[Float[Tensor, "items n"], Int[Tensor, " items"]]:
    """Returns the minimiser and the number of steps of every item.

    Args:
        programs: what to minimise.
        start: x >= 0 to begin from.
        ridge: at least 0.
        limits: when to stop.
    """
    if start.shape[1] == 0:
        return start, torch.zeros_like(start.sum(dim=1), dtype=torch.int64)
    rules = Rules(ridge, limits, torch.tensor(STEP_LENGTHS, dtype=start.dtype, device=start.device))
    state = beginning(programs, start, rules)
    while True:
        # the one place where the host waits
        counts = torch.where(state.ended, -1, (state.x > 0).sum(dim=1)).tolist()
        going = False
        for items, room in parts_of(counts, start.shape[1]):
            going = True
            index = torch.tensor(items, device=start.device)
            put(state, index, stepped(some_programs(programs, index), some_state(state, index), room, rules))
        if not going:
            return state.x, state.steps


def beginning(programs: Programs, start: Float[Tensor, "items n"], rules: Rules) -> State:
    """Returns the state before the first step."""
    none = torch.zeros_like(start[:, 0], dtype=torch.int64)
    return State(
        x=start.clone(),
        w=programs.linear - product(programs, start) - rules.ridge * start,
        entrants=none + min(rules.limits.most_entrants, FEW),
        single_failed=none > 0,
        shift=none + max(0.0, SMALLEST_SHIFT - rules.ridge),
        ended=none > 0,
        steps=none,
    )


def parts_of(counts: list[int], columns: int) -> Iterator[tuple[list[int], int]]:
    """Yields items that have not ended, those with as many columns in use together, and the room that these get."""
    waiting = sorted((count, item) for item, count in enumerate(counts) if count >= 0)
    while waiting:
        taken = 1
        while taken < len(waiting) and (taken + 1) * room_for(waiting[taken][0], columns) ** 2 <= ENTRIES_PER_CALL:
            taken += 1
        yield [item for _, item in waiting[:taken]], room_for(waiting[taken - 1][0], columns)
        waiting = waiting[taken:]


def room_for(count: int, columns: int) -> int:
    """Returns places enough for the columns in use and for those that come in until the next check."""
    wanted = count + max(LEAST_ROOM, count // 2)
    return min(columns, -(-wanted // LEAST_ROOM) * LEAST_ROOM)


def some_programs(programs: Programs, index: Int[Tensor, " k"]) -> Programs:
    """Returns the programs of some items."""
    group, slot, linear = programs.group[index], programs.slot[index], programs.linear[index]
    return Programs(programs.grams, group, slot, programs.most, linear)


def some_state(state: State, index: Int[Tensor, " k"]) -> State:
    """Returns the state of some items."""
    return State(**{field.name: getattr(state, field.name)[index] for field in fields(State)})


def put(state: State, index: Int[Tensor, " k"], part: State) -> None:
    """Writes the state of some items into that of all, in place."""
    for field in fields(State):
        getattr(state, field.name)[index] = getattr(part, field.name)


def stepped(programs: Programs, state: State, room: int, rules: Rules) -> State:
    """Returns the state `STEPS_PER_CHECK` steps later; the host is asked nothing."""
    for _ in range(STEPS_PER_CHECK):
        state = step(programs, state, room, rules)
    return state


def step(programs: Programs, state: State, room: int, rules: Rules) -> State:
    """Returns the state after one step of every item that has not ended."""
    x, w, free, limits = state.x, state.w, state.x > 0, rules.limits
    violation = torch.where(free, w.abs(), w.clamp(min=0)).amax(dim=1)
    ended = state.ended | (violation <= limits.tolerance) | (state.steps >= limits.max_steps)
    left = room - free.sum(dim=1)
    index, wanted = with_entrants(free, w, torch.minimum(state.entrants, left), room)
    here, slope = (torch.where(wanted, part.gather(1, index), 0.0) for part in (x, w))
    move, gain, sound = best_moves(blocks(programs, index, wanted, rules.ridge), here, slope, state.shift, rules)
    gained = (gain > 0) & sound & ~ended
    move = torch.where(gained[:, None], move, 0.0)
    moved = torch.zeros_like(x).scatter(1, index, move)
    entrants, single_failed, stalled = next_entrants(state, gained, wanted.sum(dim=1), limits)
    # without a factor, or without room for all that should come in, a step that gains nothing says nothing
    tells = gained | sound & ((state.entrants <= left) | (room == x.shape[1]))
    return State(
        x=x.scatter(1, index, here + move),
        w=w - product(programs, moved) - rules.ridge * moved,
        entrants=torch.where(tells, entrants, state.entrants),
        single_failed=torch.where(tells, single_failed, state.single_failed),
        shift=next_shift(state.shift, sound, rules.ridge),
        ended=ended | stalled & tells,
        steps=state.steps + (~ended).to(state.steps),
    )


def next_entrants(
    state: State, gained: Bool[Tensor, " items"], wanted: Int[Tensor, " items"], limits: Limits
) -> tuple[Int[Tensor, " items"], Bool[Tensor, " items"], Bool[Tensor, " items"]]:
    """Returns how many columns may come in next, whether a single one has not helped, and whether nothing has."""
    now = state.entrants
    most = (FEW + wanted // 2).clamp(max=limits.most_entrants)
    after = torch.where(gained, torch.minimum(most, (2 * now).clamp(min=1)), torch.where(now > 0, now // 4, 1))
    failed = torch.where(now > 0, now == 1, state.single_failed)
    return after, failed & ~gained, (now == 0) & state.single_failed & ~gained


def next_shift(shift: Float[Tensor, " items"], sound: Bool[Tensor, " items"], ridge: float) -> Float[Tensor, " items"]:
    """Returns ten times the shift where the block had no factor, else a tenth of it down to where it began."""
    least = max(0.0, SMALLEST_SHIFT - ridge)
    smaller = torch.where(shift > SMALLEST_SHIFT, shift / 10, least)
    return torch.where(sound, smaller, (10 * shift).clamp(min=SMALLEST_SHIFT))


def product(programs: Programs, x: Float[Tensor, "items n"]) -> Float[Tensor, "items n"]:
    """Returns G x of every item."""
    if programs.grams.shape[0] == 1:
        return x @ programs.grams[0]
    return torch.bmm(padded(programs, x), programs.grams).flatten(0, 1)[programs.slot]


def padded(programs: Programs, x: Float[Tensor, "items n"]) -> Float[Tensor, "groups most n"]:
    """Returns the items' rows by groups, all of which get as many: zeros where a group has fewer items."""
    groups, most = programs.grams.shape[0], programs.most
    return x.new_zeros(groups * most, x.shape[1]).index_copy(0, programs.slot, x).unflatten(0, (groups, most))


def with_entrants(
    free: Bool[Tensor, "items n"], w: Float[Tensor, "items n"], entrants: Int[Tensor, " items"], room: int
) -> tuple[Int[Tensor, "items room"], Bool[Tensor, "items room"]]:
    """Returns `room` different columns per item, and which of them count: the free ones and those of largest w > 0."""
    order = torch.where(free, torch.inf, torch.where(w > 0, w, 0.0))
    promise, index = torch.topk(order, room, dim=1)
    place = torch.arange(room, device=w.device)
    return index, (promise > 0) & (place < (free.sum(dim=1) + entrants)[:, None])


def blocks(
    programs: Programs, index: Int[Tensor, "items room"], wanted: Bool[Tensor, "items room"], ridge: float
) -> Float[Tensor, "items room room"]:
    """Returns (G + ridge 1) of the columns that count, an identity elsewhere."""
    block = programs.grams[programs.group[:, None, None], index[:, :, None], index[:, None, :]]
    block = torch.where(wanted[:, :, None] & wanted[:, None, :], block, 0.0)
    block.diagonal(dim1=1, dim2=2).add_(torch.where(wanted, ridge, 1.0))
    return block


def best_moves(
    block: Float[Tensor, "items k k"],
    x: Float[Tensor, "items k"],
    w: Float[Tensor, "items k"],
    shift: Float[Tensor, " items"],
    rules: Rules,
) -> tuple[Float[Tensor, "items k"], Float[Tensor, " items"], Bool[Tensor, " items"]]:
    """Returns what `active_set.best_move` does for every item, and whether its block could be factored."""
    shifted = block.clone()
    shifted.diagonal(dim1=1, dim2=2).add_(shift[:, None])
    factor, failed = torch.linalg.cholesky_ex(shifted)
    direction = torch.cholesky_solve(w[..., None], factor)[..., 0]
    towards_bound = (direction < 0) & (x > 0)
    reach = torch.where(towards_bound, -x / direction, 1.0).amin(dim=1, keepdim=True).clamp(max=1.0)
    lengths = torch.cat([rules.lengths.expand(len(x), -1), reach], dim=1)
    ends = x[:, None] + lengths[..., None] * direction[:, None]
    moves = torch.where(ends <= AT_BOUND * x[:, None], 0.0, ends) - x[:, None]
    gains = (moves * w[:, None]).sum(dim=-1) - (torch.bmm(moves, block) * moves).sum(dim=-1) / 2
    best = gains.argmax(dim=1, keepdim=True)
    move = moves.gather(1, best[..., None].expand(-1, -1, x.shape[1]))[:, 0]
    return move, gains.gather(1, best)[:, 0], failed == 0
