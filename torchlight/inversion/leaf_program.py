"""Radiance on the leaves of a quadtree: columns and Gram of all nodes once per scene, least squares per item.

    minimise |A v - b|^2 / 2   over   v >= 0,  D v = 0

v is the radiance on the leaves, A and b carry the weights' roots, and each row of D is one wavelet left out of the
expansion. Without D this is non-negative least squares; with it, the quadratic program of S c >= 0 over the wavelets
that are kept.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchlight.errors import ConfigError
from torchlight.inversion.nodes import DENSE_RESOLUTION, WeightedNodes
from torchlight.inversion.quadtree import Quadtree, indicators, pyramid, spread, texel_nodes
from torchlight.light import haar
from torchlight.solvers.active_set import Limits, cholesky, minimize_nonnegative
from torchlight.solvers.certificate import duality_gap, kkt_residual, nonzero_norm
from torchlight.solvers.system import System

RIDGE = 1e-12
NNLS_LIMITS = Limits(tolerance=1e-11, max_steps=5000)
PENALTY = 30.0
MAX_ROUNDS = 200
TOLERANCE = 1e-9  # on the KKT residual
RANK = 1e-12  # singular values below this part of the largest are rounding


@dataclass(frozen=True, eq=False)
class Columns:
    """What a scene and its weights give before any photograph: nothing here depends on the samples.

    Attributes:
        tree: the nodes.
        root: square roots of the weights.
        unweighted: A of every node, float64, one per row.
        nodes: W^(1/2) A of every node.
        gram: inner products of these columns.
        norms: their lengths.
        wavelet_gram: inner products of the weighted columns of all Haar functions.
        areas: share of every node in the area of all texels.
    """

    tree: Quadtree
    root: Float[Tensor, " points"]
    unweighted: Float[Tensor, "nodes points"]
    nodes: Float[Tensor, "points nodes"]
    gram: Float[Tensor, "nodes nodes"]
    norms: Float[Tensor, " nodes"]
    wavelet_gram: Float[Tensor, "coeffs coeffs"]
    areas: Float[Tensor, " nodes"]


def scene_columns(weighted: WeightedNodes) -> Columns:
    """Returns the columns of all squares and of all Haar functions, and their Gram matrices.

    Raises:
        ConfigError: some squares are not known: the tree goes deeper than the dense transport.
    """
    tree, size = weighted.source.tree, weighted.source.tree.resolution
    if weighted.node.shape[0] < tree.size:
        raise ConfigError(f"the paper's rule takes max_resolution at most {DENSE_RESOLUTION}, got {size}; 16 is usual")
    texels = texel_nodes(tree)
    texel_gram = weighted.gram[texels][:, texels]
    return Columns(
        tree=tree,
        root=weighted.root,
        unweighted=weighted.source.dense,
        nodes=weighted.columns.T,
        gram=weighted.gram,
        norms=weighted.gram.diagonal().clamp(min=0).sqrt(),
        wavelet_gram=haar.project(haar.project(texel_gram, size).T.contiguous(), size),
        areas=0.25 ** tree.level.to(torch.float64) / 3,
    )


@dataclass(frozen=True, eq=False)
class Item:
    """One channel of one photograph.

    Attributes:
        columns: the scene's.
        target: W^(1/2) b.
        correlations: A'b of every node.
        sigma: standard deviation of the noise of a sample of weight 1.
    """

    columns: Columns
    target: Float[Tensor, " points"]
    correlations: Float[Tensor, " nodes"]
    sigma: float


@dataclass(frozen=True, eq=False)
class Fitted:
    """The best radiance on given leaves.

    Attributes:
        leaves: nodes, ascending.
        values: v, one per leaf.
        multipliers: of D v = 0, one per dropped wavelet.
        steps: factorisations spent.
        kkt_residual: see `optimality`.
    """

    leaves: Int[Tensor, " leaves"]
    values: Float[Tensor, " leaves"]
    multipliers: Float[Tensor, " dropped"]
    steps: int
    kkt_residual: float


def texels_of(item: Item, fitted: Fitted) -> Float[Tensor, " texels"]:
    """Returns the radiance of every texel."""
    tree = item.columns.tree
    values = torch.zeros(tree.size, dtype=torch.float64, device=fitted.values.device)
    return spread(values.index_copy(0, fitted.leaves, fitted.values), tree.resolution)


def leaf_wavelets(tree: Quadtree, leaves: Int[Tensor, " leaves"]) -> Float[Tensor, "leaves coeffs"]:
    """Returns the Haar coefficients of each leaf's indicator: c = v @ leaf_wavelets."""
    return haar.analysis(indicators(tree, leaves), tree.resolution)


