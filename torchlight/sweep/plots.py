"""Pictures of a sweep as PNG bytes: figures against each axis, and the fewest functions for an error."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import cycle
from pathlib import Path
from statistics import median
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from torchlight.drawing.canvas import png_bytes
from torchlight.io.atomic import make_folder, write_atomically
from torchlight.io.sweep_file import Axis, Choices, Sweep

# Okabe and Ito's palette, told apart with every common colour blindness; markers and dashes say the same again
STYLES = tuple(
    zip(
        ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#D55E00", "#56B4E9", "#000000"),
        ("o", "s", "^", "D", "v", "P", "X"),
        ("-", "--", "-.", ":", "-", "--", "-."),
        strict=True,
    )
)
UNITS = {
    "held_out_rms_255": "RMS on poses never shown [of 255]",
    "fit_rms_255": "RMS of the fit [of 255]",
    "functions": "functions per channel",
    "light.resolution": "light.resolution [texels along a cube edge]",
    "adaptive.noise": "adaptive.noise [share of the brightest sample]",
    "data.noise": "data.noise [share of the brightest sample]",
    "data.samples": "data.samples [samples along a side]",
}
SPREAD = 8.0  # an axis whose largest number is so many times its smallest is drawn in ratios
Row = Mapping[str, Any]


def write_plots(out: Path, sweep: Sweep, rows: Sequence[Row]) -> list[Path]:
    """Writes all pictures of the trials that are done and returns their paths; none where none is done."""
    done = [row for row in rows if row["state"] == "done"]
    if not done:
        return []
    make_folder(out / "plots")
    paths = []
    for name, picture in pictures(sweep, done):
        paths.append(out / "plots" / f"{name}.png")
        write_atomically(paths[-1], picture)
    return paths


def pictures(sweep: Sweep, done: Sequence[Row]) -> Iterator[tuple[str, bytes]]:
    """Yields name and PNG of every picture."""
    score = score_of(done)
    for key in sweep.axes:
        yield f"{score}_against_{key}", against(sweep, done, key, score)
    yield "pareto", pareto_picture(sweep, done, score)


def score_of(rows: Sequence[Row]) -> str:
    """Returns the figure that trials are judged by: on what was held out, where anything was."""
    return next(name for name in ("held_out_rms_255", "fit_rms_255") if name in rows[0])


def against(sweep: Sweep, done: Sequence[Row], key: str, score: str) -> bytes:
    """Returns the score of all trials against one axis; lines are medians over all other axes but the one named."""
    figure = Figure(figsize=(7.6, 4.6), dpi=110, layout="constrained")
    axis = figure.subplots()
    listed = sweep.axes[key]
    place = places(listed)
    other = companion(sweep, key)
    for (colour, marker, dash), (label, rows) in zip(cycle(STYLES), grouped(done, other), strict=False):
        axis.scatter([place(row[key]) for row in rows], [row[score] for row in rows], s=22, color=colour, marker=marker)
        if isinstance(listed, Choices):
            values = [value for value in listed.values if any(row[key] == value for row in rows)]
            middles = [median(row[score] for row in rows if row[key] == value) for value in values]
            axis.plot([place(value) for value in values], middles, color=colour, linestyle=dash)
        axis.plot([], [], color=colour, marker=marker, linestyle=dash, label=label)
    along(axis, listed)
    axis.set_xlabel(UNITS.get(key, key))
    upwards(axis, [row[score] for row in done], UNITS[score])
    if other is not None:
        axis.legend(title=other, fontsize=9, title_fontsize=9)
    axis.set_title(f"{len(done)} trials; lines: medians over the other axes", fontsize=10)
    return png_bytes(figure)


def pareto_picture(sweep: Sweep, done: Sequence[Row], score: str) -> bytes:
    """Returns the score of all trials against their functions, and the front: fewer functions cost error there."""
    figure = Figure(figsize=(7.6, 4.6), dpi=110, layout="constrained")
    axis = figure.subplots()
    other = companion(sweep, None)
    for (colour, marker, _), (label, rows) in zip(cycle(STYLES), grouped(done, other), strict=False):
        x, y = [row["functions"] for row in rows], [row[score] for row in rows]
        axis.scatter(x, y, s=30, color=colour, marker=marker, label=label)
    front = pareto_front([(row["functions"], row[score]) for row in done])
    axis.step(*zip(*front, strict=True), where="post", color="0.35", linewidth=1.2, label="front", zorder=0)
    if max(row["functions"] for row in done) > SPREAD * min(row["functions"] for row in done):
        axis.set_xscale("log")
        plain_numbers(axis.xaxis)
    axis.set_xlabel(UNITS["functions"])
    upwards(axis, [row[score] for row in done], UNITS[score])
    axis.legend(title=other, fontsize=9, title_fontsize=9)
    axis.set_title(f"{len(done)} trials; on the front no other has fewer functions and less error", fontsize=10)
    return png_bytes(figure)


def pareto_front(points: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """Returns the points (functions, error) that no other equals or beats in both, by increasing functions."""
    front: list[tuple[float, float]] = []
    for functions, error in sorted(set(points)):
        if not front or error < front[-1][1]:
            front.append((functions, error))
    return front


def companion(sweep: Sweep, key: str | None) -> str | None:
    """Returns the first other axis with few listed values: what colours stand for."""
    return next(
        (
            name
            for name, axis in sweep.axes.items()
            if name != key and isinstance(axis, Choices) and len(axis.values) <= len(STYLES)
        ),
        None,
    )


def grouped(rows: Sequence[Row], key: str | None) -> Iterator[tuple[str | None, Sequence[Row]]]:
    """Yields the rows of each value of an axis; all of them where there is none."""
    if key is None:
        yield None, rows
        return
    for value in dict.fromkeys(row[key] for row in rows):
        yield named(value), [row for row in rows if row[key] == value]


def named(value: Any) -> str:
    """Returns a value as the sweep's file writes it."""
    return str(value) if isinstance(value, str) else json.dumps(value)


