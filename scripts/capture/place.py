"""Where everything stands, drawn to scale from the side and from above."""

from __future__ import annotations

import math

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon, Rectangle, Wedge

from torchlight.drawing.canvas import png_bytes
from torchlight.photo.target import Sheet

HEIGHT, HALF = 35.0, 15.0  # mm, of the object
ELEVATION, AZIMUTH = 45.0, 60.0  # degrees, of the light
CAMERA = (-430.0, 420.0)  # mm, from the side
BLUE, GREEN, ORANGE, RED, GREY = "#0072B2", "#009E73", "#E69F00", "#D55E00", "0.55"


def place_picture(sheet: Sheet) -> bytes:
    """Returns a PNG: camera, light and sheet from the side, and where to stand from above."""
    figure = Figure(figsize=(12.6, 5.6), dpi=100, layout="constrained")
    side, above = figure.subplots(1, 2, width_ratios=(1.25, 1.0))
    draw_side(side, sheet)
    draw_above(above, sheet)
    return png_bytes(figure)


def draw_side(axis: Axes, sheet: Sheet) -> None:
    """Draws the sheet's longer side, the object, its shadow, the light that makes it, and the camera."""
    half = sheet.paper[1] / 2
    reach = HEIGHT / math.tan(math.radians(ELEVATION))
    axis.plot([-520, 460], [0, 0], color="0.3", linewidth=1.2)
    axis.plot([-half, half], [3, 3], color=GREY, linewidth=5, solid_capstyle="butt")
    axis.plot([-HALF - reach, -HALF], [3, 3], color="0.1", linewidth=5, solid_capstyle="butt")
    axis.add_patch(Rectangle((-HALF, 0), 2 * HALF, HEIGHT, color=BLUE, zorder=3))
    for across in (0.0, 60.0, 120.0):
        start = (330 + across * 0.4, 345 - across + 40)
        end = (start[0] - 110, start[1] - 110)
        axis.annotate("", end, start, arrowprops={"arrowstyle": "-|>", "color": ORANGE, "linewidth": 2})
    axis.plot([-HALF - reach, 250], [0, 250 + HALF + reach], color=ORANGE, linewidth=1, linestyle="--")
    axis.text(250, 445, "light: a window, the sun,\na lamp across the room", color="0.2", ha="center")
    draw_camera(axis, *CAMERA)
    axis.plot([CAMERA[0], 0], [CAMERA[1], 0], color=GREEN, linewidth=1, linestyle=":")
    distance = math.hypot(*CAMERA) / 10
    axis.text(-205, 268, f"40 to 80 cm\n(here {distance:.0f})", color=GREEN, ha="left")
    axis.annotate("shadow", (-HALF - reach / 2, 4), (-190, 70), arrowprops={"arrowstyle": "-", "color": "0.3"})
    axis.annotate("sheet, flat", (half - 25, 4), (half - 30, 60), arrowprops={"arrowstyle": "-", "color": "0.3"})
    axis.text(0, -45, f"object {HEIGHT:g} mm tall", color=BLUE, ha="center")
    axis.set_title("from the side")
    axis.set_xlim(-540, 470)
    axis.set_ylim(-75, 520)
    label(axis, "along the sheet [mm]", "above the table [mm]")


def draw_camera(axis: Axes, x: float, y: float) -> None:
    """Draws a phone that looks at the middle of the sheet."""
    size = math.hypot(x, y)
    along = (-x / size, -y / size)
    corners = [
        (x + a * -along[1] * 70 + b * along[0] * 9, y + a * along[0] * 70 + b * along[1] * 9)
        for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))
    ]
    axis.add_patch(Polygon(corners, closed=True, color=GREEN, zorder=3))
    axis.text(x - 30, y + 70, "phone", color=GREEN, ha="center")


def draw_above(axis: Axes, sheet: Sheet) -> None:
    """Draws the sheet with its markers, the shadow, and the two sectors: stand here, do not stand here."""
    x, y = sheet.origin
    axis.add_patch(Wedge((0, 0), 420, AZIMUTH + 80, AZIMUTH + 280, color=GREEN, alpha=0.18, linewidth=0))
    axis.add_patch(
        Wedge((0, 0), 420, AZIMUTH - 40, AZIMUTH + 40, facecolor="none", edgecolor=RED, hatch="///", linewidth=1)
    )
    axis.add_patch(Rectangle((-x, -y), *sheet.paper, facecolor="white", edgecolor="0.4"))
    half = sheet.marker_size / 2
    for center in sheet.markers:
        axis.add_patch(Rectangle((center[0] - half, center[1] - half), 2 * half, 2 * half, color="0.25"))
    turn = math.radians(AZIMUTH)
    reach = HEIGHT / math.tan(math.radians(ELEVATION))
    moved = (-reach * math.cos(turn), -reach * math.sin(turn))
    corners = [(-15.0, -10.0), (15.0, -10.0), (15.0, 10.0), (-15.0, 10.0)]
    hull = [corners[1], corners[3], corners[0]]
    shadow = [hull[0], *((c[0] + moved[0], c[1] + moved[1]) for c in (corners[1], corners[0], corners[3])), hull[1]]
    axis.add_patch(Polygon(shadow, closed=True, color="0.35"))
    axis.add_patch(Polygon(corners, closed=True, color=BLUE))
    far, near = 400, 190
    axis.annotate(
        "", (near * math.cos(turn), near * math.sin(turn)), (far * math.cos(turn), far * math.sin(turn)),
        arrowprops={"arrowstyle": "-|>", "color": ORANGE, "linewidth": 3},
    )  # fmt: skip
    axis.text(235, 395, "light", color="0.2")
    box = {"facecolor": "white", "alpha": 0.85, "linewidth": 0}
    axis.text(120, 215, "not here: you would\nstand in the light", color=RED, ha="left", bbox=box)
    axis.text(-260, -270, "stand here:\nthe shadow is in full view", color="#006b4f", ha="center")
    axis.set_title("from above")
    axis.set_xlim(-430, 430)
    axis.set_ylim(-430, 430)
    label(axis, "x of the sheet [mm]", "y of the sheet [mm]")


def label(axis: Axes, x: str, y: str) -> None:
    """Names both axes, which have one scale."""
    axis.set_aspect("equal")
    axis.set_xlabel(x)
    axis.set_ylabel(y)
