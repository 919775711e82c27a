"""The observability map: drawn as the hemisphere seen from above, and as a lat-long picture for a file."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Bool, Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from torch import Tensor

from torchlight.analysis.observability import DETERMINED, Observability
from torchlight.drawing.canvas import png_bytes
from torchlight.light import cubemap, latlong
from torchlight.light.directions import from_angles
from torchlight.report.case import Case

PIXELS = 420
LATLONG_ROWS = 256
MAP = "cividis"  # even in brightness with every common colour blindness
UNREACHED = (0.85, 0.2, 0.1)


def observability_picture(cases: Sequence[Case]) -> bytes:
    """Returns, per case, R_ii and the posterior deviation over the hemisphere; the zenith is in the middle.

    The projection keeps areas, so a share of the disc is a share of the hemisphere. +x is right and +y up.
    """
    figure = Figure(figsize=(10.5, 4.7 * len(cases)), dpi=110, layout="constrained")
    axes = figure.subplots(len(cases), 2, squeeze=False)
    for case, (left, right) in zip(cases, axes, strict=True):
        seen = case.seen
        first = draw_hemisphere(left, seen.diagonal, seen, (0.0, 1.0))
        left.set_title(
            f"{case.name}: {seen.share(seen.determined):.0%} determined (R >= {DETERMINED:g}, inside the line)",
            fontsize=9,
            parse_math=False,
        )
        figure.colorbar(first, ax=left, shrink=0.8, label="resolution R: share of the truth that comes back")
        second = draw_hemisphere(right, seen.deviation, seen, (0.0, float(seen.deviation.max())))
        right.set_title("uncertainty that is left", fontsize=9)
        figure.colorbar(second, ax=right, shrink=0.8, label="posterior deviation / mean radiance")
    return png_bytes(figure)


def draw_hemisphere(
    axis: Axes, values: Float[Tensor, " texels"], seen: Observability, limits: tuple[float, float]
) -> AxesImage:
    """Draws one value per texel; texels that no used sample sees are hatched in red."""
    directions, inside = disc_directions(PIXELS)
    shown = torch.where(inside, at_directions(values, seen.resolution, directions), torch.nan)
    extent = (-1.0, 1.0, -1.0, 1.0)
    image = axis.imshow(shown.numpy(), extent=extent, cmap=MAP, vmin=limits[0], vmax=limits[1], interpolation="nearest")
    grid = np.linspace(-1, 1, PIXELS)
    level = at_directions(seen.diagonal, seen.resolution, directions) * inside
    if float(level.min()) < DETERMINED < float(level.max()):
        axis.contour(grid, -grid, level.numpy(), levels=[DETERMINED], colors="white", linewidths=1.4)
        axis.contour(grid, -grid, level.numpy(), levels=[DETERMINED], colors="black", linewidths=0.6)
    dark = (at_directions((~seen.reached).to(values), seen.resolution, directions) > 0) & inside
    if bool(dark.any()):
        hatch = axis.contourf(grid, -grid, dark.double().numpy(), levels=[0.5, 1.5], colors="none", hatches=["xxx"])
        hatch.set_edgecolor(UNREACHED)
        axis.text(0, -1.28, "red: reaches no used sample", fontsize=8, ha="center", color=UNREACHED)
    for elevation in (0, 30, 60):
        radius = math.sqrt(2) * math.sin(math.radians(90 - elevation) / 2)
        turn = np.linspace(0, 2 * math.pi, 181)
        axis.plot(radius * np.cos(turn), radius * np.sin(turn), color="white" if elevation else "0.3", linewidth=0.7)
        if elevation:
            axis.text(0, radius, f"{elevation}°", color="white", fontsize=7, ha="center", va="bottom")
    for name, x, y in (("+x", 1.07, 0), ("-x", -1.07, 0), ("+y", 0, 1.07), ("-y", 0, -1.07)):
        axis.text(x, y, name, fontsize=8, ha="center", va="center")
    axis.set_xlim(-1.15, 1.15)
    axis.set_ylim(-1.35, 1.15)
    axis.set_axis_off()
    return image


def disc_directions(pixels: int) -> tuple[Float[Tensor, "rows columns 3"], Bool[Tensor, "rows columns"]]:
    """Returns the direction of every pixel of a disc of radius 1, and which pixels lie on it; row 0 is +y.

    Lambert's azimuthal projection, r = sqrt(2) sin(theta / 2): equal areas of the disc are equal solid angles.
    """
    axis = (torch.arange(pixels, dtype=torch.float64) + 0.5) * (2 / pixels) - 1
    y, x = torch.meshgrid(-axis, axis, indexing="ij")
    radius = torch.hypot(x, y)
    theta = 2 * torch.asin(radius.clamp(max=1) / math.sqrt(2))
    return from_angles(theta, torch.atan2(y, x)), radius < 1


def at_directions(
    values: Float[Tensor, " texels"], resolution: int, directions: Float[Tensor, "*batch 3"]
) -> Float[Tensor, "*batch"]:
    """Returns the value of the texel each direction falls into, 0 below the plane."""
    faces = values.new_zeros(6 * resolution**2)
    faces[cubemap.visible_texels(resolution)] = values
    return faces[cubemap.texel_index(directions, resolution)]


def latlong_map(seen: Observability) -> Float[Tensor, "3 height width"]:
    """Returns R_ii, the posterior deviation, and 1 where no used sample is reached, in torchlight's lat-long layout.

    All three are 0 below the plane, where light is 0 by definition.
    """
    directions = latlong.pixel_directions(LATLONG_ROWS)
    layers = (seen.diagonal, seen.deviation, (~seen.reached).to(seen.diagonal))
    return torch.stack([at_directions(layer, seen.resolution, directions) for layer in layers])
