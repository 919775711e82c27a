"""The printed sheet as a page of PDF at true scale, and as a picture."""

from __future__ import annotations

from io import BytesIO

import matplotlib as mpl
import numpy as np
import torch
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path
from torch import Tensor

from torchlight.photo.boards import marker_cells
from torchlight.photo.target import MARGIN, RULER_LENGTH, STRIP, Prop, Sheet, footprint

MILLIMETRES_PER_INCH = 25.4
DOTS_PER_INCH = 300
OUTLINE_INSET = 0.4  # the outline is drawn inside the footprint: the object that stands on it hides it
OUTLINE_GREY = "0.6"
LETTER_POINTS = 6.5


def sheet_pdf(sheet: Sheet, prop: Prop) -> bytes:
    """Returns one page of PDF, as large as the paper: printed at 100 % every length is true."""
    return _page(sheet, prop, "pdf")


def sheet_png(sheet: Sheet, prop: Prop) -> bytes:
    """Returns the same page at 300 dots per inch."""
    return _page(sheet, prop, "png")


def _page(sheet: Sheet, prop: Prop, kind: str) -> bytes:
    width, height = sheet.paper
    figure = Figure(figsize=(width / MILLIMETRES_PER_INCH, height / MILLIMETRES_PER_INCH))
    FigureCanvasAgg(figure)
    axis = figure.add_axes((0, 0, 1, 1))
    x, y = sheet.origin
    axis.set_xlim(-x, width - x)
    axis.set_ylim(-y, height - y)
    axis.set_axis_off()
    for identity, center in enumerate(sheet.markers):
        _draw_marker(axis, sheet, identity, center)
    _draw_footprint(axis, prop)
    _draw_ruler(axis, sheet)
    _draw_orientation(axis, sheet)
    buffer = BytesIO()
    with mpl.rc_context({"path.snap": False, "pdf.compression": 6}):
        metadata = {"CreationDate": None} if kind == "pdf" else None
        figure.savefig(buffer, format=kind, dpi=DOTS_PER_INCH, metadata=metadata)
    return buffer.getvalue()


def _draw_marker(axis: Axes, sheet: Sheet, identity: int, center: tuple[float, float]) -> None:
    """Draws a marker's black cells as one path: neighbours that are filled one by one would show seams."""
    black = marker_cells(sheet.dictionary, identity).numpy()
    cell = sheet.marker_size / len(black)
    left, upper = center[0] - sheet.marker_size / 2, center[1] + sheet.marker_size / 2
    squares = [_square(left + column * cell, upper - (row + 1) * cell, cell) for row, column in np.argwhere(black)]
    axis.add_patch(PathPatch(Path.make_compound_path(*squares), facecolor="black", linewidth=0))


def _square(x: float, y: float, side: float) -> Path:
    return Path([(x, y), (x + side, y), (x + side, y + side), (x, y + side), (x, y)], closed=True)


def _draw_footprint(axis: Axes, prop: Prop) -> None:
    outline = _inset(footprint(prop), OUTLINE_INSET)
    axis.plot(*torch.cat([outline, outline[:1]]).T.numpy(), color=OUTLINE_GREY, linewidth=0.6)
    x, y = prop.position
    axis.plot([x - 2, x + 2], [y, y], color=OUTLINE_GREY, linewidth=0.6)
    axis.plot([x, x], [y - 2, y + 2], color=OUTLINE_GREY, linewidth=0.6)


def _inset(outline: Float[Tensor, "corners 2"], width: float) -> Float[Tensor, "corners 2"]:
    """Returns a convex outline, counter-clockwise, with every side moved inwards."""
    along = torch.nn.functional.normalize(outline.roll(-1, 0) - outline, dim=-1)
    inward = torch.stack([-along[:, 1], along[:, 0]], dim=-1)
    before = inward.roll(1, 0)
    return outline + width * (before + inward) / (1 + (before * inward).sum(-1, keepdim=True))


def _draw_ruler(axis: Axes, sheet: Sheet) -> None:
    """Draws the line that tells the print's scale, between the markers and the page's lower edge."""
    left = -sheet.origin[0] + MARGIN
    base = -sheet.origin[1] + MARGIN
    axis.plot([left, left + RULER_LENGTH], [base, base], color="black", linewidth=0.5, solid_capstyle="butt")
    for millimetre in range(0, int(RULER_LENGTH) + 1):
        tall = 3.0 if millimetre % 10 == 0 else 2.0 if millimetre % 5 == 0 else 1.0
        axis.plot([left + millimetre] * 2, [base, base + tall], color="black", linewidth=0.3, solid_capstyle="butt")
        if millimetre % 10 == 0:
            axis.text(left + millimetre, base + 3.4, str(millimetre), fontsize=LETTER_POINTS - 1, ha="center")
    note = f"Print at 100 % (actual size). This line must measure {RULER_LENGTH:g} mm."
    axis.text(left, base - 3.2, note, fontsize=LETTER_POINTS)


def _draw_orientation(axis: Axes, sheet: Sheet) -> None:
    """Draws the world's axes at the lower right."""
    x = sheet.paper[0] - sheet.origin[0] - MARGIN - 20
    y = -sheet.origin[1] + MARGIN - 2
    arrow = {"arrowstyle": "-|>", "linewidth": 0.8, "shrinkA": 0, "shrinkB": 0, "mutation_scale": 6, "color": "black"}
    axis.annotate("", (x + 9, y), (x, y), arrowprops=arrow)
    axis.annotate("", (x, y + 9), (x, y), arrowprops=arrow)
    axis.text(x + 9.6, y - 0.8, "x", fontsize=LETTER_POINTS)
    axis.text(x + 1.0, y + STRIP - 2.2, "y", fontsize=LETTER_POINTS)
    axis.text(x - 3, y + 2, "torchlight", fontsize=LETTER_POINTS, ha="right")
