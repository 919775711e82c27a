"""Ground truth of every pose by two ways that share nothing, kept on disk.

`analytic`: the closed form of the block's shadow on one ray or more per pixel of the probe (torchlight.synthetic).
`mitsuba`: the renderer Mitsuba 3 (mitsuba_truth.py). Neither knows a cube map or the solver's transport.
"""

from __future__ import annotations

import io
import sys
from collections.abc import Callable
from dataclasses import astuple, dataclass
from enum import Enum
from functools import partial
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from tqdm import tqdm

from torchlight import metrics
from torchlight.geometry.analytic_shadow import Block
from torchlight.io.atomic import write_atomically
from torchlight.io.cache import content_key
from torchlight.light.environment import EnvironmentMap
from torchlight.synthetic import block_values, pixel_rays

from .mitsuba_truth import block_renderer, installed
from .setting import POSES, RECEIVER, exposed, pose_name

ANALYTIC_VERSION, MITSUBA_VERSION = "analytic-1", "mitsuba-1"  # in the keys: raise them when the numbers change
Values = Callable[[Block], Float[Tensor, "3 points"]]


class Truth(Enum):
    """Which ground truth the photographs and the scores are made of; BOTH = the analytic one, checked by Mitsuba."""

    ANALYTIC = "analytic"
    MITSUBA = "mitsuba"
    BOTH = "both"


@dataclass(frozen=True)
class Agreement:
    """How far the two truths are apart on one pose: in 255ths of the brightest used sample."""

    probe: str
    pose: str
    rms: float
    largest: float


def available(asked: Truth | None) -> Truth:
    """Returns what can be had: both truths if Mitsuba is installed, else the analytic one, with a line on stderr.

    Exits with one line where Mitsuba was asked for and is not installed.
    """
    if asked is Truth.ANALYTIC or installed():
        return asked if asked is not None else Truth.BOTH
    if asked is not None:
        sys.exit(f"reproduce_paper: --truth {asked.value} needs Mitsuba 3; pip install 'torchlight[mitsuba]'")
    print("Mitsuba 3 is not installed (pip install 'torchlight[mitsuba]'): analytic truth alone", file=sys.stderr)
    return Truth.ANALYTIC


def truths(
    environment: EnvironmentMap, name: str, truth: Truth, folder: Path, samples: int
) -> tuple[Float[Tensor, "poses 3 points"], list[Agreement]]:
    """Returns v = E / pi of every pose, and how well the two truths agree where both were asked for.

    Args:
        environment: the light.
        name: of the probe, for the bars and the table.
        truth: which.
        folder: for the stored truths.
        samples: of Mitsuba, per sample of the receiver.
    """
    found = {}
    if truth is not Truth.MITSUBA:
        found[Truth.ANALYTIC] = stored(environment, name, folder, ANALYTIC_VERSION, analytic)
    if truth is not Truth.ANALYTIC:
        version = f"{MITSUBA_VERSION} {samples}"
        renders = partial(block_renderer, RECEIVER, samples=samples)
        found[Truth.MITSUBA] = stored(environment, name, folder, version, renders)
    if truth is not Truth.BOTH:
        return found[truth], []
    return found[Truth.ANALYTIC], agreement(name, found[Truth.MITSUBA], found[Truth.ANALYTIC])


def agreement(
    probe: str, rendered: Float[Tensor, "poses 3 points"], exact: Float[Tensor, "poses 3 points"]
) -> list[Agreement]:
    """Returns the distance of two truths per pose over used samples: RMS and largest."""
    used = [observation.weights for observation in exposed(exact, 0.0).truth]
    rows = []
    for pose, (one, two, weights) in enumerate(zip(rendered, exact, used, strict=True)):
        difference = (one - two)[:, weights > 0].abs().max() * (255.0 / metrics.brightest(two, weights))
        rms = metrics.rms_255(one, two, weights)
        rows.append(Agreement(probe, pose_name(pose), rms.item(), difference.item()))
    return rows


def analytic(environment: EnvironmentMap) -> Values:
    """Returns the function from a pose to its values by the analytic shadow."""
    rays = pixel_rays(environment)
    return lambda block: block_values(block, RECEIVER, rays)


def stored(
    environment: EnvironmentMap,
    name: str,
    folder: Path,
    version: str,
    make: Callable[[EnvironmentMap], Values],
) -> Float[Tensor, "poses 3 points"]:
    """Returns the values of all poses, each from its file in `folder` or computed and stored there."""
    paths = [folder / f"{pose_key(environment, block, version)}.npz" for block in POSES]
    missing = [pose for pose, path in enumerate(paths) if not path.exists()]
    if missing:
        values = make(environment)
        for pose in tqdm(missing, desc=f"truth of {name}, {version}", disable=not sys.stderr.isatty()):
            write(paths[pose], values(POSES[pose]))
    return torch.stack([read(path) for path in paths])


def pose_key(environment: EnvironmentMap, block: Block, version: str) -> str:
    """Returns the content key of one truth: everything its numbers depend on."""
    return content_key(
        {
            "radiance": environment.radiance,
            "size": block.size,
            "rotation": block.rotation_degrees,
            "translation": block.translation,
            "receiver": repr(astuple(RECEIVER)),
            "version": version,
        }
    )


def write(path: Path, values: Float[Tensor, "3 points"]) -> None:
    """Writes one truth."""
    buffer = io.BytesIO()
    np.savez_compressed(buffer, values=values.double().numpy())
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, buffer.getvalue())


def read(path: Path) -> Float[Tensor, "3 points"]:
    """Returns one stored truth."""
    with np.load(path) as data:
        return torch.from_numpy(data["values"])
