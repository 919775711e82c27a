"""Signed contour crossings, compiled: who hides what on a grid of samples, and how much light is left.

`geometry.contours` states the method and `geometry.contour_twin` is the readable twin. Coordinates are those of the
grid: x in columns of samples, y in lines (`lines` to a row of samples), z in the scene's unit; a direction is given
by its slope (x, y) = (dx / dz, dy / dz) in these units, and projects the point p to p_xy - (x, y) p_z. Sums are
integers (the weights of a square add up to a fixed number), so that they neither drift nor depend on their order.

Edges are columns of tables, so that the loops over them become vector code. Their rows: two ends (0 to 5), two normals
(6 to 11), the sides of the two faces (12, 13) and n_e (14).
They are narrowed down step by step: the scene's edges to those that may be contours for a square of directions, these
to a coarse block of it, these to a fine block. What is known to be a contour for a whole block, with its n_e, is kept
apart from what may turn.

Products and sums are not contracted or reordered (no fastmath): the facing of a face must come out equal to the bit
wherever it is needed, or a contour stays open and a whole line changes sides.
"""

from __future__ import annotations

from typing import no_type_check

import numpy as np

from torchlight.compiled import compiled

CLUSTER, EVERY = 16, 0xFFFF  # edges in a cluster, a bit for each
COARSE, FINE = 6, 3  # directions along the edge of a block
CROSSINGS = 32  # room for the crossings of one line at first; doubled when it is not enough
INSERTED, COUNTED = 6, 64  # crossings of a line that are sorted by insertion; by counting
TOGETHER = 16  # crossings that are counted together
LAST = 2**63 - 1  # behind all of them
ROUNDING = 1e-11  # of n . d for a unit normal and a direction to a face of the cube: a sign beyond it is certain
SLACK = 1e-9  # of the sine of an angle between a cluster and a direction
TURNING = 9.0  # in the place of an n_e that changes within a block


@compiled
@no_type_check
def facing_over(nx, ny, nz, rectangle, begin, end, facing):
    """Writes the facing of faces over a rectangle of directions (its centre, half width, half height).

    1 or -1 where it is the same for all of them, 0 where it may not be.
    """
    cx, cy, cz = rectangle[0, 0], rectangle[0, 1], rectangle[0, 2]
    rx, ry, rz = rectangle[1, 0], rectangle[1, 1], rectangle[1, 2]
    ux, uy, uz = rectangle[2, 0], rectangle[2, 1], rectangle[2, 2]
    for e in range(begin, end):
        middle = nx[e] * cx + ny[e] * cy + nz[e] * cz
        reach = abs(nx[e] * rx + ny[e] * ry + nz[e] * rz) + abs(nx[e] * ux + ny[e] * uy + nz[e] * uz) + ROUNDING
        facing[e] = (1.0 if middle > reach else 0.0) - (1.0 if middle < -reach else 0.0)


@compiled
@no_type_check
def judge(one, two, side_one, side_two, begin, end, verdict):
    """Writes n_e where both faces keep their facing, `TURNING` elsewhere."""
    for e in range(begin, end):
        verdict[e] = TURNING if one[e] * two[e] == 0.0 else side_one[e] * one[e] + side_two[e] * two[e]


@compiled
@no_type_check
def sort_out(verdict, begin, end, sure, unsure):
    """Writes which edges are known contours and which may turn, without a branch: it would be hard to predict."""
    knowns, turnings = 0, 0
    for e in range(begin, end):
        sure[knowns], unsure[turnings] = e, e
        turns = verdict[e] == TURNING
        turnings += int(turns)
        knowns += int((verdict[e] != 0.0) & (not turns))
    return knowns, turnings


@compiled
@no_type_check
def copy(source, chosen, count, fields, target, begin):
    """Copies the first fields of chosen edges behind those already in a table."""
    for k in range(fields):
        for i in range(count):
            target[k, begin + i] = source[k, chosen[i]]


