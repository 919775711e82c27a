"""Signed contour crossings, compiled: how much light reaches each sample from squares of directions.

`geometry.contours` states the method and `geometry.contour_twin` is the readable twin. Coordinates are those of the
grid: x in columns of samples, y in lines (`lines` to a row of samples), z in the scene's unit; a direction is given
by its slope (x, y) = (dx / dz, dy / dz) in these units, and projects the point p to p_xy - (x, y) p_z. Sums are
integers (the weights of a square add up to a fixed number), so that they neither drift nor depend on their order.

Tables of edges are those of `geometry.narrowing_kernel`, which leaves few of them for a block of directions;
`geometry.meeting_kernel` finds their crossings and `geometry.crossing_kernel` what these hide.
"""

from __future__ import annotations

from typing import no_type_check

import numpy as np

from torchlight.compiled import borrowed, compiled
from torchlight.geometry.crossing_kernel import (
    INSERTED,
    MANY,
    add_end,
    add_unsorted,
    limit_of,
    place_of,
    sort,
    sort_every,
    step_of,
)
from torchlight.geometry.meeting_kernel import AT_ONCE, cross_all
from torchlight.geometry.narrowing_kernel import collect, narrow, part_of, window_of
from torchlight.geometry.visibility_kernel import CLUSTER

BLOCK = 3  # directions along the edge of a block that has its own table


def empty_tables(clusters):
    """Returns room for tables of edges: what `visible_integrals` takes behind the lines; nothing in it is kept."""
    room = clusters * CLUSTER // 512 * 512 + 552  # rows fall into different sets of the processor's cache
    known, near = np.empty((7, room)), np.empty((room, 16))
    wide, turning = (np.empty((12, room), np.float32) for _ in range(2))
    places = np.empty(room, np.uint32)
    verdict, chosen = np.empty(room, np.float32), np.empty((2, room), np.uint32)
    off, kept = np.empty(clusters), np.empty(clusters, np.uint32)
    return known, near, wide, turning, places, verdict, chosen, off, kept


def empty_lists(rows, columns, lines, room):
    """Returns room for so many crossings of each line, and for what is hidden: what comes behind the tables."""
    hits, first = np.empty(AT_ONCE, np.uint32), np.empty((2, AT_ONCE), np.int32)
    packs, inclines = np.empty(AT_ONCE, np.int64), np.empty(AT_ONCE)
    crossings, states = np.empty((rows * lines, room), np.int64), np.zeros(rows * lines, np.int64)
    scratch, differences = np.empty((4, MANY), np.int32), np.empty((rows, columns + 1), np.int64)
    return hits, first, packs, inclines, crossings, states, scratch, differences, np.empty((3, 3)), np.empty(4)


@compiled
@no_type_check
def add_shadow(reach, y, weight, crossings, states, scratch, fineness, differences):
    """Adds the shadow of one direction to the differences of a square, and clears the lines.

    A hidden interval of a line begins where the number of sheets leaves 0 and ends where it returns.
    """
    lines, drift = len(states) // len(differences), y * reach[2]
    lowest = int(min(max(np.floor(reach[0] - max(drift, 0.0)) - 1.0, 0.0), float(len(states))))
    highest = int(max(min(np.ceil(reach[1] - min(drift, 0.0)) + 1.0, float(len(states))), 0.0))
    for line in range(lowest, highest):
        state, row = states[line], line // lines
        states[line] = 0
        count, sheets = np.int64(np.uint32(state)), state >> 32
        if sheets != 0:
            differences[row, 0] += weight
        if count > INSERTED:
            if add_unsorted(crossings, line, count, sheets, row, weight, scratch, fineness, differences):
                continue
            sort(line, count, crossings)
        else:
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
def total_of(weights, square):
    """Returns the sum of a square's weights."""
    total = np.int64(0)
    for i in range(weights.shape[1]):
        for j in range(weights.shape[2]):
            total += weights[square, i, j]
    return total


@compiled
@no_type_check
def visible_integrals(
    axes, clusters, edges, reach, cones, rectangles, slopes, shifts, weights, scales, columns, lines,
    known, near, wide, turning, places, verdict, chosen, off, kept,
    hits, first, packs, inclines, crossings, states, scratch, differences, part, window, done, result,
):  # fmt: skip
    """Writes, for each square and sample, the integral of the visible share over the square's directions.

    Returns how many squares are done: fewer than all where a line has more crossings than there is room for.

    Args:
        axes: of the clusters: x, y, z, and sine and cosine of their spread (2 and 0 if it may be any), [5, clusters].
        clusters: tables of edges in float32, [clusters, 12, 16].
        edges: a row of 16 numbers per edge.
        reach: how far they and their normals reach (`geometry.crossings.GridContours`).
        cones: unit axis of each square, cosine and sine of its half angle, [squares, 5].
        rectangles: its centre, half width and half height in the grid's frame, [squares, 3, 3].
        slopes: of its s x s directions, row by row from the upper left, [squares, s, s, 2].
        shifts: of the lines, per direction.
        weights: of the directions, integers.
        scales: the integral where nothing is hidden, [squares].
        columns: samples in x.
        lines: per row of samples.
        done: the first square that is asked for; those before it are left alone.
        result: [squares, points].

    What is between is from `empty_tables` and `empty_lists`.
    """
    axes, clusters, edges, reach, cones = (
        borrowed(axes),
        borrowed(clusters),
        borrowed(edges),
        borrowed(reach),
        borrowed(cones),
    )
    rectangles, slopes, shifts, weights = borrowed(rectangles), borrowed(slopes), borrowed(shifts), borrowed(weights)
    known, near, wide, turning = borrowed(known), borrowed(near), borrowed(wide), borrowed(turning)
    places, verdict, chosen, off, kept = (
        borrowed(places),
        borrowed(verdict),
        borrowed(chosen),
        borrowed(off),
        borrowed(kept),
    )
    hits, first, packs, inclines = borrowed(hits), borrowed(first), borrowed(packs), borrowed(inclines)
    crossings, states, scratch, differences = (
        borrowed(crossings),
        borrowed(states),
        borrowed(scratch),
        borrowed(differences),
    )
    result, part, window = borrowed(result), borrowed(part), borrowed(window)
    along, limit, fineness = slopes.shape[1], limit_of(columns), (2.0**31 - 1.0) / columns
    window[2] = len(states)
    for square in range(done, len(slopes)):
        differences[:] = 0
        window_of(slopes, square, 0, along, 0, along, reach, window)
        sure, wides = collect(
            axes, clusters, cones, square, rectangles[square], window, edges, verdict, chosen, off, kept, known, wide,
            near,
        )  # fmt: skip
        for top in range(0, along, BLOCK):
            bottom = min(top + BLOCK, along)
            for left in range(0, along, BLOCK):
                right = min(left + BLOCK, along)
                part_of(rectangles, square, along, top, bottom, left, right, part)
                window_of(slopes, square, top, bottom, left, right, reach, window)
                surer, fewer = narrow(wide, wides, part, window, near, verdict, chosen, known, sure, turning, places)
                for i in range(top, bottom):
                    for j in range(left, right):
                        x, y, shift = slopes[square, i, j, 0], slopes[square, i, j, 1], shifts[square, i, j]
                        if not cross_all(
                            known, surer, turning, places, fewer, near, reach, x, y, shift, limit,
                            hits, first, packs, inclines, crossings, states,
                        ):  # fmt: skip
                            return square
                        add_shadow(reach, y, weights[square, i, j], crossings, states, scratch, fineness, differences)
        sum_rows(differences, total_of(weights, square) * lines, scales[square], square, result)
    return len(slopes)
