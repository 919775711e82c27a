"""Columns of squares: on demand the same as from a dense transport, cast once, and only where asked for."""

from __future__ import annotations

import pytest
import torch
from shadows import block_transfer, coarsened, columns_of, observed, patchy, seeing_each_texel, spotty
from torch import Tensor
from torch.testing import assert_close

from torchlight.errors import ShapeError
from torchlight.inversion import nodes as module
from torchlight.inversion.adaptive import AdaptiveHaar, AdaptiveSolution, solve_adaptive
from torchlight.inversion.gain import ProjectedGain
from torchlight.inversion.nodes import TEXEL, UNKNOWN, NodeColumns, WeightedNodes, own_product, product
from torchlight.inversion.quadtree import pyramid, quadtree, squares, within
from torchlight.photo.observation import Observation
from torchlight.transfer import Transfer

FINE = 32
SETTINGS = AdaptiveHaar(FINE, 120, noise=0.002)


def sunny(seed: int) -> Tensor:
    """Three channels of a few bright squares, one of them a texel, and a spotty sky."""
    light = patchy(FINE, seed, 3) + 0.05 * spotty(FINE, seed, 3)
    light[:, 2 * FINE**2 + 100 + 7 * seed] += 3000.0
    return light


def photographs(count: int) -> Observation:
    return observed(block_transfer(FINE), torch.stack([sunny(seed) for seed in range(count)]), noise=0.002)


def on_demand(coarse: int) -> tuple[NodeColumns, list[Tensor]]:
    asked: list[Tensor] = []
    fine = block_transfer(FINE)
    return NodeColumns(coarsened(fine, coarse), FINE, columns_of(fine, asked)), asked


def cast_squares(asked: list[Tensor]) -> list[tuple[int, ...]]:
    return [tuple(square) for part in asked for square in part.tolist()]


def assert_same(found: AdaptiveSolution, expected: AdaptiveSolution) -> None:
    assert torch.equal(found.refinement.kept, expected.refinement.kept)
    assert torch.equal(found.refinement.fate, expected.refinement.fate)
    assert torch.equal(found.refinement.regions, expected.refinement.regions)
    largest = expected.solution.coefficients.abs().amax(dim=-1, keepdim=True)
    assert ((found.solution.coefficients - expected.solution.coefficients).abs() <= 1e-9 * largest).all()
    assert_close(found.irradiance, expected.irradiance, rtol=1e-9, atol=0)