@compiled
@no_type_check
def narrow(source, begin, end, rectangle, scratch, chosen, known, knowns, turning, turnings):
    """Copies the edges of a table that may be contours within a rectangle, behind those already there.

    Returns how many are known to be contours for all its directions, and how many may turn.
    """
    one, two, verdict = scratch[0], scratch[1], scratch[2]
    facing_over(source[6], source[7], source[8], rectangle, begin, end, one)
    facing_over(source[9], source[10], source[11], rectangle, begin, end, two)
    judge(one, two, source[12], source[13], begin, end, verdict)
    more, open_ones = sort_out(verdict, begin, end, chosen[0], chosen[1])
    copy(source, chosen[0], more, 6, known, knowns)
    copy(source, chosen[1], open_ones, 14, turning, turnings)
    for i in range(more):
        known[14, knowns + i] = verdict[chosen[0, i]]
    return knowns + more, turnings + open_ones


@compiled
@no_type_check
def along(axes, cluster, direction):
    """Returns the cosine between a cluster's axis and a direction."""
    return axes[cluster, 0] * direction[0] + axes[cluster, 1] * direction[1] + axes[cluster, 2] * direction[2]


@compiled
@no_type_check
def may_turn(axes, cluster, angle, direction):
    """Returns whether a cluster's normals, up to an angle from its axis, may be at right angles to a direction."""
    return angle >= 0.5 * np.pi or abs(along(axes, cluster, direction)) <= np.sin(angle) + SLACK


@compiled
@no_type_check
def collect(first, axes, spread, edges, cone, rectangle, scratch, chosen, known, turning):
    """Narrows the scene's edges to a rectangle of directions; clusters that hold no contour there are skipped.

    Args:
        cone: unit axis of the rectangle in the scene's frame, and its half angle.
        rectangle: centre, half width and half height in the grid's frame, [3, 3].
    """
    knowns, turnings, begin = 0, 0, -1
    for cluster in range(len(axes) + 1):
        wanted = cluster < len(axes) and may_turn(axes, cluster, spread[cluster] + cone[3], cone)
        if wanted and begin < 0:
            begin = first[cluster]
        elif begin >= 0 and not wanted:
            knowns, turnings = narrow(
                edges, begin, first[cluster], rectangle, scratch, chosen, known, knowns, turning, turnings
            )
            begin = -1
    return knowns, turnings


@compiled
@no_type_check
def part_of(rectangle, along, top, bottom, left, right, part):
    """Writes the rectangle spanned by the directions of rows top to bottom and columns left to right, ends excluded."""
    for k in range(3):
        part[0, k] = (
            rectangle[0, k]
            + rectangle[1, k] * ((left + right) / along - 1.0)
            + rectangle[2, k] * (1.0 - (top + bottom) / along)
        )
        part[1, k] = rectangle[1, k] * ((right - left - 1) / along)
        part[2, k] = rectangle[2, k] * ((bottom - top - 1) / along)


@compiled
@no_type_check
def turn(edges, begin, end, x, y, one, two, n):
    """Writes n_e for one direction: what faces away from the light (or is seen edge-on) counts negative."""
    component(edges[6], edges[7], edges[8], begin, end, x, y, one)
    component(edges[9], edges[10], edges[11], begin, end, x, y, two)
    add_sides(one, two, edges[12], edges[13], begin, end, n)


@compiled
@no_type_check
def component(nx, ny, nz, begin, end, x, y, result):
    """Writes n . (x, y, 1)."""
    for e in range(begin, end):
        result[e] = nx[e] * x + ny[e] * y + nz[e]


@compiled
@no_type_check
def add_sides(one, two, side_one, side_two, begin, end, n):
    """Writes the sum over both faces of side x sign of the facing."""
    for e in range(begin, end):
        n[e] = (side_one[e] if one[e] > 0.0 else -side_one[e]) + (side_two[e] if two[e] > 0.0 else -side_two[e])