def dropped_wavelets(
    tree: Quadtree, divided: Bool[Tensor, " supports"], kept: Bool[Tensor, " coeffs"]
) -> Int[Tensor, " dropped"]:
    """Returns the wavelets of divided supports that are not kept."""
    trios = tree.trios[divided][:, None] + torch.arange(3, device=kept.device)
    index = trios.reshape(-1)
    return index[~kept[index]]


def fit(
    item: Item,
    divided: Bool[Tensor, " supports"],
    kept: Bool[Tensor, " coeffs"],
    start: Float[Tensor, " texels"],
) -> Fitted:
    """Returns the best non-negative radiance on a tree, without the wavelets of it that are not kept.

    Args:
        item: the data.
        divided: the tree.
        kept: Haar functions that may differ from 0.
        start: radiance to begin from; its mean over each leaf is taken.
    """
    columns = item.columns
    tree = columns.tree
    leaves = tree.leaves(divided)
    seen = columns.norms[leaves] > 0
    used = leaves[seen]
    norms = columns.norms[used]
    size = nonzero_norm(item.target[None])[0]
    gram = columns.gram[used][:, used] / (norms[:, None] * norms)
    linear = item.correlations[used] / (norms * size)
    means = pyramid(start, tree.resolution)[used] / (columns.areas[used] * start.shape[0])
    dropped = dropped_wavelets(tree, divided, kept)
    rows = leaf_wavelets(tree, used)[:, dropped].T / norms
    scale = torch.linalg.vector_norm(rows, dim=1)
    scale = torch.where(scale > 0, scale, 1.0)
    x, multipliers, steps, residual = constrained(
        gram, linear, rows / scale[:, None], (means * norms / size).clamp(min=0)
    )
    values = torch.zeros_like(columns.norms[leaves])
    values[seen] = x * size / norms
    return Fitted(leaves, values, multipliers * size / scale, steps, residual)


def constrained(
    gram: Float[Tensor, "n n"],
    linear: Float[Tensor, " n"],
    rows: Float[Tensor, "m n"],
    start: Float[Tensor, " n"],
) -> tuple[Float[Tensor, " n"], Float[Tensor, " m"], int, float]:
    """Returns the minimiser of x'Gx/2 - c'x over x >= 0 with D x = 0, its multipliers, the steps and the KKT residual.

    An augmented Lagrangian: x <- argmin over x >= 0 with the term mu |D x + l / mu|^2 / 2 added, l <- l + mu D x. After
    each round the equality-constrained problem on the columns in use is solved directly; the rounds end when that
    answer satisfies the optimality conditions.

    Args:
        gram: G, unit diagonal.
        linear: c, of order one.
        rows: D, rows of length 1.
        start: x >= 0 to begin from.

    References:
        Hestenes, Multiplier and gradient methods, 1969; Powell, 1969.
    """
    multipliers = torch.zeros_like(rows[:, 0])
    if rows.shape[0] == 0:
        x, steps = minimize_nonnegative(gram, linear, start, RIDGE, NNLS_LIMITS)
        return x, multipliers, steps, optimality(gram, linear, rows, x, multipliers)
    augmented = gram + PENALTY * rows.T @ rows
    scale = augmented.diagonal().sqrt()
    augmented = augmented / (scale[:, None] * scale)
    x, steps = start, 0
    best = (start, multipliers, torch.inf)
    for _ in range(MAX_ROUNDS):
        shifted = (linear - multipliers @ rows) / scale
        y, spent = minimize_nonnegative(augmented, shifted, x * scale, RIDGE, NNLS_LIMITS)
        x, steps = y / scale, steps + spent
        multipliers = multipliers + PENALTY * rows @ x
        for answer in ((x, multipliers), polished(gram, linear, rows, x, multipliers)):
            residual = optimality(gram, linear, rows, *answer)
            if residual < best[2]:
                best = (*answer, residual)
        if best[2] <= 0.1 * TOLERANCE:
            break
    return best[0], best[1], steps, best[2]


