"""Draws docs/images/transport.png: a photograph is a sum of shadows, one per texel of the light.

    python scripts/draw_transport.py --out docs/images

The block and the sky of `torchlight demo`: three columns of the transport, and all of them together. Prints how many
singular values of the transport, over the visible samples, exceed 0.1, 0.01 ... of the largest.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import torch
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from torch import Tensor

from torchlight.demo import FIRST_POSE, RECEIVER
from torchlight.geometry.footprints import visible_samples
from torchlight.light import cubemap
from torchlight.light.directions import to_angles
from torchlight.light.overlap import latlong_to_texels
from torchlight.light.procedural import sun_and_window
from torchlight.precomputation import DIRECTIONS_PER_EDGE
from torchlight.preview import to_srgb8
from torchlight.synthetic import block_scene, receiver_image
from torchlight.transfer import transport

RESOLUTION = 16
UNUSED = 0.55


def brightest_texels(flux: Tensor, centers: Tensor) -> list[int]:
    """Returns the texel of largest flux (the sun), of largest flux over 90 degrees of azimuth away, and the zenith."""
    sun = int(flux.argmax())
    azimuth = to_angles(centers)[1]
    away = torch.cos(azimuth - azimuth[sun]) < 0
    window = int(torch.where(away, flux, 0.0).argmax())
    return [sun, window, int(centers[:, 2].argmax())]


def show(axes: Axes, values: Tensor, used: Tensor, title: str) -> None:
    """Draws receiver values, grey where the block stands, as a rectified photograph."""
    shown = torch.where(used, values, torch.full_like(values, UNUSED**2.2))
    axes.imshow(to_srgb8(receiver_image(shown, RECEIVER)), extent=(-2, 2, -2, 2), interpolation="nearest")
    axes.set_title(title, fontsize=12)
    axes.set_xticks([])
    axes.set_yticks([])


def main() -> None:
    """Computes a transport and draws the panels."""
    parser = argparse.ArgumentParser(description="Draws a photograph as a sum of shadows.")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder for transport.png")
    out: Path = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    scene = block_scene(FIRST_POSE, RECEIVER)
    matrix = transport(scene, RESOLUTION, DIRECTIONS_PER_EDGE // RESOLUTION).transport.double()
    radiance = latlong_to_texels(sun_and_window(256).radiance, RESOLUTION)
    cells = cubemap.texel_cells(RESOLUTION)
    flux = radiance.mean(dim=0) * cubemap.cell_cosine_weights(cells)[:, 0]
    chosen = brightest_texels(flux, cubemap.cell_directions(cells)[:, 0])
    used = visible_samples(scene)
    singular = torch.linalg.svdvals(matrix[used])
    counts = [f"1e-{digits}: {int((singular > 10.0**-digits * singular[0]).sum())}" for digits in range(1, 7)]
    print(f"{int(used.sum())} visible samples, {len(flux)} texels; singular values above", ", ".join(counts))
    figure = Figure(figsize=(11, 3.1), dpi=110, layout="constrained")
    axes = figure.subplots(1, 4)
    for axis, texel, name in zip(axes[:3], chosen, ("sun", "window", "zenith"), strict=True):
        column = radiance[:, texel, None] * matrix[:, texel]
        show(
            axis, column / column.max(), used, f"a texel in the {name}" if name != "zenith" else "a texel at the zenith"
        )
    total = radiance @ matrix.T
    show(axes[3], total / total[:, used].max(), used, f"all {len(flux)} texels: the photograph")
    for axis, sign in zip(axes[:3], ("+", "+", "+ ... ="), strict=True):
        axis.annotate(sign, (1.03, 0.5), xycoords="axes fraction", fontsize=16, va="center", annotation_clip=False)
    FigureCanvasAgg(figure).print_png(str(out / "transport.png"))


if __name__ == "__main__":
    main()
