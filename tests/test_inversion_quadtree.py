"""The quadtree against the Haar transform and against geometry written out anew."""

from __future__ import annotations

import pytest
import torch
from torch.testing import assert_close

from torchlight.errors import ConfigError
from torchlight.inversion.quadtree import indicators, pyramid, quadtree, spread, squares, texel_nodes, within
from torchlight.light import cubemap, haar


@pytest.mark.parametrize("resolution", [2, 4, 8])
def test_nodes_are_the_supports_of_the_haar_functions(resolution: int) -> None:
    """The square of a wavelet is constant on its support and 0 elsewhere: so are the indicators of its node."""
    tree = quadtree(resolution)
    synthesis = haar.synthesis(torch.eye(3 * resolution**2, dtype=torch.float64), resolution)
    for wavelet in range(3):
        squares = synthesis[tree.trios + wavelet].square()
        heights = 4.0 ** tree.level[tree.supports]
        assert_close(squares / heights[:, None], indicators(tree, tree.supports), rtol=0, atol=1e-14)
    squares = synthesis[tree.root_coefficients].square()
    heights = 4.0 ** tree.level[tree.roots]
    assert_close(squares / heights[:, None], indicators(tree, tree.roots), rtol=0, atol=1e-14)


def test_children_are_the_quarters_in_reading_order() -> None:
    """The wavelets themselves say which quarter is left, right, upper and lower."""
    tree = quadtree(8)
    synthesis = haar.synthesis(torch.eye(192, dtype=torch.float64), 8)
    signs = torch.tensor([[1, -1, 1, -1], [1, 1, -1, -1], [1, -1, -1, 1]], dtype=torch.float64)
    for support in range(tree.supports.shape[0]):
        quarters = indicators(tree, tree.children[support])
        height = 2.0 ** int(tree.level[tree.supports[support]])
        trio = synthesis[tree.trios[support] : tree.trios[support] + 3]
        assert_close(height * signs @ quarters, trio, rtol=0, atol=1e-13)
        assert torch.equal(tree.parent[tree.children[support]], tree.supports[support].expand(4))
        assert (tree.level[tree.children[support]] == tree.level[tree.supports[support]] + 1).all()


@pytest.mark.parametrize("resolution", [2, 4, 16])
def test_spread_is_the_transpose_of_pyramid(resolution: int) -> None:
    generator = torch.Generator().manual_seed(1)
    tree = quadtree(resolution)
    nodes = torch.randn(3, tree.size, generator=generator, dtype=torch.float64)
    texels = torch.randn(3, 3 * resolution**2, generator=generator, dtype=torch.float64)
    left = (pyramid(texels, resolution) * nodes).sum(dim=-1)
    assert_close(left, (texels * spread(nodes, resolution)).sum(dim=-1))


def test_leaves_of_any_tree_cover_every_texel_once() -> None:
    generator = torch.Generator().manual_seed(2)
    tree = quadtree(8)
    for _ in range(20):
        divided = torch.zeros_like(tree.supports, dtype=torch.bool)
        for _ in range(10):
            leaves = tree.support_of[tree.leaves(divided)]
            leaves = leaves[leaves >= 0]
            divided[leaves[torch.randint(leaves.shape[0], (1,), generator=generator)]] = True
        covered = indicators(tree, tree.leaves(divided))
        assert torch.equal(covered.sum(dim=0), torch.ones(192, dtype=torch.float64))
        assert covered.shape[0] == 9 + 3 * 10


def test_sizes() -> None:
    tree = quadtree(16)
    assert (tree.size, tree.supports.shape[0], tree.roots.shape[0]) == (1021, 253, 9)
    with pytest.raises(ConfigError, match="power of two"):
        quadtree(12)


@pytest.mark.parametrize("resolution", [2, 4, 8, 16])
def test_texel_nodes_are_the_nodes_of_single_texels_in_their_order(resolution: int) -> None:
    tree = quadtree(resolution)
    nodes = texel_nodes(tree)
    assert torch.equal(indicators(tree, nodes), torch.eye(3 * resolution**2, dtype=torch.float64))
    assert (tree.support_of[nodes] < 0).all()


@pytest.mark.parametrize("resolution", [2, 4, 16])
def test_squares_of_texels_are_where_the_cube_map_has_them(resolution: int) -> None:
    """As (face, level, row, column), and as rectangles on their faces."""
    tree = quadtree(resolution)
    found = squares(tree, texel_nodes(tree))
    index = cubemap.visible_texels(resolution)
    depth = torch.full_like(index, resolution.bit_length() - 1)
    row, column = index // resolution % resolution, index % resolution
    assert torch.equal(found, torch.stack([index // resolution**2, depth, row, column], dim=-1))
    assert_same_cells(cubemap.square_cells(found), cubemap.texel_cells(resolution))


def assert_same_cells(found: cubemap.Cells, texels: cubemap.Cells) -> None:
    for name in ("face", "left", "right", "bottom", "top"):
        assert_close(getattr(found, name), getattr(texels, name)[:, 0], rtol=0, atol=1e-15)


def test_squares_enclose_exactly_the_texels_of_their_node() -> None:
    """A texel whose middle lies in the rectangle of a node belongs to it, and no other."""
    tree = quadtree(8)
    places = squares(tree, torch.arange(tree.size))
    cells, texels = cubemap.square_cells(places), cubemap.texel_cells(8)
    u, v = (texels.left + texels.right)[:, 0] / 2, (texels.bottom + texels.top)[:, 0] / 2
    inside = texels.face[:, 0] == cells.face[:, None]
    inside &= (cells.left[:, None] < u) & (u < cells.right[:, None])
    inside &= (cells.bottom[:, None] < v) & (v < cells.top[:, None])
    assert torch.equal(inside.double(), indicators(tree, torch.arange(tree.size)))
    roots = places[tree.roots].tolist()
    assert roots == [[face, 1, 0, column] for face in range(4) for column in (0, 1)] + [[4, 0, 0, 0]]


@pytest.mark.parametrize(("coarse", "fine"), [(2, 2), (2, 4), (4, 16), (8, 512)])
def test_a_square_of_a_coarse_tree_is_the_same_in_a_finer_one(coarse: int, fine: int) -> None:
    small, large = quadtree(coarse), quadtree(fine)
    nodes = within(small, large)
    everything = torch.arange(small.size)
    assert torch.equal(squares(small, everything), squares(large, nodes))
    assert torch.equal(nodes[small.children], large.children[large.support_of[nodes[small.supports]]])
    assert len(nodes.unique()) == small.size
