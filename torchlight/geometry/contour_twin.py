"""The readable twin of the compiled kernels: every face's own outline, one direction after the other.

No edge is paired and no cluster skipped: each face contributes the crossings of its three edges, turned so that the
inside of its projection counts 1, and the sheets over a line are the running sum of all crossings from left to right.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool, Float

Faces = Float[np.ndarray, "faces 3 3"]


def visible_integrals(
    faces: Faces,
    slopes: Float[np.ndarray, "squares s s 2"],
    shifts: Float[np.ndarray, "squares s s"],
    weights: Float[np.ndarray, "squares s s"],
    grid: tuple[int, int, int],
) -> Float[np.ndarray, "squares points"]:
    """Returns the sum over each square's directions of weight x visible share of every footprint.

    Args:
        faces: above z = 0, in the grid's coordinates (`geometry.crossings.Grid`).
        slopes: dx / dz and dy / dz of the directions.
        shifts: where in its stratum each direction's lines lie.
        weights: of the directions.
        grid: samples in y and in x, and lines per row of samples.
    """
    rows, columns, lines = grid
    result = np.empty((len(slopes), rows * columns))
    for square, total in enumerate(weights.sum(axis=(1, 2))):
        hidden = np.zeros((rows, columns))
        for place in np.ndindex(weights.shape[1:]):
            share = hidden_lines(faces, slopes[square][place], shifts[square][place], rows * lines, columns)
            hidden += weights[square][place] * share.reshape(rows, lines, columns).mean(axis=1)
        result[square] = (total - hidden).reshape(-1)
    return result


def hidden_samples(
    faces: Faces, slopes: Float[np.ndarray, "directions 2"], rows: int, columns: int
) -> Bool[np.ndarray, "directions points"]:
    """Returns which samples have their centres hidden from each direction; one line per row of samples."""
    centers = np.arange(columns) + 0.5
    hidden = np.zeros((len(slopes), rows, columns), dtype=bool)
    for number, slope in enumerate(slopes):
        for line, places, steps in crossings(faces, slope, 0.5, rows):
            sheets = np.r_[0.0, np.cumsum(steps)]
            hidden[number, line] = sheets[np.searchsorted(places, centers, side="right")] != 0
    return hidden.reshape(len(slopes), -1)


def hidden_lines(
    faces: Faces, slope: Float[np.ndarray, " 2"], shift: float, lines: int, columns: int
) -> Float[np.ndarray, "lines columns"]:
    """Returns the share of every unit interval of every line y = line + shift that faces hide along one direction."""
    shares = np.zeros((lines, columns))
    for line, places, steps in crossings(faces, slope, shift, lines):
        hidden = np.cumsum(steps)[:-1] != 0
        covered = np.clip(places[:, None] - np.arange(columns), 0.0, 1.0)
        shares[line] = np.diff(covered, axis=0)[hidden].sum(axis=0)
    return shares


def crossings(
    faces: Faces, slope: Float[np.ndarray, " 2"], shift: float, lines: int
) -> Iterator[tuple[int, Float[np.ndarray, " crossings"], Float[np.ndarray, " crossings"]]]:
    """Yields each line y = line + shift, where faces' projected edges cross it, and what each adds to the sheets."""
    seen = faces[..., :2] - slope * faces[..., 2:] - [0.0, shift]
    first, second = seen[:, 1] - seen[:, 0], seen[:, 2] - seen[:, 0]
    facing = np.repeat(np.sign(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]), 3)
    start, end = seen.reshape(-1, 2), np.roll(seen, -1, axis=1).reshape(-1, 2)
    for line in range(lines):
        # downwards 1, upwards -1: the outline of a face seen from its front runs counter-clockwise
        step = np.where(end[:, 1] <= line, 1.0, 0.0) - np.where(start[:, 1] <= line, 1.0, 0.0)
        crossed = step != 0
        a, b = start[crossed], end[crossed]
        places = a[:, 0] + (line - a[:, 1]) * (b[:, 0] - a[:, 0]) / (b[:, 1] - a[:, 1])
        order = np.argsort(places, kind="stable")
        yield line, places[order], (step * facing)[crossed][order]