@compiled
@no_type_check
def find(edges, n, begin, end, y, shift, lines, meeting, hits, chosen):
    """Appends the contours that meet a line of the grid to the chosen edges; returns their number."""
    meet(edges[1], edges[2], edges[4], edges[5], n, begin, end, y, shift, float(lines), meeting)
    for e in range(begin, end):  # without a branch: which edges meet a line is hard to predict
        chosen[hits] = e
        hits += int(meeting[e] != 0.0)
    return hits


@compiled
@no_type_check
def meet(y0, z0, y1, z1, n, begin, end, y, shift, lines, meeting):
    """Writes n_e where an edge meets a line of the grid in one direction, 0 elsewhere."""
    for e in range(begin, end):
        first = min(max(np.ceil(y0[e] - y * z0[e] - shift), 0.0), lines)
        last = min(max(np.ceil(y1[e] - y * z1[e] - shift), 0.0), lines)
        meeting[e] = n[e] if first != last else 0.0


@compiled
@no_type_check
def empty_lists(lines):
    """Returns, for each line, room for its crossings and their steps, their number and the sheets left of the grid."""
    places, counts = np.empty((lines, CROSSINGS)), np.zeros((2, lines), np.int32)
    return places, np.empty(places.shape, np.int32), counts[0], counts[1]


@compiled
@no_type_check
def note(begin, end, x0, t0, slope, step, columns, lists):
    """Writes where one edge crosses lines, x = x0 + (line - t0) slope; returns whether there was room for all."""
    places, steps, crossings, before = lists
    for line in range(begin, end):
        place = x0 + (line - t0) * slope
        if place <= 0.0:
            before[line] += step
        elif place < columns:
            if crossings[line] == places.shape[1]:
                return False
            places[line, crossings[line]] = place
            steps[line, crossings[line]] = step
            crossings[line] += 1
    return True


@compiled
@no_type_check
def cross(edges, chosen, hits, meeting, x, y, shift, columns, lists, reached):
    """Writes where chosen edges cross the lines in one direction, and the lowest and highest line `reached`.

    A line y = k + shift is crossed by an edge with one end below it and the other not. Crossings right of the grid
    are dropped, those left of it only counted. Returns whether there was room for all.
    """
    lines, lowest, highest = len(lists[0]), reached[0], reached[1]
    for hit in range(hits):
        e = chosen[hit]
        t0, t1 = edges[1, e] - y * edges[2, e] - shift, edges[4, e] - y * edges[5, e] - shift
        x0, x1 = edges[0, e] - x * edges[2, e], edges[3, e] - x * edges[5, e]
        begin, end = int(max(np.ceil(min(t0, t1)), 0.0)), int(min(np.ceil(max(t0, t1)), float(lines)))
        step = np.int32(-meeting[e] if t0 < t1 else meeting[e])
        slope = (x1 - x0) / (t1 - t0)
        lowest, highest = min(lowest, begin), max(highest, end)
        if not note(begin, end, x0, t0, slope, step, columns, lists):
            return False
    reached[0], reached[1] = lowest, highest
    return True


@compiled
@no_type_check
def longer(lists):
    """Returns empty lists with twice the room."""
    places, steps, crossings, before = lists
    crossings[:], before[:] = 0, 0
    shape = (len(places), 2 * places.shape[1])
    return np.empty(shape, places.dtype), np.empty(shape, steps.dtype), crossings, before


@compiled
@no_type_check
def packed(place, step):
    """Returns a place > 0 and a step of -2 to 2 there as one integer: in the order of the places, upward steps first.

    The bits of positive numbers are in the order of the numbers; the last three, 1e-15 of the place, hold the step.
    """
    return (np.float64(place).view(np.int64) & ~np.int64(7)) | np.int64(4 - step)


@compiled
@no_type_check
def sort_full_lines(reached, lists, packs):
    """Sorts the lines with more than a few crossings; `sort_line` then finds nothing to move in them."""
    places, steps, crossings, _ = lists
    for line in range(reached[0], reached[1]):
        if INSERTED < crossings[line] <= COUNTED:
            count_in(line, crossings[line], places, steps, packs)


