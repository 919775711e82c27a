"""Small transports and lights for the adaptive method: what the tests of `torchlight.inversion` solve."""

from __future__ import annotations

from functools import cache

import torch
from torch import Tensor

from torchlight.geometry.analytic_shadow import Block
from torchlight.geometry.receiver import Receiver
from torchlight.inversion.forest import Items
from torchlight.inversion.gain import seeds
from torchlight.inversion.nodes import Cast, NodeColumns, WeightedNodes
from torchlight.inversion.outcome import Group
from torchlight.inversion.quadtree import indicators, pyramid, quadtree, squares, texel_nodes, within
from torchlight.photo.observation import Observation
from torchlight.synthetic import block_scene
from torchlight.transfer import Transfer, transport

BLOCK = Block((1.0, 0.6, 1.2), 20.0, (0.3, -0.2))
RECEIVER = Receiver((0.0, 0.0), (4.0, 4.0), (20, 20))


@cache
def block_transfer(resolution: int, directions: int = 32) -> Transfer:
    """Returns the transport of a block on 20 x 20 samples, float64, by so many directions along a face's edge."""
    return transport(block_scene(BLOCK, RECEIVER), resolution, directions // resolution).to(dtype=torch.float64)


def coarsened(transfer: Transfer, resolution: int) -> Transfer:
    """Returns the transport of larger texels, each the sum of those within it."""
    fine, coarse = quadtree(transfer.resolution), quadtree(resolution)
    nodes = within(coarse, fine)[texel_nodes(coarse)]
    return Transfer(pyramid(transfer.transport, transfer.resolution)[:, nodes].contiguous(), resolution)


def seeing_each_texel(resolution: int) -> Transfer:
    """Returns one sample per texel: the light itself is photographed."""
    return Transfer(torch.eye(3 * resolution**2, dtype=torch.float64), resolution)


def spotty(resolution: int, seed: int, items: int = 1) -> Tensor:
    """Returns heavy-tailed light."""
    generator = torch.Generator().manual_seed(seed)
    return torch.exp(2 * torch.randn(items, 3 * resolution**2, generator=generator, dtype=torch.float64))


def patchy(resolution: int, seed: int, items: int = 1) -> Tensor:
    """Returns a few bright squares of several sizes on a dim sky."""
    generator = torch.Generator().manual_seed(seed)
    tree = quadtree(resolution)
    light = torch.full((items, 3 * resolution**2), 0.3, dtype=torch.float64)
    for item in range(items):
        for node in torch.randint(tree.size, (3,), generator=generator):
            light[item] += indicators(tree, node[None])[0] * 4.0 ** int(tree.level[node])
    return light


def observed(transfer: Transfer, light: Tensor, noise: float = 0.0, seed: int = 0) -> Observation:
    """Returns the samples under texel radiance, with noise as a share of the brightest."""
    values = light @ transfer.transport.T
    generator = torch.Generator().manual_seed(seed)
    values = values + noise * values.max() * torch.randn(values.shape, generator=generator, dtype=torch.float64)
    return Observation(values, torch.ones(*values.shape[:-2], values.shape[-1], dtype=torch.float64))


def columns_of(fine: Transfer, asked: list[Tensor]) -> Cast:
    """Returns what casts squares by looking them up in a finer transport; `asked` collects them."""
    tree = quadtree(fine.resolution)
    columns = pyramid(fine.transport, fine.resolution).T
    node = {tuple(square): k for k, square in enumerate(squares(tree, torch.arange(tree.size)).tolist())}

    def cast(wanted: Tensor, cells: int) -> Tensor:
        assert cells >= 4
        asked.append(wanted)
        return columns[[node[tuple(square)] for square in wanted.tolist()]]

    return cast


def whole(transfer: Transfer) -> NodeColumns:
    """Returns all squares of a transport."""
    return NodeColumns(transfer, transfer.resolution)


def items_of(nodes: NodeColumns, observation: Observation, noise: float = 0.002, shared: bool = False) -> Items:
    """Returns the items of one photograph, or of several of equal weights: one per channel, or per photograph."""
    samples = observation.samples.reshape(-1, *observation.samples.shape[-2:])
    brightest = samples.amax(dim=(1, 2))
    sigmas = torch.where(brightest > 0, noise * brightest, 1.0)
    group = Group(WeightedNodes(nodes, torch.ones(nodes.points, dtype=torch.float64)), samples, sigmas)
    trees = samples.shape[0] if shared else samples.shape[0] * samples.shape[1]
    return seeds(group, group.targets.reshape(trees, -1, nodes.points))
