"""Draws docs/images/streams.png: a sun that turns, found again in every frame of a video of a shadow.

    python scripts/draw_streams.py --out docs/images

Frames are made from texels four times as fine as the solver's, with noise of 1 % of the brightest sample; one is broken
and one is black.
"""

from __future__ import annotations

import math
from pathlib import Path

import torch
import tyro
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from torch import Tensor

from torchlight.geometry.analytic_shadow import Block
from torchlight.geometry.footprints import visible_samples
from torchlight.geometry.receiver import Receiver
from torchlight.geometry.scene import Scene
from torchlight.light import overlap
from torchlight.light.environment import rotate_about_z
from torchlight.light.peaks import peak_direction, texel_peaks
from torchlight.light.procedural import SUN_AZIMUTH, sun_and_window
from torchlight.photo.radiometry import encode
from torchlight.streaming import stream
from torchlight.synthetic import EXPOSED, block_scene, receiver_image
from torchlight.transfer import transport

RECEIVER = Receiver((0.0, 0.0), (4.0, 4.0), (64, 64))
BLOCK = Block((1.0, 0.6, 1.2), 20.0)
FRAMES, TURN = 96, 360.0
FINE = 64  # texels along an edge of a face of the light that is filmed
BROKEN, BLACK = 40, 70
SHOWN = (8, 32, 56, 80)
TOLERANCE = 1e-5
NOISE = 0.01
BLUE, ORANGE = "#0072B2", "#D55E00"  # after Okabe and Ito


def main(out: Path = Path("docs/images")) -> None:
    """Draws the picture.

    Args:
        out: folder for it.
    """
    scene = block_scene(BLOCK, RECEIVER)
    used = visible_samples(scene).float()
    video = filmed(scene, used)
    matrix = transport(scene, 16, 12).transport
    solutions = list(stream(matrix, (torch.pi * video).split(32), used, TOLERANCE))
    light, kkt = (torch.cat([getattr(s, name) for s in solutions]) for name in ("coefficients", "kkt_residual"))
    x, y, _ = peak_direction(texel_peaks(light.double(), 16)).unbind(-1)
    found = torch.rad2deg(torch.atan2(y, x))
    true = (math.degrees(SUN_AZIMUTH) + angles() + 180) % 360 - 180
    missed = (found - true + 180) % 360 - 180
    good = ~torch.isnan(found)
    print(
        f"{int(good.sum())} of {FRAMES} frames with light; the sun's azimuth is off by {missed[good].abs().mean():.1f}"
    )
    print(f"degrees on average, {missed[good].abs().max():.1f} at most; largest KKT cosine {kkt[good].max():.1e}")
    figure = Figure(figsize=(11, 7.4), layout="constrained")
    axes = figure.subplot_mosaic("abcd;eeee;ffff", height_ratios=[1.5, 1.3, 0.9])
    for name, frame in zip("abcd", SHOWN, strict=True):
        draw_frame(axes[name], video[frame], frame)
    draw_azimuth(axes["e"], found, true)
    draw_certificate(axes["f"], kkt)
    FigureCanvasAgg(figure).print_png(out / "streams.png")


def angles() -> Float[Tensor, " frames"]:
    """Returns by how many degrees the light has turned in every frame."""
    return torch.arange(FRAMES, dtype=torch.float64) * (TURN / FRAMES)


def filmed(scene: Scene, used: Float[Tensor, " points"]) -> Float[Tensor, "frames 3 points"]:
    """Returns linear frames; one holds NaN, one is black."""
    fine, sky = transport(scene, FINE, 4), sun_and_window(128)
    turned = (rotate_about_z(sky, angle).radiance.float() for angle in angles().tolist())
    values = torch.stack([fine.mv(overlap.latlong_to_texels(light, FINE)).double() / torch.pi for light in turned])
    values *= EXPOSED / values[..., used > 0].max()
    noise = torch.randn(values.shape, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    video = (values + NOISE * noise).float()
    video[BROKEN, :, used.nonzero()[0]] = torch.nan
    video[BLACK] = 0
    return video


def draw_frame(ax: Axes, frame: Float[Tensor, "3 points"], number: int) -> None:
    """Draws a frame as a display would show it."""
    image = encode(receiver_image(frame, RECEIVER).clamp(0, 1), "srgb").permute(1, 2, 0)
    half = RECEIVER.size[0] / 2
    ax.imshow(image.numpy(), extent=(-half, half, -half, half))
    ax.set(title=f"frame {number}", xlabel="x (scene's unit)", ylabel="y" if number == SHOWN[0] else None)


def draw_azimuth(ax: Axes, found: Float[Tensor, " frames"], true: Float[Tensor, " frames"]) -> None:
    """Draws where the sun was and where it was found."""
    ax.plot(true.numpy(), ".", color="0.6", markersize=9, label="the sun")
    ax.plot(found.numpy(), "+", color=BLUE, markersize=6, label="brightest source found")
    for frame, what in ((BROKEN, "a sample is NaN"), (BLACK, "black")):
        ax.axvline(frame, color=ORANGE, linewidth=1)
        ax.annotate(what, (frame, 60), xytext=(4, 0), textcoords="offset points", color=ORANGE)
    ax.set(ylabel="azimuth (degrees)", yticks=range(-180, 181, 90), xlim=(-1, FRAMES))
    ax.tick_params(labelbottom=False)
    ax.legend(loc="upper right", ncols=2)


def draw_certificate(ax: Axes, kkt: Float[Tensor, "frames 3"]) -> None:
    """Draws the certificate of every frame, its worst channel."""
    worst = kkt.amax(dim=-1)
    ax.semilogy(torch.where(worst > 0, worst, torch.nan).numpy(), ".", color=BLUE)
    ax.axhline(TOLERANCE, color=ORANGE, linewidth=1)
    ax.annotate("asked for", (0, TOLERANCE), xytext=(0, 4), textcoords="offset points", color=ORANGE)
    ax.set(xlabel="frame", ylabel="KKT cosine", xlim=(-1, FRAMES), ylim=(None, 30 * TOLERANCE))


if __name__ == "__main__":
    tyro.cli(main)
