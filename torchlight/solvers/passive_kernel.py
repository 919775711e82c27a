"""The columns in use as a list, and the gradient from it, in compiled code."""

from __future__ import annotations

from typing import no_type_check

from torchlight.compiled import compiled, compiled_sums


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
