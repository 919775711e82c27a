"""The experiment of the paper's section 5.1: a block on a plane, one pose photographed and four held out."""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchlight.geometry.analytic_shadow import Block
from torchlight.geometry.footprints import visible_samples
from torchlight.geometry.receiver import Receiver
from torchlight.photo.observation import Observation
from torchlight.synthetic import block_scene, eight_bit, expose

PAPER_PROBES = ("kitchen_cross", "campus_cross", "galileo_probe")
MORE_PROBES = ("ennis_1024x512", "noon_grass_1k", "beach_cross", "probulator_pisa", "studio_small_05_1k")
PROBES = (*PAPER_PROBES, *MORE_PROBES)
SUFFIXES = (".hdr", ".exr")
RECEIVER = Receiver(center=(0.0, 0.0), size=(4.0, 4.0), samples=(64, 64))
PAPER_BLOCK = (1.0, 0.6, 1.2)
PHOTOGRAPHED = Block(PAPER_BLOCK, rotation_degrees=20.0)
HELD_OUT = (
    Block(PAPER_BLOCK, rotation_degrees=69.0, translation=(0.3, 0.2)),
    Block(PAPER_BLOCK, rotation_degrees=-25.0, translation=(-0.4, 0.3)),
    Block(PAPER_BLOCK, rotation_degrees=120.0, translation=(0.2, -0.4)),
    Block((0.7, 0.7, 1.6), rotation_degrees=50.0, translation=(-0.2, -0.3)),
)
POSES = (PHOTOGRAPHED, *HELD_OUT)
NOISE_SEED = 2004


@dataclass(frozen=True, eq=False)
class Exposed:
    """One light's photograph, and the truth of all poses at the same exposure.

    Attributes:
        photo: 8 bits, linear; the samples on which no block stands.
        truth: per pose of `POSES`, without noise and rounding, with the samples that count.
        exposure: the factor from v = E / pi to both.
    """

    photo: Observation
    truth: tuple[Observation, ...]
    exposure: float


def pose_name(pose: int) -> str:
    """Returns what the tables call a pose."""
    return "photographed" if pose == 0 else f"held out {pose}"


@cache
def used_samples(block: Block) -> Bool[Tensor, " points"]:
    """Returns the samples on which a block does not stand."""
    return visible_samples(block_scene(block, RECEIVER))


def exposed(values: Float[Tensor, "poses 3 points"], noise: float) -> Exposed:
    """Returns the photograph of the first pose and the truth of all.

    Args:
        values: v = E / pi of every pose.
        noise: standard deviation of Gaussian noise, as a share of the brightest sample; added before rounding.
    """
    used = [used_samples(block) for block in POSES]
    exposure = expose(values[0], used[0])
    bright = values[0] * exposure
    deviation = noise * bright[:, used[0]].max()
    generator = torch.Generator().manual_seed(NOISE_SEED)
    drawn = torch.randn(bright.shape, generator=generator, dtype=bright.dtype)
    photo = Observation(eight_bit(bright + deviation * drawn).float(), used[0].float())
    truth = (Observation((v * exposure).float(), mask.float()) for v, mask in zip(values, used, strict=True))
    return Exposed(photo, tuple(truth), exposure)


def probe_files(data: Path | None, probes: Path | None) -> list[Path]:
    """Returns the light probes to measure, or exits with one line that says what is missing.

    Args:
        data: folder that holds probes/*.hdr; None = the environment variable TORCHLIGHT_DATA.
        probes: a user's own folder, of which every .hdr and .exr is taken.
    """
    if probes is not None:
        found = sorted(path for path in probes.glob("*") if path.suffix.lower() in SUFFIXES)
        if not found:
            sys.exit(f"reproduce_paper: no .hdr or .exr in '{probes}'; pass the folder of your probes")
        return found
    root = data if data is not None else Path(os.environ.get("TORCHLIGHT_DATA", ""))
    files = [root / "probes" / f"{name}.hdr" for name in PROBES]
    missing = [f"probes/{path.name}" for path in files if not path.exists()]
    if missing:
        where = "no --data DIR given and TORCHLIGHT_DATA not set" if root == Path() else f"not in '{root}'"
        sys.exit(f"reproduce_paper: {', '.join(missing)}: {where}; or pass --probes DIR with your own")
    return files