@pytest.fixture(scope="module")
def dense() -> AdaptiveSolution:
    found = solve_adaptive(block_transfer(FINE), photographs(2), SETTINGS)
    finest = found.solution.coefficients[..., -3 * (FINE // 2) ** 2 :]  # of the top face
    assert (finest != 0).any(dim=-1).all()
    return found


@pytest.mark.parametrize("coarse", [4, 8, 16])
def test_on_demand_equals_dense(dense: AdaptiveSolution, coarse: int) -> None:
    nodes, asked = on_demand(coarse)
    assert_same(solve_adaptive(nodes, photographs(2), SETTINGS), dense)
    wanted = cast_squares(asked)
    assert len(set(wanted)) == len(wanted) == nodes.kept
    assert 0 < len(wanted) < (3 * FINE**2) // 3
    assert all(2**level > coarse for _, level, _, _ in wanted)
    quartets = {(face, level, row // 2, column // 2) for face, level, row, column in wanted}
    assert 4 * len(quartets) == len(wanted)
    parents = {(face, level - 1, row, column) for face, level, row, column in quartets}
    assert all(2 ** square[1] == coarse or square in set(wanted) for square in parents)


def test_what_was_cast_serves_the_photographs_that_follow(dense: AdaptiveSolution) -> None:
    nodes, asked = on_demand(8)
    photos = photographs(2)
    for k in (0, 1, 0):
        alone = solve_adaptive(nodes, Observation(photos.samples[k], photos.weights[k]), SETTINGS)
        assert torch.equal(alone.refinement.kept, dense.refinement.kept[k])
    before = len(asked)
    assert before > 0
    solve_adaptive(nodes, photos, SETTINGS)
    assert len(asked) == before
    assert len(set(cast_squares(asked))) == nodes.kept == sum(len(part) for part in asked)


def test_uniform_light_casts_nothing_and_a_dark_sky_nothing_deep() -> None:
    nodes, asked = on_demand(8)
    fine = block_transfer(FINE)
    solve_adaptive(nodes, observed(fine, torch.ones(3, 3 * FINE**2, dtype=torch.float64)), SETTINGS)
    assert asked == []
    sun = torch.zeros(3, 3 * FINE**2, dtype=torch.float64)
    sun[:, 2 * FINE**2 + 5 * FINE + 9] = 1e4
    solve_adaptive(nodes, observed(fine, sun, noise=0.002), SETTINGS)
    deepest = [square for square in cast_squares(asked) if 2 ** square[1] == FINE]
    assert 0 < len(deepest) <= 4 * 9
    assert all(face == 4 and abs(row - 5) <= 3 and abs(column - 9) <= 3 for face, _, row, column in deepest)


@pytest.mark.parametrize("kept", [1, 40])
def test_what_does_not_fit_is_cast_again(dense: AdaptiveSolution, monkeypatch: pytest.MonkeyPatch, kept: int) -> None:
    monkeypatch.setattr(module, "MAX_KEPT", 400 * kept)
    nodes, asked = on_demand(8)
    assert_same(solve_adaptive(nodes, photographs(2), SETTINGS), dense)
    wanted = cast_squares(asked)
    assert len(set(wanted)) < len(wanted)


def test_columns_are_those_of_the_squares_whatever_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    fine = block_transfer(FINE)
    tree = quadtree(FINE)
    expected = pyramid(fine.transport, FINE).T
    nodes, _ = on_demand(8)
    deeper = (2**tree.level > 8).nonzero()[:, 0]
    generator = torch.Generator().manual_seed(0)
    monkeypatch.setattr(module, "MAX_KEPT", 400 * 25)
    for _ in range(20):
        wanted = deeper[torch.randperm(len(deeper), generator=generator)[:11]]
        assert torch.equal(nodes.finer(wanted), expected[wanted])
        assert nodes.kept <= 25


def test_few_directions_per_deep_square_and_many_per_large_one() -> None:
    cells_of: dict[int, int] = {}

    def cast(wanted: Tensor, cells: int) -> Tensor:
        (level,) = {int(square[1]) for square in wanted}
        cells_of[level] = cells
        return torch.zeros(len(wanted), 48, dtype=torch.float64)

    nodes = NodeColumns(seeing_each_texel(4), 512, cast)
    nodes.finer(torch.cat([(nodes.tree.level == level).nonzero()[:2, 0] for level in range(3, 10)]))
    assert cells_of == {3: 24, 4: 12, 5: 6, 6: 4, 7: 4, 8: 4, 9: 4}


def test_places_never_change_and_the_gram_matrix_grows_with_them() -> None:
    fine = block_transfer(16)
    nodes = NodeColumns(coarsened(fine, 4), 16, columns_of(fine, []))
    root = torch.rand(400, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    weighted = WeightedNodes(nodes, root)
    tree, coarse = quadtree(16), quadtree(4)
    assert torch.equal(weighted.node, within(coarse, tree))
    leaves = (weighted.children[:, 0] == UNKNOWN).nonzero()[:, 0]
    assert torch.equal(coarse.level[leaves], torch.full_like(leaves, 2))
    first = weighted.divide(leaves[[5, 3, 5]])
    assert first.shape == (8, 400)
    assert weighted.divide(leaves[[3]]).shape == (0, 400)
    quarters = weighted.children[leaves[3]]
    assert torch.equal(weighted.node[quarters], tree.children[tree.support_of[weighted.node[leaves[3]]]])
    weighted.divide(quarters)
    assert (weighted.children[weighted.children[quarters[0]]] == TEXEL).all()
    expected = pyramid(fine.transport, 16).T[weighted.node]
    assert_close(weighted.columns, expected * root, rtol=1e-14, atol=0)
    assert_close(weighted.gram, weighted.columns @ weighted.columns.T, rtol=1e-12, atol=0)
    assert_close(weighted.unweighted(), expected, rtol=1e-14, atol=0)
    room = weighted.gram_and_room
    assert room.is_contiguous()
    assert torch.equal(room[: len(expected), : len(expected)], weighted.gram)


def test_squares_go_to_what_casts_them_as_face_level_row_column() -> None:
    nodes, asked = on_demand(16)
    finest = (nodes.tree.level == 5).nonzero()[:3, 0]
    nodes.finer(finest)
    assert torch.equal(asked[0], squares(nodes.tree, finest))


def test_products_are_the_same_to_the_bit_on_any_number_of_threads() -> None:
    generator = torch.Generator().manual_seed(0)
    left, right = (torch.randn(n, 400, generator=generator, dtype=torch.float64) for n in (700, 300))
    before = torch.get_num_threads()
    results, own = [], []
    try:
        for count in (1, 2):
            torch.set_num_threads(count)
            results.append(product(left, right))
            own.append(own_product(left))
            assert torch.get_num_threads() == count
    finally:
        torch.set_num_threads(before)
    assert torch.equal(results[0], results[1])
    assert torch.equal(own[0], own[1])
    assert torch.equal(own[0], own[0].T)
    assert_close(own[0], left @ left.T, rtol=1e-12, atol=1e-12)
    assert_close(results[0], left @ right.T, rtol=1e-12, atol=1e-12)
    assert product(left[:0], right).shape == (0, 300)


def test_a_transport_that_does_not_fit_the_tree_is_refused() -> None:
    with pytest.raises(ShapeError, match="max_resolution is 4, the transport's 8"):
        NodeColumns(seeing_each_texel(8), 4, columns_of(seeing_each_texel(8), []))
    with pytest.raises(ShapeError, match="max_resolution is 16, the transport's 8"):
        NodeColumns(seeing_each_texel(8), 16)
    nodes = NodeColumns(Transfer(torch.ones(3, 48), 4), 4)
    with pytest.raises(ShapeError, match="max_resolution is 8, the columns' 4"):
        solve_adaptive(nodes, observed(seeing_each_texel(4), patchy(4, 0)), AdaptiveHaar(8, rule=ProjectedGain()))


def test_the_gram_matrix_is_made_once_for_equal_weights(monkeypatch: pytest.MonkeyPatch) -> None:
    source = NodeColumns(block_transfer(8), 8)
    made: list[int] = []

    def counted(rows: Tensor) -> Tensor:
        made.append(len(rows))
        return own_product(rows)

    monkeypatch.setattr(module, "own_product", counted)
    first, second = torch.ones(source.points, dtype=torch.float64), torch.ones(source.points, dtype=torch.float64)
    assert_close(WeightedNodes(source, first).gram, source.dense @ source.dense.T)
    before = len(made)
    again = WeightedNodes(source, second)
    assert len(made) == before
    second = torch.linspace(0.5, 1.0, source.points, dtype=torch.float64)
    other = WeightedNodes(source, second)
    assert len(made) == before + 1
    assert_close(other.gram, other.columns @ other.columns.T)
    assert not torch.equal(other.gram, again.gram)
