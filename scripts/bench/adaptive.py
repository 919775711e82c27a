"""How long the adaptive method takes per photograph, beside the same algorithm in a loop over SciPy.

    python scripts/bench/adaptive.py [--data DIR] [--count 256]

Photographs are RGB, 64 x 64 samples, 8-bit; at most 120 functions at 16 x 16 texels per face. The peer finds the gains
with LAPACK through scipy.linalg and fits with scipy.optimize.nnls, in two ways: given the leaves' columns and the
photograph, as its documentation shows, and given the Cholesky factor of their Gram matrix, which is faster. All start
from the same Gram matrix of the scene and end with the same functions, which is checked. What the scene costs once is
printed apart.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
import tyro
from measuring import OUT, clocked, markdown, save
from photographs import photographs, scene
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import nnls
from torch import Tensor
from tqdm import tqdm

from torchlight.inversion.adaptive import AdaptiveHaar, solve_adaptive
from torchlight.inversion.gain import ProjectedGain
from torchlight.inversion.growth import ALWAYS_ASKED, ASKED_ENERGY, LEAST_PRIOR, LEAST_REACH, REACH
from torchlight.inversion.nodes import TEXEL, NodeColumns, WeightedNodes
from torchlight.inversion.quadtree import Quadtree
from torchlight.inversion.refinement import FLOOR, constants, trios
from torchlight.photo.observation import Observation
from torchlight.threads import thread_count
from torchlight.transfer import transport

RESOLUTION, SAMPLES = 16, 64
NOISE = 0.0016  # of the brightest sample: 8 bits, with a margin
SIGNS = np.array([[1, -1, 1, -1], [1, 1, -1, -1], [1, -1, -1, 1]], dtype=float)
RIDGE = 1e-12
Fit = Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray], np.ndarray]


def main(data: Path | None = None, count: int = 256, peer: int = 6, out: Path = OUT) -> None:
    """Prints the table and writes OUT/adaptive.csv.

    Args:
        data: folder with probes/*.hdr to light the photographs with; default: the built-in sky, turned.
        count: how many photographs.
        peer: how many of them the SciPy loop solves.
        out: where the CSV goes.
    """
    where, settings = scene(SAMPLES), AdaptiveHaar(RESOLUTION, 120, NOISE)
    observation = photographs(where, count, data)
    rows: list[dict[str, object]] = []
    columns, once = clocked(lambda: NodeColumns(transport(where, RESOLUTION, 192 // RESOLUTION), RESOLUTION))
    solve_adaptive(columns, part(observation, 1), settings)  # the compiler's work is not the solve's
    print(f"transport of the scene {once.wall:.2f} s, once")
    for some in (count // 4, count // 2, count):
        found, cost = clocked(lambda some=some: solve_adaptive(columns, part(observation, some), settings))
        ours = 1e3 * cost.wall / some
        each = {"ms per photograph (RGB)": ours, "processor ms": 1e3 * cost.processor / some}
        rows.append({"case": "adaptive Haar", "photographs": some, **each})
    functions = found.refinement.functions.double().mean().item()
    for name, how in (("SciPy loop, nnls(A, b)", by_columns), ("SciPy loop, nnls on the Cholesky factor", by_factor)):
        one = part(observation, peer)
        same, cost = clocked(lambda how=how, one=one: agreement(columns, one, settings, found.refinement.kept, how))
        theirs = 1e3 * cost.wall / peer
        row = {"case": "adaptive Haar", "photographs": peer, "ms per photograph (RGB)": theirs}
        more = {"processor ms": 1e3 * cost.processor / peer, "peer": name, "ratio": theirs / ours}
        rows.append({**row, **more, "same functions": same})
    print(f"{markdown(rows)}\n{functions:.0f} functions per channel in the mean")
    save("adaptive", rows, thread_count(), out)


def part(observation: Observation, count: int) -> Observation:
    """Returns the first photographs."""
    return Observation(observation.samples[:count], observation.weights[:count])


def agreement(columns: NodeColumns, observation: Observation, settings: AdaptiveHaar, kept: Tensor, how: Fit) -> str:
    """Solves with SciPy, photograph by photograph and channel by channel; says how many end with the same functions."""
    weighted = WeightedNodes(columns, observation.weights[0].sqrt())
    items = [(photo, channel) for photo in range(observation.samples.shape[0]) for channel in range(3)]
    same = 0
    for photo, channel in tqdm(items, desc="SciPy", disable=not sys.stderr.isatty()):
        sigma = NOISE * float((observation.samples[photo] * observation.weights[photo]).abs().max())
        target = observation.samples[photo, channel] * weighted.root
        leaves = grow(weighted, target.numpy(), sigma, settings, how)
        same += int(torch.equal(kept[photo, channel], functions(columns.tree, torch.from_numpy(leaves))))
    return f"{same} of {len(items)}"


def functions(tree: Quadtree, leaves: Tensor) -> Tensor:
    """Returns the constants and the wavelets of everything above the leaves."""
    kept = constants(tree)
    above = tree.parent[leaves]
    while bool((above >= 0).any()):
        above = above[above >= 0]
        kept[trios(tree, tree.support_of[above]).reshape(-1)] = True
        above = tree.parent[above]
    return kept


def grow(weighted: WeightedNodes, target: np.ndarray, sigma: float, settings: AdaptiveHaar, how: Fit) -> np.ndarray:
    """Returns the leaves: best-first growth by projected gain, by NumPy and SciPy."""
    rule, columns = settings.rule, weighted.columns.numpy()
    correlations = columns @ target
    assert isinstance(rule, ProjectedGain)
    gram, children = weighted.gram.numpy(), weighted.children.numpy()
    level = weighted.source.tree.level.numpy()
    leaves = list(weighted.roots.tolist())
    while True:
        index = np.array(leaves)
        values = how(columns, target, gram, correlations, index)
        energy = values**2 * gram[index, index]
        asked = (level[index] < ALWAYS_ASKED) | (energy >= ASKED_ENERGY * sigma**2)
        candidates = ((children[index, 0] != TEXEL) & asked).nonzero()[0]
        gain = gains(weighted, correlations, index, values, candidates, sigma, settings.condition_limit)
        worthy = int((gain > rule.threshold).sum())
        count = min(max(1, int(rule.share * len(leaves) / 3)), (settings.budget - len(leaves)) // 3, worthy)
        if count <= 0:
            return index
        for k in candidates[np.argsort(-gain, kind="stable")[:count]]:
            quarters = children[leaves[k]]
            leaves[k] = quarters[0]
            leaves.extend(quarters[1:].tolist())


def by_columns(
    columns: np.ndarray, target: np.ndarray, _gram: np.ndarray, _correlations: np.ndarray, index: np.ndarray
) -> np.ndarray:
    """Returns the non-negative least squares radiance, from the leaves' columns and the photograph."""
    return nnls(columns[index].T, target)[0]


def by_factor(
    _columns: np.ndarray, _target: np.ndarray, gram: np.ndarray, correlations: np.ndarray, index: np.ndarray
) -> np.ndarray:
    """Returns the non-negative least squares radiance, from the Cholesky factor of the leaves' Gram matrix."""
    norms = np.sqrt(gram[index, index])
    factor = cholesky(gram[np.ix_(index, index)] / np.outer(norms, norms) + RIDGE * np.eye(len(index)))
    return nnls(factor, solve_triangular(factor, correlations[index] / norms, trans=1))[0] / norms


def gains(
    weighted: WeightedNodes,
    correlations: np.ndarray,
    index: np.ndarray,
    values: np.ndarray,
    candidates: np.ndarray,
    sigma: float,
    condition_limit: float,
) -> np.ndarray:
    """Returns the projected gain of every candidate, -1 where the photograph does not determine it."""
    gram, children = weighted.gram.numpy(), weighted.children.numpy()
    area = (0.25 ** weighted.source.tree.level.double() / 3).numpy()
    used, amounts = index[values > 0], values[values > 0]
    mean, here = float(values @ area[index]), values[candidates]
    norms = np.sqrt(gram[used, used])
    factor = cholesky(gram[np.ix_(used, used)] / np.outer(norms, norms) + RIDGE * np.eye(len(used)))
    quarters = children[index[candidates]]
    across = gram[used[:, None, None], quarters]
    slopes = (correlations[quarters] - np.einsum("a,akq->kq", amounts, across)) @ SIGNS.T
    projected = solve_triangular(factor, (across @ SIGNS.T / norms[:, None, None]).reshape(len(used), -1), trans=1)
    projected = projected.reshape(len(used), -1, 3)
    own = SIGNS @ gram[quarters[:, :, None], quarters[:, None, :]] @ SIGNS.T
    innovation = own - np.einsum("akx,aky->kxy", projected, projected)
    energy = own.diagonal(axis1=1, axis2=2).max(axis=1)
    least = np.maximum((sigma / (condition_limit * (mean + here))) ** 2, FLOOR * energy)
    sound = np.linalg.eigvalsh(innovation)[:, 0] > least
    prior = (sigma / np.maximum(here, LEAST_PRIOR * mean)) ** 2
    step = np.linalg.solve(innovation + prior[:, None, None] * np.eye(3), slopes[..., None])[..., 0]
    largest, reach = np.abs(step).max(axis=1), REACH * np.maximum(here, LEAST_REACH * mean)
    length = np.where(largest > reach, reach / largest, 1.0)
    gain = (2 * length - length**2) * (slopes * step).sum(axis=1) / sigma**2
    return np.where(sound, gain, -1.0)


if __name__ == "__main__":
    tyro.cli(main)
