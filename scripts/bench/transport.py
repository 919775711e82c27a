"""How long the transport takes and how much memory, and that its cost follows the contours, not the samples.

    python scripts/bench/transport.py --data DIR [--out out/bench] [--large]

64 x 64 samples, 16x16x5 texels, 12 x 12 directions each, for a block, a sphere of 81,920 faces, and the bunny and the
chair of DIR/meshes, preparation included, with the number of contour crossings that were met; the same transport as
Haar functions and as spherical harmonics; then spheres of more and more faces and grids of more and more samples, with
the fitted exponents, and what a crossing costs. --large adds 256 x 256 samples at 64x64x5 for the block, alone in a
process of its own, so that its peak memory is its own. Prints Markdown tables and writes OUT/transport.csv. Seconds
are the least of three runs, after one that compiles.
"""

from __future__ import annotations

import csv
import math
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import torch
import trimesh
import tyro
from jaxtyping import Float
from measuring import OUT, Row, best, markdown, peak_gib, save
from torch import Tensor
from visibility import meshes

from torchlight.geometry.contours import scene_contours
from torchlight.geometry.crossings import FIELDS, on_grid
from torchlight.geometry.receiver import Receiver
from torchlight.geometry.scene import Scene
from torchlight.light import cubemap
from torchlight.light.bases import HaarCubemap, SphericalHarmonics
from torchlight.synthetic import Block, block_scene
from torchlight.threads import thread_count
from torchlight.transfer import LINES, MEMORY_BUDGET, Transfer, directions_of, transport

RUNS = 3
ASKED = {"block": 0.15, "large": 60.0}  # seconds
ASKED_OF_MESHES = 1.5
DEGREE = 5
SOME = 16  # every 16th texel stands for all where crossings are counted


def main(data: Path | None = None, out: Path = OUT, large: bool = False, only_large: bool = False) -> None:
    """Prints Markdown tables and writes OUT/transport.csv.

    Args:
        data: folder that holds meshes/stanford-bunny.obj and meshes/chair_model.obj.
        out: where the CSV goes.
        large: also 256 x 256 samples at 64x64x5.
        only_large: nothing but that, once.
    """
    block = block_scene(Block((1.0, 0.6, 1.2), 20.0), receiver(1)).triangles
    transport(Scene(block, receiver(8)), 2, 2)  # compiles
    if only_large:
        row = measured("block", block, 256, 64, 3, runs=1)
        save("transport", [{**row, "asked, seconds": ASKED["large"]}], thread_count(), out)
        return
    rows: list[Row] = [
        {**measured(name, mesh, 64, 16, 12), "asked, seconds": asked(name)} for name, mesh in meshes(data).items()
    ]
    if large:
        rows.append(alone())
    faces = [measured("sphere", sphere(n), 64, 16, 12) for n in (3, 4, 5, 6)]
    samples = [measured("sphere", sphere(4), side, 16, 12) for side in (32, 64, 128, 256)]
    projected = projections(block)
    print(f"The transport itself may take {MEMORY_BUDGET / 2**30:.0f} GiB.\n\n{markdown(rows)}")
    print(f"\n{markdown(projected)}")
    for name, scaling in (("faces", faces), ("samples", samples)):
        sizes, seconds = ([float(str(row[key])) for row in scaling] for key in (name, "processor seconds"))
        print(f"\nseconds grow as {name} to the power {exponent(sizes, seconds):.2f}\n\n{markdown(scaling)}")
    print(f"\n{per_crossing(samples)}")
    save("transport", [*rows, *projected, *faces, *samples], thread_count(), out)


def asked(name: str) -> float:
    """Returns the seconds aimed at for a mesh."""
    return ASKED.get(name, ASKED_OF_MESHES)


def receiver(side: int) -> Receiver:
    """Returns side x side samples on [-2, 2]^2."""
    return Receiver((0.0, 0.0), (4.0, 4.0), (side, side))


def sphere(subdivisions: int) -> Float[Tensor, "faces 3 3"]:
    """Returns an icosphere on the plane, of 20 x 4^subdivisions faces."""
    ball = trimesh.creation.icosphere(subdivisions=subdivisions, radius=0.6)
    return torch.from_numpy(np.array(ball.triangles)) + torch.tensor([0.0, 0.0, 0.6])


