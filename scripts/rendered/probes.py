"""The set-up of the rendered photographs: five lights, an ebony-like block on a sheet, and a camera at 45 degrees.

Everything that the paper's synthetic experiment leaves out is there: light that the block and the sheet throw on each
other, a lacquered block, perspective and lens distortion, pixels hidden by the block, 8-bit sRGB, and noise.
"""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from paper.setting import HELD_OUT, PAPER_PROBES, RECEIVER
from torch import Tensor

from torchlight.camera import Camera
from torchlight.geometry.analytic_shadow import Block
from torchlight.geometry.scene import Scene
from torchlight.io.atomic import write_atomically
from torchlight.io.cache import content_key
from torchlight.io.images import write_png
from torchlight.io.lights import read_light
from torchlight.light.environment import EnvironmentMap
from torchlight.metrics import brightest
from torchlight.observing import observe
from torchlight.photo.observation import linear_photo
from torchlight.synthetic import block_scene

from .objects import Shape, distant, matt, plane, satin, standing
from .photograph import photograph, stored

# The paper's three, an open sky, and a studio of soft boxes: indoors and outdoors, small and large sources.
PROBES = (*PAPER_PROBES, "beach_cross", "studio_small_05_1k")
TRIAL_PROBES = ("adams_place_bridge_1k", "aerodynamics_workshop_1k", "probulator_pisa")  # settings are chosen on these
PROBE_ROWS = 256  # probes are reduced to about this many rows by plain means: the light, for Mitsuba and for the truth
SCORED = HELD_OUT[:2]
ALBEDO = 0.8
EBONY = 0.05
BLOCK_ALBEDO = 0.085  # with its lacquer: what explains rendered less direct light best under TRIAL_PROBES, 0.08 to 0.10
SHEET = 4.2  # edge of the sheet: a little more than the receiver, so that no sample shows what lies beside it
EXPOSED = 0.9  # linear value of the brightest sample
NOISE = 0.01  # standard deviation, of the brightest sample
SEED = 5
VERSION = "rendered-1"  # in the key of stored pictures: raise it when they change


@dataclass(frozen=True, eq=False)
class Finish:
    """What the block is made of.

    Attributes:
        name: in the key of stored pictures; empty for the usual one.
        surface: of Mitsuba's block.
        albedo: that scene files state.
    """

    name: str
    surface: Shape
    albedo: float


LACQUERED = Finish("", satin(EBONY), BLOCK_ALBEDO)
MATT = Finish(" matt", matt(BLOCK_ALBEDO), BLOCK_ALBEDO)
BLACK = Finish(" black", matt(0.0), 0.0)


def camera() -> Camera:
    """Returns a camera 7 units away, 45 degrees above the sheet, with a barrel lens."""
    height = 5.0
    axes = torch.tensor([[1.0, 0, 0], [0, -(0.5**0.5), -(0.5**0.5)], [0, 0.5**0.5, -(0.5**0.5)]], dtype=torch.float64)
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, :3] = axes
    pose[:3, 3] = -axes @ torch.tensor([0.0, -height, height], dtype=torch.float64)
    lens = torch.tensor([[520.0, 0, 203.4], [0, 522.0, 158.7], [0, 0, 1]], dtype=torch.float64)
    return Camera(lens, pose, (400, 300), torch.tensor([-0.12, 0.06, 0.0015, -0.001, -0.01], dtype=torch.float64))


def scene(block: Block, albedo: float = 0.0) -> Scene:
    """Returns what the estimate is told: the block's shape, place and albedo, the camera, and the file's encoding."""
    triangles = block_scene(block, RECEIVER).triangles
    return Scene(triangles, RECEIVER, camera(), encoding="srgb", occluder_albedo=albedo)


def light(path: Path) -> EnvironmentMap:
    """Returns a probe reduced to about PROBE_ROWS rows by plain means over squares of its pixels."""
    radiance = read_light(path).radiance
    factor = max(1, round(radiance.shape[-2] / PROBE_ROWS))
    return EnvironmentMap(torch.nn.functional.avg_pool2d(radiance, factor))


@dataclass(frozen=True, eq=False)
class Rendering:
    """Linear radiance twice, with random numbers of its own each.

    Attributes:
        halves: two independent pictures.
    """

    halves: Float[Tensor, "2 3 height width"]

    @property
    def radiance(self) -> Float[Tensor, "3 height width"]:
        """Their mean."""
        return self.halves.mean(dim=0)


def rendering(
    environment: EnvironmentMap, block: Block, samples: int, folder: Path, finish: Finish = LACQUERED
) -> Rendering:
    """Returns the photograph in linear radiance, from its file in `folder` or rendered and stored there.

    Args:
        environment: the light.
        block: the pose.
        samples: light paths per pixel, in both halves together.
        folder: for the renderings.
        finish: of the block.
    """
    setting = (
        f"{VERSION} {samples} {block} {SHEET} {ALBEDO} {EBONY} {camera().intrinsics} {camera().distortion}{finish.name}"
    )
    path = folder / f"{content_key({'radiance': environment.radiance, 'setting': setting})}.npz"
    if not path.exists():
        objects = {
            "sheet": plane((0.0, 0.0), (SHEET, SHEET), matt(ALBEDO)),
            "block": standing(block, finish.surface),
            "light": distant(environment),
        }
        halves = [photograph(objects, camera(), samples // 2, seed=seed).float().numpy() for seed in (1, 2)]
        buffer = io.BytesIO()
        np.savez_compressed(buffer, halves=np.stack(halves))
        folder.mkdir(parents=True, exist_ok=True)
        write_atomically(path, buffer.getvalue())
    with np.load(path) as data:
        return Rendering(torch.from_numpy(data["halves"]))


@dataclass(frozen=True)
class Taken:
    """A photograph on disk.

    Attributes:
        path: the PNG.
        exposure: from radiance to its linear values.
        own_noise: standard deviation of the renderer's noise per pixel of the receiver, of the brightest sample.
    """

    path: Path
    exposure: float
    own_noise: float


def take(rendered: Rendering, block: Block, path: Path) -> Taken:
    """Writes the 8-bit sRGB photograph, its brightest sample at EXPOSED, with NOISE of that sample."""
    seen = observe(linear_photo(rendered.halves), scene(block))
    mean = seen.samples.mean(dim=0)
    largest = brightest(mean, seen.weights[0]).item()
    pixels = rendered.halves[0] - rendered.halves[1]
    shown = rendered.radiance.amin(dim=0) > 0.5 * largest  # the lit sheet
    own = pixels[:, shown].square().mean().sqrt().item() / 2 / largest
    write_png(path, stored(rendered.radiance, EXPOSED / largest, NOISE * EXPOSED, SEED))
    return Taken(path, EXPOSED / largest, own)
