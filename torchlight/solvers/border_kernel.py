"""Equations of columns that came and left since their factor was made, solved with that factor, in compiled code.

With L L' the factor of the base B of columns, E those that came, D those that left (all of B), the values are those of

    [ H_BB  H_BE  I_D ] [ v_B ]   [ c_B ]
    [ H_EB  H_EE   0  ] [ v_E ] = [ c_E ],        I_D' the rows of an identity that pick D,
    [ I_D'   0     0  ] [  s  ]   [  0  ]

by the Schur complement of H_BB: a row Y = (L^-1 [H_BE, I_D])' per change, and a matrix no larger than the changes are
many, positive definite on E and negative definite on D, so that it has a factor L D L' in any order (Vanderbei 1995).
Some ten changes cost a tenth of another factor. Rounding is worse than that of a factor of the set itself: what comes
out says which columns are on the wrong side, not more.

References:
    Bisschop and Meeraus, Matrix augmentation and partitioning in the updating of the basis inverse, 1977.
    Vanderbei, Symmetric quasidefinite matrices, 1995.
"""

from __future__ import annotations

from typing import Any, NamedTuple, no_type_check

import numpy as np

from torchlight.compiled import compiled, compiled_sums
from torchlight.solvers.factor_kernel import SMALLEST_PIVOT, TILE, backward, tile_product

MOST_ROWS = 64  # changes remembered
EXPENSIVE = 0.7  # of the operations of another factor: with more, that is made


class Border(NamedTuple):
    """What the changes since the factor was made have brought.

    Attributes:
        rows: Y, [MOST_ROWS + TILE, room].
        schur: the Schur complement of all rows, lower triangle.
        right: its right-hand side.
        column: whose change each row is.
        owner: the row of each column, -1 where it has none.
        place: where each column is in the factor, -1 where it is not.
        half: L^-1 c_B.
        small: the factor of the Schur complement of the rows in force.
        force: which rows those are.
        answer: v_E and s.
    """

    rows: Any
    schur: Any
    right: Any
    column: Any
    owner: Any
    place: Any
    half: Any
    small: Any
    force: Any
    answer: Any


@compiled
@no_type_check
def empty_border(columns):
    """Returns room for changes of so many columns."""
    most = MOST_ROWS + TILE
    return Border(
        np.zeros((most, columns + TILE)),
        np.zeros((most, most)),
        np.zeros(most),
        np.zeros(most, np.int64),
        np.full(columns, -1),
        np.full(columns, -1),
        np.zeros(columns + TILE),
        np.zeros((most, most)),
        np.zeros(most, np.int64),
        np.zeros(most),
    )


@compiled
@no_type_check
def begin(border, index, used, half):
    """Makes the columns that have just been factored the base, half = L^-1 c."""
    border.half[:used] = half[:used]
    border.owner[:] = -1
    border.place[:] = -1
    for a in range(used):
        border.place[index[a]] = a


@compiled
@no_type_check
def bordered(gram, linear, shift, passive, index, used, factor, inverse, border, rows, current, values):
    """Lists the passive columns and their values; returns how many, and how many rows the border has then.

    -1 columns where another factor costs hardly more, or where rounding leaves no sound equations.
    """
    total = fresh_rows(border, passive, used, rows)
    if total < 0:
        return -1, rows
    extend(gram, linear, shift, index, used, factor, inverse, border, rows, total)
    return solve(passive, index, used, factor, inverse, border, total, current, values), total


@compiled
@no_type_check
def fresh_rows(border, passive, used, count):
    """Lists the columns whose change has no row yet, from row `count` on; returns how many rows there are then.

    -1 where there is no room, or where another factor costs hardly more.
    """
    kept, after, total, same = 0, 0, count, True
    for j in range(len(passive)):
        inside = border.place[j] >= 0
        same = same and passive[j] == inside
        kept += same and inside
        after += passive[j]
        if passive[j] != inside and border.owner[j] < 0:
            if total == MOST_ROWS:
                return -1
            border.column[total] = j
            total += 1
    another = after**3 - kept**3
    return total if 3 * (total - count) * used * (used + 2 * total) <= EXPENSIVE * another else -1


