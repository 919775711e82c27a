"""Crossings of lines, compiled: kept for each line of a grid, and sorted from left to right.

A crossing is one integer: its place, a positive number whose bits are in the order of the numbers, with its step in
the last three of them, 1e-15 of the place. So crossings are compared, moved and counted as integers.
"""

from __future__ import annotations

from typing import no_type_check

import numpy as np

from torchlight.compiled import compiled

ROOM = 32  # for the crossings of one line at first; doubled when it is not enough
INSERTED, COUNTED = 6, 64  # crossings of a line that are sorted by insertion; by counting
TOGETHER = 16  # crossings that are counted together
LAST = 2**63 - 1  # behind all of them


@compiled
@no_type_check
def empty_lists(lines):
    """Returns, for each line, room for its crossings, their number, and the sheets left of the grid."""
    return np.empty((lines, ROOM), np.int64), np.zeros(lines, np.int32), np.zeros(lines, np.int32)


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
def sort_many(line, count, crossings, packs):
    """Sorts the crossings of a line: some by counting, very many as Shell (1959) did; few are for `sort_every(1)`."""
    if count <= COUNTED:
        sort_by_counting(line, count, crossings, packs)
        return
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
def sort_by_counting(line, count, crossings, packs):
    """Sorts some crossings: each has as many before it as are less.

    Counting them needs no branch that would be hard to predict. Equal ones are alike: any of them may come first.
    """
    full = (count + TOGETHER - 1) // TOGETHER * TOGETHER
    for i in range(count):
        packs[0, i] = crossings[line, i]
        crossings[line, i] = LAST
    for i in range(count, full):
        packs[0, i] = LAST
    for i in range(count):
        crossing, rank = packs[0, i], 0
        for j in range(full):
            rank += int(packs[0, j] < crossing)
        while crossings[line, rank] != LAST:
            rank += 1
        crossings[line, rank] = crossing