def polished(
    gram: Float[Tensor, "n n"],
    linear: Float[Tensor, " n"],
    rows: Float[Tensor, "m n"],
    x: Float[Tensor, " n"],
    multipliers: Float[Tensor, " m"],
) -> tuple[Float[Tensor, " n"], Float[Tensor, " m"]]:
    """Returns the minimiser over D x = 0 with the columns in use alone, and the multipliers nearest to those given.

    Columns that become negative leave, so that x >= 0; whether one should come in is not asked.
    """
    used = x > 0
    while bool(used.any()):
        part = rows[:, used]
        left, values, right = torch.linalg.svd(part, full_matrices=True)
        rank = int((values > RANK).sum())
        free = right[rank:].T
        block = gram[used][:, used]
        reduced = free.T @ block @ free
        reduced.diagonal().add_(RIDGE)
        y = torch.cholesky_solve((free.T @ linear[used])[:, None], cholesky(reduced, RIDGE))[:, 0]
        answer = torch.zeros_like(x)
        answer[used] = free @ y
        if bool((answer >= 0).all()):
            w = linear[used] - block @ answer[used] - multipliers @ part
            correction = left[:, :rank] @ ((right[:rank] @ w) / values[:rank])
            return answer, multipliers + correction
        used = answer > 0
    return torch.zeros_like(x), multipliers


def optimality(
    gram: Float[Tensor, "n n"],
    linear: Float[Tensor, " n"],
    rows: Float[Tensor, "m n"],
    x: Float[Tensor, " n"],
    multipliers: Float[Tensor, " m"],
) -> float:
    """Returns the largest violation of the optimality conditions, for columns and target of length 1.

    With w = c - G x - D'l: max_j w_j, max_j -x_j, sum_j |x_j w_j| and max_i |(D x)_i|; 0 at the minimiser.
    """
    if x.shape[0] == 0:
        return 0.0
    w = linear - gram @ x - multipliers @ rows
    one = torch.ones_like(x[:1])
    residual = kkt_residual(x[None], w[None], torch.ones_like(x)[None], one)[0]
    return max(residual.item(), (rows @ x).abs().max().item() if rows.shape[0] else 0.0)


def certificate(
    item: Item, divided: Bool[Tensor, " supports"], kept: Bool[Tensor, " coeffs"], fitted: Fitted
) -> Float[Tensor, "3"]:
    """Returns relative residual, KKT residual and duality gap, from the columns themselves rather than their Gram."""
    columns, leaves = item.columns, fitted.leaves
    index = dropped_wavelets(columns.tree, divided, kept)
    rows = leaf_wavelets(columns.tree, leaves)[:, index].T
    one = torch.ones_like(columns.root)[None]
    system = System(columns.nodes[:, leaves], one, item.target[None])
    residual = system.targets - system.predict(fitted.values[None])
    size, norms = nonzero_norm(system.targets), system.column_norms()
    w = system.correlate(residual) - (fitted.multipliers @ rows)[None]
    ridge = RIDGE * norms.square() * fitted.values
    safe = torch.where(norms > 0, norms, 1.0)
    lengths = torch.linalg.vector_norm(rows / safe, dim=1)
    violation = (rows @ fitted.values).abs() / torch.where(lengths > 0, lengths, 1.0) / size
    worst = torch.cat([kkt_residual(fitted.values[None], w - ridge, norms, size), violation]).max()
    return torch.stack(
        [torch.linalg.vector_norm(residual) / size[0], worst, duality_gap(system, residual, w, norms)[0]]
    )