@compiled
@no_type_check
def count_in(line, count, places, steps, packs):
    """Sorts some crossings: each has as many before it as are less.

    Counting them needs no branch that would be hard to predict. Equal ones are alike: any of them may come first.
    """
    full = (count + TOGETHER - 1) // TOGETHER * TOGETHER
    for i in range(full):
        packs[0, i] = packed(places[line, i], steps[line, i]) if i < count else LAST
        packs[1, i] = LAST
    for i in range(count):
        crossing, rank = packs[0, i], 0
        for j in range(full):
            rank += int(packs[0, j] < crossing)
        while packs[1, rank] != LAST:
            rank += 1
        packs[1, rank] = crossing
    for i in range(count):
        places[line, i] = np.int64(packs[1, i] & ~np.int64(7)).view(np.float64)
        steps[line, i] = 4 - (packs[1, i] & np.int64(7))


@compiled
@no_type_check
def sort_line(line, count, places, steps):
    """Sorts the crossings of a line from left to right (Shell 1959, gaps 3 h + 1; few are sorted by insertion)."""
    gap = 1
    while 9 * gap < count:
        gap = 3 * gap + 1
    while gap > 0:
        for i in range(gap, count):
            place, step = places[line, i], steps[line, i]
            j = i - gap
            while j >= 0 and places[line, j] > place:
                places[line, j + gap], steps[line, j + gap] = places[line, j], steps[line, j]
                j -= gap
            places[line, j + gap], steps[line, j + gap] = place, step
        gap //= 3


@compiled
@no_type_check
def add_end(differences, row, place, weight):
    """Adds one end of a hidden interval to the differences of a row: `weight` for all that lies right of it."""
    column = int(place)
    part = np.int64(np.rint(weight * (column + 1 - place)))
    differences[row, column] += part
    differences[row, column + 1] += weight - part


@compiled
@no_type_check
def add_lines(row, begin, end, weight, lists, differences):
    """Adds the hidden intervals of some lines of a row of samples, and clears the lines.

    An interval begins where the number of sheets leaves 0 and ends where it returns.
    """
    places, steps, crossings, before = lists
    for line in range(begin, end):
        count, sheets = crossings[line], before[line]
        sort_line(line, count, places, steps)
        if sheets != 0:
            differences[row, 0] += weight
        for k in range(count):
            was = sheets
            sheets += steps[line, k]
            if was == 0 and sheets != 0:
                add_end(differences, row, places[line, k], weight)
            elif was != 0 and sheets == 0:
                add_end(differences, row, places[line, k], -weight)
        crossings[line], before[line] = 0, 0


@compiled
@no_type_check
def sum_rows(differences, total, scale, result):
    """Writes scale (1 - hidden share) of every sample."""
    rows, columns = differences.shape[0], differences.shape[1] - 1
    for row in range(rows):
        hidden = np.int64(0)
        for column in range(columns):
            hidden += differences[row, column]
            result[row * columns + column] = scale * (np.float64(total - hidden) / np.float64(total))


@compiled
@no_type_check
def cross_all(known, knowns, turning, turnings, x, y, shift, columns, scratch, chosen, lists, reached):
    """Writes the crossings of all contours for one direction; returns whether there was room for them."""
    lines, meeting = len(lists[0]), scratch[2]
    reached[0], reached[1] = lines, 0
    hits = find(known, known[14], 0, knowns, y, shift, lines, meeting, 0, chosen)
    if not cross(known, chosen, hits, meeting, x, y, shift, columns, lists, reached):
        return False
    turn(turning, 0, turnings, x, y, scratch[0], scratch[1], turning[14])
    hits = find(turning, turning[14], 0, turnings, y, shift, lines, meeting, 0, chosen)
    return cross(turning, chosen, hits, meeting, x, y, shift, columns, lists, reached)