@compiled
@no_type_check
def extend(gram, linear, shift, index, used, factor, inverse, border, count, total):
    """Makes the rows from `count` on, their part of the Schur complement and of its right-hand side."""
    rows = border.rows
    padded = used + (-used) % TILE
    for r in range(count, total):
        j = border.column[r]
        border.owner[j] = r
        rows[r, :padded] = 0.0
        if border.place[j] >= 0:
            rows[r, border.place[j]] = 1.0
        else:
            for a in range(used):
                rows[r, a] = gram[j, index[a]]
    rows[total : total + TILE, :padded] = 0.0
    forward_rows(rows, count, total, factor, inverse, used)
    for r in range(count, total):
        j = border.column[r]
        came = border.place[j] < 0
        border.right[r] = (linear[j] if came else 0.0) - inner(rows[r], border.half, used)
        for q in range(r + 1):
            other = border.column[q]
            exact = gram[j, other] if came and border.place[other] < 0 else 0.0
            border.schur[r, q] = exact - inner(rows[r], rows[q], used)
        if came:
            border.schur[r, r] += shift


@compiled
@no_type_check
def forward_rows(rows, start, stop, factor, inverse, used):
    """Replaces rows y by (L^-1 y')', four at a time; the three beyond the last are made as well."""
    sums = np.zeros((TILE, TILE))
    for i in range(start, stop, TILE):
        for j in range(0, used, TILE):
            tile_product(rows, i, factor, j, sums)
            for a in range(TILE):
                for b in range(TILE):
                    total = rows[i + a, j + b] - sums[a, b]
                    for c in range(b):
                        total -= rows[i + a, j + c] * factor[j + b, j + c]
                    rows[i + a, j + b] = total * inverse[j + b]


@compiled_sums
@no_type_check
def inner(left, right, used):
    """Returns the inner product of the first `used` numbers."""
    total = 0.0
    for a in range(used):
        total += left[a] * right[a]
    return total


@compiled
@no_type_check
def solve(passive, index, used, factor, inverse, border, total, current, values):
    """Lists the passive columns and their values; returns how many, -1 where rounding leaves no factor.

    Columns of the base come first, in its order, then those that came.
    """
    changes = 0
    for r in range(total):
        j = border.column[r]
        if passive[j] != (border.place[j] >= 0):
            border.force[changes] = r
            changes += 1
    if not small_factor(border, changes):
        return -1
    small_solve(border, changes)
    values[:used] = border.half[:used]
    for a in range(changes):
        subtract(border.answer[a], border.rows[border.force[a]], used, values)
    backward(factor, inverse, used, values)
    listed = 0
    for a in range(used):
        if passive[index[a]]:
            current[listed], values[listed] = index[a], values[a]
            listed += 1
    for a in range(changes):
        j = border.column[border.force[a]]
        if passive[j]:
            current[listed], values[listed] = j, border.answer[a]
            listed += 1
    return listed


@compiled_sums
@no_type_check
def subtract(share, row, used, values):
    """Takes a multiple of a row from the values."""
    for a in range(used):
        values[a] -= share * row[a]


@compiled
@no_type_check
def small_factor(border, changes):
    """Factors the Schur complement of the rows in force as L D L'; returns whether all signs are as they must be."""
    small = border.small
    for a in range(changes):
        r = border.force[a]
        for b in range(a + 1):
            total = border.schur[r, border.force[b]]
            for c in range(b):
                total -= small[a, c] * small[b, c] * small[c, c]
            small[a, b] = total / small[b, b] if a > b else total
        came = border.place[border.column[r]] < 0
        if not (small[a, a] if came else -small[a, a]) > SMALLEST_PIVOT:
            return False
    return True


@compiled
@no_type_check
def small_solve(border, changes):
    """Sets the answer to the solution of the Schur complement's equations."""
    small, answer = border.small, border.answer
    for a in range(changes):
        answer[a] = border.right[border.force[a]]
        for b in range(a):
            answer[a] -= small[a, b] * answer[b]
    for a in range(changes):
        answer[a] /= small[a, a]
    for a in range(changes - 1, -1, -1):
        for b in range(a):
            answer[b] -= small[a, b] * answer[a]
