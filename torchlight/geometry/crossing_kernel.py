"""Crossings of lines, compiled: kept for each line of a grid, and turned into the ends of hidden intervals.

A crossing is one integer: its place, a positive number whose bits are in the order of the numbers, with its step in
the last three of them, 1e-15 of the place. So crossings are compared, moved and counted as integers.

The state of a line is one integer too: how many crossings it has, and 2^32 times the number of sheets left of the grid.
"""

from __future__ import annotations

from typing import no_type_check

import numpy as np

from torchlight.compiled import compiled

INSERTED, MANY = 6, 64  # crossings of a line that are sorted by insertion; that are compared with each other
TOGETHER = 8  # crossings that are compared together
RANK = 2**16  # steps add up in the lower half of 32 bits, ranks in the upper half
LAST = 2**31 - 1  # behind all places


@compiled
@no_type_check
def longer(crossings, counts):
    """Returns the same crossings with twice the room."""
    lines, room = crossings.shape
    result = np.empty((lines, 2 * room), crossings.dtype)
    for line in range(lines):
        for k in range(counts[line]):
            result[line, k] = crossings[line, k]
    return result


@compiled
@no_type_check
def packed(place, step):
    """Returns a place > 0 and a step of -2 to 2 there as one integer, in the order of the places."""
    return (np.float64(place).view(np.int64) & ~np.int64(7)) | np.int64(4 - step)


@compiled
@no_type_check
def place_of(crossing):
    """Returns the place of a crossing."""
    return np.int64(crossing & ~np.int64(7)).view(np.float64)


@compiled
@no_type_check
def step_of(crossing):
    """Returns the step of a crossing."""
    return 4 - (crossing & np.int64(7))


@compiled
@no_type_check
def limit_of(columns):
    """Returns the crossing that is behind all places on the grid, as a number without a sign."""
    return np.uint64(packed(np.float64(columns), np.int64(4)))


@compiled
@no_type_check
def sort(line, count, crossings):
    """Sorts the crossings of a line as Shell (1959) did."""
    gap = 1
    while 9 * gap < count:
        gap = 3 * gap + 1
    while gap > 0:
        sort_every(gap, line, count, crossings)
        gap //= 3


@compiled
@no_type_check
def sort_every(gap, line, count, crossings):
    """Sorts those crossings of a line that are a gap apart, by insertion."""
    for i in range(gap, count):
        crossing, j = crossings[line, i], i - gap
        while j >= 0 and crossings[line, j] > crossing:
            crossings[line, j + gap] = crossings[line, j]
            j -= gap
        crossings[line, j + gap] = crossing


@compiled
@no_type_check
def add_end(differences, row, place, weight):
    """Adds one end of a hidden interval to the differences of a row: `weight` for all that lies right of it."""
    column = np.uint32(place)
    part = np.int64(np.rint(weight * (column + 1 - place)))
    differences[row, column] += part
    differences[row, column + np.uint32(1)] += weight - part


@compiled
@no_type_check
def add_unsorted(crossings, line, count, sheets, row, weight, scratch, fineness, differences):
    """Adds the ends of a line's hidden intervals to the differences of its row, without sorting its crossings.

    The sheets left of a crossing are those left of the grid and the steps of all crossings before it, whose number is
    its rank. Both are one sum over all crossings, as vector code. Places are compared as integers of 31 bits; where two
    are equal, the ranks do not add up to those of a sequence, nothing is added and False returned.

    Args:
        scratch: for the places, the steps with 2^16 each, the sums and the ends, [4, 64].
        fineness: 2^31 - 1 over the number of columns.
    """
    if count > MANY:
        return False
    full = np.uint64((count + TOGETHER - 1) // TOGETHER * TOGETHER)
    for i in range(np.uint64(count)):
        crossing = crossings[line, i]
        scratch[0, i] = np.int32(place_of(crossing) * fineness)
        scratch[1, i] = np.int32(RANK + step_of(crossing))
    for i in range(np.uint64(count), full):
        scratch[0, i], scratch[1, i] = LAST, 0
    for i in range(full):
        scratch[2, i] = sheets
    for j in range(np.uint64(0), full, np.uint64(TOGETHER)):
        add_steps(scratch, j, full)
    found, ranks = np.uint32(0), 0
    for i in range(np.uint64(count)):
        total = scratch[2, i]
        ranks += np.int64(total + RANK // 2) >> 16
        scratch[3, found] = i
        hidden, then = (total & (RANK - 1)) != 0, ((total + scratch[1, i]) & (RANK - 1)) != 0
        found = np.uint32(found + np.uint32(hidden != then))
    if ranks != count * (count - 1) // 2:
        return False
    for k in range(found):
        i = np.uint32(scratch[3, k])
        begins = (scratch[2, i] & (RANK - 1)) == 0
        add_end(differences, row, place_of(crossings[line, i]), weight if begins else -weight)
    return True


@compiled
@no_type_check
def add_steps(scratch, j, full):
    """Adds the steps of eight crossings to the sums of all that are behind them.

    The eight are scalars, so that the loop over all crossings becomes vector code.
    """
    one, two, three, four = np.uint64(j + 1), np.uint64(j + 2), np.uint64(j + 3), np.uint64(j + 4)
    five, six, seven, none = np.uint64(j + 5), np.uint64(j + 6), np.uint64(j + 7), np.int32(0)
    k0, k1, k2, k3 = scratch[0, j], scratch[0, one], scratch[0, two], scratch[0, three]
    k4, k5, k6, k7 = scratch[0, four], scratch[0, five], scratch[0, six], scratch[0, seven]
    t0, t1, t2, t3 = scratch[1, j], scratch[1, one], scratch[1, two], scratch[1, three]
    t4, t5, t6, t7 = scratch[1, four], scratch[1, five], scratch[1, six], scratch[1, seven]
    for i in range(full):
        k, s = scratch[0, i], scratch[2, i]
        s = np.int32(s + (t0 if k0 < k else none))
        s = np.int32(s + (t1 if k1 < k else none))
        s = np.int32(s + (t2 if k2 < k else none))
        s = np.int32(s + (t3 if k3 < k else none))
        s = np.int32(s + (t4 if k4 < k else none))
        s = np.int32(s + (t5 if k5 < k else none))
        s = np.int32(s + (t6 if k6 < k else none))
        s = np.int32(s + (t7 if k7 < k else none))
        scratch[2, i] = s
