"""What trees amount to, on trees made by hand: radiance, functions, fates, certificates."""

from __future__ import annotations

import pytest
import torch
from shadows import block_transfer, coarsened, columns_of, observed, spotty
from torch import Tensor
from torch.testing import assert_close

from torchlight.inversion.forest import (
    RIDGE,
    Forest,
    Items,
    certificates,
    divided_nodes,
    fates_of_supports,
    functions_in_use,
    harvest,
    in_use,
    on_places,
    on_texels,
    seedlings,
)
from torchlight.inversion.growth import fit
from torchlight.inversion.nodes import NodeColumns, WeightedNodes, product
from torchlight.inversion.quadtree import Quadtree, indicators, quadtree
from torchlight.inversion.refinement import Fate, constants, trios
from torchlight.light import haar
from torchlight.solvers import nonnegative_certificate
from torchlight.solvers.system import System

SIZE, BUDGET, CHANNELS = 16, 60, 2
FINE = block_transfer(SIZE)
RESOLVED, BELOW, ILL, UNSEEN, LIMIT = (int(fate) for fate in list(Fate)[:5])


def random_tree(tree: Quadtree, divisions: int, seed: int) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    divided = torch.zeros_like(tree.supports, dtype=torch.bool)
    for _ in range(divisions):
        leaves = tree.support_of[tree.leaves(divided)]
        leaves = leaves[leaves >= 0]
        divided[leaves[torch.randint(leaves.shape[0], (1,), generator=generator)]] = True
    return divided


def planted(weighted: WeightedNodes, trees: list[Tensor], seed: int = 0) -> Forest:
    """Returns trees with random radiance, some of it 0; what is beyond a row's leaves is filled with nonsense."""
    tree = weighted.source.tree
    for level in range(int(tree.level.max())):
        place = torch.full_like(tree.level, -1).index_copy(0, weighted.node, torch.arange(len(weighted.node)))
        wanted = torch.cat([tree.supports[divided] for divided in trees])
        weighted.divide(place[wanted[tree.level[wanted] == level]])
    place = torch.full_like(tree.level, -1).index_copy(0, weighted.node, torch.arange(len(weighted.node)))
    generator = torch.Generator().manual_seed(seed)
    values = torch.rand(len(trees), CHANNELS, BUDGET, generator=generator, dtype=torch.float64)
    leaves = torch.randint(len(weighted.node), (len(trees), BUDGET), generator=generator)
    counts = torch.zeros(len(trees), dtype=torch.long)
    for k, divided in enumerate(trees):
        nodes = tree.leaves(divided)
        nodes = nodes[torch.randperm(len(nodes), generator=generator)]  # growth leaves them in no order
        counts[k] = len(nodes)
        leaves[k, : len(nodes)] = place[nodes]
    return Forest(
        leaves=leaves,
        counts=counts,
        values=torch.where(values < 0.3, 0.0, values),
        fates=torch.randint(5, leaves.shape, generator=generator),
        requests=torch.zeros_like(leaves),
        steps=torch.zeros(len(trees), CHANNELS, dtype=torch.long),
    )


def deep() -> WeightedNodes:
    """Squares whose places are not their nodes."""
    root = torch.rand(400, generator=torch.Generator().manual_seed(9), dtype=torch.float64) + 0.1
    return WeightedNodes(NodeColumns(coarsened(FINE, 4), SIZE, columns_of(FINE, [])), root)


TREES = [random_tree(quadtree(SIZE), divisions, divisions) for divisions in (0, 1, 7, 16)]


@pytest.fixture(scope="module")
def weighted() -> WeightedNodes:
    return deep()


@pytest.fixture(scope="module")
def forest(weighted: WeightedNodes) -> Forest:
    found = planted(weighted, TREES)
    assert not torch.equal(weighted.node, torch.arange(len(weighted.node)))
    return found


def radiance(weighted: WeightedNodes, forest: Forest) -> Tensor:
    """The sum of the leaves' indicators, leaf by leaf."""
    tree = weighted.source.tree
    light = torch.zeros(len(forest.counts), CHANNELS, 3 * SIZE**2, dtype=torch.float64)
    for k, count in enumerate(forest.counts.tolist()):
        shapes = indicators(tree, weighted.node[forest.leaves[k, :count]])
        light[k] = forest.values[k, :, :count] @ shapes
    return light


def items_for(weighted: WeightedNodes, forest: Forest) -> Items:
    light = torch.stack([spotty(SIZE, k, CHANNELS) for k in range(len(forest.counts))])
    targets = observed(FINE, light, noise=0.01).samples * weighted.root
    correlations = product(targets.flatten(0, 1), weighted.columns).unflatten(0, targets.shape[:2])
    return Items(weighted, targets, correlations, torch.ones(len(targets), dtype=torch.float64))


def test_rows_are_in_use_up_to_their_count(forest: Forest) -> None:
    assert forest.counts.tolist() == [9, 12, 30, 57]
    assert torch.equal(in_use(forest).sum(dim=1), forest.counts)
    assert in_use(forest)[0].tolist() == [True] * 9 + [False] * 51


def test_radiance_of_texels_and_of_places(weighted: WeightedNodes, forest: Forest) -> None:
    light = radiance(weighted, forest)
    assert_close(on_texels(forest, weighted), light, rtol=0, atol=0)
    assert_close(
        on_places(forest, len(weighted.node)) @ weighted.unweighted(), light @ FINE.transport.T, rtol=1e-12, atol=0
    )


