"""How often `photo.tone.halo` warns of tone mapping where there is none, and where there is.

    python scripts/halo_rates.py [--data DIR] [--scenes 30]

Photographs of blocks of random size and turn under random light, by the block's analytic shadow, 8-bit sRGB with 1 %
noise, as they are (false alarms) and after a local tone map of several strengths: ln brightness is split by a Gaussian
into a base, which is compressed, and detail, which is kept. With --data the probes of DIR/probes are light too.
"""

from __future__ import annotations

import math
from pathlib import Path

import torch
import tyro
from jaxtyping import Float
from kornia.color import linear_rgb_to_rgb, rgb_to_linear_rgb
from kornia.filters import gaussian_blur2d
from torch import Tensor

from torchlight.geometry.analytic_shadow import Block
from torchlight.geometry.footprints import visible_samples
from torchlight.geometry.receiver import Receiver, sample_centers
from torchlight.io.lights import read_light
from torchlight.light.directions import from_angles
from torchlight.photo.observation import Observation
from torchlight.photo.tone import HALO, halo
from torchlight.synthetic import Rays, block_scene, block_values, expose, pixel_rays

RECEIVER = Receiver((0.0, 0.0), (6.0, 6.0), (80, 80))
STRENGTHS = (0.0, 0.15, 0.3, 0.5)
WIDTHS = (5.0, 10.0)  # samples: the Gaussian's deviation


def main(data: Path | None = None, scenes: int = 30) -> None:
    """Prints the share of photographs flagged, per strength and width of the tone map.

    Args:
        data: folder that holds probes/*.hdr or *.exr in lat-long form; without it lamps over a grey sky only.
        scenes: photographs.
    """
    generator = torch.Generator().manual_seed(0)
    probes = probe_rays(data)
    found: dict[tuple[float, float], list[float]] = {}
    for index in range(scenes):
        size = 0.3 + torch.rand(3, generator=generator, dtype=torch.float64)
        block = Block((float(size[0]), float(size[1]), float(size[2])), 90 * float(torch.rand(1, generator=generator)))
        rays = probes[index % len(probes)] if probes and index % 2 else lamps(generator)
        values = block_values(block, RECEIVER, rays)
        seen = visible_samples(block_scene(block, RECEIVER))
        values = values * expose(values, seen)
        for strength in STRENGTHS:
            for width in WIDTHS if strength else WIDTHS[:1]:
                photo = stored(tone_mapped(values, strength, width), generator)
                observation = Observation(photo, seen.to(photo))
                found.setdefault((strength, width), []).append(
                    halo(observation, sample_centers(RECEIVER), RECEIVER.samples).item()
                )
    print("| strength | width, samples | judged | flagged | median halo | 95 % below |")
    print("| --- | --- | --- | --- | --- | --- |")
    for (strength, width), halos in found.items():
        told = sorted(value for value in halos if not math.isnan(value))
        flagged = sum(value > HALO for value in told)
        row = (f"{strength:g}", f"{width:g}" if strength else "-", f"{len(told)} of {len(halos)}", f"{flagged}")
        print(f"| {' | '.join(row)} | {told[len(told) // 2]:.3f} | {told[int(0.95 * len(told))]:.3f} |")


def probe_rays(data: Path | None) -> list[Rays]:
    """Returns the probes that are lat-long maps as rays."""
    files = [] if data is None else sorted((data / "probes").glob("*.hdr"))
    files = [file for file in files if not file.stem.endswith(("_cross", "_probe"))]
    return [pixel_rays(read_light(file, "blender")) for file in files]


def lamps(generator: torch.Generator) -> Rays:
    """Returns one to three lamps of 1 to 8 degrees over a constant sky of a tenth to half of all flux."""

    def uniform(low: float, high: float) -> float:
        return low + (high - low) * float(torch.rand(1, generator=generator, dtype=torch.float64))

    directions, fluxes = [], []
    for _ in range(int(uniform(1, 4))):
        middle = torch.tensor([uniform(0.2, 1.2), uniform(0, 2 * math.pi)], dtype=torch.float64)
        spread = math.radians(uniform(1, 8)) / 2
        offset = spread * torch.randn(200, 2, generator=generator, dtype=torch.float64)
        directions.append(from_angles((middle[0] + offset[:, 0]).clamp(0.01, 1.5), middle[1] + offset[:, 1]))
        fluxes.append(torch.full((200,), uniform(0.3, 1.0) / 200, dtype=torch.float64))
    sky = torch.rand(2000, 2, generator=generator, dtype=torch.float64)
    directions.append(from_angles(sky[:, 0].sqrt().asin(), 2 * math.pi * sky[:, 1]))
    total = float(torch.cat(fluxes).sum())
    share = uniform(0.1, 0.5)
    fluxes.append(torch.full((2000,), total * share / (1 - share) / 2000, dtype=torch.float64))
    return Rays(torch.cat(directions), torch.cat(fluxes)[:, None].expand(-1, 3).contiguous())


def tone_mapped(values: Float[Tensor, "3 points"], strength: float, width: float) -> Float[Tensor, "3 points"]:
    """Returns values x exp(-strength (base - mean base)), the base a Gaussian mean of ln luminance."""
    image = values.reshape(1, 3, *RECEIVER.samples[::-1])
    logarithm = image.mean(dim=1, keepdim=True).clamp(min=1e-3).log()
    size = int(4 * width) | 1
    base = gaussian_blur2d(logarithm, (size, size), (width, width), border_type="reflect")
    return (image * (-strength * (base - base.mean())).exp()).reshape(3, -1)


def stored(values: Float[Tensor, "3 points"], generator: torch.Generator) -> Float[Tensor, "3 points"]:
    """Returns the linear values of an 8-bit sRGB photograph with 1 % noise."""
    noisy = values * (1 + 0.01 * torch.randn(values.shape, generator=generator, dtype=torch.float64))
    scaled = (noisy / noisy.max() * 0.95)[..., None]
    return rgb_to_linear_rgb((linear_rgb_to_rgb(scaled) * 255).round() / 255)[..., 0]


if __name__ == "__main__":
    tyro.cli(main)
