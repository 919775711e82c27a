"""Draws docs/images/formats.png: the axis-coloured test map in every kind of picture, with the world's axes on it.

    python scripts/draw_formats.py --out docs/images

Pictures and places of the labels come from the package: a label stands where that kind puts the light of its axis.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import torch
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from torch import Tensor

from torchlight.light.formats import grid_for, is_latlong, to_picture
from torchlight.light.grids import Grid
from torchlight.light.procedural import axis_faces
from torchlight.light.sampled import converted
from torchlight.preview import to_srgb8

SIZES = {"angular": 401, "cross": 101, "horizontal-cross": 101, "strip": 101, "opengl-strip": 101}
LATLONG = 200
AXES = {
    "+X": (1.0, 0.0, 0.0),
    "-X": (-1.0, 0.0, 0.0),
    "+Y": (0.0, 1.0, 0.0),
    "-Y": (0.0, -1.0, 0.0),
    "+Z": (0.0, 0.0, 1.0),
    "-Z": (0.0, 0.0, -1.0),
}
TITLES = {
    "torchlight": "torchlight, blender, threejs (lat-long, 2:1)",
    "openexr": "openexr, usd, mitsuba",
    "skylibs": "skylibs",
    "cross": "cross (vertical, 3:4)",
    "horizontal-cross": "horizontal-cross (4:3)",
    "angular": "angular (Debevec's angular map, 1:1)",
    "strip": "strip (6:1)",
    "opengl-strip": "opengl-strip (6:1): every face mirrored",
}
PLACES = {  # left, top, width and height, in units of a lat-long's height
    "torchlight": (0.0, 0.2, 2.0, 1.0),
    "openexr": (2.15, 0.2, 2.0, 1.0),
    "skylibs": (4.3, 0.2, 2.0, 1.0),
    "cross": (0.1, 1.5, 1.2, 1.6),
    "horizontal-cross": (1.75, 1.5, 2.13, 1.6),
    "angular": (4.5, 1.5, 1.6, 1.6),
    "strip": (0.0, 3.4, 3.06, 0.51),
    "opengl-strip": (3.24, 3.4, 3.06, 0.51),
}
ACROSS, DOWN, INCHES = 6.3, 3.93, 1.75
BRIGHTEST = 1.75


def draw(axes: Axes, kind: str) -> None:
    """Draws the map in a kind of picture; captions are white."""
    grid = grid_for(kind, LATLONG if is_latlong(kind) else SIZES[kind])
    light = converted(axis_faces(LATLONG), grid)
    image = to_picture(light.radiance, grid, kind) / BRIGHTEST
    lit = to_picture(torch.ones_like(light.radiance), grid, kind)
    axes.imshow(to_srgb8(torch.where(lit > 0, image, 1.0)), interpolation="nearest")
    for name, direction in AXES.items():
        row, column = place(grid, kind, torch.tensor(direction, dtype=torch.float64))
        write(axes, name, row, column, image.shape[-2:])
    axes.set_title(TITLES[kind], fontsize=10)
    axes.axis("off")


def place(grid: Grid, kind: str, direction: Tensor) -> tuple[float, float]:
    """Returns the row and column at which a picture shows a direction; the middle of the row at a lat-long's poles."""
    marked = torch.zeros(grid.solid_angles().shape[0]).index_fill(0, grid.locate(direction), 1.0)
    picture = to_picture(marked, grid, kind)
    row, column = divmod(int(picture.argmax()), picture.shape[-1])
    at_pole = is_latlong(kind) and direction[2].abs() == 1
    return row, picture.shape[-1] / 2 if at_pole else column


def write(axes: Axes, name: str, row: float, column: float, shape: tuple[int, ...]) -> None:
    """Writes a label that can be read on any colour, whole within the picture."""
    height, width = shape
    left, right = column < 0.02 * width, column > 0.98 * width
    top, bottom = row < 0.02 * height, row > 0.98 * height
    box = {"facecolor": "white", "alpha": 0.9, "edgecolor": "none", "pad": 1.5}
    align = "left" if left else "right" if right else "center"
    vertical = "top" if top else "bottom" if bottom else "center"
    axes.text(column, row, name, ha=align, va=vertical, fontsize=10, weight="bold", bbox=box)


def main() -> None:
    """Draws the picture."""
    parser = argparse.ArgumentParser(description="Draws the test map in every kind of picture.")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder for the picture")
    out: Path = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    figure = Figure(figsize=(ACROSS * INCHES, DOWN * INCHES), dpi=100)
    for kind, (left, top, width, height) in PLACES.items():
        frame = (left / ACROSS, 1 - (top + height) / DOWN, width / ACROSS, height / DOWN)
        draw(figure.add_axes(frame), kind)
    FigureCanvasAgg(figure).print_png(str(out / "formats.png"))


if __name__ == "__main__":
    main()
