"""Where contours cross the lines of a grid in one direction, compiled.

Most edges of a fine mesh are shorter than the distance of two lines. So all of a table's edges are looked at together,
as vector code without a branch, the crossing of the first line included; what meets a line is picked out afterwards,
and noted. A few hundred edges at a time stay in the nearest cache all the way.

What may turn is looked at in float32 first. Only what may be a contour and meet a line as far as float32 tells, about
one edge of ten, is asked in float64, where the facing of a face comes out equal to the bit wherever it is needed.
"""

from __future__ import annotations

from typing import no_type_check

import numpy as np

from torchlight.compiled import compiled
from torchlight.geometry.crossing_kernel import packed, place_of, step_of
from torchlight.geometry.narrowing_kernel import NONE, ROUNDING, SLACK

AT_ONCE = 256  # edges


@compiled
@no_type_check
def first_crossing(y0, z0, y1, z1, x0, x1, n, x, y, shift, lines):
    """Returns the first line that an edge crosses, on how many it does, the crossing there, and columns per line.

    A line y = k + shift is crossed by an edge with one end below it and the other not, at x = x0 + (k - t0) slope.
    """
    t0, t1 = y0 - y * z0 - shift, y1 - y * z1 - shift
    a, b = x0 - x * z0, x1 - x * z1
    first = max(np.ceil(min(t0, t1)), 0.0)
    last = min(np.ceil(max(t0, t1)), lines)
    slope = np.divide(b - a, t1 - t0)
    return first, max(last - first, 0.0), packed(a + (first - t0) * slope, np.int64(-n if t0 < t1 else n)), slope


@compiled
@no_type_check
def find_known(known, begin, end, x, y, shift, lines, hits, first, packs, inclines):
    """Writes the first crossings of some known contours, and which of them meet a line; returns their number."""
    for e in range(begin, end):
        line, span, pack, slope = first_crossing(
            known[0, e], known[1, e], known[2, e], known[3, e], known[4, e], known[5, e], known[6, e],
            x, y, shift, lines,
        )  # fmt: skip
        i = e - begin
        first[0, i], first[1, i], packs[i], inclines[i] = np.int32(line), np.int32(span), pack, slope
    return pick(first, end - begin, hits)


@compiled
@no_type_check
def pick(first, count, hits):
    """Writes which edges meet a line, without a branch: it would be hard to predict."""
    found = np.uint32(0)
    for i in range(count):
        hits[found] = i
        found = np.uint32(found + np.uint32(first[1, i] != 0))
    return found


@compiled
@no_type_check
def may_meet(turning, begin, end, x, y, shift, lines, slack, doubt, first):
    """Writes 1 where an edge may be a contour that meets a line in one direction, as far as float32 tells, else 0."""
    x, y, shift, lines = np.float32(x), np.float32(y), np.float32(shift), np.float32(lines)
    slack, doubt = np.float32(slack), np.float32(doubt)
    for e in range(begin, end):
        one = turning[4, e] * x + turning[5, e] * y + turning[6, e]
        two = turning[7, e] * x + turning[8, e] * y + turning[9, e]
        side_one, side_two = turning[10, e], turning[11, e]
        n = (side_one if one > NONE else -side_one) + (side_two if two > NONE else -side_two)
        t0 = turning[0, e] - y * turning[1, e] - shift
        t1 = turning[2, e] - y * turning[3, e] - shift
        low = max(np.ceil(min(t0, t1) - slack), NONE)
        high = min(np.ceil(max(t0, t1) + slack), lines)
        first[1, e - begin] = np.int32((low < high) & ((n != NONE) | (min(abs(one), abs(two)) <= doubt)))


@compiled
@no_type_check
def find_turning(turning, places, begin, end, near, x, y, shift, lines, slack, doubt, hits, first, packs, inclines):
    """Writes the first crossings of some edges that may turn, and which are contours and meet a line.

    What faces away from the light (or is seen edge-on) counts negative.
    """
    may_meet(turning, begin, end, x, y, shift, lines, slack, doubt, first)
    found, kept = pick(first, end - begin, hits), np.uint32(0)
    for hit in range(found):
        i = hits[hit]
        e = places[begin + i]
        one = near[e, 6] * x + near[e, 7] * y + near[e, 8]
        two = near[e, 9] * x + near[e, 10] * y + near[e, 11]
        side_one, side_two = near[e, 12], near[e, 13]
        n = (side_one if one > 0.0 else -side_one) + (side_two if two > 0.0 else -side_two)
        line, span, pack, slope = first_crossing(
            near[e, 1], near[e, 2], near[e, 4], near[e, 5], near[e, 0], near[e, 3], n, x, y, shift, lines
        )
        first[0, i], first[1, i], packs[i], inclines[i] = np.int32(line), np.int32(span), pack, slope
        hits[kept] = i
        kept = np.uint32(kept + np.uint32((n != 0.0) & (span != 0.0)))
    return kept


@compiled
@no_type_check
def note(crossings, states, line, pack, limit):
    """Notes a crossing; returns how many its line has.

    Crossings right of the grid are dropped, those left of it only counted; both without a branch, which would be hard
    to predict: a crossing that does not count is written over by the next. The bits of a negative place are those of a
    negative number, or of a large one without a sign.
    """
    state = states[line]
    crossings[line, np.uint32(state)] = pack
    state += np.int64(np.uint64(pack) < limit) + ((step_of(pack) << 32) & (pack >> 63))
    states[line] = state
    return np.uint32(state)


@compiled
@no_type_check
def cross(hits, found, limit, first, packs, inclines, crossings, states):
    """Notes the crossings of the edges that meet a line; returns whether there was room."""
    room, most = np.uint32(crossings.shape[1]), np.uint32(0)
    for hit in range(found):
        i = hits[hit]
        line, pack = first[0, i], packs[i]
        most = max(most, note(crossings, states, np.uint32(line), pack, limit))
        if first[1, i] > 1:
            place, step, slope = place_of(pack), step_of(pack), inclines[i]
            for k in range(1, first[1, i]):
                more = packed(place + k * slope, step)
                most = max(most, note(crossings, states, np.uint32(line + k), more, limit))
        if most == room:
            return False
    return True


@compiled
@no_type_check
def cross_all(
    known, knowns, turning, places, turnings, near, reach, x, y, shift, limit,
    hits, first, packs, inclines, crossings, states,
):  # fmt: skip
    """Notes the crossings of all contours for one direction; returns whether there was room for them."""
    lines, slack = float(len(states)), SLACK * (reach[3] + abs(y) * reach[2] + 1.0)
    doubt = ROUNDING * (abs(x) * reach[4] + abs(y) * reach[5] + 1.0)
    for start in range(0, knowns, AT_ONCE):
        begin, end = np.uint64(start), np.uint64(min(start + AT_ONCE, knowns))
        found = find_known(known, begin, end, x, y, shift, lines, hits, first, packs, inclines)
        if not cross(hits, found, limit, first, packs, inclines, crossings, states):
            return False
    for start in range(0, turnings, AT_ONCE):
        begin, end = np.uint64(start), np.uint64(min(start + AT_ONCE, turnings))
        found = find_turning(
            turning, places, begin, end, near, x, y, shift, lines, slack, doubt, hits, first, packs, inclines
        )
        if not cross(hits, found, limit, first, packs, inclines, crossings, states):
            return False
    return True
