"""How long the nullity takes once the transport is there: 300 rotations, B = 1..12, 4,096 samples.

python scripts/bench/nullity.py
"""

from __future__ import annotations

import os
import time
from pathlib import Path

import torch
import tyro

from torchlight.analysis.nullity import equations, nullity
from torchlight.analysis.sampling import random_rotations
from torchlight.analysis.spectrum import transfer_harmonics
from torchlight.io.scene_file import load_scene
from torchlight.precomputation import precompute

SCENE = Path(__file__).resolve().parents[2] / "configs" / "paper" / "above.yaml"
RESOLUTION = 32


def main(bandwidth_max: int = 12, rotations: int = 300) -> None:
    """Prints the seconds of the projection and of the nullity, for all samples of the view from above."""
    scene = load_scene(SCENE)
    transfer = precompute(scene, RESOLUTION)
    start = time.perf_counter()
    harmonics = transfer_harmonics(transfer, bandwidth_max - 1)
    projected = time.perf_counter()
    nullity(equations(harmonics, scene.receiver.points), random_rotations(rotations, seed=0))
    done = time.perf_counter()
    print(f"{os.cpu_count()} processors, {torch.get_num_threads()} threads, {len(harmonics)} samples")
    print(f"projection {projected - start:.2f} s, nullity {done - projected:.2f} s, together {done - start:.2f} s")


if __name__ == "__main__":
    tyro.cli(main)