def numeric(axis: Axis) -> bool:
    """Returns whether all values of an axis are numbers."""
    values = axis.values if isinstance(axis, Choices) else (axis.low, axis.high)
    return all(isinstance(value, int | float) and not isinstance(value, bool) for value in values)


def places(axis: Axis) -> Callable[[Any], float]:
    """Returns where a value is drawn: numbers where they are, others in the file's order."""
    if numeric(axis) or not isinstance(axis, Choices):
        return float
    return lambda value: float(axis.values.index(value))


def along(drawn: Axes, axis: Axis) -> None:
    """Sets the horizontal axis up: ratios where numbers spread widely, listed values named."""
    values = axis.values if isinstance(axis, Choices) else (axis.low, axis.high)
    if numeric(axis) and min(values) > 0 and max(values) >= SPREAD * min(values):
        drawn.set_xscale("log")
        plain_numbers(drawn.xaxis)
    if isinstance(axis, Choices):
        drawn.xaxis.set_minor_locator(NullLocator())
        drawn.set_xticks([places(axis)(value) for value in values], [named(value) for value in values])


def upwards(drawn: Axes, scores: Sequence[float], label: str) -> None:
    """Sets the vertical axis up: from 0, or in ratios where errors spread widely."""
    drawn.set_ylabel(label)
    drawn.grid(visible=True, color="0.9", linewidth=0.6)
    drawn.set_axisbelow(True)
    if min(scores) > 0 and max(scores) > SPREAD * min(scores):
        drawn.set_yscale("log")
        plain_numbers(drawn.yaxis)
    else:
        drawn.set_ylim(bottom=0)


def plain_numbers(side: Any) -> None:
    """Writes numbers on a logarithmic side as they are, not as powers."""
    side.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    side.set_minor_locator(LogLocator(subs=(2.0, 5.0)))
    side.set_minor_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
