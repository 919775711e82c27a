"""Table 1 of the paper on its three light probes, with ground truth the solver never touched.

    python scripts/reproduce_paper.py --data DIR [--out out/paper]

DIR holds probes/kitchen_cross.hdr, probes/campus_cross.hdr and probes/galileo_probe.hdr (TORCHLIGHT_DATA is used when
--data is absent). A block of 1.0 x 0.6 x 1.2 stands on a plane of 4 x 4, seen as 64 x 64 samples. Its 8-bit
photograph gives the light; four other poses, one of them of another block, are relit and compared with the truth.

Ground truth is the block's analytic shadow on one ray or more per pixel of the probe: no cube map, no solver's grid.
Errors are RMS over all samples that no block stands on, in 255ths of the brightest (Okabe, Sato and Sato 2004,
Table 1, print 3.7 / 2.7 / 5.9 for spherical harmonics and 1.6 / 1.3 / 2.1 for Haar wavelets on a scene of their own).
"""

from __future__ import annotations

import json
import os
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import torch
import tyro
from jaxtyping import Float
from torch import Tensor
from tqdm import tqdm

from torchlight import metrics
from torchlight.errors import TorchlightError
from torchlight.geometry.analytic_shadow import Block
from torchlight.geometry.footprints import visible_samples
from torchlight.geometry.receiver import Receiver
from torchlight.inversion.adaptive import AdaptiveHaar
from torchlight.inversion.level_by_level import LevelByLevel
from torchlight.io.atomic import write_atomically
from torchlight.io.lights import read_light
from torchlight.light.bases import Basis, SphericalHarmonics, Texels
from torchlight.photo.observation import Observation
from torchlight.pipeline import find_light, precompute
from torchlight.relighting import irradiance
from torchlight.solvers import NNLS, NonnegativeSynthesis, Ridge, Solver
from torchlight.synthetic import block_scene, block_values, eight_bit, expose, pixel_rays
from torchlight.transfer import Transfer

PROBES = ("kitchen_cross", "campus_cross", "galileo_probe")
RECEIVER = Receiver(center=(0.0, 0.0), size=(4.0, 4.0), samples=(64, 64))
PAPER_BLOCK = (1.0, 0.6, 1.2)
PHOTOGRAPHED = Block(PAPER_BLOCK, rotation_degrees=20.0)
HELD_OUT = (
    Block(PAPER_BLOCK, rotation_degrees=69.0, translation=(0.3, 0.2)),
    Block(PAPER_BLOCK, rotation_degrees=-25.0, translation=(-0.4, 0.3)),
    Block(PAPER_BLOCK, rotation_degrees=120.0, translation=(0.2, -0.4)),
    Block((0.7, 0.7, 1.6), rotation_degrees=50.0, translation=(-0.2, -0.3)),
)


@dataclass(frozen=True)
class Method:
    """A line of the table: its name, what light is made of, and how it is found."""

    name: str
    basis: Basis
    solver: Solver | AdaptiveHaar


GAIN = AdaptiveHaar()
PAPER = AdaptiveHaar(rule=LevelByLevel())
METHODS = (
    Method("Haar, adaptive, by gain", GAIN.basis, GAIN),
    Method("Haar, adaptive, the paper's rule", PAPER.basis, PAPER),
    Method("texels 16x16x5, non-negative", Texels(16), NNLS()),
    Method("SH, 25 coefficients", SphericalHarmonics(4, 32), Ridge()),
    Method("SH, 36 coefficients", SphericalHarmonics(5, 32), Ridge()),
    Method("SH, 25 coefficients, non-negative", SphericalHarmonics(4, 32), NonnegativeSynthesis()),
    Method("SH, 36 coefficients, non-negative", SphericalHarmonics(5, 32), NonnegativeSynthesis()),
)


@dataclass(frozen=True)
class Row:
    """One measurement: RMS of 255 on the photograph and on the other poses, and the seconds of the solve.

    functions: most per channel of those in use; regions: the same of squares of constant light, if any.
    """

    probe: str
    method: str
    functions: int
    regions: int | None
    fit: float
    held_out_mean: float
    held_out_worst: float
    solve_seconds: float
    kkt_residual: float


@dataclass(frozen=True, eq=False)
class Case:
    """A pose: its samples and truth, exposed like the photograph."""

    used: Float[Tensor, " points"]
    truth: Float[Tensor, "3 points"]


