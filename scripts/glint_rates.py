"""How often `photo.specular.glints` takes lit paper for a glint, and how many glints it finds.

    python scripts/glint_rates.py [--data DIR] [--scenes 20]

The photographs of halo_rates.py: blocks of random size and turn under random light by their analytic shadow, 8-bit
sRGB, noise of several sizes; then each again with a round Gaussian glint on lit paper. Counted are photographs in which
a sample is taken where none was put, the samples so taken, and the glints of which the brightest sample is found.
"""

from __future__ import annotations

from pathlib import Path

import torch
import tyro
from halo_rates import lamps, probe_rays
from jaxtyping import Float
from kornia.color import linear_rgb_to_rgb, rgb_to_linear_rgb
from torch import Tensor

from torchlight.geometry.analytic_shadow import Block
from torchlight.geometry.footprints import visible_samples
from torchlight.geometry.receiver import Receiver, sample_centers
from torchlight.photo.observation import Observation
from torchlight.photo.specular import glints
from torchlight.synthetic import Rays, block_scene, block_values, expose

SIDES = (16, 32, 64)  # samples along each side of the receiver
NOISES = (0.0, 0.01, 0.03)
HEIGHTS = (0.05, 0.1, 0.2, 0.5)  # of a glint, as a share of the lit plane
DEVIATION = 1.0  # of its Gaussian, in samples


def main(data: Path | None = None, scenes: int = 20) -> None:
    """Prints the rates.

    Args:
        data: folder that holds probes/*.hdr in lat-long form; without it lamps over a grey sky only.
        scenes: photographs per row.
    """
    probes = probe_rays(data)
    print("| samples | noise | photographs with a false one | samples taken falsely |", end="")
    print("".join(f" found of {height:.0%} |" for height in HEIGHTS))
    print("| --- " * (4 + len(HEIGHTS)) + "|")
    for side in SIDES:
        generator = torch.Generator().manual_seed(side)
        photographs = [plane(index, side, probes, generator) for index in range(scenes)]
        for noise in NOISES:
            print(row(side, noise, photographs, generator))


def plane(index: int, side: int, probes: list[Rays], generator: torch.Generator) -> tuple[Tensor, Tensor]:
    """Returns the linear values of a photograph, white at 1, and the samples that are seen."""
    receiver = Receiver((0.0, 0.0), (6.0, 6.0), (side, side))
    size = 0.3 + torch.rand(3, generator=generator, dtype=torch.float64)
    block = Block((float(size[0]), float(size[1]), float(size[2])), 90 * float(torch.rand(1, generator=generator)))
    rays = probes[index % len(probes)] if probes and index % 2 else lamps(generator)
    values = block_values(block, receiver, rays)
    seen = visible_samples(block_scene(block, receiver))
    return values * expose(values, seen) / 1.6, seen  # room for a glint that does not saturate


def row(side: int, noise: float, photographs: list[tuple[Tensor, Tensor]], generator: torch.Generator) -> str:
    """Returns one row of the table."""
    false, taken, total = 0, 0, 0
    found = [0] * len(HEIGHTS)
    for values, seen in photographs:
        wrong = int(glints(stored(values, seen, noise, generator), (side, side)).sum())
        false, taken, total = false + (wrong > 0), taken + wrong, total + int(seen.sum())
        for index, height in enumerate(HEIGHTS):
            glint, at = bump(values, seen, side, generator)
            shown = glints(stored(values + height * glint, seen, noise, generator), (side, side))
            found[index] += bool(shown[at])
    shares = " | ".join(f"{count} of {len(photographs)}" for count in found)
    return f"| {side} x {side} | {noise:.0%} | {false} of {len(photographs)} | {taken} of {total} | {shares} |"


def bump(values: Tensor, seen: Tensor, side: int, generator: torch.Generator) -> tuple[Tensor, int]:
    """Returns a Gaussian as bright as the brightest sample, on a sample off the rim that is nearly unshadowed."""
    grid = sample_centers(Receiver((0.0, 0.0), (side, side), (side, side)))
    grey = values.mean(dim=0)
    lit = seen & (grey > 0.95 * grey[seen].max()) & (grid.abs().amax(dim=-1) < side / 2 - 5 * DEVIATION)
    places = lit.nonzero()[:, 0]
    if len(places) == 0:
        return torch.zeros_like(values), int(grey.argmax())
    at = int(places[int(torch.randint(len(places), (1,), generator=generator))])
    away = (grid - grid[at]).square().sum(dim=-1)
    return float(grey[seen].max()) * torch.exp(-away / (2 * DEVIATION**2)).expand(3, -1), at


def stored(values: Tensor, seen: Tensor, noise: float, generator: torch.Generator) -> Observation:
    """Returns what an 8-bit sRGB photograph of that relative noise says."""
    noisy = values * (1 + noise * torch.randn(values.shape, generator=generator, dtype=torch.float64))
    return Observation(linear(noisy.clamp(0, 1)), seen.double())


def linear(values: Float[Tensor, "3 points"]) -> Float[Tensor, "3 points"]:
    """Returns linear values after rounding to 8-bit sRGB."""
    codes = (linear_rgb_to_rgb(values[..., None]) * 255).round()
    return rgb_to_linear_rgb(codes / 255)[..., 0]


if __name__ == "__main__":
    tyro.cli(main)
