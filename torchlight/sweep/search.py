"""Which points are tried: all of a grid, or some at random. Optuna's are in `optuna_search`.

A search yields groups of points and is sent what came of each; the points follow from the file and the seed alone.
"""

from __future__ import annotations

import itertools
import math
import random
from collections.abc import Generator, Mapping, Sequence
from typing import Any

from torchlight.io.sweep_file import Axis, Choices, Sweep

Point = Mapping[str, Any]
Answers = Sequence[float | None]
Points = Generator[Sequence[Point], Answers, None]


def grid(sweep: Sweep) -> Points:
    """Yields all points in one group, the last axis fastest."""
    listed = [axis.values for axis in sweep.axes.values() if isinstance(axis, Choices)]
    yield [dict(zip(sweep.axes, values, strict=True)) for values in itertools.product(*listed)]


def at_random(sweep: Sweep) -> Points:
    """Yields `search.trials` points in one group; the first n are the same however many are asked for."""
    yield [random_point(sweep, index) for index in range(sweep.search.trials)]


def random_point(sweep: Sweep, index: int) -> Point:
    """Returns a point drawn with a generator of its own, seeded by the sweep's seed and the point's number."""
    generator = random.Random(f"{sweep.seed} {index}")  # noqa: S311 (a seed, not a secret)
    return {key: drawn(axis, generator) for key, axis in sweep.axes.items()}


def drawn(axis: Axis, generator: random.Random) -> Any:
    """Returns a value of an axis: each choice, each number or (log) each ratio is equally likely."""
    if isinstance(axis, Choices):
        return generator.choice(axis.values)
    if axis.whole and not axis.log:
        return generator.randint(int(axis.low), int(axis.high))
    # integers own the numbers that round to them, so that the two ends are as likely as their neighbours
    low, high = (axis.low - 0.5, axis.high + 0.5) if axis.whole else (axis.low, axis.high)
    value = math.exp(generator.uniform(math.log(low), math.log(high))) if axis.log else generator.uniform(low, high)
    value = min(max(value, axis.low), axis.high)
    return round(value) if axis.whole else value
