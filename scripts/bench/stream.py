"""How many frames of a video torchlight turns into light per second, how late they come, and what memory that takes.

    OMP_WAIT_POLICY=passive python scripts/bench/stream.py [--data DIR] [--frames 5000] [--out DIR]

A sky turns above a cylinder and a slab, a quarter of a degree per frame; 64 x 64 samples, RGB, 8 bits, noise of 1 code;
16 x 16 texels per face. Frames are made before the clock starts. Frames per second count everything from samples to the
certified light. By processor time means: what the threads named would reach on a machine that does nothing else.

The peer, scipy.optimize.nnls, gets the Cholesky factor of the same columns' Gram matrix (made once, not counted) and a
few of the same frames, all channels. Warm is the same solver begun at the support of the frame before.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import tyro
from jaxtyping import Float
from measuring import OUT, Cost, best, clocked, markdown, peak_gib, save
from photographs import FINE, another_scene, lights
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import nnls
from torch import Tensor

from torchlight.geometry.footprints import visible_samples
from torchlight.geometry.scene import Scene
from torchlight.light import overlap
from torchlight.light.environment import EnvironmentMap, rotate_about_z
from torchlight.solvers import Solution
from torchlight.solvers.batch import minimize
from torchlight.solvers.prepared import COSINE_KEPT, LIMITS, RIDGE, PreparedNNLS, prepare
from torchlight.streaming import stream
from torchlight.synthetic import EXPOSED, eight_bit
from torchlight.threads import thread_count
from torchlight.transfer import transport

DEGREES, BETWEEN = 6.0, 24  # of turn between two rendered views, and frames that fade from one into the next
NOISE = 1 / 255
ASKED = {1e-3: 250.0, 1e-5: 120.0}


@dataclass(frozen=True, eq=False)
class Video:
    """Frames made as they are asked for, from views of a light that turns."""

    name: str
    views: Float[Tensor, "views 3 points"]

    def block(self, start: int, count: int) -> Float[Tensor, "count 3 points"]:
        """Returns frames as irradiance samples, with noise of their own."""
        place = torch.arange(start, start + count, dtype=torch.float64) / BETWEEN
        view, share = place.long(), (place % 1)[:, None, None]
        shown = torch.lerp(self.views[view % len(self.views)], self.views[(view + 1) % len(self.views)], share)
        noise = torch.randn(shown.shape, generator=torch.Generator().manual_seed(start), dtype=torch.float64)
        return (torch.pi * eight_bit((shown + NOISE * noise).clamp(0, 1))).float()


def main(
    data: Path | None = None,
    frames: int = 5000,
    block: int = 32,
    probes: tuple[str, ...] = ("campus_cross", "ennis_1024x512", "noon_grass_1k"),
    peer: int = 4,
    samples: int = 64,
    resolution: int = 16,
    out: Path = OUT,
) -> None:
    """Prints the tables and writes them as CSV.

    Args:
        data: folder with probes/*.hdr to light the video with; default: the built-in sky.
        frames: how many, per light and tolerance.
        block: how many at once.
        probes: which of the folder's.
        peer: how many frames SciPy solves.
        samples: along an edge of the receiver; few, and few texels, to watch memory over very many frames.
        resolution: texels along an edge of a face.
        out: folder for stream.csv.
    """
    where = another_scene(samples)
    matrix = transport(where, resolution, 192 // resolution).transport
    weights = visible_samples(where).to(matrix)
    prepared, once = clocked(lambda: prepare(matrix, weights))
    print(f"made once: {once.wall:.2f} s; {thread_count()} threads, SciPy runs on one")
    rows: list[dict[str, object]] = []
    for video in videos(where, weights, data, probes):
        found = by_scipy(prepared, video.block(0, peer))
        for tolerance in ASKED:
            rows.append(watched(matrix, weights, video, tolerance, frames, block, found))
            print(markdown(rows[-1:]), flush=True)
        for tolerance in ASKED:
            rows.append(warm(prepared, video, tolerance, block))
            print(markdown(rows[-1:]), flush=True)
    save("stream", rows, thread_count(), out)


def videos(where: Scene, weights: Tensor, data: Path | None, probes: tuple[str, ...]) -> Iterator[Video]:
    """Yields a video per light."""
    files = {} if data is None else {file.stem: file for file in sorted((data / "probes").glob("*.hdr"))}
    chosen = {"sky": lights(None)[0]} if data is None else {name: lights_of(files[name]) for name in probes}
    fine = transport(where, FINE, 4)
    for name, light in chosen.items():
        turned = (rotate_about_z(light, DEGREES * k) for k in range(int(360 / DEGREES)))
        shown = [fine.mv(overlap.latlong_to_texels(sky.radiance.float(), FINE)).double() / torch.pi for sky in turned]
        views = torch.stack(shown)
        yield Video(name, views * (EXPOSED / views[..., weights > 0].max()))


def lights_of(file: Path) -> EnvironmentMap:
    """Returns the light probe of a file."""
    from torchlight.io.lights import read_light

    return read_light(file)


@dataclass(frozen=True, eq=False)
class ByPeer:
    """What SciPy found for some frames: seconds of the first solve of each item, and |r| of the answers."""

    cost: Cost
    frames: Float[Tensor, "frames 3 points"]
    residuals: Float[Tensor, "frames 3"]


def by_scipy(prepared: PreparedNNLS, frames: Float[Tensor, "frames 3 points"]) -> ByPeer:
    """Returns the peer's answers."""
    columns = prepared.columns.numpy()
    factor = cholesky(prepared.gram.gram.numpy() + 1e-13 * np.eye(columns.shape[1]))
    targets = (frames[..., prepared.seen].double() * prepared.root).flatten(0, 1).numpy()

    def all_of_them() -> list[np.ndarray]:
        return [nnls(factor, solve_triangular(factor, columns.T @ b, trans=1))[0] for b in targets]

    found, cost = clocked(all_of_them)
    left = [float(np.linalg.norm(columns @ x - b)) for x, b in zip(found, targets, strict=True)]
    return ByPeer(cost, frames, torch.tensor(left, dtype=torch.float64).reshape(frames.shape[:2]))


def watched(
    matrix: Tensor, weights: Tensor, video: Video, tolerance: float, frames: int, block: int, peer: ByPeer
) -> dict[str, object]:
    """Returns the row of one video at one tolerance."""
    waiting: deque[Tensor] = deque()

    def handed() -> Iterator[Tensor]:
        while True:
            yield waiting.popleft()

    solutions = stream(matrix, handed(), weights, tolerance)
    waiting.append(video.block(0, block))
    next(solutions)  # the compiler's work is not the stream's
    took: list[Cost] = []
    worst, failed, memory = 0.0, 0, []
    for start in range(0, frames, block):
        waiting.append(video.block(start, min(block, frames - start)))
        solution, cost = clocked(lambda: next(solutions))
        took.append(cost)
        worst = max(worst, solution.kkt_residual.max().item())
        failed += int((solution.status != 0).sum())
        memory.append(peak_gib())
    waiting.append(peer.frames)
    gap = gaps(matrix, weights, next(solutions), peer).max().item()
    walls = 1e3 * np.array([cost.wall for cost in took])
    wall, processor = (sum(getattr(cost, name) for cost in took) / frames for name in ("wall", "processor"))
    theirs = peer.cost.wall / len(peer.frames)
    return {
        "case": f"{video.name}, KKT {tolerance:g}, {matrix.shape[0]} samples, {matrix.shape[1]} texels",
        "frames": frames,
        "frames/s": 1 / wall,
        "frames/s by processor time": thread_count() / processor,
        "asked frames/s": ASKED[tolerance],
        "block": block,
        "latency ms, median": float(np.median(walls)),
        "latency ms, 99 %": float(np.quantile(walls, 0.99)),
        "peak GiB at 10 %": memory[len(memory) // 10],
        "at 50 %": memory[len(memory) // 2],
        "at 100 %": memory[-1],
        "peer": "SciPy nnls on the factor",
        "peer ms per frame": 1e3 * theirs,
        "ratio": theirs / wall,
        "ratio of processor times": peer.cost.processor / len(peer.frames) / processor,
        "largest kkt": worst,
        "largest gap to the peer": gap,
        "not converged": failed,
    }


def gaps(matrix: Tensor, weights: Tensor, ours: Solution, peer: ByPeer) -> Float[Tensor, "frames 3"]:
    """Returns (|r| - |r*|) / |r*|, r* the smaller residual of the two answers, from the columns."""
    weighted = weights.double().sqrt()
    residual = (ours.coefficients.double() @ matrix.double().T - peer.frames.double()) * weighted
    left = torch.linalg.vector_norm(residual, dim=-1)
    return left / torch.minimum(left, peer.residuals) - 1


def warm(prepared: PreparedNNLS, video: Video, tolerance: float, block: int) -> dict[str, object]:
    """Returns what the search alone takes per frame, from the guess and from the support of the frame before."""
    frames = video.block(0, block)[..., prepared.seen].double() * prepared.root
    target = torch.nn.functional.normalize(frames.flatten(0, 1), dim=1)
    linear = target @ prepared.columns

    def searched(start: Tensor) -> Tensor:
        return minimize(prepared.gram, linear, start, RIDGE, LIMITS, cosine=COSINE_KEPT * tolerance)[0]

    found, from_guess = best(lambda: searched(prepared.guess.minimizers(linear)), 3)
    before = torch.cat([found[:3], found[:-3]])
    _, from_before = best(lambda: searched(before), 3)
    return {
        "case": f"{video.name}, KKT {tolerance:g}, search alone",
        "frames": block,
        "cold, processor ms per frame": 1e3 * from_guess.processor / block,
        "warm, processor ms per frame": 1e3 * from_before.processor / block,
    }


if __name__ == "__main__":
    started = time.perf_counter()
    tyro.cli(main)
    print(f"{time.perf_counter() - started:.0f} s in all")
