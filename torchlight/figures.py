"""Pictures of results as PNG bytes: what was observed, what the light predicts, what is left; and the light itself."""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO

import matplotlib as mpl
import numpy as np
import torch
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure, SubFigure
from matplotlib.patches import Patch
from torch import Tensor

from torchlight.geometry.receiver import Receiver
from torchlight.light.environment import EnvironmentMap, flux, luminance
from torchlight.photo.observation import Observation, Rejection
from torchlight.photo.radiometry import encode

UNUSED = 0.55  # grey of samples that were not used
REJECTED = {  # after Okabe and Ito: told apart with every common colour blindness
    Rejection.SATURATED: ("#D55E00", "saturated"),
    Rejection.SPECULAR: ("#F0E442", "glint"),
    Rejection.ROBUST: ("#56B4E9", "let go of by --robust"),
}
PREVIEW_PERCENTILE = 98.0
PREVIEW_LEVEL = 0.8  # linear value given to that percentile of the pixels that hold light
DIVERGING = "PuOr"  # readable with every common colour blindness
MIN_SCALE_255 = 1.0
PANEL_INCHES, FOOT_INCHES, HEAD_INCHES, LEGEND_INCHES = 3.5, 0.62, 0.72, 0.3


@dataclass(frozen=True)
class Preview:
    """A tone-mapped light as PNG bytes, and what the tone map lost.

    Attributes:
        png: 8-bit sRGB lat-long picture.
        scale: the factor from radiance to linear picture values.
        clipped_flux: share of the luminance flux on the plane above white.
    """

    png: bytes
    scale: float
    clipped_flux: float


def fit_picture(
    observation: Observation,
    predicted: Float[Tensor, "3 points"],
    receiver: Receiver,
    units: str,
    title: str,
    names: tuple[str, str] = ("observed", "predicted"),
) -> bytes:
    """Returns a PNG of the observed and the predicted receiver and of their difference, with scales.

    Observed and predicted are shown as sRGB with white at the brightest used sample; the difference is that of the
    luminance, predicted - observed, in 255ths of the same white. Samples that were not used are grey; those that the
    camera sees and that were left out have the colour of their `Rejection` in the first and the last picture.
    """
    used = observation.weights > 0
    white = observation.samples[:, used].max().item()
    difference = luminance(predicted - observation.samples) * (255.0 / white)
    limit = max(MIN_SCALE_255, float(torch.quantile(difference[used].abs().double(), 0.998)))
    side = _panel_inches(receiver)
    handles, layers = _rejected(observation, receiver)
    foot = FOOT_INCHES + (LEGEND_INCHES if handles else 0.0)
    figure = Figure(figsize=(13.5, foot + side[1] + HEAD_INCHES), dpi=110)
    axes = [add_axes(figure, 0.75 + 4.05 * place, foot, *side) for place in range(3)]
    extent = _extent(receiver)
    for axis, values, name in zip(axes[:2], (observation.samples, predicted), names, strict=True):
        axis.imshow(_picture(values / white, used, receiver), extent=extent, interpolation="nearest")
        _label(axis, name, units)
    for axis, layer in itertools.product((axes[0], axes[2]), layers):
        axis.imshow(layer, extent=extent, interpolation="nearest", zorder=2)
    shown = torch.where(used, difference, torch.nan).reshape(receiver.samples[::-1]).flip(0).numpy(force=True)
    colours = mpl.colormaps[DIVERGING].with_extremes(bad=(UNUSED, UNUSED, UNUSED))
    image = axes[2].imshow(shown, extent=extent, cmap=colours, vmin=-limit, vmax=limit, interpolation="nearest")
    _label(axes[2], f"{names[1]} - {names[0]} (luminance)", units)
    for axis in axes[1:]:
        axis.tick_params(labelleft=False)
    beside = add_axes(figure, 12.55, foot + 0.075 * side[1], 0.17, 0.85 * side[1])
    figure.colorbar(image, cax=beside, extend="both", label="255ths of the brightest sample")
    if handles:
        figure.legend(handles=handles, loc="lower left", ncols=len(handles), fontsize=9, frameon=False)
    figure.text(0.5, 1 - 0.18 / figure.get_figheight(), title, ha="center", va="center", fontsize=11, parse_math=False)
    return png_bytes(figure)


