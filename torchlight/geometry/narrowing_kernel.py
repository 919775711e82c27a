"""Which edges may bound a shadow for a rectangle of directions, compiled: narrowed down in two steps.

Edges come in clusters (`geometry.crossings`), each a small table in float32: a column per edge, so that loops over them
become vector code; its rows are y and z of both ends (0 to 3), two normals (4 to 9), and the sides of the two faces
(10, 11). The clusters are narrowed to the edges that may be contours for a square of directions, these to those that
may turn within a block of it: a table with the same rows, and a number for each edge, its row among those of the square
whose numbers in float64 stand near each other.

What is known to be a contour for a whole block, with its n_e, is kept apart, in float64: y and z of both ends (0 to 3),
x of both ends (4, 5) and n_e (6). What meets no line of the grid is left out.

Here float32 is enough: what it leaves in doubt may turn. Products and sums are not contracted or reordered (no
fastmath).
"""

from __future__ import annotations

from typing import no_type_check

import numpy as np

from torchlight.compiled import compiled
from torchlight.geometry.visibility_kernel import CLUSTER, clusters_within

FIELDS, VALUES = 12, 16  # rows of a table; numbers of an edge
ROUNDING = 4e-6  # of n . d for a unit normal and a direction to a face of the cube: a sign beyond it is certain
SLACK = 1e-6  # of the largest numbers that a line is made of
NONE, ONE, TURNING = np.float32(0), np.float32(1), np.float32(9)  # the last in the place of an n_e that changes


@compiled
@no_type_check
def facing_over(x, y, z, center, right, up):
    """Returns 1 or -1 where the facing of a normal is the same over a rectangle of directions, 0 where it may not be.

    The rectangle is its centre, half its width and half its height.
    """
    middle = x * center[0] + y * center[1] + z * center[2]
    reach = (
        abs(x * right[0] + y * right[1] + z * right[2]) + abs(x * up[0] + y * up[1] + z * up[2]) + np.float32(ROUNDING)
    )
    return (ONE if middle > reach else NONE) - (ONE if middle < -reach else NONE)


@compiled
@no_type_check
def judge(fields, count, rectangle, window, verdict):
    """Writes n_e where both faces keep their facing, `TURNING` elsewhere, and 0 for what meets no line of the grid.

    The window is the least and the largest y of the directions' slopes, the number of lines, which lie up to 1 above
    whole numbers, and how far rounding may move an edge.
    """
    low, high = np.float32(window[0]), np.float32(window[1])
    least, most = np.float32(-window[3]), np.float32(window[2] + window[3])
    center = np.float32(rectangle[0, 0]), np.float32(rectangle[0, 1]), np.float32(rectangle[0, 2])
    right = np.float32(rectangle[1, 0]), np.float32(rectangle[1, 1]), np.float32(rectangle[1, 2])
    up = np.float32(rectangle[2, 0]), np.float32(rectangle[2, 1]), np.float32(rectangle[2, 2])
    for e in range(np.uint64(count)):
        one = facing_over(fields[4, e], fields[5, e], fields[6, e], center, right, up)
        two = facing_over(fields[7, e], fields[8, e], fields[9, e], center, right, up)
        n = TURNING if one * two == NONE else fields[10, e] * one + fields[11, e] * two
        top = max(fields[0, e] - low * fields[1, e], fields[2, e] - low * fields[3, e])
        bottom = min(fields[0, e] - high * fields[1, e], fields[2, e] - high * fields[3, e])
        verdict[e] = NONE if (top <= least) | (bottom > most) else n


@compiled
@no_type_check
def sort_out(verdict, count, chosen):
    """Writes which edges are known contours and which may turn, without a branch: it would be hard to predict."""
    knowns, turnings = np.uint32(0), np.uint32(0)
    for e in range(np.uint64(count)):
        chosen[0, knowns], chosen[1, turnings] = e, e
        turns = verdict[e] == TURNING
        turnings = np.uint32(turnings + np.uint32(turns))
        knowns = np.uint32(knowns + np.uint32((verdict[e] != NONE) & (not turns)))
    return knowns, turnings


