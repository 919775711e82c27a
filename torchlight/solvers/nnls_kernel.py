"""Non-negative least squares on a Gram matrix in compiled code, many right-hand sides without the interpreter.

Readable twin: `active_set.minimize_nonnegative`. An answer is a function of the set of passive columns alone (the
last factor is that of the set in ascending order), so it does not depend on the start, nor on the number of threads.
"""

from __future__ import annotations

from typing import no_type_check

import numpy as np

from torchlight.compiled import compiled, compiled_sums

PIVOTINGS = 20
CHANCES = 3
SMALLEST_SHIFT = 1e-13  # just above the rounding of a float64 Gram matrix with unit diagonal
SMALLEST_PIVOT = 1e-14
SHIFT_ROUNDS = 50
AT_BOUND = 1e-10  # of its value before the step: a coefficient this small has reached 0
TILE = 4


@compiled
@no_type_check
def minimize_items(gram, linear, ridge, tolerance, max_steps, x, steps):
    """Minimises x'Gx/2 - c'x + ridge |x|^2/2 over x >= 0 for every row of c and x, in place.

    Args:
        gram: G, symmetric, positive semidefinite to rounding, with unit diagonal (or a row of zeros), [n, n].
        linear: c, of order one, [items, n].
        ridge: at least 0. Below 1e-13, or where columns are dependent to rounding, the factors carry a larger one,
            whose effect is then removed by proximal rounds.
        tolerance: on w = c - G x - ridge x: w_j at most this everywhere, and |w_j| where x_j > 0.
        max_steps: factorisations per item, whole or in part.
        x: in: where to begin, only x > 0 counts while that leads to the end; out: the answer, at least 0.
        steps: out: factorisations spent; max_steps where that did not suffice.
    """
    columns = gram.shape[0]
    room = columns + TILE
    factor = np.zeros((room, room))
    inverse = np.ones(room)
    for item in range(len(x)):
        steps[item] = minimize(gram, linear[item], ridge, tolerance, max_steps, x[item], factor, inverse)


@compiled
@no_type_check
def solve_items(gram, linear, damping, x):
    """Sets every row of x to (G + damping 1)^-1 c, without a sign constraint; the damping grows until G is definite."""
    columns = gram.shape[0]
    factor = np.zeros((columns + TILE, columns + TILE))
    inverse = np.ones(columns + TILE)
    index = np.arange(columns)
    factored(gram, index, columns, 0, damping, factor, inverse)
    for item in range(len(x)):
        substitute(factor, inverse, index, columns, linear[item], x[item])


@compiled
@no_type_check
def minimize(gram, linear, ridge, tolerance, max_steps, x, factor, inverse):
    """Minimises for one item; returns the factorisations."""
    shift = max(ridge, SMALLEST_SHIFT)
    pulled = np.zeros(len(x))
    shifted = linear.copy()
    spent = 0
    for _ in range(SHIFT_ROUNDS):
        more, shift = pivot(gram, shifted, shift, tolerance, max_steps - spent, x, factor, inverse)
        spent += more
        # a shift above the ridge leaves w = (shift - ridge) x - pulled where x > 0
        wrong = 0.0
        for j in range(len(x)):
            wrong = max(wrong, abs((shift - ridge) * x[j] - pulled[j]))
        if wrong <= tolerance or spent >= max_steps:
            break
        for j in range(len(x)):
            pulled[j] = (shift - ridge) * x[j]
            shifted[j] = linear[j] + pulled[j]
    return spent


@compiled
@no_type_check
def pivot(gram, linear, shift, tolerance, max_steps, x, factor, inverse):
    """Minimises with a positive shift in place of the ridge; returns the factorisations and the shift that held.

    Block principal pivoting (Portugal, Judice and Vicente 1994): all infeasible columns change sides while their
    number falls, the last one alone where it does not. Should that not end soon, Lawson and Hanson's method, which
    must, begins where fewest were infeasible.
    """
    columns = len(x)
    passive = x > 0.0
    index = np.empty(columns, np.int64)
    values = np.empty(columns)
    w = np.empty(columns)
    wrong = np.empty(columns, np.bool_)
    fewest, chances, spent, used = columns + 1, CHANCES, 0, 0
    for _ in range(PIVOTINGS):
        if spent >= max_steps:
            break
        used, kept = collect(passive, index, used)
        spent += 1
        shift = factored(gram, index, used, kept, shift, factor, inverse)
        substitute(factor, inverse, index, used, linear, values)
        gradient(gram, linear, index, used, values, w)
        infeasible, last = 0, -1
        for j in range(columns):
            wrong[j] = not passive[j] and w[j] > tolerance
        for a in range(used):
            wrong[index[a]] = values[a] < 0.0
        for j in range(columns):
            if wrong[j]:
                infeasible += 1
                last = j
        if infeasible == 0:
            scatter(index, used, values, x)
            return spent, shift
        if infeasible < fewest:
            fewest, chances = infeasible, CHANCES
            scatter(index, used, values, x)
        else:
            chances -= 1
        for j in range(columns):
            if wrong[j] and (chances >= 0 or j == last):
                passive[j] = not passive[j]
    more, shift = lawson_hanson(gram, linear, shift, tolerance, max_steps - spent, x, factor, inverse)
    return spent + more, shift


