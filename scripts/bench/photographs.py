"""Photographs of one block under many lights, for benchmarks: what the solvers are timed on."""

from __future__ import annotations

from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from torchlight.geometry.analytic_shadow import Block
from torchlight.geometry.footprints import visible_samples
from torchlight.geometry.primitives import box, cylinder
from torchlight.geometry.receiver import Receiver
from torchlight.geometry.scene import Scene
from torchlight.geometry.transforms import transform
from torchlight.io.lights import read_light
from torchlight.light import overlap
from torchlight.light.environment import EnvironmentMap, rotate_about_z
from torchlight.light.procedural import sun_and_window
from torchlight.photo.observation import Observation
from torchlight.synthetic import EXPOSED, block_scene, eight_bit
from torchlight.transfer import Transfer, transport

BLOCK = Block((1.0, 0.6, 1.2), rotation_degrees=20.0)
FINE = 64  # texels per face edge of the light in the photographs: finer than any solver here sees


def scene(samples: int) -> Scene:
    """Returns a block on a plane of 4 x 4, seen as samples x samples."""
    return block_scene(BLOCK, Receiver(center=(0.0, 0.0), size=(4.0, 4.0), samples=(samples, samples)))


def another_scene(samples: int) -> Scene:
    """Returns a cylinder and a slab on that plane: no setting of a solver was chosen on their photographs."""
    column = transform(cylinder(0.35, 1.4), 1.0, (0.0, 0.0, 0.0), (-0.5, 0.35, 0.0))
    slab = transform(box((1.1, 0.3, 0.8)), 1.0, (0.0, 0.0, -35.0), (0.55, -0.4, 0.0))
    receiver = Receiver(center=(0.0, 0.0), size=(4.0, 4.0), samples=(samples, samples))
    return Scene(torch.cat([column, slab]), receiver, encoding="linear")


def lights(data: Path | None) -> list[EnvironmentMap]:
    """Returns the light probes of a folder, or the built-in sky where none is given."""
    if data is None:
        return [sun_and_window(256)]
    files = sorted((data / "probes").glob("*.hdr"))
    return [read_light(file) for file in files]


def photographs(where: Scene, count: int, data: Path | None, seed: int = 0) -> Observation:
    """Returns 8-bit photographs as irradiance samples, each under a light turned by an angle of its own."""
    fine: Transfer = transport(where, FINE, 4)
    maps = lights(data)
    angles = torch.rand(count, generator=torch.Generator().manual_seed(seed), dtype=torch.float64) * 360
    visible = visible_samples(where)
    samples = torch.stack([_photograph(fine, maps[i % len(maps)], angles[i].item(), visible) for i in range(count)])
    return Observation(samples, visible.to(samples).expand(count, -1))


def _photograph(fine: Transfer, light: EnvironmentMap, degrees: float, visible: Tensor) -> Float[Tensor, "3 points"]:
    turned = rotate_about_z(light, degrees)
    values = fine.mv(overlap.latlong_to_texels(turned.radiance.float(), FINE)).double() / torch.pi
    return eight_bit(values * (EXPOSED / values[:, visible].max())) * torch.pi
