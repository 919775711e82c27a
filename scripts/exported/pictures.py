"""The pictures of the check: what every program showed, side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import matplotlib as mpl
from jaxtyping import Float
from matplotlib.figure import Figure
from torch import Tensor

from exported.setting import RECEIVER, WIDTH
from torchlight.drawing.canvas import png_bytes
from torchlight.preview import to_srgb8
from torchlight.synthetic import receiver_image

LEGEND = "seen from above, +x right, +y up; below: turn of the shadows against torchlight's, irradiance off"


def comparison(
    columns: Sequence[str], rows: Mapping[str, Sequence[Float[Tensor, "3 points"]]], captions: Mapping[str, str]
) -> bytes:
    """Returns a PNG: one row per light, one column per program, the first of which sets the row's exposure.

    Args:
        columns: names of the programs.
        rows: planes seen from above by the light's name.
        captions: below single pictures, by "row/column".
    """
    with mpl.rc_context({"font.size": 9}):
        figure = Figure(figsize=(2.15 * len(columns), 2.45 * len(rows) + 0.2), dpi=100, layout="constrained")
        axes = figure.subplots(len(rows), len(columns), squeeze=False)
        for line, (name, planes) in zip(axes, rows.items(), strict=True):
            for axis, column, values in zip(line, columns, planes, strict=True):
                axis.set_xticks([])
                axis.set_yticks([])
                exposure = 0.85 / float(planes[0].max())
                picture = to_srgb8(receiver_image(values, RECEIVER) * exposure)
                half = WIDTH / 2
                axis.imshow(picture, extent=(-half, half, -half, half), interpolation="nearest")
                axis.set_xlabel(captions.get(f"{name}/{column}", ""), fontsize=8)
            line[0].set_ylabel(name)
        for axis, column in zip(axes[0], columns, strict=True):
            axis.set_title(column, fontsize=9)
        figure.supxlabel(LEGEND, fontsize=8)
        return png_bytes(figure)
