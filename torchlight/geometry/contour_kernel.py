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

from torchlight.compiled import compiled
from torchlight.geometry.crossing_kernel import (
    COUNTED,
    INSERTED,
    empty_lists,
    longer,
    packed,
    place_of,
    sort_every,
    sort_many,
    step_of,
)
from torchlight.geometry.narrowing_kernel import bring_ends, collect, empty_table, narrow, part_of, window_of

COARSE, FINE = 6, 3  # directions along the edge of a block


@compiled
@no_type_check
def turn(fields, count, x, y):
    """Writes n_e for one direction: what faces away from the light (or is seen edge-on) counts negative."""
    for e in range(count):
        one = fields[4, e] * x + fields[5, e] * y + fields[6, e]
        two = fields[7, e] * x + fields[8, e] * y + fields[9, e]
        side_one, side_two = fields[10, e], fields[11, e]
        fields[12, e] = (side_one if one > 0.0 else -side_one) + (side_two if two > 0.0 else -side_two)


@compiled
@no_type_check
def find(fields, count, y, shift, lines, meeting, hits):
    """Writes which contours meet a line of the grid in one direction; returns their number."""
    for e in range(count):
        first = min(max(np.ceil(fields[0, e] - y * fields[1, e] - shift), 0.0), lines)
        last = min(max(np.ceil(fields[2, e] - y * fields[3, e] - shift), 0.0), lines)
        meeting[e] = fields[12, e] if first != last else 0.0
    found = 0
    for e in range(count):  # without a branch: which edges meet a line is hard to predict
        hits[found] = e
        found += int(meeting[e] != 0.0)
    return found


@compiled
@no_type_check
def span(ends, numbers, meeting, hits, found, x, y, shift, lines, spans, lanes):
    """Writes which lines an edge crosses (first, last + 1 and the step), and where: t0, x0 and the slope.

    A line y = k + shift is crossed by an edge with one end below it and the other not, at x = x0 + (k - t0) slope.
    """
    for hit in range(found):
        e, n = numbers[hits[hit]], meeting[hits[hit]]
        z0, z1 = ends[e, 2], ends[e, 5]
        t0, t1 = ends[e, 1] - y * z0 - shift, ends[e, 4] - y * z1 - shift
        x0, x1 = ends[e, 0] - x * z0, ends[e, 3] - x * z1
        spans[hit, 0] = np.int64(max(np.ceil(min(t0, t1)), 0.0))
        spans[hit, 1] = np.int64(min(np.ceil(max(t0, t1)), lines))
        spans[hit, 2] = np.int64(-n if t0 < t1 else n)
        lanes[hit, 0], lanes[hit, 1], lanes[hit, 2] = t0, x0, (x1 - x0) / (t1 - t0)


@compiled
@no_type_check
def cross(spans, lanes, found, columns, crossings, counts, before, reached):
    """Notes the crossings of some edges, and the lowest and highest line `reached`; returns whether there was room.

    Crossings right of the grid are dropped, those left of it only counted; both without a branch, which would be hard
    to predict: a crossing that does not count is written over by the next.
    """
    room, most, lowest, highest = crossings.shape[1], 0, reached[0], reached[1]
    for hit in range(found):
        begin, end, step = spans[hit, 0], spans[hit, 1], spans[hit, 2]
        t0, x0, slope = lanes[hit, 0], lanes[hit, 1], lanes[hit, 2]
        lowest, highest = min(lowest, begin), max(highest, end)
        for line in range(begin, end):
            place, row = x0 + (line - t0) * slope, np.uint32(line)
            count = counts[row]
            crossings[row, np.uint32(count)] = packed(place, step)
            count += int((place > 0.0) & (place < columns))
            counts[row] = count
            before[row] += step * int(place <= 0.0)
            most = max(most, count)
        if most == room:
            return False
    reached[0], reached[1] = lowest, highest
    return True


