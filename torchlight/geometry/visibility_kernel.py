"""Signed contour crossings, compiled: which samples' centres are hidden from each of many directions.

`geometry.contours` states the method and `geometry.contour_twin` is the readable twin; coordinates are those of
`geometry.contour_kernel`. Neighbouring directions look through the clusters of edges together, so that each cluster is
read once for all of them. A crossing is noted at the first sample whose centre lies right of it, a whole number.

Edges are a table per cluster, so that the loops over them become vector code. Its rows: y and z of both ends (0 to 3),
two normals (4 to 9), the sides of the two faces (10, 11), x of both ends (12, 13); 0 beyond the last edge.
"""

from __future__ import annotations

from typing import no_type_check

import numpy as np

from torchlight.compiled import compiled
from torchlight.geometry.crossing_kernel import INSERTED, longer

ROOM = 32  # for the crossings of one line at first; doubled when it is not enough
CLUSTER = 16  # edges in a cluster
SLACK = 1e-9  # of the sine of an angle between a cluster and a direction


@compiled
@no_type_check
def cone_about(directions):
    """Returns the axis of a cone that holds unit directions, and the cosine and the sine of its half angle."""
    x, y, z = directions[0].sum(), directions[1].sum(), directions[2].sum()
    length, cosine = np.sqrt(x * x + y * y + z * z), 1.0
    x, y, z = x / length, y / length, z / length
    for k in range(directions.shape[1]):
        cosine = min(cosine, directions[0, k] * x + directions[1, k] * y + directions[2, k] * z)
    return x, y, z, cosine, np.sqrt(max(0.0, 1.0 - cosine * cosine))


@compiled
@no_type_check
def clusters_within(axes, cone, off, kept):
    """Writes which clusters may hold a contour for some direction of a cone; returns their number.

    Their normals may be at right angles to one when the angle a between the axes is within b = spread + half angle of
    90 degrees: cos(b) <= 0, or |cos(a)| <= sin(b).
    """
    x, y, z, cosine, sine = cone
    for c in range(axes.shape[1]):
        reach = axes[3, c] * cosine + axes[4, c] * sine + SLACK
        across = abs(axes[0, c] * x + axes[1, c] * y + axes[2, c] * z)
        off[c] = 1.0 if (across > reach) & (axes[4, c] * cosine > axes[3, c] * sine) else 0.0
    keeps = 0
    for c in range(axes.shape[1]):
        kept[keeps] = c
        keeps += int(off[c] == 0.0)
    return keeps


@compiled
@no_type_check
def directions_near(axes, c, directions, across, near):
    """Writes for which directions a cluster may hold a contour; returns their number."""
    x, y, z, sine = axes[0, c], axes[1, c], axes[2, c], axes[3, c] + SLACK
    for k in range(directions.shape[1]):
        across[k] = abs(x * directions[0, k] + y * directions[1, k] + z * directions[2, k])
    found = 0
    for k in range(directions.shape[1]):
        near[found] = k
        found += int(across[k] <= sine)
    return found


@compiled
@no_type_check
def meet(clusters, c, x, y, lines, i, met):
    """Writes n_e where an edge of a cluster meets a line of centres in one direction, 0 elsewhere."""
    for e in range(CLUSTER):
        one = clusters[c, 4, e] * x + clusters[c, 5, e] * y + clusters[c, 6, e]
        two = clusters[c, 7, e] * x + clusters[c, 8, e] * y + clusters[c, 9, e]
        side_one, side_two = clusters[c, 10, e], clusters[c, 11, e]
        n = (side_one if one > 0.0 else -side_one) + (side_two if two > 0.0 else -side_two)
        first = min(max(np.ceil(clusters[c, 0, e] - y * clusters[c, 1, e] - 0.5), 0.0), lines)
        last = min(max(np.ceil(clusters[c, 2, e] - y * clusters[c, 3, e] - 0.5), 0.0), lines)
        met[i, e] = n if first != last else 0.0


@compiled
@no_type_check
def hits_among(met, count, hits):
    """Writes the places of what is not 0 among the first `count`, without a branch: it would be hard to predict."""
    found = 0
    for place in range(count):
        hits[found] = place
        found += int(met[place] != 0.0)
    return found


@compiled
@no_type_check
def note(begin, end, first, t0, x0, slope, step, columns, crossings, counts, before):
    """Notes one edge at the lines it crosses, x = x0 + (line - t0) slope; returns the most crossings one of them has.

    Lines are numbered from `first` in the lists. Crossings right of the grid are dropped, those left of it counted.
    """
    most = 0
    for line in range(begin, end):
        place = np.ceil(x0 + (line - t0) * slope - 0.5)
        row, within = np.uint32(first + line), int(min(max(place, 0.0), float(columns)))
        count = counts[row]
        crossings[row, np.uint32(count)] = 8 * within + 4 - step  # written over by the next where it does not count
        count += int((within > 0) & (within < columns))
        counts[row] = count
        before[row] += step * int(within == 0)
        most = max(most, count)
    return most


