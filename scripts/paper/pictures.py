"""Figures 4 to 6 of the paper as PNG bytes, with difference pictures, and the fates of the Haar functions."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import matplotlib as mpl
import numpy as np
import torch
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.image import AxesImage
from torch import Tensor

from torchlight import fates as fates_of
from torchlight import metrics
from torchlight.drawing.canvas import png_bytes
from torchlight.drawing.content import DIVERGING, HEIGHT, WIDTH
from torchlight.drawing.fates import draw_borders, label_faces
from torchlight.inversion.quadtree import quadtree
from torchlight.light.bases import SphericalHarmonics
from torchlight.light.environment import EnvironmentMap, luminance
from torchlight.light.haar import block_synthesis
from torchlight.light.overlap import latlong_to_texels
from torchlight.light.synthesis import without_rounding
from torchlight.photo.observation import Observation
from torchlight.preview import to_srgb8

from .measure import Transfers, relit
from .methods import GAIN, Found
from .setting import HELD_OUT, PHOTOGRAPHED, RECEIVER, Exposed

SHOWN = ("SH, 36 coefficients", GAIN.name)  # the two columns of Figure 6
DETAIL = 64  # texels along a face's edge of the lights shown
LEVEL = 0.8  # linear value given to the PERCENTILE of a light's texels
PERCENTILE = 0.95
GREY = 0.55
NEGATIVE = np.array([204, 121, 167])  # pink
SCALE_255 = 10.0  # least limit of the difference pictures
EXTENT = (-2.0, 2.0, -2.0, 2.0)


def functions_picture() -> bytes:
    """Returns Figure 4: the first ten Haar functions of a face: 1 is white, 0 grey, -1 black."""
    figure = Figure(figsize=(11.0, 1.5), dpi=110, layout="constrained")
    for axis, values in zip(figure.subplots(1, 10), block_synthesis(torch.eye(16))[:10], strict=True):
        axis.imshow(values.sign(), extent=(0, 1, 0, 1), cmap="gray", vmin=-1, vmax=1, interpolation="nearest")
        axis.set_xticks([])
        axis.set_yticks([])
    return png_bytes(figure)


def probes_picture(lights: Mapping[str, EnvironmentMap]) -> bytes:
    """Returns Figure 5: the lights as cube maps without their bottom, unfolded, each at its own exposure."""
    columns = min(3, len(lights))
    rows = math.ceil(len(lights) / columns)
    figure = Figure(figsize=(4.6 * columns, 2.1 * rows), dpi=110, layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).reshape(-1)
    for axis, (name, light) in zip(axes, lights.items(), strict=False):
        texels = latlong_to_texels(light.radiance, DETAIL)
        draw_light(axis, texels, DETAIL, exposure(texels))
        axis.set_title(name, fontsize=10, parse_math=False)
    for axis in axes[len(lights) :]:
        axis.set_axis_off()
    return png_bytes(figure)


def comparison(
    probe: str, light: EnvironmentMap, seen: Exposed, found: Mapping[str, Found], transfers: Transfers
) -> bytes:
    """Returns Figure 6 with two columns more: truth, spherical harmonics, Haar wavelets, and what each gets wrong.

    First row: the lights at one exposure; negative radiance is pink, lines border the squares on which the green
    channel of the Haar wavelets is constant. Second: the photograph. Third: a pose that no solve has seen.
    """
    figure = Figure(figsize=(18.5, 11.0), dpi=100, layout="constrained")
    panels: list[SubFigure] = list(np.array(figure.subfigures(2, 1, height_ratios=(1.0, 2.6)), dtype=object))
    upper, lower = panels
    draw_lights(upper.subplots(1, 3), light, seen, [found[name] for name in SHOWN])
    axes = lower.subplots(2, 5)
    for row, block, truth in ((axes[0], PHOTOGRAPHED, seen.photo), (axes[1], HELD_OUT[0], seen.truth[1])):
        draw_pose(lower, row, truth, {name: relit(block, found[name], transfers) for name in SHOWN})
    axes[0, 0].set_title("the photograph", fontsize=10)
    axes[1, 0].set_title("another pose, never shown", fontsize=10)
    figure.suptitle(f"{probe}: Figure 6 of Okabe, Sato and Sato (2004)", fontsize=12, parse_math=False)
    return png_bytes(figure)


def draw_pose(
    figure: SubFigure, axes: Sequence[Axes], truth: Observation, relit_by: Mapping[str, Float[Tensor, "3 points"]]
) -> None:
    """Draws the truth of a pose, the pose under each light, and the differences at one scale."""
    used = truth.weights > 0
    white = metrics.brightest(truth.samples, truth.weights)
    errors = {name: luminance(values - truth.samples) * (255.0 / white) for name, values in relit_by.items()}
    limit = max(SCALE_255, float(torch.quantile(torch.stack(list(errors.values()))[:, used].abs(), 0.99)))
    draw_plane(axes[0], truth.samples / white, used, "truth")
    for k, (name, values) in enumerate(relit_by.items()):
        rms = metrics.rms_255(values, truth.samples, truth.weights).item()
        draw_plane(axes[1 + k], values / white, used, f"{name}: {rms:.2f} of 255")
        difference = axes[1 + len(errors) + k]
        image = draw_difference(difference, errors[name], used, limit, f"{name}, minus truth")
        figure.colorbar(image, ax=difference, shrink=0.85, extend="both", label="255ths of the brightest")


def fates(found: Mapping[str, Found]) -> bytes:
    """Returns which Haar functions the adaptive method by gain uses, and why no others."""
    light = found[GAIN.name]
    if light.refinement is None:
        raise ValueError(f"{GAIN.name}: no refinement")
    return fates_of.fates_picture(light.refinement, light.basis.resolution)


def draw_lights(axes: Sequence[Axes], light: EnvironmentMap, seen: Exposed, found: Sequence[Found]) -> None:
    """Draws the true light and those found, unfolded, at the exposure of the truth."""
    truth = latlong_to_texels(light.radiance, DETAIL)
    scale = exposure(truth)
    draw_light(axes[0], truth, DETAIL, scale)
    axes[0].set_title("the light", fontsize=10)
    for axis, one, name in zip(axes[1:], found, SHOWN, strict=False):
        texels, resolution = shown_texels(one)
        draw_light(axis, texels / seen.exposure, resolution, scale)
        negative = " (pink: negative radiance)" if bool((texels < 0).any()) else ""
        axis.set_title(f"{name}{negative}", fontsize=10)
        if one.refinement is not None:
            tree = quadtree(one.basis.resolution)
            draw_borders(axis, fates_of.borders(tree, one.refinement.kept[1]).numpy(), colour="0.6")


def shown_texels(found: Found) -> tuple[Float[Tensor, "3 texels"], int]:
    """Returns the radiance at texels, finer than the solve's where the basis allows, and their resolution."""
    basis, coefficients = found.basis, found.solution.coefficients
    if isinstance(basis, SphericalHarmonics):
        return SphericalHarmonics(basis.degree, DETAIL).synthesis(coefficients), DETAIL
    return without_rounding(basis.synthesis(coefficients)[:, None])[:, 0], basis.resolution