@compiled
@no_type_check
def lawson_hanson(gram, linear, shift, tolerance, max_steps, x, factor, inverse):
    """Minimises from a feasible x, one column in at a time (Lawson and Hanson 1974); returns as `pivot` does.

    The objective falls with every step. A column that rounding alone lets in leaves at once, without a step; it is
    not asked again before x has moved. New columns are appended, and only the rows of the factor below the first
    column that left are made again.
    """
    columns = len(x)
    passive = x > 0.0
    refused = np.zeros(columns, np.bool_)
    index = np.empty(columns, np.int64)
    values = np.empty(columns)
    w = np.empty(columns)
    used, kept = collect(passive, index, 0)
    spent, entrant, moved = 0, -1, True
    while spent < max_steps:
        spent += 1
        shift = factored(gram, index, used, kept, shift, factor, inverse)
        substitute(factor, inverse, index, used, linear, values)
        left, kept, step = advance(index, used, values, passive, x)
        if left < used:
            used, moved = left, moved or step > 0.0
            continue
        if entrant >= 0 and not passive[entrant] and not moved:
            refused[entrant] = True
        else:
            refused[:] = False
        gradient(gram, linear, index, used, values, w)
        entrant = steepest(w, passive, refused, tolerance)
        if entrant < 0:
            used, kept = collect(passive, index, 0)
            shift = factored(gram, index, used, kept, shift, factor, inverse)
            substitute(factor, inverse, index, used, linear, values)
            if used == 0 or values[:used].min() > 0.0:
                scatter(index, used, values, x)
            return spent, shift
        passive[entrant] = True
        moved = False
        kept = used
        index[used] = entrant
        used += 1
    return spent, shift


@compiled
@no_type_check
def advance(index, used, values, passive, x):
    """Moves x towards the values until a passive column meets 0; columns at 0 whose values are not positive leave.

    Returns how many columns stay, how many of those head the list as before, and the length of the step.
    """
    step = 1.0
    for a in range(used):
        before = x[index[a]]
        if values[a] <= 0.0 and before <= step * (before - values[a]):
            step = before / (before - values[a]) if before > values[a] else 0.0
    left, kept = 0, used
    for a in range(used):
        j = index[a]
        end = x[j] + step * (values[a] - x[j])
        if values[a] <= 0.0 and end <= AT_BOUND * x[j]:  # rounding must not keep the one that blocks
            x[j], passive[j] = 0.0, False
            kept = min(kept, left)
        else:
            x[j] = end
            index[left] = j
            left += 1
    return left, kept, step


@compiled
@no_type_check
def steepest(w, passive, refused, tolerance):
    """Returns the column outside that lowers the objective fastest, -1 where none does."""
    entrant = -1
    for j in range(len(w)):
        if not passive[j] and not refused[j] and w[j] > tolerance and (entrant < 0 or w[j] > w[entrant]):
            entrant = j
    return entrant


@compiled
@no_type_check
def collect(passive, index, before):
    """Lists the passive columns in ascending order; returns how many, and how many head the list as before."""
    used, kept, same = 0, 0, True
    for j in range(len(passive)):
        if passive[j]:
            same = same and used < before and index[used] == j
            if same:
                kept += 1
            index[used] = j
            used += 1
    return used, kept


@compiled
@no_type_check
def scatter(index, used, values, x):
    """Sets x to the values on the passive columns, 0 elsewhere."""
    x[:] = 0.0
    for a in range(used):
        x[index[a]] = max(values[a], 0.0)


@compiled
@no_type_check
def factored(gram, index, used, kept, shift, factor, inverse):
    """Factors the passive block plus shift 1 as L L', its first rows being known; returns the shift that sufficed."""
    start = kept - kept % TILE
    while True:
        gather(gram, index, start, used, shift, factor)
        if cholesky(factor, inverse, start, used):
            return shift
        shift, start = 10.0 * shift, 0


