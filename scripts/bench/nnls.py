"""How long exact non-negative least squares takes per photograph and channel, beside scipy.optimize.nnls.

    OMP_WAIT_POLICY=passive python scripts/bench/nnls.py [--data DIR] [--photographs 256] [--out DIR]

The shadows of a cylinder and a slab, a scene on which no setting of the solver was chosen; 16 x 16 texels per face (the
columns above the plane), RGB, 8-bit. Lights are random (each texel uniform) or light probes, each turned by an angle of
its own. The peer solves the green channel of some photographs, in two ways: given the Cholesky factor of the same
columns' Gram matrix (made once, not counted), and given the columns.
The gap is (|r| - |r*|) / |r*|, r* the smaller residual of the two answers, taken from the columns. Ours counts
everything from the samples to the certified answer, the Gram matrix included. Wall time is what one waits for;
processor time, summed over threads, says what it takes on a machine that is busy with other things.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import tyro
from jaxtyping import Float
from measuring import OUT, Row, clocked, markdown, save
from photographs import another_scene, photographs
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import nnls
from torch import Tensor
from tqdm import tqdm

from torchlight.geometry.footprints import visible_samples
from torchlight.solvers import NNLS, LeastSquares, Solution
from torchlight.synthetic import EXPOSED, eight_bit
from torchlight.threads import thread_count
from torchlight.transfer import transport

RESOLUTION = 16
FACTOR_RIDGE = 1e-13
ASKED = {"random lights": 60.0, "probes": 40.0}  # ratios
ASKED_MORE = {0.05: 8.0, 0.2: 20.0}  # ms per photograph


def main(
    data: Path | None = None,
    photographs: int = 256,
    peer: int = 64,
    plain: int = 4,
    samples: tuple[int, ...] = (64, 72),
    out: Path = OUT,
) -> None:
    """Prints the tables, and writes them as CSV where --out names a file.

    Args:
        data: folder with probes/*.hdr to light the photographs with; default: the built-in sky.
        photographs: how many.
        peer: how many of them SciPy solves from the factor, one channel each.
        plain: how many it solves from the columns.
        samples: samples along an edge of the receiver, one table each.
        out: folder for nnls.csv.
    """
    print(f"{thread_count()} threads; SciPy runs on one")
    rows: list[Row] = []
    for edge in samples:
        case = Case.of(edge)
        lit = {
            "random lights": random_lights(case, photographs),
            "probes" if data else "sky": probes(case, photographs, data),
        }
        for name, photos in lit.items():
            rows.append(against_scipy(case, name, photos, peer, plain))
            print(markdown(rows[-1:]), flush=True)
        if edge == samples[0]:
            for name, photos in lit.items():
                more = variants(case, name, photos[:64])
                print(markdown(more), flush=True)
                rows += more
    save("nnls", rows, thread_count(), out)


@dataclass(frozen=True, eq=False)
class Case:
    """A scene's transport, and what the peer is given of it: weighted unit columns and their Cholesky factor."""

    edge: int
    matrix: Float[Tensor, "points coeffs"]
    weights: Float[Tensor, " points"]
    columns: np.ndarray
    factor: np.ndarray

    @staticmethod
    def of(edge: int) -> Case:
        """Returns the case of so many samples along an edge."""
        where = another_scene(edge)
        matrix = transport(where, RESOLUTION, 192 // RESOLUTION).transport
        weights = visible_samples(where).to(torch.float64)
        columns = (matrix.double() * weights.sqrt()[:, None]).numpy()
        norms = np.linalg.norm(columns, axis=0)
        columns = columns[:, norms > 0] / norms[norms > 0]
        factor = cholesky(columns.T @ columns + FACTOR_RIDGE * np.eye(columns.shape[1]))
        return Case(edge, matrix, weights, columns, factor)


def random_lights(case: Case, count: int) -> Float[Tensor, "count 3 points"]:
    """Returns 8-bit photographs under lights whose texels are uniform in [0, 1)."""
    g = torch.Generator().manual_seed(7)
    light = torch.rand(count, 3, case.matrix.shape[1], generator=g, dtype=torch.float64)
    values = light @ case.matrix.double().T / torch.pi
    return eight_bit(values * (EXPOSED / (values * case.weights).amax((-1, -2), keepdim=True))) * torch.pi


def probes(case: Case, count: int, data: Path | None) -> Float[Tensor, "count 3 points"]:
    """Returns 8-bit photographs under light probes turned about the vertical."""
    return photographs(another_scene(case.edge), count, data, seed=7).samples


def against_scipy(case: Case, name: str, photos: Float[Tensor, "count 3 points"], peer: int, plain: int) -> Row:
    """Returns one row of the table."""
    solve(case, photos[:1])  # the compiler's work is not the solve's
    ours, cost = clocked(lambda: solve(case, photos))
    targets = [(photos[k, 1] * case.weights.sqrt()).numpy() for k in range(min(peer, len(photos)))]
    theirs, by_peer = clocked(lambda: [by_factor(case, b) for b in tqdm(targets, disable=not sys.stderr.isatty())])
    _, by_plain = clocked(lambda: [nnls(case.columns, b) for b in targets[:plain]])
    again, second = clocked(lambda: solve(case, photos))
    assert torch.equal(again.coefficients, ours.coefficients)
    gaps, below = gaps_of(case, ours, theirs, targets)
    wall, processor = (1e3 * min(getattr(cost, what), getattr(second, what)) for what in ("wall", "processor"))
    per_item, per_peer = wall / (3 * len(photos)), 1e3 * by_peer.wall / len(targets)
    per_plain = 1e3 * by_plain.wall / max(1, min(plain, len(targets)))
    return {
        "case": f"{name}, {case.edge**2} samples",
        "columns": case.columns.shape[1],
        "photographs": len(photos),
        "channels": 3,
        "wall ms": per_item,
        "processor ms": processor / (3 * len(photos)),
        "peer": "SciPy nnls on the factor",
        "peer wall ms": per_peer,
        "peer processor ms": 1e3 * by_peer.processor / len(targets),
        "ratio": per_peer / per_item,
        "ratio by processor time, two threads": 2 * by_peer.processor / len(targets) / processor * 3e3 * len(photos),
        "asked": ASKED.get(name, ""),
        "SciPy nnls(A, b), wall ms": per_plain,
        "ratio to nnls(A, b)": per_plain / per_item,
        "compared": len(targets),
        "largest gap": float(gaps.max()),
        "SciPy's largest gap": float(below.max()),
        "largest kkt residual": ours.kkt_residual.max().item(),
        "not converged": int((ours.status != 0).sum()),
        "most steps": int(ours.steps.max()),
    }


def variants(case: Case, name: str, photos: Float[Tensor, "count 3 points"]) -> list[Row]:
    """Returns rows for masks, ties, dark, noisy and badly scaled problems, beside the plain problem."""
    g = torch.Generator().manual_seed(11)
    noise = torch.randn(photos.shape, generator=g, dtype=torch.float64)
    scales = 10.0 ** (6 * torch.rand(case.matrix.shape[1], generator=g, dtype=torch.float64) - 3)
    twice = torch.cat([case.matrix, case.matrix[:, ::3]], dim=1)
    problems: dict[str, Callable[[], Solution]] = {
        "plain": lambda: solve(case, photos),
        "no tie-break (ridge 0)": lambda: solve(case, photos, NNLS(ridge=0.0)),
        "a third of the columns twice": lambda: NNLS().solve(LeastSquares(twice, *posed(case, photos))),
        "columns scaled by 1e-3 to 1e3": lambda: NNLS().solve(
            LeastSquares(case.matrix * scales.float(), *posed(case, photos))
        ),
        "dark": lambda: solve(case, 0 * photos),
        "noise alone": lambda: solve(case, noise),
        "noise of 10 % added": lambda: solve(case, photos + 0.1 * photos.mean() * noise),
    }
    for share in (0.05, 0.2):
        for shape, masks in (
            ("scattered", scattered(case, len(photos), share)),
            ("disc", discs(case, len(photos), share)),
        ):
            problems[f"masks of their own, {share:.0%}, {shape}"] = lambda masks=masks: solve(case, photos, masks=masks)
    rows: list[Row] = []
    for what, problem in problems.items():
        found, cost = clocked(problem)
        wall, processor = (1e3 * value / len(photos) for value in (cost.wall, cost.processor))
        rows.append(
            {
                "case": f"{name}: {what}",
                "photographs": len(photos),
                "channels": 3,
                "wall ms per photograph": wall,
                "processor ms per photograph": processor,
                "wall ms more": wall - float(str(rows[0]["wall ms per photograph"])) if rows else 0.0,
                "processor ms more": processor - float(str(rows[0]["processor ms per photograph"])) if rows else 0.0,
                "asked ms more": next((ms for share, ms in ASKED_MORE.items() if f"{share:.0%}, " in what), ""),
                "largest kkt residual": found.kkt_residual.max().item(),
                "not converged": int((found.status != 0).sum()),
                "most steps": int(found.steps.max()),
            }
        )
    return rows


def posed(case: Case, photos: Float[Tensor, "count 3 points"]) -> tuple[Tensor, Tensor]:
    """Returns samples and weights as a problem takes them."""
    return photos.to(case.matrix), case.weights.to(case.matrix).expand(len(photos), -1)


def solve(
    case: Case,
    photos: Float[Tensor, "count 3 points"],
    solver: NNLS | None = None,
    masks: Float[Tensor, "count points"] | None = None,
) -> Solution:
    """Returns the solution of all photographs."""
    samples, weights = posed(case, photos)
    own = weights if masks is None else weights * masks.to(weights)
    return (NNLS() if solver is None else solver).solve(LeastSquares(case.matrix, samples, own))


def scattered(case: Case, count: int, share: float) -> Float[Tensor, "count points"]:
    """Returns masks that leave out a share of the samples at random."""
    g = torch.Generator().manual_seed(13)
    return (torch.rand(count, case.edge**2, generator=g) >= share).to(torch.float64)


def discs(case: Case, count: int, share: float) -> Float[Tensor, "count points"]:
    """Returns masks that leave out a disc of so large a share of the samples, as a highlight would."""
    g = torch.Generator().manual_seed(17)
    places = (torch.arange(case.edge) + 0.5) / case.edge
    y, x = torch.meshgrid(places, places, indexing="ij")
    centers = 0.25 + 0.5 * torch.rand(count, 2, 1, 1, generator=g)
    far = (y - centers[:, 0]) ** 2 + (x - centers[:, 1]) ** 2 > share / torch.pi
    return far.reshape(count, -1).to(torch.float64)


def by_factor(case: Case, target: np.ndarray) -> np.ndarray:
    """Returns the answer for unit columns, from the Cholesky factor of their Gram matrix."""
    return nnls(case.factor, solve_triangular(case.factor, case.columns.T @ target, trans=1))[0]


def gaps_of(
    case: Case, ours: Solution, theirs: list[np.ndarray], targets: list[np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Returns (|r| - |r*|) / |r*| of our answers and of the peer's, r* the smaller of both."""
    weighted = (case.matrix.double() * case.weights.sqrt()[:, None]).numpy()
    found = [np.linalg.norm(weighted @ ours.coefficients[k, 1].double().numpy() - b) for k, b in enumerate(targets)]
    peer = [np.linalg.norm(case.columns @ x - b) for x, b in zip(theirs, targets, strict=True)]
    best = np.minimum(found, peer)
    return np.array(found) / best - 1, np.array(peer) / best - 1


if __name__ == "__main__":
    tyro.cli(main)