@compiled
@no_type_check
def narrow(source, count, rectangle, window, near, verdict, chosen, known, knowns, turning, places):
    """Writes the edges of a square's table that may turn within a block, and adds the contours known for the block.

    Returns how many are known to be contours for all its directions, and how many may turn.

    Args:
        near: the numbers in float64 of the square's edges.
        places: gets which of them may turn.
    """
    judge(source, count, rectangle, window, verdict)
    more, turnings = sort_out(verdict, count, chosen)
    for i in range(more):
        add_known(near, chosen[0, i], verdict[chosen[0, i]], known, np.uint64(knowns) + i)
    for k in range(FIELDS):
        for i in range(turnings):
            turning[k, i] = source[k, chosen[1, i]]
    for i in range(turnings):
        places[i] = chosen[1, i]
    return knowns + more, turnings


@compiled
@no_type_check
def add_known(edges, e, n, known, k):
    """Writes a known contour into its table."""
    known[0, k], known[1, k], known[2, k], known[3, k] = edges[e, 1], edges[e, 2], edges[e, 4], edges[e, 5]
    known[4, k], known[5, k], known[6, k] = edges[e, 0], edges[e, 3], n


@compiled
@no_type_check
def collect(axes, clusters, cones, square, rectangle, window, edges, verdict, chosen, off, kept, known, turning, near):
    """Narrows the scene's edges to a square of directions; clusters that hold no contour there are skipped.

    Args:
        cones: unit axis of each square in the scene's frame, and cosine and sine of its half angle.
        rectangle: centre, half width and half height in the grid's frame, [3, 3].
        window: of its slopes, as `judge` takes it.
        near: gets the numbers in float64 of what may turn.
    """
    cone = cones[square, 0], cones[square, 1], cones[square, 2], cones[square, 3], cones[square, 4]
    knowns, turnings = np.uint64(0), np.uint64(0)
    for place in range(clusters_within(axes, cone, off, kept)):
        cluster = clusters[kept[place]]
        base = np.uint64(CLUSTER) * kept[place]
        judge(cluster, CLUSTER, rectangle, window, verdict)
        more, some = sort_out(verdict, CLUSTER, chosen)
        for i in range(more):
            add_known(edges, base + chosen[0, i], verdict[chosen[0, i]], known, knowns + i)
        for i in range(some):
            e, to = chosen[1, i], turnings + i
            for k in range(VALUES):
                near[to, k] = edges[base + e, k]
            for k in range(FIELDS):
                turning[k, to] = cluster[k, e]
        knowns, turnings = knowns + more, turnings + some
    return knowns, turnings


@compiled
@no_type_check
def part_of(rectangles, square, along, top, bottom, left, right, part):
    """Writes the rectangle spanned by the directions of rows top to bottom and columns left to right, ends excluded."""
    for k in range(3):
        part[0, k] = (
            rectangles[square, 0, k]
            + rectangles[square, 1, k] * ((left + right) / along - 1.0)
            + rectangles[square, 2, k] * (1.0 - (top + bottom) / along)
        )
        part[1, k] = rectangles[square, 1, k] * ((right - left - 1) / along)
        part[2, k] = rectangles[square, 2, k] * ((bottom - top - 1) / along)


@compiled
@no_type_check
def window_of(slopes, square, top, bottom, left, right, reach, window):
    """Writes the least and the largest y of some slopes of a square, and how far rounding may move an edge, in lines.

    The slopes are those of rows top to bottom and columns left to right, ends excluded.
    """
    window[0], window[1] = np.inf, -np.inf
    for i in range(top, bottom):
        for j in range(left, right):
            window[0] = min(window[0], slopes[square, i, j, 1])
            window[1] = max(window[1], slopes[square, i, j, 1])
    window[3] = SLACK * (1.0 + reach[3] + reach[2] * max(abs(window[0]), abs(window[1])))