def exposure(texels: Float[Tensor, "3 texels"]) -> float:
    """Returns the factor from radiance to linear picture values."""
    level = torch.quantile(luminance(texels).double(), PERCENTILE).item()
    return LEVEL / level if level > 0 else 1.0


def draw_light(axis: Axes, texels: Float[Tensor, "3 texels"], resolution: int, scale: float) -> None:
    """Draws a light on the unfolded faces as sRGB; where its luminance is negative, pink."""
    picture = fates_of.unfolded(texels * scale, resolution)
    encoded = to_srgb8(picture.nan_to_num(nan=1.0).float())
    encoded[(luminance(picture.flatten(start_dim=1)) < 0).reshape(picture.shape[1:]).numpy()] = NEGATIVE
    axis.imshow(encoded, extent=(0, WIDTH, 0, HEIGHT), interpolation="nearest")
    label_faces(axis)


def draw_plane(axis: Axes, values: Float[Tensor, "3 points"], used: Tensor, title: str) -> None:
    """Draws the plane as sRGB, white at 1; grey where the block stands."""
    columns, rows = RECEIVER.samples
    encoded = to_srgb8(values.reshape(3, rows, columns).flip(1))
    encoded[~used.reshape(rows, columns).flip(0).numpy()] = round(255 * GREY)
    axis.imshow(encoded, extent=EXTENT, interpolation="nearest")
    finish(axis, title)


def draw_difference(axis: Axes, error: Float[Tensor, " points"], used: Tensor, limit: float, title: str) -> AxesImage:
    """Draws a signed difference, grey where the block stands."""
    columns, rows = RECEIVER.samples
    shown = torch.where(used, error, torch.nan).reshape(rows, columns).flip(0).numpy()
    colours = mpl.colormaps[DIVERGING].with_extremes(bad=(GREY, GREY, GREY))
    image = axis.imshow(shown, extent=EXTENT, cmap=colours, vmin=-limit, vmax=limit, interpolation="nearest")
    finish(axis, title)
    return image


def finish(axis: Axes, title: str) -> None:
    """Writes the title and the axes' names."""
    axis.set_title(title, fontsize=10)
    axis.set_xlabel("x")
    axis.set_ylabel("y")
    axis.set_xticks([-2, -1, 0, 1, 2])
    axis.set_yticks([-2, -1, 0, 1, 2])
