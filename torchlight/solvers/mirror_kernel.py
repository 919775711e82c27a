"""A symmetric matrix from its lower triangle, rows and columns scaled on the way, in compiled code."""

from __future__ import annotations

from typing import no_type_check

from torchlight.compiled import compiled

SQUARE = 8  # numbers of a line of the cache; more lines, a row apart each, may fall on one another there


@compiled
@no_type_check
def mirror(matrix, scale):
    """Sets entries i, j and j, i to scale_i scale_j times the entry i, j, i >= j, in place."""
    columns = len(scale)
    for top in range(0, columns, SQUARE):
        for left in range(0, top + 1, SQUARE):
            for i in range(top, min(top + SQUARE, columns)):
                for j in range(left, min(left + SQUARE, i + 1)):
                    value = matrix[i, j] * scale[i] * scale[j]
                    matrix[i, j] = value
                    matrix[j, i] = value
