"""Two lights side by side: both maps at one exposure, their difference, and the six spheres."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np
import torch
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from torch import Tensor

from torchlight.drawing.canvas import png_bytes
from torchlight.drawing.content import DIVERGING
from torchlight.light.environment import luminance
from torchlight.light_metrics.protocol import MATERIALS, SphereTest
from torchlight.light_metrics.spheres import picture
from torchlight.light_metrics.summary import Pair
from torchlight.preview import preview, to_srgb8
from torchlight.report.comparison import Comparison

SPHERE_PERCENTILE, SPHERE_LEVEL = 0.98, 0.8
SCORES = {"mirror": "mirror", "matte": "matte silver", "diffuse": "diffuse"}


def comparison_picture(found: Comparison) -> bytes:
    """Returns a PNG: left the light, the reference and light - reference, right the spheres under both."""
    upper = found.pair.part == "upper"
    figure = Figure(figsize=(13.5, 6.3 if upper else 8.6), dpi=110, layout="constrained")
    panels: list[SubFigure] = list(np.array(figure.subfigures(1, 2, width_ratios=(1.0, 1.0)), dtype=object))
    draw_maps(panels[0], found.pair)
    draw_spheres(panels[1], found.spheres)
    names = [Path(name).name for name in found.names]
    figure.suptitle(f"{names[0]} against {names[1]}", fontsize=12, parse_math=False)
    return png_bytes(figure)


def draw_maps(figure: SubFigure, pair: Pair) -> None:
    """Draws the maps at the exposure of the reference's preview, and their signed difference of luminance."""
    scale = preview(pair.reference).scale
    axes: list[Axes] = list(figure.subplots(3, 1, sharex=True))
    rows = pair.light.height // 2 if pair.part == "upper" else pair.light.height
    light, reference = pair.light.radiance[:, :rows] * scale, pair.reference.radiance[:, :rows] * scale
    extent = (180.0, -180.0, 0.0 if pair.part == "upper" else -90.0, 90.0)
    for axis, image, name in zip(axes, (light, reference), ("light", "reference"), strict=False):
        axis.imshow(to_srgb8(image), extent=extent, aspect="auto", interpolation="nearest")
        axis.set_title(name)
    difference = luminance((light - reference).flatten(start_dim=1)).reshape(rows, -1).numpy(force=True)
    image = axes[2].imshow(
        difference,
        extent=extent,
        aspect="auto",
        cmap=mpl.colormaps[DIVERGING],
        vmin=-1,
        vmax=1,
        interpolation="nearest",
    )
    axes[2].set_title("light - reference")
    bar = figure.colorbar(image, ax=axes[2], extend="both", location="bottom", aspect=40, pad=0.28)
    bar.set_label("luminance; 1 = white in the pictures above")
    for axis in axes:
        axis.set_ylabel("elevation [°]")
        axis.set_yticks([0, 30, 60, 90] if pair.part == "upper" else [-90, -45, 0, 45, 90])
        axis.set_xticks([180, 90, 0, -90, -180])
    axes[2].set_xlabel("azimuth [°], 0 = +x, 90 = +y")


def draw_spheres(figure: SubFigure, test: SphereTest) -> None:
    """Draws light above reference, a column per material, each pair at one exposure."""
    grid = figure.subplots(2, 3)
    for column, name in enumerate(MATERIALS):
        level = torch.quantile(luminance(test.reference[name]).flatten(), SPHERE_PERCENTILE)
        scale = SPHERE_LEVEL / float(level) if float(level) > 0 else 1.0
        for row, (values, title) in enumerate(((test.light[name], "light"), (test.reference[name], "reference"))):
            axis: Axes = grid[row, column]
            axis.imshow(sphere_image(values * scale, test), interpolation="nearest")
            axis.axis("off")
            axis.set_title(f"{SCORES[name]}, {title}", fontsize=10)
        score = test.scores[name]
        below = f"si-RMSE {float(score.si_rmse):.3g}\nRGB angle {float(score.angle):.2g}°"
        grid[1, column].text(0.5, -0.04, below, transform=grid[1, column].transAxes, ha="center", va="top", fontsize=9)


def sphere_image(values: Float[Tensor, "3 pixels"], test: SphereTest) -> np.ndarray:
    """Returns a sphere as 8-bit sRGB on white."""
    image = to_srgb8(picture(values, test.inside))
    image[~test.inside.numpy(force=True)] = 255
    return image
