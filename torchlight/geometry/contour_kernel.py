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
from torchlight.geometry.crossing_kernel import add_line, count_of, packed, step_of
from torchlight.geometry.narrowing_kernel import collect, narrow, part_of, window_of

COARSE, FINE = 6, 3  # directions along the edge of a block
AT_ONCE = 256  # edges that stay in the nearest cache from the search to the crossings


@compiled
@no_type_check
def first_crossing(y0, z0, y1, z1, x0, x1, n, x, y, shift, lines):
    """Returns the first line that an edge crosses, on how many it does, and the crossing there.

    A line y = k + shift is crossed by an edge with one end below it and the other not, at x = x0 + (k - t0) slope.
    """
    t0, t1 = y0 - y * z0 - shift, y1 - y * z1 - shift
    a, b = x0 - x * z0, x1 - x * z1
    first = max(np.ceil(min(t0, t1)), 0.0)
    last = min(np.ceil(max(t0, t1)), lines)
    place = a + (first - t0) * np.divide(b - a, t1 - t0)
    return first, max(last - first, 0.0), packed(place, np.int64(-n if t0 < t1 else n))


@compiled
@no_type_check
def find_known(known, begin, end, x, y, shift, lines, rows, spans, packs, hits):
    for e in range(begin, end):
        first, span, pack = first_crossing(
            known[0, e], known[1, e], known[2, e], known[3, e], known[4, e], known[5, e], known[6, e],
            x, y, shift, lines,
        )  # fmt: skip
        i = e - begin
        rows[i], spans[i], packs[i] = np.int32(first), np.int32(span), pack
    found = np.uint32(0)
    for i in range(end - begin):
        hits[found] = i
        found = np.uint32(found + np.uint32(spans[i] != 0))
    return found


@compiled
@no_type_check
def find_turning(turning, begin, end, x, y, shift, lines, rows, spans, packs, hits, steps):
    for e in range(begin, end):
        one = turning[4, e] * x + turning[5, e] * y + turning[6, e]
        two = turning[7, e] * x + turning[8, e] * y + turning[9, e]
        side_one, side_two = turning[10, e], turning[11, e]
        n = (side_one if one > 0.0 else -side_one) + (side_two if two > 0.0 else -side_two)
        first = min(max(np.ceil(turning[0, e] - y * turning[1, e] - shift), 0.0), lines)
        last = min(max(np.ceil(turning[2, e] - y * turning[3, e] - shift), 0.0), lines)
        steps[e - begin] = n if first != last else 0.0
    found = np.uint32(0)
    for i in range(end - begin):
        hits[found] = i
        found = np.uint32(found + np.uint32(steps[i] != 0.0))
    for hit in range(found):
        i = hits[hit]
        e = begin + i
        first, span, pack = first_crossing(
            turning[0, e], turning[1, e], turning[2, e], turning[3, e], turning[12, e], turning[13, e], steps[i],
            x, y, shift, lines,
        )  # fmt: skip
        rows[i], spans[i], packs[i] = np.int32(first), np.int32(span), pack
    return found


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
def cross(table, xs, begin, hits, found, x, y, shift, limit, rows, spans, packs, crossings, states):
    room, most = np.uint32(crossings.shape[1]), np.uint32(0)
    for hit in range(found):
        e = hits[hit]
        most = max(most, note(crossings, states, np.uint32(rows[e]), packs[e], limit))
        if spans[e] > 1:
            k = begin + e
            z0, z1 = table[0 + 1, k], table[3, k]
            t0, t1 = table[0, k] - y * z0 - shift, table[2, k] - y * z1 - shift
            a, b = table[xs, k] - x * z0, table[xs + 1, k] - x * z1
            slope, step = np.divide(b - a, t1 - t0), step_of(packs[e])
            for line in range(rows[e] + 1, rows[e] + spans[e]):
                pack = packed(a + (line - t0) * slope, step)
                most = max(most, note(crossings, states, np.uint32(line), pack, limit))
        if most == room:
            return False
    return True


@compiled
@no_type_check
def cross_all(known, knowns, turning, turnings, x, y, shift, limit, rows, spans, packs, hits, steps, crossings, states):
    """Notes the crossings of all contours for one direction; returns whether there was room for them."""
    lines = float(len(states))
    for start in range(0, knowns, AT_ONCE):
        begin, end = np.uint64(start), np.uint64(min(start + AT_ONCE, knowns))
        found = find_known(known, begin, end, x, y, shift, lines, rows, spans, packs, hits)
        if not cross(known, 4, begin, hits, found, x, y, shift, limit, rows, spans, packs, crossings, states):
            return False
    for start in range(0, turnings, AT_ONCE):
        begin, end = np.uint64(start), np.uint64(min(start + AT_ONCE, turnings))
        found = find_turning(turning, begin, end, x, y, shift, lines, rows, spans, packs, hits, steps)
        if not cross(turning, 12, begin, hits, found, x, y, shift, limit, rows, spans, packs, crossings, states):
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
    axes, clusters, box, cones, rectangles, slopes, shifts, weights, scales, columns, lines, result,
    known, wide, coarse, fine, verdict, chosen, off, kept, crossings, states, hits, rows, spans, packs, steps, part,
    window, differences, scratch, done
):
    along = slopes.shape[1]
    height = result.shape[1] // columns
    axes, clusters, box, cones, rectangles, slopes, shifts, weights, scales, result = borrowed(axes), borrowed(clusters), borrowed(box), borrowed(cones), borrowed(rectangles), borrowed(slopes), borrowed(shifts), borrowed(weights), borrowed(scales), borrowed(result)
    known, wide, coarse, fine, verdict, chosen, off, kept = borrowed(known), borrowed(wide), borrowed(coarse), borrowed(fine), borrowed(verdict), borrowed(chosen), borrowed(off), borrowed(kept)
    crossings, states, hits, rows, spans, packs, steps, part = borrowed(crossings), borrowed(states), borrowed(hits), borrowed(rows), borrowed(spans), borrowed(packs), borrowed(steps), borrowed(part)
    window, differences, scratch = borrowed(window), borrowed(differences), borrowed(scratch)
    limit, finest = np.uint64(packed(columns, 4)), 2147483647.0 / columns
    window[2] = height * lines
    for square in range(done, len(slopes)):
        differences[:] = 0
        rectangle = rectangles[square]
        window_of(slopes, square, 0, along, 0, along, window)
        sure, wides = collect(
            axes, clusters, cones, square, rectangle, window, verdict, chosen, off, kept, known, wide
        )
        for top in range(0, along, COARSE):
            bottom = min(top + COARSE, along)
            for left in range(0, along, COARSE):
                right = min(left + COARSE, along)
                part_of(rectangle, along, top, bottom, left, right, part)
                window_of(slopes, square, top, bottom, left, right, window)
                surer, coarses = narrow(wide, wides, part, window, verdict, chosen, known, sure, coarse, 0)
                for upper in range(top, bottom, FINE):
                    lower = min(upper + FINE, bottom)
                    for west in range(left, right, FINE):
                        east = min(west + FINE, right)
                        part_of(rectangle, along, upper, lower, west, east, part)
                        window_of(slopes, square, upper, lower, west, east, window)
                        surest, fines = narrow(coarse, coarses, part, window, verdict, chosen, known, surer, fine, 0)
                        for i in range(upper, lower):
                            for j in range(west, east):
                                x, y, shift = slopes[square, i, j, 0], slopes[square, i, j, 1], shifts[square, i, j]
                                if not cross_all(
                                    known, surest, fine, fines, x, y, shift, limit,
                                    rows, spans, packs, hits, steps, crossings, states,
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