def add_axes(figure: Figure, left: float, bottom: float, width: float, height: float) -> Axes:
    """Returns new axes, placed in inches from a figure's lower left corner.

    Matplotlib's own layouts measure every label first, which takes as long as drawing it.
    """
    across, up = figure.get_size_inches()
    return figure.add_axes((left / across, bottom / up, width / across, height / up))


def _panel_inches(receiver: Receiver) -> tuple[float, float]:
    """Returns width and height of a picture of the receiver, except where it is very long or very narrow."""
    return PANEL_INCHES, PANEL_INCHES * min(max(receiver.size[1] / receiver.size[0], 0.25), 2.5)


def _rejected(observation: Observation, receiver: Receiver) -> tuple[list[Patch], list[np.ndarray]]:
    """Returns legend entries that say how many samples were left out and why, and a coloured layer for each."""
    columns, rows = receiver.samples
    grid = observation.rejections.reshape(rows, columns).flip(0).cpu().numpy()
    handles, layers = [], []
    for why, (colour, name) in REJECTED.items():
        count = int((grid == why).sum())
        if count == 0:
            continue
        layer = np.zeros((rows, columns, 4))
        layer[grid == why] = to_rgba(colour)
        layers.append(layer)
        handles.append(Patch(facecolor=colour, edgecolor="0.4", label=f"{name}: {count} samples"))
    return handles, layers


def preview(environment: EnvironmentMap) -> Preview:
    """Returns a tone-mapped picture of a map: one exposure for all, clipped to [0, 1], encoded as sRGB."""
    radiance = environment.radiance.detach().double().cpu()
    brightness = luminance(radiance.flatten(start_dim=1)).clamp(min=0)
    lit = brightness[brightness > 0]
    level = float(np.percentile(lit.numpy(), PREVIEW_PERCENTILE)) if len(lit) else 1.0
    scale = PREVIEW_LEVEL / level
    flows = flux(EnvironmentMap(radiance.clamp(min=0)))
    lost = flows * (1 - (1 / (radiance * scale).clamp(min=1e-12)).clamp(max=1))
    total = luminance(flows.flatten(start_dim=1)).sum().item()
    share = luminance(lost.flatten(start_dim=1)).sum().item() / total if total > 0 else 0.0
    return Preview(encode_png(to_srgb8(radiance * scale)), scale, share)


def to_srgb8(linear: Float[Tensor, "3 height width"]) -> np.ndarray:
    """Returns linear values as 8-bit sRGB, [height, width, 3]; clipped to [0, 1]."""
    encoded = encode(linear.clamp(0, 1), "srgb")
    return (encoded * 255).round().byte().permute(1, 2, 0).contiguous().numpy(force=True)


def encode_png(image: np.ndarray) -> bytes:
    """Returns an 8-bit picture, [height, width, 3 or 4], as PNG bytes."""
    from PIL import Image

    buffer = BytesIO()
    Image.fromarray(image).save(buffer, format="PNG")
    return buffer.getvalue()


def decode_png(data: bytes) -> np.ndarray:
    """Returns the pixels of an 8-bit picture, which may be written to."""
    from PIL import Image

    return np.array(Image.open(BytesIO(data)))


def png_bytes(figure: Figure) -> bytes:
    """Returns a figure drawn as PNG; characters that its font lacks, as in a file's name, are drawn as boxes."""
    buffer = BytesIO()
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph .* missing from font")
        FigureCanvasAgg(figure).print_png(buffer)
    return buffer.getvalue()