def measured(
    mesh: str, triangles: Float[Tensor, "faces 3 3"], side: int, resolution: int, subsamples: int, runs: int = RUNS
) -> Row:
    """Returns the cost of one transport."""
    scene = Scene(triangles, receiver(side))
    _, prepared = best(lambda: scene_contours(scene), 1)
    _, cost = best(lambda: transport(scene, resolution, subsamples), runs)
    return {
        "what": mesh,
        "faces": len(triangles),
        "samples": side**2,
        "texels": f"{resolution}x{resolution}x5",
        "directions per texel": subsamples**2,
        "crossings, millions": met(scene, resolution, subsamples),
        "preparation, seconds": prepared.wall,
        "seconds": cost.wall,
        "processor seconds": cost.processor,
        "peak memory so far, GiB": peak_gib(),
    }


def met(scene: Scene, resolution: int, subsamples: int) -> float:
    """Returns millions of lines x directions x contour edges that cross them, estimated from some of the texels.

    An edge crosses as many lines as its projection is high; edges outside the receiver count too.
    """
    shape = on_grid(scene_contours(scene), scene.receiver, LINES)
    rectangles = directions_of(cubemap.whole_texels(resolution), subsamples)
    towards = rectangles.directions[::SOME].reshape(-1, 3)[::SOME].numpy()
    slopes, fields = shape.grid.slopes(towards), shape.edges[: len(shape.contours.ends), FIELDS].T
    total = 0.0
    for x, y in slopes:
        facing = [np.where(fields[k] * x + fields[k + 1] * y + fields[k + 2] > 0, 1.0, -1.0) for k in (4, 7)]
        contour = fields[10] * facing[0] + fields[11] * facing[1] != 0
        high = abs((fields[0] - y * fields[1]) - (fields[2] - y * fields[3]))
        total += float(np.minimum(high, shape.grid.rows * LINES)[contour].sum())
    return total * len(rectangles.directions) * subsamples**2 / len(slopes) / 1e6


def projections(block: Float[Tensor, "faces 3 3"]) -> list[Row]:
    """Returns the cost of the same transport as Haar functions and as spherical harmonics, beside that of itself."""
    scene = Scene(block, receiver(64))
    whole, cost = best(lambda: transport(scene, 16, 12), RUNS)
    rows: list[Row] = [{"what": "block, transport", "seconds": cost.wall, "processor seconds": cost.processor}]
    for name, basis in (("Haar", HaarCubemap(16)), ("harmonics of degree 5", SphericalHarmonics(DEGREE, 16))):
        rows.append(projection(f"block, as {name}", whole, basis))
    return rows


def projection(what: str, whole: Transfer, basis: HaarCubemap | SphericalHarmonics) -> Row:
    """Returns the cost of one projection."""
    whole.project(basis)
    _, cost = best(lambda: whole.project(basis), RUNS)
    return {"what": what, "seconds": cost.wall, "processor seconds": cost.processor}


def alone() -> Row:
    """Returns the row of the large transport, measured in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, __file__, "--only-large", "--out", folder]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        with (Path(folder) / "transport.csv").open(newline="") as file:
            row = next(csv.DictReader(file))
    return {name: number(value) for name, value in row.items() if name not in ("machine", "threads")}


def number(text: str) -> float | str:
    """Returns a number where the text is one."""
    try:
        return float(text)
    except ValueError:
        return text


def per_crossing(rows: list[Row]) -> str:
    """Returns in one line the straight line through processor seconds over crossings, and how far from it they are."""
    crossings, seconds = (
        np.array([float(str(row[key])) for row in rows]) for key in ("crossings, millions", "processor seconds")
    )
    slope, start = np.polyfit(crossings, seconds, 1)
    off = abs(start + slope * crossings - seconds).max() / seconds.max()
    return f"{start:.2f} s and {1e3 * slope:.1f} ns per crossing, within {off:.0%} of the largest"


def exponent(sizes: list[float], seconds: list[float]) -> float:
    """Returns the slope of log seconds over log size."""
    return float(np.polyfit([math.log(n) for n in sizes], [math.log(s) for s in seconds], 1)[0])


if __name__ == "__main__":
    tyro.cli(main)
