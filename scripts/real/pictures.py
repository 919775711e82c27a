"""One sheet per photograph: what the camera saw, the rectified plane, the prediction, the residual and the light."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import matplotlib as mpl
import numpy as np
import torch
from jaxtyping import Bool, Float
from kornia.color import linear_rgb_to_rgb
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from torch import Tensor

from torchlight.drawing.canvas import png_bytes
from torchlight.drawing.content import DIVERGING, UNUSED
from torchlight.fit import MIN_SCALE_255
from torchlight.geometry.receiver import Receiver
from torchlight.geometry.scene import Scene
from torchlight.light.environment import EnvironmentMap, luminance
from torchlight.preview import to_srgb8

PHOTO_WIDTH = 640  # pixels of the photograph on the sheet
DECADES = 4.0  # of luminance shown of a light
LIGHT_MAP = "cividis"  # even in brightness with every common colour blindness
ORANGE, SKY, PINK = "#E69F00", "#56B4E9", "#CC79A7"  # Okabe and Ito
LIMIT_PERCENTILE = 0.995


@dataclass(frozen=True, eq=False)
class Line:
    """A polygon or polyline on the plane, with its name for the legend."""

    name: str
    points: Float[Tensor, "corners 2"]
    colour: str


@dataclass(frozen=True, eq=False)
class Mark:
    """A direction marked on the light."""

    name: str
    direction: Float[Tensor, "3"]
    colour: str


@dataclass(frozen=True, eq=False)
class Sheet:
    """What one sheet shows.

    Attributes:
        title: what it is.
        photo: linear picture, white at 1.
        scene: the plane.
        observed: samples.
        predicted: samples, same units.
        used: samples that are shown.
        compared: samples of the residual.
        light: the recovered light.
        marks: directions on it.
        lines: on the plane.
    """

    title: str
    photo: Float[Tensor, "3 height width"]
    scene: Scene
    observed: Float[Tensor, "3 points"]
    predicted: Float[Tensor, "3 points"]
    used: Bool[Tensor, " points"]
    compared: Bool[Tensor, " points"]
    light: EnvironmentMap
    marks: Sequence[Mark] = ()
    lines: Sequence[Line] = ()


def sheet_picture(sheet: Sheet) -> bytes:
    """Returns a PNG of five panels; observed and predicted have one exposure; unused samples are grey."""
    figure = Figure(figsize=(15.0, 7.6), dpi=100, layout="constrained")
    grid = figure.add_gridspec(2, 6)
    photo, observed, predicted = (figure.add_subplot(grid[0, 2 * k : 2 * k + 2]) for k in range(3))
    residual, light = figure.add_subplot(grid[1, :2]), figure.add_subplot(grid[1, 2:])
    draw_photo(photo, sheet.photo)
    white = torch.quantile(sheet.observed[:, sheet.used].double(), LIMIT_PERCENTILE).item()
    for axis, values, name in (
        (observed, sheet.observed, "observed on the plane, rectified"),
        (predicted, sheet.predicted, "predicted by the light"),
    ):
        draw_plane(axis, values / white, sheet.used, sheet.scene)
        axis.set_title(name)
        draw_lines(axis, sheet.lines)
    draw_residual(figure, residual, sheet, white)
    draw_light(figure, light, sheet)
    figure.suptitle(sheet.title, fontsize=13, parse_math=False)
    return png_bytes(figure)


def draw_photo(axis: Axes, photo: Float[Tensor, "3 height width"]) -> None:
    """Draws a linear photograph, made smaller by averaging, with its own pixels on the axes."""
    height, width = photo.shape[-2:]
    factor = max(1, width // PHOTO_WIDTH)
    small = torch.nn.functional.avg_pool2d(photo[None].float(), factor)[0]
    axis.imshow(to_srgb8(small), extent=(-0.5, width - 0.5, height - 0.5, -0.5))
    axis.set_title("photograph")
    axis.set_xlabel("x [pixels]")
    axis.set_ylabel("y [pixels]")


def draw_plane(axis: Axes, values: Float[Tensor, "3 points"], used: Bool[Tensor, " points"], scene: Scene) -> None:
    """Draws samples as sRGB, white at 1, seen from above."""
    columns, rows = scene.receiver.samples
    encoded = linear_rgb_to_rgb(values.float().clamp(0, 1).reshape(3, rows, columns)).reshape(3, -1)
    shown = torch.where(used, encoded, torch.full_like(encoded, UNUSED)).reshape(3, rows, columns)
    axis.imshow(shown.flip(1).permute(1, 2, 0).numpy(), extent=extent(scene.receiver), interpolation="nearest")
    label_plane(axis, scene.units)


def draw_residual(figure: Figure, axis: Axes, sheet: Sheet, white: float) -> None:
    """Draws predicted - observed luminance in 255ths of white, with its RMS in the title."""
    difference = luminance((sheet.predicted - sheet.observed).double()) * (255.0 / white)
    kept = difference[sheet.compared]
    limit = max(MIN_SCALE_255, torch.quantile(kept.abs(), LIMIT_PERCENTILE).item())
    shown = torch.where(sheet.compared, difference, torch.nan).reshape(sheet.scene.receiver.samples[::-1]).flip(0)
    colours = mpl.colormaps[DIVERGING].with_extremes(bad=(UNUSED, UNUSED, UNUSED))
    where = extent(sheet.scene.receiver)
    image = axis.imshow(shown.numpy(), extent=where, cmap=colours, vmin=-limit, vmax=limit, interpolation="nearest")
    axis.set_title(f"predicted - observed, luminance, RMS {kept.square().mean().sqrt():.1f}")
    label_plane(axis, sheet.scene.units)
    figure.colorbar(image, ax=axis, shrink=0.8, extend="both", label="luminance, 255ths of white")


def draw_light(figure: Figure, axis: Axes, sheet: Sheet) -> None:
    """Draws the upper hemisphere's luminance in decades below its brightest pixel, with the marked directions."""
    radiance = sheet.light.radiance[:, : sheet.light.height // 2].double()
    brightness = luminance(radiance.flatten(start_dim=1)).reshape(radiance.shape[1:])
    level = (brightness / brightness.max()).clamp(min=10.0**-DECADES).log10()
    image = axis.imshow(
        level.numpy(), extent=(180, -180, 0, 90), aspect="auto", cmap=LIGHT_MAP, vmin=-DECADES, vmax=0,
        interpolation="nearest",
    )  # fmt: skip
    for k, mark in enumerate(sheet.marks):
        x, y, z = mark.direction.tolist()
        place = math.degrees(math.atan2(y, x)), math.degrees(math.atan2(z, math.hypot(x, y)))
        axis.plot(
            *place, linestyle="none", marker="os"[k % 2], markersize=13 + 7 * k, fillstyle="none",
            markeredgewidth=1.8, color=mark.colour, label=mark.name,
        )  # fmt: skip
    if sheet.marks:
        axis.legend(loc="lower left", framealpha=0.9)
    axis.set_title("the light: upper hemisphere")
    axis.set_xlabel("azimuth [degrees], 0 = +x, 90 = +y")
    axis.set_ylabel("elevation [degrees]")
    axis.set_xticks([180, 90, 0, -90, -180])
    axis.set_yticks([0, 30, 60, 90])
    figure.colorbar(image, ax=axis, label="log10 of luminance / brightest", extend="min")


def draw_lines(axis: Axes, lines: Sequence[Line]) -> None:
    """Draws outlines with a legend below the panel."""
    for k, line in enumerate(lines):
        x, y = line.points.T.numpy()
        axis.plot(x, y, color=line.colour, linewidth=2.0, linestyle=("-", "--", ":")[k % 3], label=line.name)
    if lines:
        axis.legend(loc="upper center", framealpha=0.9, fontsize=8)


def label_plane(axis: Axes, units: str) -> None:
    """Names the axes of the plane."""
    axis.set_xlabel(f"x [{units}]")
    axis.set_ylabel(f"y [{units}]")
    axis.set_aspect("equal")


def extent(receiver: Receiver) -> tuple[float, float, float, float]:
    """Returns the rectangle of the plane that a picture of it covers."""
    (x, y), (width, height) = receiver.center, receiver.size
    return x - width / 2, x + width / 2, y - height / 2, y + height / 2


def pictures_side_by_side(pictures: Sequence[tuple[str, np.ndarray]], title: str) -> bytes:
    """Returns 8-bit pictures next to each other, each with its name, as a PNG."""
    figure = Figure(figsize=(4.6 * len(pictures), 4.2), dpi=100, layout="constrained")
    for axis, (name, image) in zip(figure.subplots(1, len(pictures), squeeze=False)[0], pictures, strict=True):
        axis.imshow(image, interpolation="nearest")
        axis.set_title(name, fontsize=10)
        axis.set_xticks([])
        axis.set_yticks([])
    figure.suptitle(title, parse_math=False)
    return png_bytes(figure)