def _picture(values: Float[Tensor, "3 points"], used: Tensor, receiver: Receiver) -> np.ndarray:
    columns, rows = receiver.samples
    encoded = encode(values.clamp(0, 1).reshape(3, rows, columns), "srgb").reshape(3, -1)
    shown = torch.where(used, encoded, torch.full_like(encoded, UNUSED)).reshape(3, rows, columns)
    return shown.flip(1).permute(1, 2, 0).numpy(force=True)


def _extent(receiver: Receiver) -> tuple[float, float, float, float]:
    (x, y), (width, height) = receiver.center, receiver.size
    return x - width / 2, x + width / 2, y - height / 2, y + height / 2


def _label(axis: Axes, title: str, units: str) -> None:
    axis.set_title(title, y=1.0)  # stated, or Matplotlib measures all labels to find it
    axis.locator_params(nbins=5)
    axis.set_xlabel(f"x [{units}]", parse_math=False)
    axis.set_ylabel(f"y [{units}]", parse_math=False)
    axis.set_aspect("equal")


def light_comparison(truth: EnvironmentMap, found: EnvironmentMap) -> bytes:
    """Returns a PNG of the upper hemispheres of a true and a recovered light at one exposure, one above the other."""
    figure = Figure(figsize=(9.5, 5.6), dpi=110, layout="constrained")
    draw_lights(list(figure.subplots(2, 1, sharex=True)), truth, found)
    return png_bytes(figure)


def draw_lights(axes: Sequence[Axes], truth: EnvironmentMap, found: EnvironmentMap) -> None:
    """Draws the upper hemispheres of a true and a recovered light at one exposure into two axes."""
    scale = preview(truth).scale
    for axis, light, name in zip(axes, (truth, found), ("true light", "light recovered from the shadow"), strict=True):
        upper = light.radiance[:, : light.height // 2].double() * scale
        axis.imshow(to_srgb8(upper), extent=(180, -180, 0, 90), aspect="auto", interpolation="nearest")
        axis.set_title(name)
        axis.set_ylabel("elevation [degrees]")
        axis.set_yticks([0, 30, 60, 90])
        axis.set_xticks([180, 90, 0, -90, -180])
    axes[-1].set_xlabel("azimuth [degrees], 0 = +x, 90 = +y")


def overview(
    photo: Observation,
    lights: tuple[EnvironmentMap, EnvironmentMap],
    second: Observation,
    relit: Float[Tensor, "3 points"],
    receiver: Receiver,
) -> bytes:
    """Returns the whole story as one PNG: the photograph, the true and the recovered light, a second pose relit.

    Args:
        photo: what the light was recovered from.
        lights: true and recovered.
        second: truth of a pose that was never shown to the solver.
        relit: that pose under the recovered light.
        receiver: the plane of both.
    """
    figure = Figure(figsize=(14.0, 4.6), dpi=110, layout="constrained")
    panels: list[SubFigure] = list(np.array(figure.subfigures(1, 3, width_ratios=(1.0, 1.55, 1.75)), dtype=object))
    left, middle, right = panels
    shown = ((left.subplots(), photo, photo.samples, "1  the photograph"),)
    truth_axis, relit_axis = right.subplots(1, 2, sharey=True)
    shown += ((truth_axis, second, second.samples, "3  another pose: truth"),)
    shown += ((relit_axis, second, relit, "relit by the recovered light"),)
    for axis, observation, values, name in shown:
        used = observation.weights > 0
        white = observation.samples[:, used].max()
        axis.imshow(_picture(values / white, used, receiver), extent=_extent(receiver), interpolation="nearest")
        axis.set_title(name)
        axis.set_xticks([])
        axis.set_yticks([])
    axes = list(middle.subplots(2, 1, sharex=True))
    draw_lights(axes, *lights)
    axes[0].set_title("the true light (not used)")
    axes[1].set_title("2  the light recovered from the shadow")
    return png_bytes(figure)
