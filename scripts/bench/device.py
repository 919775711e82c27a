"""The same work on the CPU and on a GPU: seconds, and by how much the answers differ.

    python scripts/bench/device.py [--out out/bench] [--count 256] [--side 64]

A block on side x side samples, 16x16x5 texels, 12 x 12 directions each; count photographs of it in RGB under random
lights, one in ten noise alone. Prints a Markdown table and writes OUT/device.csv. Seconds are the best of three runs
after one that compiles, everything from tensors on the device to tensors there. Where there is no CUDA device its rows
say so. "Differs" is the largest difference from the CPU's answer: for a transport in shares of its largest entry, for
least squares of the squared residual over that of the samples, else in shares of the largest value.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import torch
import tyro
from measuring import Row, best, markdown, save
from torch import Tensor

import torchlight as tl
from torchlight.geometry.analytic_shadow import Block
from torchlight.geometry.primitives import sphere
from torchlight.geometry.receiver import Receiver
from torchlight.geometry.scene import Scene
from torchlight.inversion.adaptive import AdaptiveHaar, solve_adaptive
from torchlight.photo.observation import Observation
from torchlight.pipeline import explain
from torchlight.relighting import irradiance
from torchlight.solvers import NNLS, LeastSquares, ProjectedAdam, Ridge
from torchlight.synthetic import block_scene
from torchlight.threads import thread_count
from torchlight.transfer import Transfer, transport

RESOLUTION, SUBSAMPLES, RUNS, MASKED = 16, 12, 3, 0.05
Work = Callable[[], Tensor]


@dataclass(frozen=True, eq=False)
class Case:
    """Some work that can be prepared on any device.

    Attributes:
        name: what it is.
        prepared: device -> the work itself, which returns an answer to compare.
        photographs: that it treats; 0 where it treats none.
        slowly: whether the answer on a CPU is worth waiting for once only.
    """

    name: str
    prepared: Callable[[torch.device], Work]
    photographs: int = 0
    slowly: bool = False


def main(out: Path = Path("out/bench"), count: int = 256, side: int = 64) -> None:
    """Prints a Markdown table and writes OUT/device.csv.

    Args:
        out: where the CSV goes.
        count: photographs.
        side: samples along an edge of the receiver.
    """
    print(f"GPU: {torch.cuda.get_device_name() if torch.cuda.is_available() else 'none'}\n")
    rows = [row for case in cases(side, count) for row in measured(case)]
    print(markdown(rows))
    save("device", rows, thread_count(), out)


def cases(side: int, count: int) -> Iterator[Case]:
    """Yields what is measured."""
    scene = block_scene(Block((1.0, 0.6, 1.2), 20.0), Receiver((0.0, 0.0), (4.0, 4.0), (side, side)))
    for name, where in (("block", scene), ("sphere", Scene(sphere(0.6), scene.receiver))):
        yield Case(f"transport, {name}, {len(where.triangles):,} faces", transports(where))
    transfer = transport(scene, RESOLUTION, SUBSAMPLES).to(dtype=torch.float64)
    samples, masks = photographs(transfer, count)
    few = max(1, count // 8)
    yield Case("NNLS, texels", solves(NNLS(), transfer, samples), count)
    yield Case(f"NNLS, {MASKED:.0%} masked each", solves(NNLS(), transfer, samples[:few], masks[:few]), few)
    yield Case("ridge, texels", solves(Ridge(1e-6), transfer, samples), count)
    yield Case("Adam, texels, 200 steps", solves(ProjectedAdam(steps=200), transfer, samples[:few]), few, slowly=True)
    yield Case("irradiance of all", shown(transfer, samples), count)
    yield Case("transport in harmonics, degree 5", projected(transfer))
    yield Case("adaptive, at most 120 functions", adaptive(transfer, samples[:few]), few)
    yield Case("from samples to light, texels", explained(scene, transfer, samples[:few], tl.Texels(RESOLUTION)), few)


def photographs(transfer: Transfer, count: int) -> tuple[Tensor, Tensor]:
    """Returns irradiance samples [count, 3, points], one in ten noise alone, and masks [count, points]."""
    random = torch.Generator().manual_seed(0)
    texels = torch.rand(count, 3, transfer.transport.shape[1], generator=random, dtype=torch.float64) ** 4
    samples = transfer.mv(texels)
    noise = torch.randn(samples.shape, generator=random, dtype=torch.float64)
    samples += 1e-3 * samples.abs().amax() * noise
    samples[::10] = noise[::10]
    return samples, (torch.rand(count, samples.shape[-1], generator=random) > MASKED).double()


def transports(scene: Scene) -> Callable[[torch.device], Work]:
    """Returns the making of a transport."""
    return lambda device: lambda: transport(scene, RESOLUTION, SUBSAMPLES, device=device).transport


def solves(
    solver: tl.Solver, transfer: Transfer, samples: Tensor, weights: Tensor | None = None
) -> Callable[[torch.device], Work]:
    """Returns a solve; the squared residual is what is compared, since ties leave coefficients open."""

    def prepared(device: torch.device) -> Work:
        there = None if weights is None else weights.to(device)
        problem = LeastSquares(transfer.transport.to(device), samples.to(device), there)

        def squared() -> Tensor:
            return solver.solve(problem).relative_residual.square()

        return squared

    return prepared


def shown(transfer: Transfer, samples: Tensor) -> Callable[[torch.device], Work]:
    """Returns the irradiance under as many lights as there are photographs."""

    def prepared(device: torch.device) -> Work:
        matrix, lights = transfer.transport.to(device), transfer.rmv(samples).to(device)
        return lambda: irradiance(matrix, lights)

    return prepared


def projected(transfer: Transfer) -> Callable[[torch.device], Work]:
    """Returns the transport of spherical harmonics."""

    def prepared(device: torch.device) -> Work:
        there, basis = transfer.to(device), tl.SphericalHarmonics(5, RESOLUTION)
        return lambda: there.project(basis)

    return prepared


def adaptive(transfer: Transfer, samples: Tensor) -> Callable[[torch.device], Work]:
    """Returns the growth of trees; what the receiver shows is compared, since ties leave the trees open."""

    def prepared(device: torch.device) -> Work:
        there = samples.to(device)
        seen = Observation(there, torch.ones_like(there[:, 0]))
        columns, method = transfer.to(device), AdaptiveHaar(RESOLUTION, 120)
        return lambda: solve_adaptive(columns, seen, method).irradiance

    return prepared


def explained(scene: Scene, transfer: Transfer, samples: Tensor, basis: tl.Texels) -> Callable[[torch.device], Work]:
    """Returns all that follows the observation: solve, light, peaks, prediction."""

    def prepared(device: torch.device) -> Work:
        there = samples.to(device)
        seen = Observation(there, torch.ones_like(there[:, 0]))
        columns = transfer.to(device)
        return lambda: explain(seen, scene, columns, basis, NNLS()).predicted

    return prepared


def measured(case: Case) -> Iterator[Row]:
    """Yields a row for the CPU and one for CUDA."""
    cpu, seconds = timed(case, torch.device("cpu"))
    yield row(case, "CPU", seconds, None)
    if not torch.cuda.is_available():
        yield {"case": case.name, "device": "CUDA", "note": "not measured: no CUDA device"}
        return
    answer, there = timed(case, torch.device("cuda"))
    differs = float((answer.cpu() - cpu).abs().max() / cpu.abs().max().clamp(min=1e-300))
    yield {**row(case, torch.cuda.get_device_name(), there, differs), "CPU over GPU": seconds / there}


def timed(case: Case, device: torch.device) -> tuple[Tensor, float]:
    """Returns the answer and the least wall seconds."""
    work = case.prepared(device)

    def whole() -> Tensor:
        answer = work()
        if device.type == "cuda":
            torch.cuda.synchronize()
        return answer

    if not (case.slowly and device.type == "cpu"):
        whole()  # compiles
    answer, cost = best(whole, 1 if case.slowly and device.type == "cpu" else RUNS)
    return answer, cost.wall


def row(case: Case, device: str, seconds: float, differs: float | None) -> Row:
    """Returns a line of the table."""
    each = 1e3 * seconds / case.photographs if case.photographs else None
    return {"case": case.name, "device": device, "s": seconds, "ms per photograph": each, "differs": differs}


if __name__ == "__main__":
    tyro.cli(main)