@compiled
@no_type_check
def cross_all(
    ends, known, knowns, turning, turnings, x, y, shift, columns, meeting, hits, spans, lanes, crossings, counts,
    before, reached,
):  # fmt: skip
    """Notes the crossings of all contours for one direction; returns whether there was room for them."""
    lines = float(len(counts))
    reached[0], reached[1] = len(counts), 0
    found = find(known[0], knowns, y, shift, lines, meeting, hits)
    span(ends, known[1], meeting, hits, found, x, y, shift, lines, spans, lanes)
    if not cross(spans, lanes, found, columns, crossings, counts, before, reached):
        return False
    turn(turning[0], turnings, x, y)
    found = find(turning[0], turnings, y, shift, lines, meeting, hits)
    span(ends, turning[1], meeting, hits, found, x, y, shift, lines, spans, lanes)
    return cross(spans, lanes, found, columns, crossings, counts, before, reached)


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
def add_shadow(reached, weight, crossings, counts, before, packs, differences):
    """Adds the shadow of one direction to the differences of a square, and clears the lines.

    A hidden interval of a line begins where the number of sheets leaves 0 and ends where it returns.
    """
    lines = len(counts) // len(differences)
    for line in range(reached[0], reached[1]):
        count, sheets, row = counts[line], before[line], line // lines
        if count > INSERTED:
            sort_many(line, count, crossings, packs)
        else:
            sort_every(1, line, count, crossings)
        if sheets != 0:
            differences[row, 0] += weight
        for k in range(count):
            crossing, was = crossings[line, k], sheets
            sheets += step_of(crossing)
            if was == 0 and sheets != 0:
                add_end(differences, row, place_of(crossing), weight)
            elif was != 0 and sheets == 0:
                add_end(differences, row, place_of(crossing), -weight)
        counts[line], before[line] = 0, 0


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
    first, axes, spread, fields, ends, cones, rectangles, slopes, shifts, weights, scales, columns, lines, result
):
    """Writes, for each square and sample, the integral of the visible share over the square's directions.

    Args:
        first: where each cluster of edges begins, and the number of edges.
        axes: of the clusters.
        spread: of the clusters.
        fields: of the scene's edges.
        ends: of the scene's edges.
        cones: unit axis and half angle of each square, [squares, 4].
        rectangles: its centre, half width and half height in the grid's frame, [squares, 3, 3].
        slopes: of its s x s directions, row by row from the upper left, [squares, s, s, 2].
        shifts: of the lines, per direction.
        weights: of the directions, integers.
        scales: the integral where nothing is hidden, [squares].
        columns: samples in x.
        lines: per row of samples.
        result: [squares, points].
    """
    along, room = slopes.shape[1], fields.shape[1]
    rows = result.shape[1] // columns
    known, wide, coarse, fine = empty_table(room), empty_table(room), empty_table(room), empty_table(room)
    near, verdict, chosen = np.empty(ends.shape), np.empty(room), np.empty((2, room), np.uint32)
    crossings, counts, before = empty_lists(rows * lines)
    hits, part, reached, window = np.empty(room, np.uint32), np.empty((3, 3)), np.zeros(2, np.int64), np.empty(3)
    differences, packs = np.empty((rows, columns + 1), np.int64), np.empty((2, COUNTED), np.int64)
    spans, lanes = np.empty((room, 3), np.int64), np.empty((room, 3))
    window[2], everything = rows * lines, (fields, np.arange(room).astype(np.uint32))
    for square in range(len(slopes)):
        differences[:] = 0
        rectangle = rectangles[square]
        window_of(slopes, square, 0, along, 0, along, window)
        sure, wides = collect(
            first, axes, spread, everything, cones[square], rectangle, window, verdict, chosen, known, wide
        )
        bring_ends(ends, known, sure, near, 0)
        bring_ends(ends, wide, wides, near, sure)
        for top in range(0, along, COARSE):
            bottom = min(top + COARSE, along)
            for left in range(0, along, COARSE):
                right = min(left + COARSE, along)
                part_of(rectangle, along, top, bottom, left, right, part)
                window_of(slopes, square, top, bottom, left, right, window)
                surer, coarses = narrow(wide, 0, wides, part, window, verdict, chosen, known, sure, coarse, 0)
                for upper in range(top, bottom, FINE):
                    lower = min(upper + FINE, bottom)
                    for west in range(left, right, FINE):
                        east = min(west + FINE, right)
                        part_of(rectangle, along, upper, lower, west, east, part)
                        window_of(slopes, square, upper, lower, west, east, window)
                        surest, fines = narrow(coarse, 0, coarses, part, window, verdict, chosen, known, surer, fine, 0)
                        for i in range(upper, lower):
                            for j in range(west, east):
                                x, y, shift = slopes[square, i, j, 0], slopes[square, i, j, 1], shifts[square, i, j]
                                while not cross_all(
                                    near, known, surest, fine, fines, x, y, shift, columns, verdict, hits, spans, lanes,
                                    crossings, counts, before, reached,
                                ):  # fmt: skip
                                    crossings = longer(crossings, counts)
                                    counts[:], before[:] = 0, 0
                                add_shadow(
                                    reached, weights[square, i, j], crossings, counts, before, packs, differences
                                )
        sum_rows(differences, weights[square].sum() * lines, scales[square], square, result)
