"""Non-negative least squares on a Gram matrix in compiled code, many right-hand sides without the interpreter.

Readable twin: `active_set.minimize_nonnegative`. Unless less is asked, an answer is a function of the set of passive
columns alone (the last factor is that of the set in ascending order), so it does not depend on the start.
"""

from __future__ import annotations

from typing import no_type_check

import numpy as np

from torchlight.compiled import compiled, compiled_sums
from torchlight.solvers.border_kernel import begin, bordered, empty_border
from torchlight.solvers.factor_kernel import TILE, backward, factored, forward, substitute
from torchlight.solvers.passive_kernel import collect, gradient, scatter

PIVOTINGS = 20
CHANCES = 3
FEW_WRONG = 2  # columns on the wrong side: with no more the next set is likely the last, and is factored
PROMISING = 0.1  # of the largest w outside: what comes in
CAREFUL = 10  # pivotings in which only that does; where nearly all columns belong in, it would take hundreds
SMALLEST_SHIFT = 1e-13  # just above the rounding of a float64 Gram matrix with unit diagonal
SHIFT_ROUNDS = 50
AT_BOUND = 1e-10  # of its value before the step: a coefficient this small has reached 0
SLACK = 0.1  # of the cosine: columns nearer to a right angle are left outside; more would save little
SMALLEST_SQUARE = 1e-12  # of |b|^2: smaller residuals are rounding


@compiled
@no_type_check
def minimize_items(gram, linear, ridge, tolerance, cosine, near, max_steps, x, steps):
    """Minimises x'Gx/2 - c'x + ridge |x|^2/2 over x >= 0 for every row of c and x, in place.

    Args:
        gram: G, symmetric, positive semidefinite to rounding, with unit diagonal (or a row of zeros), [n, n].
        linear: c, of order one, [items, n].
        ridge: at least 0. Below 1e-13, or where columns are dependent to rounding, the factors carry a larger one,
            whose effect is then removed by proximal rounds.
        tolerance: on w = c - G x - ridge x: w_j at most this everywhere, and |w_j| where x_j > 0.
        cosine: above 0, where c is A'b of a |b| = 1, an item also ends where w = c - G x, of a minimum on a face with
            its negative values set to 0, is at most this times |r| in the sense of the tolerance; |r|^2 follows from w.
            Columns whose own cosine is a tenth of it or less are not let in.
        near: 0: an answer is a function of the set of passive columns alone. Above 0 it may come from the factor of
            another set (`border_kernel`) where |w_j| <= near if x_j > 0, which is less work.
        max_steps: factorisations per item, whole or in part, and sets solved without.
        x: in: where to begin, only x > 0 counts while that leads to the end; out: the answer, at least 0.
        steps: out: factorisations spent; max_steps where that did not suffice.
    """
    columns = gram.shape[0]
    room = columns + TILE
    factor = np.zeros((room, room))
    inverse = np.ones(room)
    border = empty_border(columns)
    for item in range(len(x)):
        c, start = linear[item], x[item]
        steps[item] = minimize(gram, c, ridge, tolerance, cosine, near, max_steps, start, factor, inverse, border)


@compiled
@no_type_check
def minimize(gram, linear, ridge, tolerance, cosine, near, max_steps, x, factor, inverse, border):
    """Minimises for one item; returns the factorisations."""
    shift = max(ridge, SMALLEST_SHIFT)
    pulled = np.zeros(len(x))
    shifted = linear.copy()
    spent = 0
    for _ in range(SHIFT_ROUNDS):
        left = max_steps - spent
        more, shift = pivot(gram, shifted, shift, tolerance, cosine, near, left, x, factor, inverse, border)
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
def pivot(gram, linear, shift, tolerance, cosine, near, max_steps, x, factor, inverse, border):
    """Minimises with a positive shift in place of the ridge; returns the factorisations and the shift that held.

    Block principal pivoting (Portugal, Judice and Vicente 1994): infeasible columns change sides while their number
    falls, the last one alone where it does not. Should that not end soon, Lawson and Hanson's method, which must,
    begins where fewest were infeasible. Sets that few changes make of the last one factored are solved with its factor
    (`border_kernel`), until none is infeasible: then, and where hardly any is, the set gets a factor of its own, unless
    what is `near` or has the cosine will do.
    """
    columns = len(x)
    passive = x > 0.0
    index, current, wrong = np.empty(columns, np.int64), np.empty(columns, np.int64), np.empty(columns, np.bool_)
    values, w, rough = np.empty(columns), np.empty(columns), np.empty(columns)
    few = 0 if near > 0.0 or cosine > 0.0 else FEW_WRONG
    fewest, chances, spent, pivoting, used, rows, infeasible = columns + 1, CHANCES, 0, 0, 0, 0, 0
    while pivoting < PIVOTINGS and spent < max_steps:
        spent += 1
        listed = -1
        if infeasible > few:
            listed, rows = bordered(
                gram, linear, shift, passive, index, used, factor, inverse, border, rows, current, values
            )
        exact = listed < 0
        if exact:
            used, kept = collect(passive, index, used)
            shift = factored(gram, index, used, kept, shift, factor, inverse)
            forward(factor, inverse, index, used, linear, values)
            begin(border, index, used, values)
            backward(factor, inverse, used, values)
            current[:used], listed, rows = index[:used], used, 0
        gradient(gram, linear, current, listed, values, w)
        least = enough(linear, current, listed, values, w, tolerance, cosine)
        infeasible = judge(passive, current, listed, values, w, least, wrong)
        done = infeasible == 0 and (exact or unrest(current, listed, values, w, shift) <= near)
        if done or (cosine > 0.0 and met(gram, linear, current, listed, values, w, cosine, rough)):
            scatter(current, listed, values, x)
            return spent, shift
        if infeasible == 0:
            continue  # to a factor of this very set
        if infeasible < fewest:
            fewest, chances = infeasible, CHANCES
            scatter(current, listed, values, x)
        else:
            chances -= 1
        swap(passive, wrong, w, PROMISING if pivoting < CAREFUL else 0.0, chances)
        pivoting += 1
    more, shift = lawson_hanson(gram, linear, shift, tolerance, cosine, max_steps - spent, x, factor, inverse)
    return spent + more, shift


