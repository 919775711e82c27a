"""Cholesky factors of rows and columns picked from a Gram matrix, in compiled code."""

from __future__ import annotations

from typing import no_type_check

import numpy as np

from torchlight.compiled import compiled, compiled_sums

SMALLEST_PIVOT = 1e-14
LEAST_ADDED = 1e-13
TILE = 4


@compiled
@no_type_check
def solve_items(gram, damping, linear, x):
    """Sets every row of x to (G + diag(damping))^-1 c, without a sign constraint.

    Where that is not definite, the smallest of 1e-13, 1e-12, ... that makes it so is added to the diagonal.
    """
    columns = gram.shape[0]
    factor = np.zeros((columns + TILE, columns + TILE))
    inverse = np.ones(columns + TILE)
    index = np.arange(columns)
    more = 0.0
    while True:
        gather(gram, index, 0, columns, more, factor)
        for a in range(columns):
            factor[a, a] += damping[a]
        if cholesky(factor, inverse, 0, columns):
            break
        more = max(10.0 * more, LEAST_ADDED)
    for item in range(len(x)):
        substitute(factor, inverse, index, columns, linear[item], x[item])


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
            tile_product(factor, i, factor, j, sums)
            for a in range(TILE):
                for b in range(TILE):
                    total = factor[i + a, j + b] - sums[a, b]
                    for c in range(b):
                        total -= factor[i + a, j + c] * factor[j + b, j + c]
                    factor[i + a, j + b] = total * inverse[j + b]
        tile_product(factor, i, factor, i, sums)
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
def tile_product(rows, i, factor, j, sums):
    """Fills the inner products of rows i to i + 3 with the factor's rows j to j + 3, over the columns before j.

    Sixteen sums in registers: per eight numbers loaded sixteen are multiplied, so the processor never waits.
    """
    r0, r1, r2, r3 = rows[i, :j], rows[i + 1, :j], rows[i + 2, :j], rows[i + 3, :j]
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


@compiled
@no_type_check
def substitute(factor, inverse, index, used, linear, values):
    """Solves L L' v = c on the passive columns."""
    forward(factor, inverse, index, used, linear, values)
    backward(factor, inverse, used, values)


@compiled_sums
@no_type_check
def forward(factor, inverse, index, used, linear, values):
    """Solves L v = c on the passive columns."""
    for a in range(used):
        row, total = factor[a], 0.0
        for b in range(a):
            total += row[b] * values[b]
        values[a] = (linear[index[a]] - total) * inverse[a]


@compiled_sums
@no_type_check
def backward(factor, inverse, used, values):
    """Solves L' v = v in place."""
    for a in range(used - 1, -1, -1):
        value = values[a] * inverse[a]
        values[a] = value
        row = factor[a, :a]
        for b in range(a):
            values[b] -= value * row[b]
