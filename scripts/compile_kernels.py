"""Compiles the kernels, about half a minute of work, into the cache on disk that every process of the tests reads.

    python scripts/compile_kernels.py

Without it each process that needs a kernel before another has compiled it compiles it too.
"""

from __future__ import annotations

import torch

from torchlight.geometry.analytic_shadow import Block
from torchlight.geometry.receiver import Receiver
from torchlight.light.bases import Texels
from torchlight.pipeline import estimate
from torchlight.precomputation import precompute
from torchlight.synthetic import block_scene


def main() -> None:
    """Estimates light once by each way that has kernels: Haar functions as the photograph asks, and all texels."""
    scene = block_scene(Block((1.0, 0.6, 1.2), 20.0), Receiver((0.0, 0.0), (4.0, 4.0), (16, 16)))
    photo = torch.rand(3, 16, 16, generator=torch.Generator().manual_seed(1))
    estimate(photo, scene)
    estimate(photo, scene, Texels(4), transfer=precompute(scene, 4, use_cache=False))


if __name__ == "__main__":
    main()
