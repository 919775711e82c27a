"""Draws docs/images/latlong.png and cubemap.png: which way the light's pictures look, and how texels are numbered.

    python scripts/draw_light.py --out docs/images

Directions, numbers and colours come from the package, so that the pictures cannot disagree with the code.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from torchlight.light import cubemap
from torchlight.light.formats import to_latlong
from torchlight.light.procedural import axis_colours
from torchlight.preview import to_srgb8

RED, GREEN = "#D55E00", "#009E73"
RESOLUTION = 4
PLACES = {"+y": (0, 1), "+x": (1, 1), "-y": (2, 1), "-x": (3, 1), "+z": (1, 2), "-z": (1, 0)}  # column, row from below
CONVENTIONS = {
    "torchlight": ("torchlight, Blender: Z up", ("-X", "+Y", "+X", "-Y", "-X"), "+Z"),
    "openexr": (
        "OpenEXR, USD, Mitsuba: Y up; the same light, rolled left by a quarter",
        ("-Z", "+X", "+Z", "-X", "-Z"),
        "+Y",
    ),
}


def draw_latlong(axes: Axes, convention: str) -> None:
    """Draws the axis-coloured test map in a convention, with that convention's own names of the axes."""
    title, around, up = CONVENTIONS[convention]
    height = 180
    image = to_latlong(axis_colours(height).radiance, convention)
    axes.imshow(to_srgb8(image / image.max()), extent=(0, 2 * height, height, 0), interpolation="bilinear")
    for quarter, name in enumerate(around):
        align = {0: "left", 4: "right"}.get(quarter, "center")
        write(axes, quarter * height / 2, height / 2, name, align)
    write(axes, height, 12, up, "center")
    write(axes, height, height - 12, up.replace("+", "-"), "center")
    axes.set_title(title, fontsize=12)
    axes.axis("off")


def write(axes: Axes, x: float, y: float, text: str, align: str) -> None:
    """Writes a label that can be read on any colour."""
    box = {"facecolor": "white", "alpha": 0.85, "edgecolor": "none", "pad": 2}
    axes.annotate(text, (x, y), ha=align, va="center", fontsize=13, weight="bold", bbox=box)


def draw_faces(axes: Axes) -> None:
    """Draws the cube, unfolded and seen from inside, with the number of every texel."""
    visible = set(cubemap.visible_texels(RESOLUTION).tolist())
    for face, name in enumerate(cubemap.FACES):
        left, bottom = (RESOLUTION * place for place in PLACES[name])
        for index in range(RESOLUTION**2):
            row, column = index // RESOLUTION, index % RESOLUTION
            corner = (left + column, bottom + RESOLUTION - 1 - row)
            number = face * RESOLUTION**2 + index
            shown = number in visible
            axes.add_patch(Rectangle(corner, 1, 1, facecolor="white" if shown else "0.85", edgecolor="0.7"))
            middle = (corner[0] + 0.5, corner[1] + 0.5)
            axes.annotate(
                str(number), middle, ha="center", va="center", fontsize=10, color="black" if shown else "0.55"
            )
        axes.add_patch(Rectangle((left, bottom), RESOLUTION, RESOLUTION, fill=False, edgecolor="0.2", linewidth=1.5))
        middle = (left + RESOLUTION / 2, bottom + RESOLUTION / 2)
        axes.annotate(name, middle, ha="center", va="center", fontsize=30, weight="bold", color="#0072B2", alpha=0.35)
    corner = (0.7, 2 * RESOLUTION + 1.0)
    for end, colour, name in (((2.0, 0.0), RED, "u"), ((0.0, 2.0), GREEN, "v")):
        tip = (corner[0] + end[0], corner[1] + end[1])
        axes.annotate("", tip, corner, arrowprops={"arrowstyle": "-|>", "color": colour, "linewidth": 2.2})
        axes.annotate(name, tip, fontsize=13, weight="bold", color=colour)
    axes.annotate("on every face", corner, (0, -14), textcoords="offset points", fontsize=11, color="0.35")
    axes.set_title("Six faces of 4 x 4 texels, unfolded and seen from inside; grey is below the plane", fontsize=12)
    axes.set_xlim(-0.3, 4 * RESOLUTION + 0.3)
    axes.set_ylim(-0.3, 3 * RESOLUTION + 0.3)
    axes.set_aspect("equal")
    axes.axis("off")


def main() -> None:
    """Draws both pictures."""
    parser = argparse.ArgumentParser(description="Draws the conventions of environment maps.")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder for the pictures")
    out: Path = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    maps = Figure(figsize=(7.2, 7.6), dpi=110, layout="constrained")
    for axes, convention in zip(maps.subplots(2, 1), CONVENTIONS, strict=True):
        draw_latlong(axes, convention)
    FigureCanvasAgg(maps).print_png(str(out / "latlong.png"))
    faces = Figure(figsize=(8.4, 6.6), dpi=110, layout="constrained")
    draw_faces(faces.subplots())
    FigureCanvasAgg(faces).print_png(str(out / "cubemap.png"))


if __name__ == "__main__":
    main()