@compiled
@no_type_check
def judge(passive, index, used, values, w, tolerance, wrong):
    """Marks the columns that are on the wrong side: negative values, and w_j > 0 outside. Returns how many they are."""
    infeasible = 0
    for j in range(len(w)):
        wrong[j] = not passive[j] and w[j] > tolerance
        infeasible += wrong[j]
    for a in range(used):
        wrong[index[a]] = values[a] < 0.0
        infeasible += wrong[index[a]]
    return infeasible


@compiled
@no_type_check
def unrest(index, used, values, w, shift):
    """Returns the largest |w_j| of the passive columns, of the objective with the shift."""
    worst = 0.0
    for a in range(used):
        worst = max(worst, abs(w[index[a]] - shift * values[a]))
    return worst


@compiled
@no_type_check
def swap(passive, wrong, w, share, chances):
    """Lets wrong columns change sides: the last one alone where no chance is left.

    Else all negative ones leave, but only those come in whose w is at least a share of the largest: one that is missing
    makes its neighbours wanted.
    """
    promise, last = 0.0, -1
    for j in range(len(w)):
        if wrong[j]:
            last = j
            if not passive[j]:
                promise = max(promise, w[j])
    for j in range(len(w)):
        chosen = j == last if chances < 0 else wrong[j] and (passive[j] or w[j] >= share * promise)
        if chosen:
            passive[j] = not passive[j]


@compiled
@no_type_check
def met(gram, linear, index, used, values, w, cosine, rough):
    """Returns whether the cosine holds once negative values are 0: w = c - G x then changes by their columns alone."""
    rough[:] = w
    for a in range(used):
        if values[a] < 0.0:
            add_row(values[a], gram[index[a]], rough)
    square, worst = 1.0, 0.0
    for a in range(used):
        j = index[a]
        if values[a] > 0.0:
            square -= (linear[j] + rough[j]) * values[a]
            worst = max(worst, abs(rough[j]))
    for j in range(len(rough)):
        worst = max(worst, rough[j])
    return worst <= cosine * np.sqrt(max(square, SMALLEST_SQUARE))


@compiled_sums
@no_type_check
def add_row(share, row, w):
    """Adds a multiple of a row."""
    for j in range(len(w)):
        w[j] += share * row[j]


@compiled
@no_type_check
def enough(linear, index, used, values, w, tolerance, cosine):
    """Returns the w_j = (c - G x)_j that lets a column in: a tenth of what the cosine allows, or the tolerance."""
    square = 1.0
    if cosine > 0.0:
        for a in range(used):
            square -= (linear[index[a]] + w[index[a]]) * values[a]
    return max(tolerance, SLACK * cosine * np.sqrt(max(square, SMALLEST_SQUARE)))


@compiled
@no_type_check
def lawson_hanson(gram, linear, shift, tolerance, cosine, max_steps, x, factor, inverse):
    """Minimises from a feasible x, one column in at a time (Lawson and Hanson 1974); returns as `pivot` does.

    The objective falls with every step. A column that rounding alone lets in leaves at once, without a step; it is
    not asked again before x has moved. New columns are appended; only rows below the first that left are made again.
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
        entrant = steepest(w, passive, refused, enough(linear, index, used, values, w, tolerance, cosine))
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