@compiled
@no_type_check
def gather(gram, index, start, used, shift, factor):
    """Fills the lower triangle from a row on, and up to a whole tile with rows of the identity."""
    for a in range(start, used):
        row, target = gram[index[a]], factor[a]
        for b in range(a + 1):
            target[b] = row[index[b]]
        target[a] += shift
    for a in range(used, used + (-used) % TILE):
        factor[a, : a + 1] = 0.0
        factor[a, a] = 1.0


@compiled
@no_type_check
def cholesky(factor, inverse, start, used):
    """Replaces the rows from `start` on by those of L, and sets 1 / L_aa; returns whether the block is definite."""
    sums = np.zeros((TILE, TILE))
    for i in range(start, used, TILE):
        for j in range(0, i, TILE):
            tile_product(factor, i, j, sums)
            for a in range(TILE):
                for b in range(TILE):
                    total = factor[i + a, j + b] - sums[a, b]
                    for c in range(b):
                        total -= factor[i + a, j + c] * factor[j + b, j + c]
                    factor[i + a, j + b] = total * inverse[j + b]
        tile_product(factor, i, i, sums)
        for a in range(TILE):
            for b in range(a + 1):
                total = factor[i + a, i + b] - sums[a, b]
                for c in range(b):
                    total -= factor[i + a, i + c] * factor[i + b, i + c]
                if a > b:
                    factor[i + a, i + b] = total * inverse[i + b]
                elif not total > SMALLEST_PIVOT:
                    return False
                else:
                    factor[i + a, i + a] = np.sqrt(total)
                    inverse[i + a] = 1.0 / factor[i + a, i + a]
    return True


@compiled_sums
@no_type_check
def tile_product(factor, i, j, sums):
    """Fills the inner products of rows i to i + 3 with rows j to j + 3, over the columns before j.

    Sixteen sums in registers: per eight numbers loaded sixteen are multiplied, so the processor never waits.
    """
    r0, r1, r2, r3 = factor[i, :j], factor[i + 1, :j], factor[i + 2, :j], factor[i + 3, :j]
    q0, q1, q2, q3 = factor[j, :j], factor[j + 1, :j], factor[j + 2, :j], factor[j + 3, :j]
    s00 = s01 = s02 = s03 = s10 = s11 = s12 = s13 = 0.0
    s20 = s21 = s22 = s23 = s30 = s31 = s32 = s33 = 0.0
    for k in range(j):
        a0, a1, a2, a3 = r0[k], r1[k], r2[k], r3[k]
        b0, b1, b2, b3 = q0[k], q1[k], q2[k], q3[k]
        s00 += a0 * b0
        s01 += a0 * b1
        s02 += a0 * b2
        s03 += a0 * b3
        s10 += a1 * b0
        s11 += a1 * b1
        s12 += a1 * b2
        s13 += a1 * b3
        s20 += a2 * b0
        s21 += a2 * b1
        s22 += a2 * b2
        s23 += a2 * b3
        s30 += a3 * b0
        s31 += a3 * b1
        s32 += a3 * b2
        s33 += a3 * b3
    sums[0, 0], sums[0, 1], sums[0, 2], sums[0, 3] = s00, s01, s02, s03
    sums[1, 0], sums[1, 1], sums[1, 2], sums[1, 3] = s10, s11, s12, s13
    sums[2, 0], sums[2, 1], sums[2, 2], sums[2, 3] = s20, s21, s22, s23
    sums[3, 0], sums[3, 1], sums[3, 2], sums[3, 3] = s30, s31, s32, s33


@compiled_sums
@no_type_check
def substitute(factor, inverse, index, used, linear, values):
    """Solves L L' v = c on the passive columns."""
    for a in range(used):
        row, total = factor[a], 0.0
        for b in range(a):
            total += row[b] * values[b]
        values[a] = (linear[index[a]] - total) * inverse[a]
    for a in range(used - 1, -1, -1):
        value = values[a] * inverse[a]
        values[a] = value
        row = factor[a, :a]
        for b in range(a):
            values[b] -= value * row[b]


@compiled_sums
@no_type_check
def gradient(gram, linear, index, used, values, w):
    """Sets w = c - G x, four columns of G at a time."""
    w[:] = linear
    a = 0
    while a + 4 <= used:
        v0, v1, v2, v3 = values[a], values[a + 1], values[a + 2], values[a + 3]
        g0, g1, g2, g3 = gram[index[a]], gram[index[a + 1]], gram[index[a + 2]], gram[index[a + 3]]
        for j in range(len(w)):
            w[j] -= (v0 * g0[j] + v1 * g1[j]) + (v2 * g2[j] + v3 * g3[j])
        a += 4
    while a < used:
        v0, g0 = values[a], gram[index[a]]
        for j in range(len(w)):
            w[j] -= v0 * g0[j]
        a += 1
