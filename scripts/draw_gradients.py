"""Draws docs/images/gradients.png: how the light found answers to the shadow's samples.

    python scripts/draw_gradients.py --out docs/images

The block and the sky of `torchlight demo`, grey: the photograph; how the texel at the sun changes with every sample
(one backward pass); and how every texel changes with one sample, where the cross is. Prints how far the first agrees
with finite differences.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import torch
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from torch import Tensor
from torch.func import jacrev

from torchlight.demo import FIRST_POSE, RECEIVER
from torchlight.geometry.footprints import visible_samples
from torchlight.inversion.linear import solve
from torchlight.light import cubemap
from torchlight.light.overlap import latlong_to_texels
from torchlight.light.procedural import sun_and_window
from torchlight.photo.observation import Observation
from torchlight.precomputation import DIRECTIONS_PER_EDGE
from torchlight.solvers import NNLS
from torchlight.synthetic import block_scene, receiver_image
from torchlight.transfer import transport

RESOLUTION = 8
SOLVER = NNLS(ridge=1e-3)  # enough damping for a picture of what the photograph can tell
PLACES = ((1, 1), (3, 1), (0, 1), (2, 1), (1, 2))  # of the faces +x -x +y -y +z: column, row from below
EXTENT = (-2.0, 2.0, -2.0, 2.0)
STEP = 1e-4  # of the finite differences, relative to the brightest sample


def main() -> None:
    """Solves, differentiates and draws."""
    parser = argparse.ArgumentParser(description="Draws the gradients of a light by the samples of a shadow.")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder for gradients.png")
    out: Path = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    scene = block_scene(FIRST_POSE, RECEIVER)
    matrix = transport(scene, RESOLUTION, DIRECTIONS_PER_EDGE // RESOLUTION).transport.double()
    radiance = latlong_to_texels(sun_and_window(256).radiance, RESOLUTION).double().mean(dim=0)
    weights = visible_samples(scene).double()
    samples = matrix @ radiance
    samples = samples / (samples * weights).max()
    jacobian = jacrev(lambda samples: light(matrix, samples, weights))(samples)
    texel = int(light(matrix, samples, weights).argmax())
    by_sample = jacobian[texel]
    sample = int((by_sample.abs() * weights).argmax())
    print(f"largest |difference| to finite differences: {disagreement(matrix, samples, weights, texel, by_sample):.1e}")
    figure = Figure(figsize=(14, 4.0), dpi=100, layout="constrained")
    axes = figure.subplots(1, 3, width_ratios=(1, 1, 1.15))
    plane(axes[0], samples, weights, "the photograph: samples b", "gray", (0.0, 1.0), "share of the brightest")
    most = (by_sample.abs() * weights).max().item()
    title = "d(texel at the sun) / d(every sample)"
    plane(axes[1], by_sample, weights, title, "PuOr", (-most, most), "radiance per unit of sample")
    row, column = divmod(sample, RECEIVER.samples[0])
    for axis in axes[:2]:
        mark(axis, row, column)
    unfolded(axes[2], jacobian[:, sample], "d(every texel) / d(sample at the cross)")
    FigureCanvasAgg(figure).print_png(str(out / "gradients.png"))


def light(matrix: Tensor, samples: Tensor, weights: Tensor) -> Tensor:
    """Returns the radiance of the texels, of one channel."""
    return solve(matrix, Observation(samples[None], weights), SOLVER).coefficients[0]


def disagreement(matrix: Tensor, samples: Tensor, weights: Tensor, texel: int, gradient: Tensor) -> float:
    """Returns the largest relative difference to central differences, over the 16 samples of largest gradient."""
    worst = 0.0
    for index in gradient.abs().topk(16).indices.tolist():
        step = torch.zeros_like(samples)
        step[index] = STEP
        ahead, behind = (light(matrix, samples + sign * step, weights)[texel] for sign in (1, -1))
        worst = max(worst, abs((ahead - behind).item() / (2 * STEP) - gradient[index].item()))
    return worst / gradient.abs().max().item()


def plane(
    axis: Axes, values: Tensor, used: Tensor, title: str, colours: str, limits: tuple[float, float], units: str
) -> None:
    """Draws receiver values; where the block stands nothing."""
    shown = torch.where(used > 0, values, torch.nan)
    image = receiver_image(shown[None], RECEIVER)[0].numpy()
    drawn = axis.imshow(image, cmap=colours, vmin=limits[0], vmax=limits[1], extent=EXTENT, interpolation="nearest")
    axis.set(title=title, xlabel="x, scene units", ylabel="y, scene units", facecolor="0.55")
    axis.figure.colorbar(drawn, ax=axis, label=units, shrink=0.8)


def mark(axis: Axes, row: int, column: int) -> None:
    """Draws a cross at a sample."""
    steps = [4.0 / count for count in RECEIVER.samples]
    axis.plot(-2 + (column + 0.5) * steps[0], -2 + (row + 0.5) * steps[1], "x", color="#D55E00", markersize=11, mew=2.5)


def unfolded(axis: Axes, values: Tensor, title: str) -> None:
    """Draws texels on the unfolded cube map, the four sides in a row and the top above."""
    faces = cubemap.scatter_to_faces(values, RESOLUTION)
    visible = cubemap.scatter_to_faces(torch.ones_like(values), RESOLUTION)
    most = values.abs().max().item()
    for name, face, shown, (left, bottom) in zip(cubemap.FACES, faces, visible, PLACES, strict=False):
        image = torch.where(shown > 0, face, torch.nan).numpy()
        extent = (left, left + 1, bottom, bottom + 1)
        axis.imshow(image, cmap="PuOr", vmin=-most, vmax=most, extent=extent, interpolation="nearest")
        axis.annotate(name, (left + 0.05, bottom + 0.9), va="top", fontsize=11)
        axis.plot([left, left + 1, left + 1, left, left], [bottom, bottom, bottom + 1, bottom + 1, bottom], color="0.3")
    axis.set(title=title, xlim=(-0.05, 4.05), ylim=(1.49, 3.02), xticks=[], yticks=[], aspect="equal")
    axis.set_xlabel("the cube map from inside; sides above the horizon")
    axis.figure.colorbar(axis.images[0], ax=axis, label="radiance per unit of sample", location="bottom", shrink=0.8)


if __name__ == "__main__":
    main()