@compiled
@no_type_check
def add_shadow(reached, weight, lists, differences):
    """Adds the shadow of one direction to the differences of a square."""
    lines = len(lists[0]) // len(differences)
    for row in range(reached[0] // lines, (reached[1] + lines - 1) // lines):
        add_lines(row, max(row * lines, reached[0]), min(row * lines + lines, reached[1]), weight, lists, differences)


@compiled
@no_type_check
def visible_integrals(
    first, axes, spread, edges, cones, rectangles, slopes, shifts, weights, scales, columns, lines, result
):
    """Writes, for each square and sample, the integral of the visible share over the square's directions.

    Args:
        first: where each cluster of edges begins, and the number of edges.
        axes: of the clusters.
        spread: of the clusters.
        edges: the table of edges.
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
    along, room = slopes.shape[1], edges.shape[1]
    rows = result.shape[1] // columns
    known, wide, coarse, fine = (
        np.empty(edges.shape),
        np.empty(edges.shape),
        np.empty(edges.shape),
        np.empty(edges.shape),
    )
    scratch, chosen, lists = np.empty((3, room)), np.empty((2, room), np.int32), empty_lists(rows * lines)
    met, part, reached = np.empty(room, np.int32), np.empty((3, 3)), np.zeros(2, np.int64)
    differences, packs = np.empty((rows, columns + 1), np.int64), np.empty((2, COUNTED), np.int64)
    for square in range(len(slopes)):
        differences[:] = 0
        rectangle = rectangles[square]
        sure, wides = collect(first, axes, spread, edges, cones[square], rectangle, scratch, chosen, known, wide)
        for top in range(0, along, COARSE):
            bottom = min(top + COARSE, along)
            for left in range(0, along, COARSE):
                right = min(left + COARSE, along)
                part_of(rectangle, along, top, bottom, left, right, part)
                surer, coarses = narrow(wide, 0, wides, part, scratch, chosen, known, sure, coarse, 0)
                for upper in range(top, bottom, FINE):
                    lower = min(upper + FINE, bottom)
                    for west in range(left, right, FINE):
                        east = min(west + FINE, right)
                        part_of(rectangle, along, upper, lower, west, east, part)
                        surest, fines = narrow(coarse, 0, coarses, part, scratch, chosen, known, surer, fine, 0)
                        for i in range(upper, lower):
                            for j in range(west, east):
                                x, y, shift = slopes[square, i, j, 0], slopes[square, i, j, 1], shifts[square, i, j]
                                while not cross_all(
                                    known, surest, fine, fines, x, y, shift, columns, scratch, met, lists, reached
                                ):
                                    lists = longer(lists)
                                sort_full_lines(reached, lists, packs)
                                add_shadow(reached, weights[square, i, j], lists, differences)
        sum_rows(differences, weights[square].sum() * lines, scales[square], result[square])


@compiled
@no_type_check
def fill_lines(reached, columns, lists, hidden):
    """Marks the samples of a line whose centres lie within its hidden intervals, and clears the lines."""
    places, steps, crossings, before = lists
    for line in range(reached[0], reached[1]):
        count, sheets = crossings[line], before[line]
        sort_line(line, count, places, steps)
        begin = 0
        for k in range(count + 1):
            column = columns if k == count else int(np.ceil(places[line, k] - 0.5))
            if sheets != 0:
                hidden[line * columns + begin : line * columns + column] = True
            begin = column
            if k < count:
                sheets += steps[line, k]
        crossings[line], before[line] = 0, 0


@compiled
@no_type_check
def facings(nx, ny, nz, x, y):
    """Returns a bit per edge of a cluster: whether n . (x, y, 1) is positive."""
    bits = np.int64(0)
    for e in range(CLUSTER):
        bits += (np.int64(1) << e) if nx[e] * x + ny[e] * y + nz[e] > 0.0 else np.int64(0)
    return bits


@compiled
@no_type_check
def lowest(bits):
    """Returns the place of the lowest bit among 16."""
    low, place = bits & -bits, 0
    for step, mask in ((8, 0xFF00), (4, 0xF0F0), (2, 0xCCCC), (1, 0xAAAA)):
        place += step if low & mask else 0
    return place


@compiled
@no_type_check
def contours_of(normals, sides, first, x, y, chosen, found):
    """Appends a cluster's contours in one direction to the chosen edges; returns their number.

    `chosen` holds each edge's place among all and its n_e, `first` is the place of the cluster's first edge.
    """
    one = ~(facings(normals[0], normals[1], normals[2], x, y) ^ sides[0])  # side x facing is 1, not -1
    two = ~(facings(normals[3], normals[4], normals[5], x, y) ^ sides[1])
    left = (~(one ^ two) | sides[2]) & ~sides[3] & EVERY
    while left != 0:
        e = lowest(left)
        left &= left - 1
        chosen[0, found] = first + e
        chosen[1, found] = (2 * (one >> e & 1) - 1) * (2 - (sides[2] >> e & 1))
        found += 1
    return found


@compiled
@no_type_check
def cross_centers(ends, chosen, found, x, y, columns, lists, reached):
    """Does what `cross` does, for contours of which few meet a line, the lines of the sample centres."""
    lines = len(lists[0])
    for hit in range(found):
        e = chosen[0, hit]
        t0, t1 = ends[e, 0, 1] - y * ends[e, 0, 2] - 0.5, ends[e, 1, 1] - y * ends[e, 1, 2] - 0.5
        if np.ceil(t0) == np.ceil(t1):
            continue
        x0, x1 = ends[e, 0, 0] - x * ends[e, 0, 2], ends[e, 1, 0] - x * ends[e, 1, 2]
        begin, end = int(max(np.ceil(min(t0, t1)), 0.0)), int(min(np.ceil(max(t0, t1)), float(lines)))
        step = -chosen[1, hit] if t0 < t1 else chosen[1, hit]
        slope = (x1 - x0) / (t1 - t0)
        reached[0], reached[1] = min(reached[0], begin), max(reached[1], end)
        if not note(begin, end, x0, t0, slope, step, columns, lists):
            return False
    return True


@compiled
@no_type_check
def hidden_samples(axes, spread, normals, sides, ends, cone, directions, slopes, numbers, columns, result):
    """Marks the samples whose centres are hidden from each of a bundle of directions.

    Args:
        axes: of the clusters.
        spread: of the clusters.
        normals: of the clusters' edges, [clusters, 6, 16].
        sides: bits of the clusters' edges, [clusters, 4].
        ends: of the edges, [edges, 2, 3].
        cone: unit axis and half angle of the bundle, [4].
        directions: unit, [directions, 3].
        slopes: of the directions, [directions, 2].
        numbers: which row of the result a direction has.
        columns: samples in x.
        result: False everywhere, [directions, points].
    """
    chosen, reached = np.empty((2, len(ends)), np.int32), np.zeros(2, np.int64)
    lists, kept, sines = empty_lists(result.shape[1] // columns), np.empty(len(axes), np.int64), np.empty(len(axes))
    keeps, packs = 0, np.empty((2, COUNTED), np.int64)
    for cluster in range(len(axes)):
        if may_turn(axes, cluster, spread[cluster] + cone[3], cone):
            kept[keeps] = cluster
            sines[keeps] = np.sin(spread[cluster]) + SLACK if spread[cluster] < 0.5 * np.pi else 2.0
            keeps += 1
    for k in range(len(slopes)):
        x, y, found = slopes[k, 0], slopes[k, 1], 0
        for place in range(keeps):
            cluster = kept[place]
            if abs(along(axes, cluster, directions[k])) <= sines[place]:
                found = contours_of(normals[cluster], sides[cluster], cluster * CLUSTER, x, y, chosen, found)
        reached[0], reached[1] = len(lists[0]), 0
        while not cross_centers(ends, chosen, found, x, y, columns, lists, reached):
            lists = longer(lists)
        sort_full_lines(reached, lists, packs)
        fill_lines(reached, columns, lists, result[numbers[k]])
