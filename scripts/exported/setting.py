"""The block, the plane and the lights of the check, and what a program is asked to render."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from torchlight.geometry.analytic_shadow import Block
from torchlight.geometry.primitives import box
from torchlight.geometry.receiver import Receiver
from torchlight.geometry.transforms import transform

BLOCK = Block((1.0, 0.6, 1.2), rotation_degrees=20.0)
WIDTH = 4.0
PIXELS = 64
RECEIVER = Receiver((0.0, 0.0), (WIDTH, WIDTH), (PIXELS, PIXELS))
LAMPS = 3


def job(folder: Path, shots: Sequence[dict[str, Any]], samples: int) -> dict[str, Any]:
    """Returns what a program is told: geometry, light and pictures.

    Args:
        folder: of the export.
        shots: from `shot`.
        samples: light paths per pixel.
    """
    placed = (*BLOCK.translation, 0.0)
    triangles = transform(box(BLOCK.size), 1.0, (0.0, 0.0, BLOCK.rotation_degrees), placed)
    corners = triangles.reshape(-1, 3).tolist()
    faces = [[3 * i, 3 * i + 1, 3 * i + 2] for i in range(len(triangles))]
    geometry = {"width": WIDTH, "pixels": PIXELS, "vertices": corners, "faces": faces}
    return {**geometry, "folder": str(folder.resolve()), "samples": samples, "shots": list(shots)}


def shot(out: Path, *, block: bool = True, picture: bool = True, lamps: Sequence[int] | None = None) -> dict[str, Any]:
    """Returns one picture: with or without the block, the environment, and all lamps (None) or some."""
    return {"out": str(out.resolve()), "block": block, "picture": picture, "lamps": lamps}
