"""The quadtree against the Haar transform and against geometry written out anew."""

from __future__ import annotations

import pytest
import torch
from torch.testing import assert_close

from torchlight.errors import ConfigError
from torchlight.inversion.quadtree import indicators, pyramid, quadtree, spread
from torchlight.light import haar


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
