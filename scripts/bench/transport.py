"""How long the transport takes and how much memory, and that its cost follows the contours, not the samples.

    python scripts/bench/transport.py --data DIR [--out out/bench] [--large]

64 x 64 samples, 16x16x5 texels, 12 x 12 directions each, for a block, a sphere of 81,920 faces, and the bunny and the
chair of DIR/meshes, preparation included; then spheres of more and more faces and grids of more and more samples, with
the fitted exponents. --large adds 256 x 256 samples at 64x64x5 for the block. Prints Markdown tables and writes
OUT/transport.csv. Wall seconds are the best of three runs, after one that compiles.
"""

from __future__ import annotations

import csv
import math
import os
import resource
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import trimesh
import tyro
from jaxtyping import Float
from torch import Tensor
from visibility import meshes

from torchlight.geometry.contours import scene_contours
from torchlight.geometry.receiver import Receiver
from torchlight.geometry.scene import Scene
from torchlight.threads import thread_count
from torchlight.transfer import transport

RUNS = 3


@dataclass(frozen=True)
class Row:
    """One transport: its scene, its size and its cost."""

    mesh: str
    faces: int
    samples: int
    resolution: int
    subsamples: int
    prepared: float
    seconds: float
    processor_seconds: float
    peak_gib: float


def main(data: Path | None = None, out: Path = Path("out/bench"), large: bool = False) -> None:
    """Prints Markdown tables and writes OUT/transport.csv.

    Args:
        data: folder that holds meshes/stanford-bunny.obj and meshes/chair_model.obj.
        out: where the CSV goes.
        large: also 256 x 256 samples at 64x64x5.
    """
    print(f"{os.cpu_count()} processors, {thread_count()} threads\n")
    found = meshes(data)
    transport(Scene(found["block"], receiver(8)), 2, 2)  # compiles
    rows = [measure(name, triangles, 64, 16, 12) for name, triangles in found.items()]
    if large:
        rows.append(measure("block", found["block"], 256, 64, 3))
    table(rows)
    faces = [measure("sphere", sphere(n), 64, 16, 12) for n in (3, 4, 5, 6)]
    samples = [measure("sphere", sphere(4), side, 16, 12) for side in (32, 64, 128, 256)]
    for name, scaling, sizes in (
        ("faces", faces, [r.faces for r in faces]),
        ("samples", samples, [r.samples for r in samples]),
    ):
        print(f"\nseconds grow as {name} to the power {exponent(sizes, [r.processor_seconds for r in scaling]):.2f}\n")
        table(scaling)
    out.mkdir(parents=True, exist_ok=True)
    with (out / "transport.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(rows[0].__dict__)
        writer.writerows(row.__dict__.values() for row in (*rows, *faces, *samples))


def receiver(side: int) -> Receiver:
    """Returns side x side samples on [-2, 2]^2."""
    return Receiver((0.0, 0.0), (4.0, 4.0), (side, side))


def sphere(subdivisions: int) -> Float[Tensor, "faces 3 3"]:
    """Returns an icosphere on the plane, of 20 x 4^subdivisions faces."""
    ball = trimesh.creation.icosphere(subdivisions=subdivisions, radius=0.6)
    return torch.from_numpy(np.array(ball.triangles)) + torch.tensor([0.0, 0.0, 0.6])


def measure(mesh: str, triangles: Float[Tensor, "faces 3 3"], side: int, resolution: int, subsamples: int) -> Row:
    """Returns the cost of one transport."""
    scene, runs = Scene(triangles, receiver(side)), []
    start = time.perf_counter()
    scene_contours(scene)
    prepared = time.perf_counter() - start
    for _ in range(RUNS):
        wall, processor = time.perf_counter(), time.process_time()
        transport(scene, resolution, subsamples)
        runs.append((time.perf_counter() - wall, time.process_time() - processor))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    seconds, processor = min(runs)
    return Row(mesh, len(triangles), side**2, resolution, subsamples, prepared, seconds, processor, peak)


def exponent(sizes: list[int], seconds: list[float]) -> float:
    """Returns the slope of log seconds over log size."""
    return float(np.polyfit([math.log(n) for n in sizes], [math.log(s) for s in seconds], 1)[0])


def table(rows: list[Row]) -> None:
    """Prints rows as a Markdown table."""
    print("| mesh | faces | samples | texels | directions | prepared, s | in all, s | processor, s | peak, GiB |")
    print("| --- | ---: | ---: | --- | --- | ---: | ---: | ---: | ---: |")
    for r in rows:
        print(
            f"| {r.mesh} | {r.faces:,} | {r.samples:,} | {r.resolution}x{r.resolution}x5 "
            f"| {r.subsamples} x {r.subsamples} | {r.prepared:.2f} | {r.seconds:.2f} "
            f"| {r.processor_seconds:.2f} | {r.peak_gib:.1f} |"
        )


if __name__ == "__main__":
    tyro.cli(main)
