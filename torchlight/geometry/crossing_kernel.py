"""Crossings of lines, compiled: kept for each line of a grid, and turned into the ends of hidden intervals.

A crossing is one integer: its place, a positive number whose bits are in the order of the numbers, with its step in
the last three of them, 1e-15 of the place. So crossings are compared, moved and counted as integers.

The state of a line is one integer too: how many crossings it has, and 2^32 times the sheets left of the grid.
"""

from __future__ import annotations

from typing import no_type_check

import numpy as np

from torchlight.compiled import compiled

ROOM = 32  # for the crossings of one line at first; doubled when it is not enough
INSERTED, MANY = 6, 64  # crossings of a line that are sorted; that are compared with each other; more are sorted again
TOGETHER = 8  # crossings that are compared together
RANK = 2**16  # sums of steps are kept in the lower half of 32 bits, ranks in the upper half
LAST = 2**31 - 1  # behind all places


@compiled
@no_type_check
def empty_lists(lines):
    """Returns, for each line, room for its crossings, and its state."""
    return np.empty((lines, ROOM), np.int64), np.zeros(lines, np.int64)


@compiled
@no_type_check
def longer(crossings, states):
    """Returns the same crossings with twice the room."""
    lines, room = crossings.shape
    result = np.empty((lines, 2 * room), crossings.dtype)
    for line in range(lines):
        for k in range(count_of(states[line])):
            result[line, k] = crossings[line, k]
    return result


@compiled
@no_type_check
def count_of(state):
    """Returns the number of crossings of a line."""
    return np.int64(np.uint32(state))


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
def add_line(crossings, line, count, sheets, row, weight, scratch, fine, differences):
    """Adds the hidden intervals of a line to the differences of its row."""
    if sheets != 0:
        differences[row, 0] += weight
    if count > INSERTED:
        if count <= MANY and add_unsorted(crossings, line, count, sheets, row, weight, scratch, fine, differences):
            return
        gap = 1
        while 9 * gap < count:
            gap = 3 * gap + 1
        while gap > 1:
            sort_every(gap, line, count, crossings)
            gap //= 3
    sort_every(1, line, count, crossings)
    for k in range(count):
        crossing, was = crossings[line, k], sheets
        sheets += step_of(crossing)
        if was == 0 and sheets != 0:
            add_end(differences, row, place_of(crossing), weight)
        elif was != 0 and sheets == 0:
            add_end(differences, row, place_of(crossing), -weight)


@compiled
@no_type_check
def sort_every(gap, line, count, crossings):
    """Sorts those crossings of a line that are a gap apart, by insertion; for gap after gap as Shell (1959) did."""
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
def add_unsorted(crossings, line, count, sheets, row, weight, scratch, fine, differences):
    full, start = (count + TOGETHER - 1) // TOGETHER * TOGETHER, np.int32(sheets)
    for i in range(np.uint64(count)):
        crossing = crossings[line, i]
        scratch[0, i] = np.int32(place_of(crossing) * fine)
        scratch[1, i] = np.int32(RANK + 4 - (crossing & np.int64(7)))
    for i in range(np.uint64(count), np.uint64(full)):
        scratch[0, i] = LAST
        scratch[1, i] = 0
    for i in range(np.uint64(full)):
        scratch[2, i] = start
    for j in range(0, full, TOGETHER):
        add_steps(scratch, np.uint64(j), np.uint64(full))
    found, ranks = np.uint64(0), 0
    for i in range(np.uint64(count)):
        total = scratch[2, i]
        ranks += np.int64(total + RANK // 2) >> 16
        scratch[3, found] = i
        found += np.uint64(((total & (RANK - 1)) == 0) != (((total + scratch[1, i]) & (RANK - 1)) == 0))
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
    zero = np.int32(0)
    one, two, three, four = np.uint64(1), np.uint64(2), np.uint64(3), np.uint64(4)
    five, six, seven = np.uint64(5), np.uint64(6), np.uint64(7)
    k0, k1, k2, k3 = scratch[0, j], scratch[0, j + one], scratch[0, j + two], scratch[0, j + three]
    k4, k5, k6, k7 = scratch[0, j + four], scratch[0, j + five], scratch[0, j + six], scratch[0, j + seven]
    t0, t1, t2, t3 = scratch[1, j], scratch[1, j + one], scratch[1, j + two], scratch[1, j + three]
    t4, t5, t6, t7 = scratch[1, j + four], scratch[1, j + five], scratch[1, j + six], scratch[1, j + seven]
    for i in range(full):
        k, s = scratch[0, i], scratch[2, i]
        s = np.int32(s + (t0 if k0 < k else zero))
        s = np.int32(s + (t1 if k1 < k else zero))
        s = np.int32(s + (t2 if k2 < k else zero))
        s = np.int32(s + (t3 if k3 < k else zero))
        s = np.int32(s + (t4 if k4 < k else zero))
        s = np.int32(s + (t5 if k5 < k else zero))
        s = np.int32(s + (t6 if k6 < k else zero))
        s = np.int32(s + (t7 if k7 < k else zero))
        scratch[2, i] = s
