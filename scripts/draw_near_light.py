"""Draws docs/images/near_light.png: a lamp at a height acts as distant light on a stretched object.

    python scripts/draw_near_light.py

The left half shows where the lamp throws the corners of a box, the right half where parallel rays throw those of the
box that `torchlight.near_light.model.stretched` makes of it: the shadows are the same.
"""

from __future__ import annotations

from pathlib import Path

import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from torchlight.geometry.receiver import Receiver
from torchlight.geometry.scene import Scene
from torchlight.near_light.model import stretched

OUT = Path(__file__).resolve().parent.parent / "docs" / "images" / "near_light.png"
LAMP = (110.0, 120.0)  # x and height, mm
BOX = ((-20.0, 0.0), (-20.0, 45.0), (20.0, 45.0), (20.0, 0.0))
LIGHT, OBJECT, SHADOW = "#E69F00", "#56B4E9", "#333333"


def main() -> None:
    """Draws the picture."""
    figure = Figure(figsize=(9, 3.2), layout="constrained")
    near, far = figure.subplots(1, 2, sharex=True, sharey=True)
    box = [list(corner) for corner in BOX]
    draw(near, box, [LAMP] * 2, f"a lamp {LAMP[1]:g} mm high")
    near.plot(*LAMP, "o", color=LIGHT, markersize=12)
    corners = torch.tensor([[x, 0.0, z] for x, z in box], dtype=torch.float64)
    scene = Scene(torch.stack([corners[:3], corners[1:]]), Receiver((0.0, 0.0), (300.0, 300.0), (2, 2)))
    mapped = stretched(scene, torch.zeros(2, dtype=torch.float64), 1 / LAMP[1]).triangles
    longer = [[p[0], p[2]] for p in torch.cat([mapped[0], mapped[1, 2:]]).tolist()]
    draw(far, longer, [(x + LAMP[0] / LAMP[1] * 200, z + 200) for x, z in (longer[1], longer[2])], "distant light")
    near.set_ylabel("z, mm")
    figure.savefig(OUT, dpi=110)


def draw(axes: Axes, box: list[list[float]], sources: list[tuple[float, float]], title: str) -> None:
    """Draws a box, the rays past its upper corners, and its shadow on z = 0."""
    landed = []
    for (x, z), (lamp_x, lamp_z) in zip((box[1], box[2]), sources, strict=True):
        end = x - (lamp_x - x) / (lamp_z - z) * z
        axes.plot([lamp_x, end], [lamp_z, 0], color=LIGHT, linewidth=1.5)
        landed.append(end)
    axes.fill([p[0] for p in box], [p[1] for p in box], color=OBJECT)
    axes.plot([min(landed), box[3][0]], [-2, -2], color=SHADOW, linewidth=5, solid_capstyle="butt")
    axes.set(title=title, xlabel="x, mm", xlim=(-140, 130), ylim=(-8, 130), aspect="equal")


if __name__ == "__main__":
    main()
