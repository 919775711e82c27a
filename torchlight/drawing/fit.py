"""What was observed, what the light predicts, and what is left, side by side."""

from __future__ import annotations

import itertools

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize, to_rgba
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from torchlight.drawing.canvas import add_axes, png_bytes
from torchlight.drawing.content import DIVERGING, UNUSED, FitContent, LeftOut

PANEL_INCHES, FOOT_INCHES, HEAD_INCHES, LEGEND_INCHES = 3.5, 0.62, 0.72, 0.3


def draw_fit(content: FitContent) -> bytes:
    """Returns a PNG of the two receivers and of their difference, with scales and a legend of what was left out."""
    side = _panel_inches(content)
    foot = FOOT_INCHES + (LEGEND_INCHES if content.left_out else 0.0)
    figure = Figure(figsize=(13.5, foot + side[1] + HEAD_INCHES), dpi=110)
    axes = [add_axes(figure, 0.75 + 4.05 * place, foot, *side) for place in range(3)]
    extent = content.extent
    for axis, values, name in zip(axes[:2], content.shown, content.names, strict=True):
        axis.imshow(values, extent=extent, interpolation="nearest")
        _label(axis, name, content.units)
    for axis, left_out in itertools.product((axes[0], axes[2]), content.left_out):
        axis.imshow(_layer(left_out), extent=extent, interpolation="nearest", zorder=2)
    colours = mpl.colormaps[DIVERGING].with_extremes(bad=(UNUSED, UNUSED, UNUSED))
    limits = Normalize(-content.limit, content.limit)
    image = axes[2].imshow(content.difference, extent=extent, cmap=colours, norm=limits, interpolation="nearest")
    _label(axes[2], f"{content.names[1]} - {content.names[0]} (luminance)", content.units)
    for axis in axes[1:]:
        axis.tick_params(labelleft=False)
    beside = add_axes(figure, 12.55, foot + 0.075 * side[1], 0.17, 0.85 * side[1])
    figure.colorbar(image, cax=beside, extend="both", label="255ths of the brightest sample")
    if content.left_out:
        handles = [Patch(facecolor=one.colour, edgecolor="0.4", label=one.label) for one in content.left_out]
        figure.legend(handles=handles, loc="lower left", ncols=len(handles), fontsize=9, frameon=False)
    style = {"ha": "center", "va": "center", "fontsize": 11, "parse_math": False}
    figure.text(0.5, 1 - 0.18 / figure.get_figheight(), content.title, **style)
    return png_bytes(figure)


def _panel_inches(content: FitContent) -> tuple[float, float]:
    """Returns width and height of a picture of the receiver, except where it is very long or very narrow."""
    left, right, bottom, top = content.extent
    return PANEL_INCHES, PANEL_INCHES * min(max((top - bottom) / (right - left), 0.25), 2.5)


def _layer(left_out: LeftOut) -> np.ndarray:
    """Returns a picture of samples in their colour, transparent elsewhere."""
    layer = np.zeros((*left_out.samples.shape, 4))
    layer[left_out.samples] = to_rgba(left_out.colour)
    return layer


def _label(axis: Axes, title: str, units: str) -> None:
    axis.set_title(title, y=1.0)  # stated, or Matplotlib measures all labels to find it
    axis.locator_params(nbins=5)
    axis.set_xlabel(f"x [{units}]", parse_math=False)
    axis.set_ylabel(f"y [{units}]", parse_math=False)
    axis.set_aspect("equal")
