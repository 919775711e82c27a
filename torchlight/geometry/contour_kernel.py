"""Signed contour crossings, compiled: how much light reaches each sample from squares of directions.

`geometry.contours` states the method and `geometry.contour_twin` is the readable twin. Coordinates are those of the
grid: x in columns of samples, y in lines (`lines` to a row of samples), z in the scene's unit; a direction is given
by its slope (x, y) = (dx / dz, dy / dz) in these units, and projects the point p to p_xy - (x, y) p_z. Sums are
integers (the weights of a square add up to a fixed number), so that they neither drift nor depend on their order.

Tables of edges are those of `geometry.narrowing_kernel`, which leaves few of them for a block of directions; lists of
crossings are those of `geometry.crossing_kernel`.
"""

from __future__ import annotations

from typing import no_type_check

import numpy as np

from torchlight.compiled import borrowed, compiled
from torchlight.geometry.crossing_kernel import add_line, count_of, packed, place_of, step_of
from torchlight.geometry.narrowing_kernel import NONE, SLACK, collect, narrow, part_of, window_of

COARSE, FINE = 6, 2  # directions along the edge of a block
AT_ONCE = 256  # edges that stay in the nearest cache from the search to the crossings


@compiled
@no_type_check
def first_crossing(y0, z0, y1, z1, x0, x1, n, x, y, shift, lines):
    """Returns the first line that an edge crosses, on how many it does, the crossing there, and dx / dy.

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
def find_known(known, begin, end, x, y, shift, lines, rows, spans, packs, inclines, hits):
    for e in range(begin, end):
        first, span, pack, slope = first_crossing(
            known[0, e], known[1, e], known[2, e], known[3, e], known[4, e], known[5, e], known[6, e],
            x, y, shift, lines,
        )  # fmt: skip
        i = e - begin
        rows[i], spans[i], packs[i], inclines[i] = np.int32(first), np.int32(span), pack, slope
    found = np.uint32(0)
    for i in range(end - begin):
        hits[found] = i
        found = np.uint32(found + np.uint32(spans[i] != 0))
    return found


@compiled
@no_type_check
def may_meet(turning, begin, end, x, y, shift, lines, slack, doubt, spans):
    """Writes 1 where an edge may be a contour that meets a line in one direction, as far as float32 tells."""
    x, y, shift, lines = np.float32(x), np.float32(y), np.float32(shift), np.float32(lines)
    slack, doubt = np.float32(slack), np.float32(doubt)
    for e in range(begin, end):
        one = turning[4, e] * x + turning[5, e] * y + turning[6, e]
        two = turning[7, e] * x + turning[8, e] * y + turning[9, e]
        side_one, side_two = turning[10, e], turning[11, e]
        n = (side_one if one > NONE else -side_one) + (side_two if two > NONE else -side_two)
        t0 = turning[0, e] - y * turning[1, e] - shift
        t1 = turning[2, e] - y * turning[3, e] - shift
        first = max(np.ceil(min(t0, t1) - slack), NONE)
        last = min(np.ceil(max(t0, t1) + slack), lines)
        spans[e - begin] = np.int32((first < last) & ((n != NONE) | (min(abs(one), abs(two)) <= doubt)))


@compiled
@no_type_check
def find_turning(turning, places, begin, end, near, x, y, shift, lines, slack, doubt, rows, spans, packs, inclines, hits):
    may_meet(turning, begin, end, x, y, shift, lines, slack, doubt, spans)
    found = np.uint32(0)
    for i in range(end - begin):
        hits[found] = i
        found = np.uint32(found + np.uint32(spans[i]))
    kept = np.uint32(0)
    for hit in range(found):
        i = hits[hit]
        e = places[begin + i]
        one = near[e, 6] * x + near[e, 7] * y + near[e, 8]
        two = near[e, 9] * x + near[e, 10] * y + near[e, 11]
        side_one, side_two = near[e, 12], near[e, 13]
        n = (side_one if one > 0.0 else -side_one) + (side_two if two > 0.0 else -side_two)
        first, span, pack, slope = first_crossing(
            near[e, 1], near[e, 2], near[e, 4], near[e, 5], near[e, 0], near[e, 3], n, x, y, shift, lines
        )
        rows[i], spans[i], packs[i], inclines[i] = np.int32(first), np.int32(span), pack, slope
        hits[kept] = i
        kept = np.uint32(kept + np.uint32((n != 0.0) & (span != 0.0)))
    return kept


@compiled
@no_type_check
def note(crossings, states, row, pack, limit):
    state = states[row]
    crossings[row, np.uint32(state)] = pack
    state += np.int64(np.uint64(pack) < limit) + ((step_of(pack) << 32) & (pack >> 63))
    states[row] = state
    return np.uint32(state)


@compiled
@no_type_check
def cross(hits, found, limit, rows, spans, packs, inclines, crossings, states):
    room, most = np.uint32(crossings.shape[1]), np.uint32(0)
    for hit in range(found):
        e = hits[hit]
        row, pack = rows[e], packs[e]
        most = max(most, note(crossings, states, np.uint32(row), pack, limit))
        if spans[e] > 1:
            place, step, slope = place_of(pack), step_of(pack), inclines[e]
            for k in range(1, spans[e]):
                more = packed(place + k * slope, step)
                most = max(most, note(crossings, states, np.uint32(row + k), more, limit))
        if most == room:
            return False
    return True


@compiled
@no_type_check
def cross_all(known, knowns, turning, places, turnings, near, box, x, y, shift, limit, rows, spans, packs, inclines, hits, crossings, states):
    """Notes the crossings of all contours for one direction; returns whether there was room for them."""
    lines = float(len(states))
    slack, doubt = SLACK * (box[3] + abs(y) * box[2]), 4e-6 * (abs(x) * box[4] + abs(y) * box[5] + 1.0)
    for start in range(0, knowns, AT_ONCE):
        begin, end = np.uint64(start), np.uint64(min(start + AT_ONCE, knowns))
        found = find_known(known, begin, end, x, y, shift, lines, rows, spans, packs, inclines, hits)
        if not cross(hits, found, limit, rows, spans, packs, inclines, crossings, states):
            return False
    for start in range(0, turnings, AT_ONCE):
        begin, end = np.uint64(start), np.uint64(min(start + AT_ONCE, turnings))
        found = find_turning(turning, places, begin, end, near, x, y, shift, lines, slack, doubt, rows, spans, packs, inclines, hits)
        if not cross(hits, found, limit, rows, spans, packs, inclines, crossings, states):
            return False
    return True


@compiled
@no_type_check
def add_shadow(box, y, weight, crossings, states, scratch, fine, differences):
    """Adds the shadow of one direction to the differences of a square, and clears the lines.

    A hidden interval of a line begins where the number of sheets leaves 0 and ends where it returns.
    """
    lines = len(states) // len(differences)
    drift = y * box[2]
    lowest = int(min(max(np.floor(box[0] - max(drift, 0.0)) - 1.0, 0.0), len(states)))
    highest = int(max(min(np.ceil(box[1] - min(drift, 0.0)) + 1.0, len(states)), 0.0))
    for line in range(lowest, highest):
        state = states[line]
        if state != 0:
            add_line(
                crossings, line, count_of(state), state >> 32, line // lines, weight, scratch, fine, differences
            )
            states[line] = 0


@compiled
@no_type_check
def sum_rows(differences, total, scale, square, result):
    """Writes scale (1 - hidden share) of every sample."""
    rows, columns = differences.shape[0], differences.shape[1] - 1
    for row in range(rows):
        hidden = np.int64(0)
        for column in range(columns):
            hidden += differences[row, column]
            result[square, row * columns + column] = scale * (np.float64(total - hidden) / np.float64(total))


@compiled
@no_type_check
def visible_integrals(
    axes, clusters, edges, box, cones, rectangles, slopes, shifts, weights, scales, columns, lines, result,
    known, wide, coarse, fine, wide_places, coarse_places, fine_places, verdict, chosen, off, kept, crossings, states, hits, rows, spans, packs, inclines, part,
    window, differences, scratch, near, done
):
    along = slopes.shape[1]
    height = result.shape[1] // columns
    axes, clusters, edges, box, cones, rectangles, slopes, shifts, weights, scales, result = borrowed(axes), borrowed(clusters), borrowed(edges), borrowed(box), borrowed(cones), borrowed(rectangles), borrowed(slopes), borrowed(shifts), borrowed(weights), borrowed(scales), borrowed(result)
    known, wide, coarse, fine, wide_places, coarse_places, fine_places, verdict, chosen, off, kept = borrowed(known), borrowed(wide), borrowed(coarse), borrowed(fine), borrowed(wide_places), borrowed(coarse_places), borrowed(fine_places), borrowed(verdict), borrowed(chosen), borrowed(off), borrowed(kept)
    crossings, states, hits, rows, spans, packs, inclines, part = borrowed(crossings), borrowed(states), borrowed(hits), borrowed(rows), borrowed(spans), borrowed(packs), borrowed(inclines), borrowed(part)
    near=borrowed(near)
    window, differences, scratch = borrowed(window), borrowed(differences), borrowed(scratch)
    limit, finest = np.uint64(packed(columns, 4)), 2147483647.0 / columns
    window[2] = height * lines
    for square in range(done, len(slopes)):
        differences[:] = 0
        rectangle = rectangles[square]
        window_of(slopes, square, 0, along, 0, along, box, window)
        sure, wides = collect(
            axes, clusters, cones, square, rectangle, window, edges, verdict, chosen, off, kept, known, wide, near
        )
        for top in range(0, along, COARSE):
            bottom = min(top + COARSE, along)
            for left in range(0, along, COARSE):
                right = min(left + COARSE, along)
                part_of(rectangle, along, top, bottom, left, right, part)
                window_of(slopes, square, top, bottom, left, right, box, window)
                surer, coarses = narrow(wide, wide_places, wides, part, window, near, verdict, chosen, known, sure, coarse, coarse_places, 0)
                for upper in range(top, bottom, FINE):
                    lower = min(upper + FINE, bottom)
                    for west in range(left, right, FINE):
                        east = min(west + FINE, right)
                        part_of(rectangle, along, upper, lower, west, east, part)
                        window_of(slopes, square, upper, lower, west, east, box, window)
                        surest, fines = narrow(coarse, coarse_places, coarses, part, window, near, verdict, chosen, known, surer, fine, fine_places, 0)
                        for i in range(upper, lower):
                            for j in range(west, east):
                                x, y, shift = slopes[square, i, j, 0], slopes[square, i, j, 1], shifts[square, i, j]
                                if not cross_all(
                                    known, surest, fine, fine_places, fines, near, box, x, y, shift, limit,
                                    rows, spans, packs, inclines, hits, crossings, states,
                                ):  # fmt: skip
                                    return square
                                add_shadow(
                                    box, y, weights[square, i, j], crossings, states, scratch, finest, differences
                                )
        total = np.int64(0)
        for i in range(along):
            for j in range(along):
                total += weights[square, i, j]
        sum_rows(differences, total * lines, scales[square], square, result)
    return len(slopes)