def main(data: Path | None = None, out: Path = Path("out/paper")) -> None:
    """Prints the table and writes OUT/paper.md and OUT/paper.json.

    Args:
        data: folder that holds probes/*.hdr; default: the environment variable TORCHLIGHT_DATA.
        out: folder for the table.
    """
    folder = find_probes(data)
    blocks = (PHOTOGRAPHED, *HELD_OUT)
    resolutions = sorted({method.basis.resolution for method in METHODS})
    work = [(block, resolution) for resolution in resolutions for block in blocks]
    transfers = {
        (block, resolution): precompute(block_scene(block, RECEIVER), resolution)
        for block, resolution in tqdm(work, desc="transport", disable=not sys.stderr.isatty())
    }
    rows = [row for probe in PROBES for row in measure(folder / f"{probe}.hdr", transfers)]
    table = markdown(rows)
    out.mkdir(parents=True, exist_ok=True)
    write_atomically(out / "paper.md", table.encode())
    write_atomically(out / "paper.json", json.dumps([asdict(row) for row in rows], indent=2).encode())
    print(table)


def find_probes(data: Path | None) -> Path:
    """Returns the folder of the probes, or exits with one line that says what is missing."""
    named = data if data is not None else Path(os.environ.get("TORCHLIGHT_DATA", ""))
    missing = [name for name in PROBES if not (named / "probes" / f"{name}.hdr").exists()]
    if missing or str(named) == ".":
        sys.exit(f"reproduce_paper: no probes/{PROBES[0]}.hdr in '{named}'; pass --data DIR or set TORCHLIGHT_DATA")
    return named / "probes"


def measure(probe: Path, transfers: dict[tuple[Block, int], Transfer]) -> list[Row]:
    """Returns every method's row for one probe."""
    rays = pixel_rays(read_light(probe))
    values = block_values(PHOTOGRAPHED, RECEIVER, rays)
    used = visible_samples(block_scene(PHOTOGRAPHED, RECEIVER))
    exposure = expose(values, used)
    photo = Observation((eight_bit(values * exposure)).float(), used.float())
    cases = [
        Case(
            visible_samples(block_scene(block, RECEIVER)).float(),
            block_values(block, RECEIVER, rays).float() * exposure,
        )
        for block in tqdm(HELD_OUT, desc=f"truth of {probe.stem}", disable=not sys.stderr.isatty())
    ]
    return [measure_method(probe.stem, method, photo, cases, transfers) for method in METHODS]


def measure_method(
    probe: str, method: Method, photo: Observation, cases: list[Case], transfers: dict[tuple[Block, int], Transfer]
) -> Row:
    """Returns one row: the light from the photograph, scored on the photograph and on the other poses."""
    resolution = method.basis.resolution
    received = Observation(photo.samples * torch.pi, photo.weights)
    transfer = transfers[PHOTOGRAPHED, resolution]
    start = time.perf_counter()
    solution, refinement = find_light(transfer, method.basis, received, method.solver)
    seconds = time.perf_counter() - start
    solution.check()

    def predict(block: Block) -> Float[Tensor, "3 points"]:
        return irradiance(transfers[block, resolution].project(method.basis), solution.coefficients) / torch.pi

    held_out = [
        metrics.rms_255(predict(block), case.truth, case.used).item()
        for block, case in zip(HELD_OUT, cases, strict=True)
    ]
    fit = metrics.rms_255(predict(PHOTOGRAPHED), photo.samples, photo.weights).item()
    mean = sum(held_out) / len(held_out)
    functions = method.basis.size if refinement is None else int(refinement.functions.max())
    regions = None if refinement is None else int(refinement.regions.max())
    kkt = solution.kkt_residual.max().item()
    return Row(probe, method.name, functions, regions, fit, mean, max(held_out), seconds, kkt)


def markdown(rows: list[Row]) -> str:
    """Returns the rows as a Markdown table."""
    lines = [
        "| probe | method | functions | regions | fit | other poses, mean | worst | solve, s (RGB) | KKT residual |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    lines += [
        f"| {row.probe} | {row.method} | {row.functions} | {row.regions or ''} | {row.fit:.2f} "
        f"| {row.held_out_mean:.2f} | {row.held_out_worst:.2f} | {row.solve_seconds:.2f} | {row.kkt_residual:.0e} |"
        for row in rows
    ]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    try:
        tyro.cli(main)
    except TorchlightError as error:
        sys.exit(f"reproduce_paper: {error}")
