"""Radiance on leaves against scipy and against the quadratic program over wavelets."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.optimize import nnls
from torch import Tensor
from torch.testing import assert_close

from torchlight.errors import ConfigError
from torchlight.inversion.leaf_program import Item, certificate, fit, leaf_wavelets, scene_columns, texels_of
from torchlight.inversion.nodes import NodeColumns, WeightedNodes
from torchlight.inversion.quadtree import Quadtree, indicators, quadtree
from torchlight.inversion.refinement import constants, needed, trios
from torchlight.light import haar
from torchlight.solvers import LeastSquares, NonnegativeSynthesis
from torchlight.transfer import Transfer

RESOLUTION = 8
TEXELS = 3 * RESOLUTION**2


def make_item(matrix: Tensor, root: Tensor, samples: Tensor) -> Item:
    columns = scene_columns(WeightedNodes(NodeColumns(Transfer(matrix, RESOLUTION), RESOLUTION), root))
    target = samples * root
    return Item(columns, target, target @ columns.nodes, 1.0)


def random_item(seed: int, points: int = 300) -> tuple[Tensor, Tensor, Item]:
    """A smooth non-negative matrix, weights of several sizes, and the samples of a spotty light with noise."""
    generator = torch.Generator().manual_seed(seed)
    matrix = torch.rand(points, TEXELS, generator=generator, dtype=torch.float64)
    light = torch.exp(2 * torch.randn(TEXELS, generator=generator, dtype=torch.float64))
    samples = matrix @ light * (1 + 0.02 * torch.randn(points, generator=generator, dtype=torch.float64))
    root = torch.randint(1, 4, (points,), generator=generator).double().sqrt()
    return matrix * root[:, None], samples * root, make_item(matrix, root, samples)


def random_tree(tree: Quadtree, divisions: int, seed: int) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    divided = torch.zeros_like(tree.supports, dtype=torch.bool)
    for _ in range(divisions):
        leaves = tree.support_of[tree.leaves(divided)]
        leaves = leaves[leaves >= 0]
        divided[leaves[torch.randint(leaves.shape[0], (1,), generator=generator)]] = True
    return divided


def whole(tree: Quadtree, divided: Tensor) -> Tensor:
    return constants(tree).index_fill(0, trios(tree, divided.nonzero()[:, 0]).reshape(-1), True)


def test_columns_of_nodes_are_sums_of_texels() -> None:
    weighted, target, item = random_item(1)
    tree = item.columns.tree
    nodes = weighted @ indicators(tree, torch.arange(tree.size)).T
    assert_close(item.columns.nodes, nodes)
    assert_close(item.columns.gram, nodes.T @ nodes)
    assert_close(item.correlations, nodes.T @ target)
    wavelets = haar.project(weighted, RESOLUTION)
    assert_close(item.columns.wavelet_gram, wavelets.T @ wavelets)
    assert_close(item.columns.areas[tree.roots].sum().item(), 1.0)


@pytest.mark.parametrize("divisions", [0, 1, 12, 40])
def test_whole_trios_are_nonnegative_least_squares_on_leaves(divisions: int) -> None:
    weighted, target, item = random_item(2)
    tree = item.columns.tree
    divided = random_tree(tree, divisions, seed=divisions)
    fitted = fit(item, divided, whole(tree, divided), torch.zeros(TEXELS, dtype=torch.float64))
    columns = (weighted @ indicators(tree, fitted.leaves).T).numpy()
    expected = torch.from_numpy(nnls(columns, target.numpy())[0])
    assert_close(fitted.values, expected, rtol=1e-6, atol=1e-8 * float(expected.max()))
    assert fitted.kkt_residual < 1e-10
    assert fitted.multipliers.shape == (0,)


@pytest.mark.parametrize("seed", range(6))
def test_dropped_wavelets_make_the_program_of_nonnegative_radiance(seed: int) -> None:
    """The same minimiser as the proximal method over coefficients, which knows neither leaves nor multipliers."""
    weighted, target, item = random_item(10 + seed)
    tree = item.columns.tree
    divided = random_tree(tree, 14, seed)
    kept = whole(tree, divided)
    wavelets = (kept & ~constants(tree)).nonzero()[:, 0]
    generator = torch.Generator().manual_seed(seed)
    kept[wavelets[torch.randperm(wavelets.shape[0], generator=generator)[:15]]] = False
    divided = needed(tree, kept)
    fitted = fit(item, divided, kept, torch.zeros(TEXELS, dtype=torch.float64))
    assert (fitted.values == 0).any()  # the constraint is felt
    found = fitted.values @ leaf_wavelets(tree, fitted.leaves)
    synthesis = haar.synthesis(torch.eye(TEXELS, dtype=torch.float64)[kept], RESOLUTION).T.contiguous()
    problem = LeastSquares(weighted @ synthesis, target[None], synthesis=synthesis)
    expected = NonnegativeSynthesis().solve(problem).coefficients[0]
    assert_close(found[kept], expected, rtol=1e-5, atol=1e-6 * float(expected.abs().max()))
    assert_close(found[~kept], torch.zeros_like(found[~kept]), rtol=0, atol=1e-11 * float(found.abs().max()))
    radiance = haar.synthesis(torch.where(kept, found, 0.0), RESOLUTION)
    assert radiance.min() >= -1e-9 * radiance.max()
    assert_close(radiance, texels_of(item, fitted), rtol=0, atol=1e-9 * float(radiance.max()))


def test_the_certificate_knows_the_minimum_from_its_neighbours() -> None:
    weighted, target, item = random_item(30)
    tree = item.columns.tree
    divided = random_tree(tree, 10, 5)
    kept = whole(tree, divided)
    kept[trios(tree, divided.nonzero()[:, 0])[::2, 1]] = False
    fitted = fit(item, divided, kept, torch.zeros(TEXELS, dtype=torch.float64))
    relative, kkt, gap = certificate(item, divided, kept, fitted).tolist()
    light = texels_of(item, fitted)
    assert_close(relative, float((weighted @ light - target).norm() / target.norm()), rtol=1e-9, atol=0)
    assert kkt < 1e-9
    assert 0 <= gap < 1e-8
    moved = type(fitted)(fitted.leaves, fitted.values * 1.01, fitted.multipliers, fitted.steps, 0.0)
    assert certificate(item, divided, kept, moved)[1] > 1e-5


def test_a_column_that_nothing_sees_gets_no_light() -> None:
    generator = torch.Generator().manual_seed(4)
    tree = quadtree(RESOLUTION)
    matrix = torch.rand(50, TEXELS, generator=generator, dtype=torch.float64)
    matrix[:, indicators(tree, tree.roots[:1])[0] > 0] = 0.0
    item = make_item(matrix, torch.ones(50, dtype=torch.float64), matrix.sum(dim=1))
    divided = torch.zeros_like(tree.supports, dtype=torch.bool)
    fitted = fit(item, divided, constants(tree), torch.ones(TEXELS, dtype=torch.float64))
    expected = torch.ones(9, dtype=torch.float64).index_fill(0, torch.tensor([0]), 0.0)
    assert_close(fitted.values, expected, rtol=1e-9, atol=1e-9)
    assert np.isfinite(fitted.kkt_residual)


def test_a_tree_deeper_than_the_dense_transport_is_refused() -> None:
    transfer = Transfer(torch.ones(5, TEXELS, dtype=torch.float64), RESOLUTION)
    deeper = NodeColumns(transfer, 32, lambda squares, cells: torch.ones(len(squares), 5))
    with pytest.raises(ConfigError, match="at most 16, got 32"):
        scene_columns(WeightedNodes(deeper, torch.ones(5, dtype=torch.float64)))
