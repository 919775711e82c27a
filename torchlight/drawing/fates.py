"""Which functions a light uses and why no others: unfolded faces and a table, one pair per channel."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle

from torchlight.drawing.canvas import add_axes, png_bytes
from torchlight.drawing.content import HEIGHT, PLACES, SIDE_TOP, WIDTH, ChannelFates, FatesContent

FACES_INCHES, CHANNEL_INCHES, LEGEND_INCHES = 2.6, 2.95, 0.45
HEAD_ROWS, LEAST_ROWS = 1.8, 11.0  # of the table: its head counts as so many; fewer rows are not drawn taller


def draw_fates(content: FatesContent) -> bytes:
    """Returns a PNG of faces and tables, channel below channel, with a legend."""
    count = len(content.channels)
    figure = Figure(figsize=(11.0, CHANNEL_INCHES * count + LEGEND_INCHES), dpi=110)
    for place, channel in enumerate(content.channels):
        bottom = LEGEND_INCHES + CHANNEL_INCHES * (count - 1 - place)
        faces, table = (add_axes(figure, x, bottom, width, FACES_INCHES) for x, width in ((0.08, 6.45), (6.6, 4.3)))
        draw_faces(faces, channel, content)
        faces.set_title(channel.title, fontsize=10, y=1.0)
        draw_table(table, channel.head, channel.rows)
    handles = [Patch(facecolor=colour, edgecolor="0.4", label=name) for colour, name in content.legend]
    figure.legend(handles=handles, loc="lower center", ncols=len(handles), fontsize=9, frameon=False)
    return png_bytes(figure)


def draw_faces(axis: Axes, channel: ChannelFates, content: FatesContent) -> None:
    """Draws the fates of one channel and the borders of the squares on which its light is constant."""
    colours = ListedColormap(list(content.colours))
    limits = BoundaryNorm(np.arange(len(content.colours) + 1) - 0.5, len(content.colours))
    axis.imshow(channel.faces, extent=(0, WIDTH, 0, HEIGHT), cmap=colours, norm=limits, interpolation="nearest")
    draw_borders(axis, channel.borders)
    label_faces(axis)


def draw_borders(axis: Axes, borders: Float[np.ndarray, "squares 5 2"], colour: str = "0.35") -> None:
    """Draws the borders of squares."""
    axis.add_collection(LineCollection(list(borders), colors=colour, linewidths=0.4))


def draw_table(axis: Axes, head: Sequence[str], rows: Sequence[Sequence[int]]) -> None:
    """Writes numbers below a head of several lines."""
    axis.set_axis_off()
    height = HEAD_ROWS + len(rows)
    axis.set_xlim(0, len(head))
    axis.set_ylim(max(height, LEAST_ROWS), 0)  # rows are counted downwards
    style: dict[str, Any] = {"ha": "center", "va": "center", "fontsize": 8}
    for column, name in enumerate(head):
        axis.text(column + 0.5, HEAD_ROWS / 2, name, **style)
        for level, row in enumerate(rows):
            axis.text(column + 0.5, HEAD_ROWS + level + 0.5, str(row[column]), **style)
    axis.hlines([0, *(HEAD_ROWS + level for level in range(len(rows) + 1))], 0, len(head), color="0.8", linewidth=1)


def label_faces(axis: Axes) -> None:
    """Frames and names the faces, and takes the axes away."""
    for name, left in PLACES.items():
        bottom, height = (SIDE_TOP, 1.0) if name == "+z" else (0.0, SIDE_TOP)
        axis.add_patch(Rectangle((left, bottom), 1, height, fill=False, edgecolor="black", linewidth=0.9))
        below = name != "+z"
        axis.annotate(
            name,
            (left + (0.5 if below else 0.0), bottom + (0.0 if below else 0.5)),
            (0, -3) if below else (-4, 0),
            textcoords="offset points",
            ha="center" if below else "right",
            va="top" if below else "center",
            fontsize=8,
        )
    axis.set_xlim(-0.02, WIDTH + 0.02)
    axis.set_ylim(-0.12, HEIGHT + 0.02)
    axis.set_aspect("equal")
    axis.set_axis_off()
