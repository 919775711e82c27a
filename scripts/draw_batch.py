"""Draws docs/images/batch.png: a day of photographs, the lights recovered from them, and one file that is damaged.

    python scripts/draw_batch.py --out docs/images

Photographs are made by the block's exact shadow under a sky whose sun goes round; `torchlight batch` does the rest.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import cv2
import numpy as np
import tyro
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from torchlight.demo import FIRST_POSE, RECEIVER
from torchlight.geometry.footprints import visible_samples
from torchlight.io.images import write_png
from torchlight.light.environment import EnvironmentMap
from torchlight.light.procedural import sun_and_window
from torchlight.synthetic import block_scene, block_values, eight_bit, expose, pixel_rays, receiver_image

PHOTOGRAPHS = 10
DAMAGED = 6
SCENE = """units: unit
occluders: [{box: [1, 0.6, 1.2], rotation_degrees: [0, 0, 20]}]
receiver: {size: [4, 4], samples: [64, 64]}
photo: {encoding: linear}
"""


def main(out: Path = Path("docs/images")) -> None:
    """Draws the picture.

    Args:
        out: folder for it.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "block.yaml").write_text(SCENE)
        (folder / "day").mkdir()
        photograph(folder / "day")
        said = run(folder)
        figure = drawn(folder, said)
    FigureCanvasAgg(figure).print_png(out / "batch.png")


def photograph(folder: Path) -> None:
    """Writes the photographs of a day, one of them cut off in the middle."""
    sky, scene = sun_and_window(128), block_scene(FIRST_POSE, RECEIVER)
    for index in range(PHOTOGRAPHS):
        turned = EnvironmentMap(sky.radiance.roll(-index * sky.radiance.shape[-1] // (2 * PHOTOGRAPHS), dims=-1))
        values = block_values(FIRST_POSE, RECEIVER, pixel_rays(turned))
        photo = receiver_image(eight_bit(values * expose(values, visible_samples(scene))), RECEIVER)
        write_png(place(folder, index), (photo * 255).round().byte().permute(1, 2, 0).contiguous().numpy())
    damaged = place(folder, DAMAGED)
    damaged.write_bytes(damaged.read_bytes()[:3000])


def place(folder: Path, index: int) -> Path:
    """Returns the place of a photograph."""
    return folder / f"{index + 8:02d}00.png"


def run(folder: Path) -> str:
    """Returns what `torchlight batch` prints."""
    call = ["batch", "day/*.png", "--scene", "block.yaml", "--out", "lights", "--workers", "0"]
    call += ["--skip-near-test", "--skip-confidence", "--skip-report"]  # whose marks and legend light.png would have
    command = [sys.executable, "-c", "from torchlight.cli import program; program()", *call]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    print(done.stdout, done.stderr)
    return done.stdout.splitlines()[0]


def drawn(folder: Path, said: str) -> Figure:
    """Returns the photographs above their lights."""
    figure = Figure(figsize=(15, 3.3), layout="constrained", dpi=100)
    axes = figure.subplots(2, PHOTOGRAPHS, height_ratios=(1.0, 0.52))
    for index in range(PHOTOGRAPHS):
        photo = place(folder / "day", index)
        light = folder / "lights" / "photos" / photo.stem / "light.png"
        show(axes[0, index], photo, photo.name, "cut off:\nno PNG any more")
        show(axes[1, index], light, "", "failed, with\nthe reason")
    axes[0, 0].set_ylabel("photograph")
    axes[1, 0].set_ylabel("light.png")
    figure.suptitle(said)
    return figure


def show(axis: Axes, file: Path, title: str, otherwise: str) -> None:
    """Draws a picture, or the words where it cannot be read."""
    stored = cv2.imread(str(file), cv2.IMREAD_COLOR) if file.is_file() and intact(file) else None
    axis.set(xticks=[], yticks=[], title=title, box_aspect=1.0 if title else 0.5)
    if stored is None:
        axis.text(0.5, 0.5, otherwise, ha="center", va="center", fontsize=9, transform=axis.transAxes)
        axis.set_facecolor("0.85")
        return
    picture = np.ascontiguousarray(stored[..., ::-1])
    axis.imshow(picture)


def intact(file: Path) -> bool:
    """Returns whether a PNG file ends as it should."""
    return file.read_bytes().rstrip()[-8:-4] == b"IEND"


if __name__ == "__main__":
    tyro.cli(main)
