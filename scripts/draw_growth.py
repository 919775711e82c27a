"""Draws docs/images/growth.png from what scripts/bench/growth.py measured: seconds along each axis, with fitted powers.

python scripts/draw_growth.py [--bench out/bench] [--out docs/images/growth.png]
"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np
import tyro
from draw_performance import DOCS, rows
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from torchlight.drawing.canvas import png_bytes
from torchlight.io.atomic import write_atomically

COLOURS = {"transport": "#0072B2", "non-negative solve": "#D55E00"}  # after Okabe and Ito
MARKS = {"transport": "o", "non-negative solve": "s"}
AXES = ("samples", "texels", "faces", "photographs")


def main(bench: Path = Path("out/bench"), out: Path = DOCS / "images" / "growth.png") -> None:
    """Writes the picture.

    Args:
        bench: folder of growth.csv.
        out: the picture.
    """
    path = bench / "growth.csv"
    if not path.is_file():
        sys.exit(f"draw_growth: no '{path}'; run scripts/bench/growth.py first")
    found = rows(path)
    mpl.rcParams["font.size"] = 9
    figure = Figure(figsize=(11.0, 3.2), dpi=110, layout="constrained")
    for axis, name in zip(figure.subplots(1, len(AXES), sharey=True), AXES, strict=True):
        for what in COLOURS:
            some = [row for row in found if (row["what"], row["axis"]) == (what, name)]
            if some:
                draw(axis, what, *(np.array([float(row[key]) for row in some]) for key in ("size", "seconds")))
        axis.set_xscale("log")
        axis.set_yscale("log")
        axis.set_xlabel(name)
        axis.grid(visible=True, which="major", color="0.9")
        axis.legend(fontsize=8, frameon=False)
    figure.axes[0].set_ylabel("seconds")
    write_atomically(out, png_bytes(figure))
    print(out)


def draw(axis: Axes, what: str, sizes: np.ndarray, seconds: np.ndarray) -> None:
    """Draws measured points and the straight line through their logarithms."""
    power, start = np.polyfit(np.log(sizes), np.log(seconds), 1)
    axis.plot(sizes, seconds, MARKS[what], color=COLOURS[what], label=f"{what}: power {power:.2f}")
    axis.plot(sizes, np.exp(start) * sizes**power, color=COLOURS[what], linewidth=1)


if __name__ == "__main__":
    tyro.cli(main)
