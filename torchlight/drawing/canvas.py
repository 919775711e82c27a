"""Figures as PNG bytes, and axes that are placed by hand."""

from __future__ import annotations

import warnings
from io import BytesIO

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure


def add_axes(figure: Figure, left: float, bottom: float, width: float, height: float) -> Axes:
    """Returns new axes, placed in inches from a figure's lower left corner.

    Matplotlib's own layouts measure every label first, which takes as long as drawing it.
    """
    across, up = figure.get_size_inches()
    return figure.add_axes((left / across, bottom / up, width / across, height / up))


def png_bytes(figure: Figure) -> bytes:
    """Returns a figure drawn as PNG; characters that its font lacks, as in a file's name, are drawn as boxes."""
    buffer = BytesIO()
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph .* missing from font")
        FigureCanvasAgg(figure).print_png(buffer)
    return buffer.getvalue()
