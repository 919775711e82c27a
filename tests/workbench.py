"""Small scenes and photographs on disk, and the command line called in this process."""

from __future__ import annotations

import math
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from functools import cache
from io import StringIO
from pathlib import Path

import pytest
import torch
from torch import Tensor

from torchlight.cli import main
from torchlight.compiled import ANNOUNCEMENT
from torchlight.geometry.analytic_shadow import Block
from torchlight.geometry.receiver import Receiver
from torchlight.io.exr import write_exr
from torchlight.io.images import write_png
from torchlight.light.procedural import SUN_AZIMUTH, SUN_ELEVATION, sun_and_window
from torchlight.synthetic import block_values, expose, pixel_rays, receiver_image

BLOCK = Block((1.0, 0.6, 1.2), 20.0)
BOX = """units: mm
occluders:
  - box: [1, 0.6, 1.2]
    rotation_degrees: [0, 0, 20]
"""
RECEIVER = "receiver: {size: [4, 4], samples: [16, 16]}\n"
LINEAR = "photo: {encoding: linear}\n"
RECTIFIED = BOX + RECEIVER + LINEAR
CAMERA = """camera:
  image_size: [96, 72]
  K: [[102, 0, 47.5], [0, 102, 35.5], [0, 0, 1]]
  distortion: [-0.05, 0.01, 0, 0, 0]
  world_to_camera: [[1, 0, 0, 0],
                    [0, -0.8137334712067350, -0.5812381937190965, 0],
                    [0, 0.5812381937190965, -0.8137334712067350, 7],
                    [0, 0, 0, 1]]
"""
SUN = (
    math.cos(SUN_ELEVATION) * math.cos(SUN_AZIMUTH),
    math.cos(SUN_ELEVATION) * math.sin(SUN_AZIMUTH),
    math.sin(SUN_ELEVATION),
)


@dataclass(frozen=True)
class Ran:
    """What a command left behind: its exit code and what it printed."""

    code: int
    out: str
    err: str

    @property
    def line(self) -> str:
        """The only line on standard error."""
        lines = self.err.splitlines()
        assert len(lines) == 1, lines
        assert lines[0].startswith("torchlight: ")
        assert "Traceback" not in self.err
        return lines[0]


def torchlight(*arguments: object) -> Ran:
    """Runs `torchlight ARGUMENTS` in this process; that kernels are compiled first is left out of what it printed."""
    out, err = StringIO(), StringIO()
    with redirect_stdout(out), redirect_stderr(err), pytest.raises(SystemExit) as stop:
        main([str(argument) for argument in arguments])
    assert isinstance(stop.value.code, int)
    complaints = err.getvalue().replace(f"torchlight: {ANNOUNCEMENT}\n", "")
    return Ran(stop.value.code, out.getvalue(), complaints)


def scene_file(folder: Path, text: str = RECTIFIED, name: str = "scene.yaml") -> Path:
    path = folder / name
    path.write_text(text)
    return path


@cache
def shadow(samples: int = 16) -> Tensor:
    """Returns the block's rectified photograph under sun and window, by its analytic shadow: [3, rows, columns]."""
    receiver = Receiver((0.0, 0.0), (4.0, 4.0), (samples, samples))
    values = block_values(BLOCK, receiver, pixel_rays(sun_and_window(64)))
    exposure = expose(values, torch.ones(receiver.points, dtype=torch.bool))
    return receiver_image(values * exposure, receiver).float()


def png(path: Path, image: Tensor | None = None) -> Path:
    """Writes a linear 8-bit photograph."""
    pixels = ((shadow() if image is None else image).clamp(0, 1) * 255).round()
    write_png(path, pixels.byte().permute(1, 2, 0).contiguous().numpy())
    return path


def exr(path: Path, image: Tensor | None = None) -> Path:
    """Writes a linear float photograph."""
    write_exr(path, shadow() if image is None else image, {})
    return path


def light(path: Path, height: int = 64) -> Path:
    """Writes the light that the photographs were taken under, at exposure 1."""
    write_exr(path, sun_and_window(height).radiance, {})
    return path


def degrees_between(a: object, b: object) -> float:
    """Returns the angle between two directions of any length."""
    first, second = (torch.as_tensor(v, dtype=torch.float64) for v in (a, b))
    return math.degrees(math.atan2(float(torch.linalg.cross(first, second).norm()), float(first @ second)))


def contents(folder: Path) -> list[str]:
    """Returns every name below a folder, hidden ones too."""
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*"))