@compiled
@no_type_check
def note_all(hits, found, near, met, clusters, c, slopes, columns, crossings, counts, before):
    """Notes all hits of a cluster; returns the most crossings that one of the lines met has."""
    lines, most = len(counts) // len(slopes), 0
    for hit in range(found):
        i, e = hits[hit] // np.uint32(CLUSTER), hits[hit] % np.uint32(CLUSTER)
        k = near[i]
        x, y, n = slopes[k, 0], slopes[k, 1], met[i, e]
        t0 = clusters[c, 0, e] - y * clusters[c, 1, e] - 0.5
        t1 = clusters[c, 2, e] - y * clusters[c, 3, e] - 0.5
        x0, x1 = clusters[c, 12, e] - x * clusters[c, 1, e], clusters[c, 13, e] - x * clusters[c, 3, e]
        begin, end = int(max(np.ceil(min(t0, t1)), 0.0)), int(min(np.ceil(max(t0, t1)), float(lines)))
        step, slope = np.int32(-n if t0 < t1 else n), (x1 - x0) / (t1 - t0)
        most = max(most, note(begin, end, k * lines, t0, x0, slope, step, columns, crossings, counts, before))
    return most


@compiled
@no_type_check
def fill_lines(first, lines, columns, crossings, counts, before, steps, hidden, number):
    """Marks the samples of some lines that lie within hidden intervals, and clears the lines."""
    for line in range(lines):
        row = first + line
        count = counts[row]
        if count > INSERTED:
            fill_full_line(row, line * columns, columns, crossings, count, before[row], steps, hidden, number)
        elif count + abs(before[row]) > 0:
            fill_line(row, line * columns, columns, crossings, count, before[row], hidden, number)
        counts[row], before[row] = 0, 0


@compiled
@no_type_check
def fill_line(row, base, columns, crossings, count, sheets, hidden, number):
    """Marks the hidden samples of a line with few crossings."""
    for i in range(1, count):
        crossing, j = crossings[row, i], i - 1
        while j >= 0 and crossings[row, j] > crossing:
            crossings[row, j + 1] = crossings[row, j]
            j -= 1
        crossings[row, j + 1] = crossing
    begin = 0
    for k in range(count):
        column = crossings[row, k] >> 3
        if sheets != 0:
            hidden[number, base + begin : base + column] = True
        begin = column
        sheets += 4 - (crossings[row, k] & 7)
    if sheets != 0:
        hidden[number, base + begin : base + columns] = True


@compiled
@no_type_check
def fill_full_line(row, base, columns, crossings, count, sheets, steps, hidden, number):
    """Marks the hidden samples of a line with many crossings; `steps` is 0 before and after."""
    for k in range(count):
        steps[crossings[row, k] >> 3] += 4 - (crossings[row, k] & 7)
    for column in range(columns):
        sheets += steps[column]
        hidden[number, base + column] = sheets != 0
        steps[column] = 0


@compiled
@no_type_check
def hidden_samples(axes, clusters, directions, slopes, numbers, columns, result):
    """Marks the samples whose centres are hidden from each of a bundle of directions.

    Args:
        axes: of the clusters: x, y, z, and sine and cosine of their spread (2 and 0 if it may be any), [5, clusters].
        clusters: tables of edges, [clusters, 14, 16].
        directions: unit, [3, directions].
        slopes: of the directions, [directions, 2].
        numbers: which row of the result a direction has.
        columns: samples in x.
        result: False everywhere, [directions, points].
    """
    bundle, lines = len(slopes), result.shape[1] // columns
    across, near = np.empty(bundle), np.empty(bundle, np.uint32)
    met, hits = np.empty((bundle, CLUSTER)), np.empty(bundle * CLUSTER, np.uint32)
    off, kept = np.empty(axes.shape[1]), np.empty(axes.shape[1], np.uint32)
    crossings = np.empty((bundle * lines, ROOM), np.int32)
    counts, before = np.zeros(bundle * lines, np.int32), np.zeros(bundle * lines, np.int32)
    steps, height, most = np.zeros(columns, np.int32), float(lines), 0
    flat = met.reshape(-1)
    keeps = clusters_within(axes, cone_about(directions), off, kept)
    for place in range(keeps):
        c = kept[place]
        nears = directions_near(axes, c, directions, across, near)
        for i in range(nears):
            meet(clusters, c, slopes[near[i], 0], slopes[near[i], 1], height, i, met)
        found = hits_among(flat, nears * CLUSTER, hits)
        if most + CLUSTER >= crossings.shape[1]:
            crossings = longer(crossings, counts)
        most = max(most, note_all(hits, found, near, met, clusters, c, slopes, columns, crossings, counts, before))
    for k in range(bundle):
        fill_lines(k * lines, lines, columns, crossings, counts, before, steps, result, numbers[k])
