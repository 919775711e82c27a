"""The squares of a plane's cube map: nine roots, each cut into four down to the texels.

Nodes follow the order of `light.haar`: root by root, within a root level by level from coarse to fine, within a level
row by row from the upper left. A node that is not a texel is the support of three wavelets.

A *tree* is a closed set of divided nodes (a divided node's parent is divided); the undivided children of divided nodes
and the undivided roots are its *leaves*. They cover the faces once, and any light that is constant on each of them has
wavelets on the divided nodes only.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchlight.light.haar import SIDE_ROOTS, check_resolution

WAVELETS = 3


@dataclass(frozen=True, eq=False)
class Quadtree:
    """Every node from the roots to the texels.

    Attributes:
        resolution: N, texels along a face's edge.
        roots: nodes that are roots.
        root_coefficients: the index of each root's scaling coefficient.
        level: a node is a square of 2^-level times the face's side.
        parent: the node that holds this one; -1 for roots.
        supports: nodes that carry wavelets: all but the texels.
        support_of: the place of a node among the supports; -1 for texels.
        children: the four quarters of every support: upper left, upper right, lower left, lower right.
        trios: the index of every support's first wavelet coefficient; the other two follow.
    """

    resolution: int
    roots: Int[Tensor, " roots"]
    root_coefficients: Int[Tensor, " roots"]
    level: Int[Tensor, " nodes"]
    parent: Int[Tensor, " nodes"]
    supports: Int[Tensor, " supports"]
    support_of: Int[Tensor, " nodes"]
    children: Int[Tensor, "supports 4"]
    trios: Int[Tensor, " supports"]

    @property
    def size(self) -> int:
        """Number of nodes."""
        return self.level.shape[0]

    def leaves(self, divided: Bool[Tensor, " supports"]) -> Int[Tensor, " leaves"]:
        """Returns the leaves of a tree in ascending order of their nodes."""
        inner = torch.zeros_like(self.level, dtype=torch.bool)
        inner[self.supports] = divided
        covered = (self.parent < 0) | inner[self.parent.clamp(min=0)]
        return (covered & ~inner).nonzero()[:, 0]


@functools.cache
def quadtree(resolution: int, *, device: torch.device | str = "cpu") -> Quadtree:
    """Returns all nodes for an N x N cube map.

    Raises:
        ConfigError: N is not a power of two from 2.
    """
    check_resolution(resolution)
    sides = [resolution // 2] * SIDE_ROOTS + [resolution]
    parts: dict[str, list[Tensor]] = {name: [] for name in ("level", "parent", "supports", "children", "trios")}
    roots, coefficients = [], []
    node, coefficient = 0, 0
    for side in sides:
        level, parent, children = _block(side)
        inner = children.shape[0]
        roots.append(node)
        coefficients.append(coefficient)
        parts["level"].append(level + (resolution // side).bit_length() - 1)
        parts["parent"].append(torch.where(parent < 0, parent, parent + node))
        parts["supports"].append(node + torch.arange(inner))
        parts["children"].append(children + node)
        parts["trios"].append(coefficient + 1 + WAVELETS * torch.arange(inner))
        node, coefficient = node + level.shape[0], coefficient + side**2
    joined = {name: torch.cat(tensors).to(device) for name, tensors in parts.items()}
    support_of = torch.full_like(joined["level"], -1)
    support_of[joined["supports"]] = torch.arange(joined["supports"].shape[0], device=device)
    return Quadtree(
        resolution=resolution,
        roots=torch.tensor(roots, device=device),
        root_coefficients=torch.tensor(coefficients, device=device),
        support_of=support_of,
        **joined,
    )


def _block(side: int) -> tuple[Int[Tensor, " nodes"], Int[Tensor, " nodes"], Int[Tensor, "inner 4"]]:
    """Returns (level, parent, children) within one root of side^2 texels."""
    levels, parents, children = [], [], []
    depth = side.bit_length() - 1
    for level in range(depth + 1):
        width, start = 2**level, (4**level - 1) // 3
        index = torch.arange(width**2)
        row, column = index // width, index % width
        levels.append(torch.full_like(index, level))
        above = (4 ** (level - 1) - 1) // 3 if level else 0
        parents.append(above + row // 2 * (width // 2) + column // 2 if level else torch.full_like(index, -1))
        if level < depth:
            first = start + width**2 + 4 * row * width + 2 * column
            children.append(torch.stack([first, first + 1, first + 2 * width, first + 2 * width + 1], dim=-1))
    inner = torch.cat(children) if children else torch.zeros(0, 4, dtype=torch.int64)
    return torch.cat(levels), torch.cat(parents), inner


def pyramid(texels: Float[Tensor, "*batch texels"], resolution: int) -> Float[Tensor, "*batch nodes"]:
    """Returns the sum over the texels of every node: columns of nodes from columns of texels."""
    half = resolution // 2
    sides = texels[..., : SIDE_ROOTS * half**2].unflatten(-1, (4, half, 2, half)).movedim(-2, -3)
    top = texels[..., SIDE_ROOTS * half**2 :].unflatten(-1, (resolution, resolution))
    return torch.cat([_block_sums(sides).flatten(start_dim=-3), _block_sums(top)], dim=-1)


def _block_sums(values: Float[Tensor, "*batch side side"]) -> Float[Tensor, "*batch nodes"]:
    sums = [values.flatten(start_dim=-2)]
    while values.shape[-1] > 1:
        rows = values[..., 0::2, :] + values[..., 1::2, :]
        values = rows[..., 0::2] + rows[..., 1::2]
        sums.append(values.flatten(start_dim=-2))
    return torch.cat(sums[::-1], dim=-1)


def spread(values: Float[Tensor, "*batch nodes"], resolution: int) -> Float[Tensor, "*batch texels"]:
    """Returns for every texel the sum of the values of the nodes that hold it; the transpose of `pyramid`."""
    half = resolution // 2
    per_side = (4 * half**2 - 1) // 3
    sides = _block_spread(values[..., : SIDE_ROOTS * per_side].unflatten(-1, (4, 2, per_side)), half)
    top = _block_spread(values[..., SIDE_ROOTS * per_side :], resolution)
    return torch.cat([sides.movedim(-3, -2).flatten(start_dim=-4), top.flatten(start_dim=-2)], dim=-1)


def _block_spread(values: Float[Tensor, "*batch nodes"], side: int) -> Float[Tensor, "*batch {side} {side}"]:
    result = values[..., :1, None]
    start, width = 1, 2
    while width <= side:
        own = values[..., start : start + width**2].unflatten(-1, (width, width))
        result = own + result.repeat_interleave(2, dim=-1).repeat_interleave(2, dim=-2)
        start, width = start + width**2, 2 * width
    return result


def indicators(tree: Quadtree, nodes: Int[Tensor, " leaves"]) -> Float[Tensor, "leaves texels"]:
    """Returns 1 at the texels of each node, 0 elsewhere, in float64."""
    chosen = torch.zeros(nodes.shape[0], tree.size, dtype=torch.float64, device=nodes.device)
    chosen[torch.arange(nodes.shape[0], device=nodes.device), nodes] = 1.0
    return spread(chosen, tree.resolution)


def within(coarse: Quadtree, fine: Quadtree) -> Int[Tensor, " nodes"]:
    """Returns the node of the finer tree that is the same square, for every node of the coarser."""
    sizes = torch.diff(torch.cat([coarse.roots, coarse.roots.new_tensor([coarse.size])]))
    return torch.arange(coarse.size, device=coarse.level.device) + (fine.roots - coarse.roots).repeat_interleave(sizes)


def squares(tree: Quadtree, nodes: Int[Tensor, " k"]) -> Int[Tensor, "k 4"]:
    """Returns face, level, row and column of nodes: a square of 2^-level times the side of its face.

    Rows count from the top and columns from the left of the whole face, as texels do.
    """
    root = torch.searchsorted(tree.roots, nodes, right=True) - 1
    side = root < SIDE_ROOTS
    depth = tree.level[nodes] - side.long()
    place = nodes - tree.roots[root] - (4**depth - 1) // 3
    row, column = place // 2**depth, place % 2**depth
    column = column + torch.where(side, root % 2, 0) * 2**depth
    return torch.stack([root // 2, tree.level[nodes], row, column], dim=-1)


def texel_nodes(tree: Quadtree) -> Int[Tensor, " texels"]:
    """Returns the node that is each texel of the finest level, in the order of texels."""
    number = torch.arange(tree.size, dtype=torch.float64, device=tree.level.device)
    return spread(torch.where(tree.support_of < 0, number, 0.0), tree.resolution).long()
