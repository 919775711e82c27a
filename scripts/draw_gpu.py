"""Draws docs/images/gpu.png: which steps of an estimate run on the CPU and which on the GPU.

python scripts/draw_gpu.py
"""

from __future__ import annotations

from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

IMAGE = Path(__file__).parents[1] / "docs" / "images" / "gpu.png"
SIZE = (2.3, 0.62)
CPU, GPU = "#e8e8e8", "#bfe0f2"
BOXES = {
    "photographs:\nfiles, camera, glints": (0, 2, CPU),
    "scene: occluders,\ntheir edges prepared": (0, 0, CPU),
    "samples b": (3, 2, GPU),
    "transport T": (3, 0, GPU),
    "T x = b, x >= 0,\ncertificates": (6, 1, GPU),
    "trees of the adaptive\nmethod grow": (6, 2.6, GPU),
    "light, peaks,\nprediction, errors": (9, 1, GPU),
    "result files": (12, 1, CPU),
}
ARROWS = [(0, 2), (1, 3), (2, 4), (3, 4), (4, 6), (6, 7), (2, 5), (5, 6)]


def main() -> None:
    """Writes the picture."""
    figure = Figure(figsize=(11, 3.2), layout="constrained")
    axis = figure.add_subplot()
    axis.set(xlim=(-1.4, 13.4), ylim=(-0.9, 3.2), aspect="auto")
    axis.set_axis_off()
    places = [(x, y) for x, y, _ in BOXES.values()]
    for text, (x, y, colour) in BOXES.items():
        box(axis, text, (x, y), colour)
    for start, end in ARROWS:
        arrow(axis, places[start], places[end])
    box(axis, "CPU", (9.6, -0.55), CPU)
    box(axis, "GPU", (12, -0.55), GPU)
    IMAGE.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(IMAGE, dpi=110)


def box(axis: Axes, text: str, middle: tuple[float, float], colour: str) -> None:
    """Draws a step."""
    width, height = SIZE
    corner = (middle[0] - width / 2, middle[1] - height / 2)
    axis.add_patch(Rectangle(corner, width, height, facecolor=colour, edgecolor="black", linewidth=0.8))
    axis.text(*middle, text, ha="center", va="center", fontsize=9)


def arrow(axis: Axes, start: tuple[float, float], end: tuple[float, float]) -> None:
    """Draws what goes from one step to the next."""
    half = SIZE[0] / 2
    head, tail = (end[0] - half, end[1]), (start[0] + half, start[1])
    axis.annotate("", xy=head, xytext=tail, arrowprops={"arrowstyle": "->", "linewidth": 1.0})


if __name__ == "__main__":
    main()
