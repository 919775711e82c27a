"""Which edges may bound a shadow for a rectangle of directions, compiled: narrowed down step by step.

Edges come in clusters (`geometry.crossings`), each a small table: a column per edge, so that loops over them become
vector code; its rows are y and z of both ends (0 to 3), two normals (4 to 9), the sides of the two faces (10, 11), and
x of both ends (12, 13).

The clusters are narrowed to the edges that may be contours for a square of directions, these to a coarse block of it,
these to a fine block. What may turn within a block is a table with the same rows. What is known to be a contour for
all of it, with its n_e, is kept apart: y and z of both ends (0 to 3), x of both ends (4, 5) and n_e (6). What meets no
line of the grid is left out.

Products and sums are not contracted or reordered (no fastmath): the facing of a face must come out equal to the bit
wherever it is needed, or a contour stays open and a whole line changes sides.
"""

from __future__ import annotations

from typing import no_type_check

import numpy as np

from torchlight.compiled import compiled
from torchlight.geometry.visibility_kernel import CLUSTER, clusters_within

ROUNDING = 1e-11  # of n . d for a unit normal and a direction to a face of the cube: a sign beyond it is certain
SLACK = 1e-9  # of a line
FIELDS, KNOWN = 14, 7  # rows of a table of edges that may turn; of known contours
TURNING = 9.0  # in the place of an n_e that changes within a block


@compiled
@no_type_check
def facing_over(x, y, z, center, right, up):
    """Returns 1 or -1 where the facing of a normal is the same over a rectangle of directions, 0 where it may not be.

    The rectangle is its centre, half its width and half its height.
    """
    middle = x * center[0] + y * center[1] + z * center[2]
    reach = abs(x * right[0] + y * right[1] + z * right[2]) + abs(x * up[0] + y * up[1] + z * up[2]) + ROUNDING
    return (1.0 if middle > reach else 0.0) - (1.0 if middle < -reach else 0.0)


@compiled
@no_type_check
def judge(fields, count, rectangle, window, verdict):
    """Writes n_e where both faces keep their facing, `TURNING` elsewhere, and 0 for what meets no line of the grid.

    The window is the least and the largest y of the directions' slopes, and the number of lines, which lie up to 1
    above whole numbers. Rounding keeps the order of numbers: what holds at both ends of a window holds within.
    """
    low, high, lines = window[0], window[1], window[2] + SLACK
    center = rectangle[0, 0], rectangle[0, 1], rectangle[0, 2]
    right = rectangle[1, 0], rectangle[1, 1], rectangle[1, 2]
    up = rectangle[2, 0], rectangle[2, 1], rectangle[2, 2]
    for e in range(np.uint64(count)):
        one = facing_over(fields[4, e], fields[5, e], fields[6, e], center, right, up)
        two = facing_over(fields[7, e], fields[8, e], fields[9, e], center, right, up)
        n = TURNING if one * two == 0.0 else fields[10, e] * one + fields[11, e] * two
        top = max(fields[0, e] - low * fields[1, e], fields[2, e] - low * fields[3, e])
        bottom = min(fields[0, e] - high * fields[1, e], fields[2, e] - high * fields[3, e])
        verdict[e] = 0.0 if (top <= 0.0) | (bottom > lines) else n


@compiled
@no_type_check
def sort_out(verdict, count, chosen):
    """Writes which edges are known contours and which may turn, without a branch: it would be hard to predict."""
    knowns, turnings = 0, 0
    for e in range(np.uint64(count)):
        chosen[0, np.uint32(knowns)], chosen[1, np.uint32(turnings)] = e, e
        turns = verdict[e] == TURNING
        turnings += int(turns)
        knowns += int((verdict[e] != 0.0) & (not turns))
    return knowns, turnings


@compiled
@no_type_check
def narrow(fields, count, rectangle, window, verdict, chosen, known, knowns, turning, turnings):
    """Copies the edges of a table that may be contours within a rectangle, behind those already there.

    Returns how many are known to be contours for all its directions, and how many may turn.
    """
    judge(fields, count, rectangle, window, verdict)
    more, open_ones = sort_out(verdict, count, chosen)
    for k in range(4):
        copy(fields, k, chosen, 0, more, known, k, knowns)
    copy(fields, 12, chosen, 0, more, known, 4, knowns)
    copy(fields, 13, chosen, 0, more, known, 5, knowns)
    for i in range(np.uint64(more)):
        known[6, np.uint64(knowns) + i] = verdict[chosen[0, i]]
    for k in range(FIELDS):
        copy(fields, k, chosen, 1, open_ones, turning, k, turnings)
    return knowns + more, turnings + open_ones


@compiled
@no_type_check
def copy(fields, row, chosen, which, count, target, into, begin):
    """Copies the chosen ones of a row behind those already in another."""
    for i in range(np.uint64(count)):
        target[into, np.uint64(begin) + i] = fields[row, chosen[which, i]]


@compiled
@no_type_check
def empty_table(rows, room):
    """Returns a table with room for so many edges."""
    return np.empty((rows, room))


@compiled
@no_type_check
def collect(axes, clusters, cones, square, rectangle, window, verdict, chosen, off, kept, known, turning):
    """Narrows the scene's edges to a rectangle of directions; clusters that hold no contour there are skipped.

    Args:
        cone: unit axis of the rectangle in the scene's frame, and cosine and sine of its half angle.
        rectangle: centre, half width and half height in the grid's frame, [3, 3].
        window: of its slopes, as `judge` takes it.
    """
    knowns, turnings = 0, 0
    keeps = clusters_within(axes, (cones[square, 0], cones[square, 1], cones[square, 2], cones[square, 3], cones[square, 4]), off, kept)
    for place in range(keeps):
        knowns, turnings = narrow(
            clusters[kept[place]], CLUSTER, rectangle, window, verdict, chosen, known, knowns, turning, turnings
        )
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
def window_of(slopes, square, top, bottom, left, right, window):
    """Writes the least and the largest y of the slopes of rows top to bottom and columns left to right of a square."""
    window[0], window[1] = np.inf, -np.inf
    for i in range(top, bottom):
        for j in range(left, right):
            window[0] = min(window[0], slopes[square, i, j, 1])
            window[1] = max(window[1], slopes[square, i, j, 1])
