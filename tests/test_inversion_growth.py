"""The compiled growth and its twins in torch, item by item and in lockstep: the same leaves, fates and radiance."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from shadows import block_transfer, coarsened, columns_of, items_of, observed, patchy, seeing_each_texel, spotty, whole
from torch import Tensor
from torch.testing import assert_close

from torchlight.inversion import gain, growth, lockstep
from torchlight.inversion.forest import Forest, Items, in_use, on_places
from torchlight.inversion.gain import ProjectedGain
from torchlight.inversion.growth import Pace
from torchlight.inversion.nodes import NodeColumns
from torchlight.inversion.quadtree import indicators, quadtree
from torchlight.inversion.refinement import Bounds, Fate
from torchlight.photo.observation import Observation
from torchlight.transfer import Transfer

BOUNDS = Bounds(budget=60, condition_limit=10.0)
PACE = Pace(ProjectedGain().threshold, ProjectedGain().share, BOUNDS.budget + ProjectedGain().spare)


def one_texel_sun(resolution: int) -> Tensor:
    light = torch.full((3, 3 * resolution**2), 0.1, dtype=torch.float64)
    light[:, 2 * resolution**2 + resolution + 2] = 500.0
    return light


def with_a_dark_channel(resolution: int) -> Tensor:
    light = patchy(resolution, 1, 3)
    light[1] = 0.0
    return light


LIGHTS: dict[str, Callable[[int], Tensor]] = {
    "spotty": lambda resolution: spotty(resolution, 3, 3),
    "patchy": lambda resolution: patchy(resolution, 4, 3),
    "a dark channel": with_a_dark_channel,
    "a sun of one texel": one_texel_sun,
    "noise only": lambda resolution: torch.zeros(3, 3 * resolution**2, dtype=torch.float64),
}


def photographed(transfer: Transfer, name: str) -> Observation:
    light = LIGHTS[name](transfer.resolution)
    photo = observed(transfer, light, noise=0.002)
    photo.samples[light.amax(dim=1) == 0] = 0.0
    if name == "noise only":
        photo.samples.normal_(generator=torch.Generator().manual_seed(1))
    return photo


Grown = tuple[Items, Forest]
Both = Callable[..., tuple[Grown, Grown]]
TWINS = {"item by item": growth.grow, "in lockstep": lockstep.grow}


@pytest.fixture(params=TWINS)
def both(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Both:
    """Grows by the kernel and by a twin."""

    def grown(make: Callable[[], Items], bounds: Bounds = BOUNDS, pace: Pace = PACE) -> tuple[Grown, Grown]:
        kernel = gain.grow(make(), pace, bounds)
        with monkeypatch.context() as patch:
            patch.setattr(gain, "grow_compiled", TWINS[request.param])
            return kernel, gain.grow(make(), pace, bounds)

    return grown


def assert_same(kernel: Grown, twin: Grown) -> None:
    """Leaves, fates and radiance, in the same order."""
    (items, ours), (_, theirs) = kernel, twin
    assert torch.equal(ours.counts, theirs.counts)
    used = in_use(ours)
    assert torch.equal(torch.where(used, ours.leaves, 0), torch.where(used, theirs.leaves, 0))
    assert torch.equal(torch.where(used, ours.fates, 0), torch.where(used, theirs.fates, 0))
    assert torch.equal(ours.requests, theirs.requests)
    left, right = (on_places(forest, items.weighted.node.shape[0]) for forest in (ours, theirs))
    assert_close(left, right, rtol=1e-8, atol=1e-8 * float(right.max()))
    assert_same_picture(kernel, twin)


def assert_same_picture(kernel: Grown, twin: Grown) -> None:
    """As many leaves, and the same samples under their light."""
    (items, ours), (others, theirs) = kernel, twin
    assert torch.equal(ours.counts, theirs.counts)
    shown = [on_places(forest, items.weighted.node.shape[0]) @ items.weighted.columns for forest in (ours, theirs)]
    assert_close(shown[0], shown[1], rtol=0, atol=1e-9 * float(others.targets.abs().max()))


@pytest.mark.parametrize("shared", [False, True])
@pytest.mark.parametrize("name", LIGHTS)
def test_kernel_and_twin_grow_the_same_trees(name: str, shared: bool, both: Both) -> None:
    transfer = block_transfer(8)
    photo = photographed(transfer, name)
    kernel, twin = both(lambda: items_of(whole(transfer), photo, shared=shared))
    assert_same(kernel, twin)
    counts = kernel[1].counts
    assert counts.shape == (1 if shared else 3,)
    assert int(counts.max()) > (9 if name == "noise only" else 15)
    if name == "a dark channel" and not shared:
        assert counts[1] == 9
        assert (kernel[1].values[1] == 0).all()


def test_the_same_where_steps_are_long(both: Both) -> None:
    """Several divisions between two fits, in their order of gain."""
    transfer = block_transfer(8)
    photo = observed(transfer, spotty(8, 5, 2), noise=0.002)
    pace = Pace(threshold=1.0, share=1.0, room=130)
    kernel, twin = both(lambda: items_of(whole(transfer), photo), Bounds(100, 1e4), pace)
    assert_same(kernel, twin)
    assert (kernel[1].steps < 400).all()


def test_the_same_with_squares_that_no_sample_sees(both: Both) -> None:
    transfer = block_transfer(8)
    tree, matrix = quadtree(8), transfer.transport.clone()
    for node in (tree.roots[2], tree.children[40, 3]):
        matrix[:, indicators(tree, node[None])[0] > 0] = 0.0
    hidden = Transfer(matrix, 8)
    photo = observed(hidden, spotty(8, 6, 3), noise=0.002)
    kernel, twin = both(lambda: items_of(whole(hidden), photo, noise=1e-5))
    assert_same(kernel, twin)
    assert (kernel[1].fates[:, 2] == Fate.UNSEEN).all()
    assert (kernel[1].values[..., 2] == 0).all()


def test_the_same_with_columns_that_depend_on_each_other(both: Both) -> None:
    """Quarters that no sample tells apart."""
    plain = seeing_each_texel(8)
    tree, matrix = quadtree(8), plain.transport.clone()
    texels = indicators(tree, tree.children[40]) > 0
    first, second = (matrix[:, texels[k]].mean(dim=1, keepdim=True) for k in (0, 1))
    matrix[:, texels[0]] = first
    matrix[:, texels[1]] = second
    alike = Transfer(matrix, 8)
    photo = observed(alike, patchy(8, 7, 3), noise=0.002)
    kernel, twin = both(lambda: items_of(whole(alike), photo))
    assert_same(kernel, twin)
    assert (kernel[1].fates == Fate.ILL_CONDITIONED).any()


def test_the_same_picture_where_two_roots_look_the_same(both: Both) -> None:
    """Only their sum is determined; which of them takes the light is left to rounding."""
    plain = seeing_each_texel(8)
    tree, matrix = quadtree(8), plain.transport.clone()
    matrix[:, indicators(tree, tree.roots[1:2])[0] > 0] = matrix[:, indicators(tree, tree.roots[:1])[0] > 0]
    twins = Transfer(matrix, 8)
    photo = observed(twins, patchy(8, 7, 3), noise=0.002)
    kernel, twin = both(lambda: items_of(whole(twins), photo))
    assert_same_picture(kernel, twin)


def test_the_same_when_quarters_are_cast_on_demand(both: Both) -> None:
    fine = block_transfer(16)
    photo = observed(fine, torch.cat([patchy(16, 8, 2), spotty(16, 8, 1)]), noise=0.002)
    kernel, twin = both(lambda: items_of(NodeColumns(coarsened(fine, 4), 16, columns_of(fine, [])), photo))
    assert_same(kernel, twin)
    assert kernel[0].weighted.node.shape[0] > kernel[0].weighted.source.coarse.size
    assert torch.equal(kernel[0].weighted.node, twin[0].weighted.node)


def test_photographs_of_a_group_grow_as_they_do_alone(both: Both) -> None:
    transfer = block_transfer(8)
    light = torch.stack([spotty(8, 1, 2), patchy(8, 2, 2)])
    photo = observed(transfer, light, noise=0.002)
    batch, _ = both(lambda: items_of(whole(transfer), photo))
    for k in range(2):
        alone = gain.grow(items_of(whole(transfer), Observation(photo.samples[k], photo.weights[k])), PACE, BOUNDS)
        part = slice(2 * k, 2 * k + 2)
        assert torch.equal(batch[1].counts[part], alone[1].counts)
        assert torch.equal(batch[1].leaves[part], alone[1].leaves)
        assert_close(batch[1].values[part], alone[1].values, rtol=1e-8, atol=1e-8)