def test_what_is_divided_and_the_functions_of_it(weighted: WeightedNodes, forest: Forest) -> None:
    tree = weighted.source.tree
    divided = divided_nodes(forest, weighted)
    expected = torch.stack(TREES)
    assert torch.equal(divided[:, tree.supports], expected)
    assert int(divided.sum()) == int(expected.sum())
    kept = functions_in_use(tree, divided)
    assert torch.equal(kept.sum(dim=1), forest.counts)
    for k, chosen in enumerate(TREES):
        wanted = constants(tree).index_fill(0, trios(tree, chosen.nonzero()[:, 0]).reshape(-1), True)
        assert torch.equal(kept[k], wanted)


def test_harvest_is_the_light_in_its_functions_and_what_it_shows(weighted: WeightedNodes, forest: Forest) -> None:
    light = radiance(weighted, forest)
    found = harvest(items_for(weighted, forest), forest, (4, CHANNELS))
    assert_close(found.coefficients, haar.analysis(light, SIZE), rtol=0, atol=1e-14)
    assert (found.coefficients[~found.kept] == 0).all()
    assert_close(haar.synthesis(found.coefficients, SIZE), light, rtol=0, atol=1e-13)
    assert_close(found.irradiance, light @ FINE.transport.T, rtol=1e-12, atol=0)
    assert found.regions.tolist() == [[9, 9], [12, 12], [30, 30], [57, 57]]
    assert torch.equal(found.kept[:, 0], found.kept[:, 1])


def test_fates_go_down_to_what_is_not_divided(weighted: WeightedNodes, forest: Forest) -> None:
    """Walks from every support up to the leaf that holds it."""
    tree = weighted.source.tree
    found = fates_of_supports(forest, weighted, divided_nodes(forest, weighted))
    for k, chosen in enumerate(TREES):
        count = int(forest.counts[k])
        fate_of = dict(zip(weighted.node[forest.leaves[k, :count]].tolist(), forest.fates[k].tolist(), strict=False))
        for support, node in enumerate(tree.supports.tolist()):
            at = node
            while at >= 0 and at not in fate_of:
                at = int(tree.parent[at])
            expected = RESOLVED if chosen[support] else fate_of[at]
            assert int(found[k, support]) == expected


def test_what_no_sample_sees_is_unseen_and_all_within_it() -> None:
    tree, fine = quadtree(SIZE), FINE.transport.clone()
    quarter = tree.children[tree.support_of[tree.roots[8]], 1]
    hidden = indicators(tree, torch.stack([tree.roots[3], quarter]))
    fine[:, hidden.any(dim=0)] = 0.0
    transfer = type(FINE)(fine, SIZE)
    weighted = WeightedNodes(
        NodeColumns(coarsened(transfer, 4), SIZE, columns_of(transfer, [])), torch.ones(400, dtype=torch.float64)
    )
    forest = planted(weighted, [torch.zeros_like(tree.supports, dtype=torch.bool)])
    forest.fates[:] = BELOW
    forest.fates[weighted.node[forest.leaves] == tree.roots[3]] = UNSEEN
    found = fates_of_supports(forest, weighted, divided_nodes(forest, weighted))[0]
    unseen = (indicators(tree, tree.supports) @ (~hidden.any(dim=0)).double()) == 0
    known = tree.level[tree.supports] <= 2
    inside_root = indicators(tree, tree.supports) @ hidden[0] > 0
    assert (found[unseen & (known | inside_root)] == UNSEEN).all()
    assert (found[~unseen] == BELOW).all()


def test_seedlings_are_nine_bright_roots(weighted: WeightedNodes, forest: Forest) -> None:
    items = items_for(weighted, forest)
    young = seedlings(items, 20)
    assert young.counts.tolist() == [9] * 4
    assert torch.equal(young.leaves[:, :9], weighted.roots.expand(4, -1))
    assert (on_texels(young, weighted) == 1).all()
    assert young.values.shape == (4, CHANNELS, 20)


@pytest.mark.parametrize("fitted", [False, True])
def test_certificates_are_those_of_the_same_problem_on_the_columns_of_the_leaves(
    weighted: WeightedNodes, fitted: bool
) -> None:
    forest = planted(weighted, TREES, seed=3)
    items = items_for(weighted, forest)
    if fitted:
        for k in range(len(TREES)):
            fit(items, forest, k)
    shown = on_places(forest, len(weighted.node)) @ weighted.columns
    found = certificates(items, forest, shown)
    for k, count in enumerate(forest.counts.tolist()):
        matrix = weighted.unweighted()[forest.leaves[k, :count]].T.contiguous()
        system = System(matrix, weighted.root[None], items.targets[k])
        expected = nonnegative_certificate(system, forest.values[k, :, :count], RIDGE)
        assert_close(found[k, :, 0], expected.relative_residual, rtol=1e-9, atol=0)
        assert_close(found[k, :, 1], expected.kkt_residual, rtol=1e-6, atol=1e-12)
        assert_close(found[k, :, 2], expected.gap, rtol=1e-6, atol=1e-11)
        assert (found[k, :, 1] < 1e-9).all() == fitted
        assert (found[k, :, 2] < 1e-7).all() == fitted


def test_a_black_item_is_certain() -> None:
    weighted = deep()
    forest = planted(weighted, TREES[:1])
    forest.values[:] = 0.0
    targets = torch.zeros(1, CHANNELS, 400, dtype=torch.float64)
    items = Items(weighted, targets, targets.new_zeros(1, CHANNELS, len(weighted.node)), targets.new_ones(1))
    assert (certificates(items, forest, targets) == 0).all()
