"""Draws docs/images/joint.png: what a second photograph of one light adds, on a third pose.

    python scripts/draw_joint.py --out docs/images

Photographs are made by the block's exact shadow under a sun and a window, with noise of 1 % of the brightest sample.
The second has 0.6 times the exposure of the first, which is found. Everything shown is computed here.
"""

from __future__ import annotations

from pathlib import Path

import torch
import tyro
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from torch import Tensor

from torchlight import metrics
from torchlight.geometry.analytic_shadow import Block
from torchlight.geometry.footprints import visible_samples
from torchlight.geometry.receiver import Receiver
from torchlight.geometry.scene import Scene
from torchlight.inversion.adaptive import AdaptiveHaar
from torchlight.joint import View, explain_together, side_by_side
from torchlight.light.environment import EnvironmentMap
from torchlight.light.procedural import sun_and_window
from torchlight.photo.observation import Observation
from torchlight.photo.radiometry import encode
from torchlight.pipeline import explain
from torchlight.precomputation import columns_for, precompute
from torchlight.relighting import relight
from torchlight.synthetic import block_scene, block_values, pixel_rays

RECEIVER = Receiver((0.0, 0.0), (4.0, 4.0), (64, 64))
SIZE = (1.0, 0.6, 1.2)
POSES = (Block(SIZE, 20.0), Block(SIZE, 69.0, (0.3, 0.2)), Block(SIZE, -25.0, (-0.4, 0.3)))
EXPOSURES = (1.0, 0.6)
NOISE = 0.01
SETTINGS = AdaptiveHaar(noise=NOISE)
NAMES = ("the first photograph", "the second", "both")
FULL = 4.0  # end of the colour bar, 255ths of the brightest sample


def main(out: Path = Path("docs/images")) -> None:
    """Draws the picture.

    Args:
        out: folder for it.
    """
    truth = values()
    scenes = [block_scene(block, RECEIVER) for block in POSES]
    used = [visible_samples(scene).float() for scene in scenes]
    photos = [photographed(truth[k] * exposure, used[k], k) for k, exposure in enumerate(EXPOSURES)]
    lights, exposure, deviation = found(photos, scenes[:2])
    titles = ["first photograph", f"second: exposure {exposure:.4f} ± {deviation:.4f} found, 0.6 true", "a third pose"]
    figure = Figure(figsize=(13, 8.4), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, 3, sharex=True, sharey=True)
    top = truth[0][:, used[0] > 0].max()
    shown = [*(photo.samples for photo in photos), truth[2]]
    for place, title, picture, seen in zip(axes[0], titles, shown, used, strict=True):
        draw_photograph(place, picture / top, seen, title)
    bars = [
        draw_error(place, relight(scenes[2], light).double(), truth[2], used[2], f"by the light of {name}")
        for place, name, light in zip(axes[1], NAMES, lights, strict=True)
    ]
    figure.colorbar(bars[0], ax=axes[1], label="predicted - true, 255ths of the brightest sample", extend="both")
    figure.savefig(out / "joint.png", dpi=100)


def values() -> list[Float[Tensor, "3 points"]]:
    """Returns v = E / pi of the three poses by the exact shadow."""
    rays = pixel_rays(sun_and_window())
    return [block_values(block, RECEIVER, rays) for block in POSES]


def photographed(shown: Float[Tensor, "3 points"], used: Float[Tensor, " points"], seed: int) -> Observation:
    """Returns a photograph with noise."""
    drawn = torch.randn(shown.shape, generator=torch.Generator().manual_seed(seed), dtype=shown.dtype)
    return Observation(shown + NOISE * shown[:, used > 0].max() * drawn, used.double())


def found(photos: list[Observation], scenes: list[Scene]) -> tuple[list[EnvironmentMap], float, float]:
    """Returns the light of the first, the second at the first's exposure, and both; and the exposure found."""
    alone = [
        explain(photo, scene, columns_for(scene, SETTINGS.basis, SETTINGS), SETTINGS.basis, SETTINGS).light.radiance
        for photo, scene in zip(photos, scenes, strict=True)
    ]
    transfers = [precompute(scene, SETTINGS.dense_resolution) for scene in scenes]
    views = [View(scene, photo) for scene, photo in zip(scenes, photos, strict=True)]
    joint = explain_together(views, side_by_side(scenes, transfers, SETTINGS), SETTINGS.basis, SETTINGS)
    scale, deviation = joint.scales.values[1].item(), joint.scales.deviations[1].item()
    second = alone[1] * (EXPOSURES[0] / EXPOSURES[1])
    lights = [EnvironmentMap(alone[0]), EnvironmentMap(second), joint.estimate.light]
    return lights, scale, scale * deviation


def grid(points: Tensor) -> Tensor:
    """Returns values of samples as the rows of a picture, y upwards."""
    return points.reshape(*points.shape[:-1], RECEIVER.samples[1], RECEIVER.samples[0])


def draw_photograph(axes: Axes, shown: Float[Tensor, "3 points"], used: Float[Tensor, " points"], title: str) -> None:
    """Draws samples as sRGB, those under the block in grey."""
    picture = encode(grid(shown).clamp(0, 1), "srgb")
    picture = torch.where(grid(used) > 0, picture, torch.full_like(picture, 0.55))
    axes.imshow(picture.permute(1, 2, 0).numpy(), origin="lower", extent=extent())
    decorate(axes, title)


def draw_error(
    axes: Axes, shown: Float[Tensor, "3 points"], truth: Float[Tensor, "3 points"], used: Tensor, title: str
) -> AxesImage:
    """Draws predicted - true, mean over channels; names its RMS."""
    error = 255 * (shown - truth).mean(dim=0) / metrics.brightest(truth, used)
    error = torch.where(used > 0, error, torch.full_like(error, torch.nan))
    axes.set_facecolor("0.55")
    bar = axes.imshow(grid(error).numpy(), origin="lower", extent=extent(), cmap="PuOr", vmin=-FULL, vmax=FULL)
    decorate(axes, f"{title}\nRMS {metrics.rms_255(shown, truth, used):.2f} of 255")
    return bar


def decorate(axes: Axes, title: str) -> None:
    """Names a panel and its axes."""
    axes.set_title(title, fontsize=11)
    axes.set_xlabel("x [widths of the block]")
    axes.set_ylabel("y [widths of the block]")


def extent() -> tuple[float, float, float, float]:
    """Returns the receiver's edges."""
    (x, y), (width, height) = RECEIVER.center, RECEIVER.size
    return x - width / 2, x + width / 2, y - height / 2, y + height / 2


if __name__ == "__main__":
    tyro.cli(main)
