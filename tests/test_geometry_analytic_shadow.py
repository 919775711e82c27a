"""The block's shadow in closed form, against a slab test written on its own, and its special directions."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

from torchlight.geometry.analytic_shadow import (
    Block,
    block_irradiance,
    interval_coverage,
    line_positions,
    shadow_coverage,
    shadow_intervals,
)
from torchlight.geometry.receiver import Receiver

RECEIVER = Receiver((0.1, -0.05), (4.0, 3.0), (8, 6))
BLOCK = Block((1.0, 0.6, 1.2), 20.0, (0.3, -0.2))


def vectors(*rows: tuple[float, float, float]) -> Tensor:
    return torch.nn.functional.normalize(torch.tensor(rows, dtype=torch.float64), dim=-1)


DIRECTIONS = vectors((0.3, -0.5, 0.8), (-0.7, 0.2, 0.4), (0.1, 0.9, 0.6), (-0.2, -0.3, 1.0), (0.9, 0.1, 0.15))


def slab_hidden(block: Block, points: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Whether the ray from each plane point meets the block, axis by axis in the block's own frame."""
    turn = math.radians(block.rotation_degrees)
    into = np.array([[math.cos(turn), math.sin(turn), 0], [-math.sin(turn), math.cos(turn), 0], [0, 0, 1]])
    half = np.array(block.size) / 2
    origin = (points - np.array([*block.translation, half[2]])) @ into.T
    first, last = np.zeros(len(points)), np.full(len(points), np.inf)
    for axis, step in enumerate(into @ direction):
        if step == 0:
            last = np.where(np.abs(origin[:, axis]) < half[axis], last, -1)
            continue
        ends = np.sort(np.stack([-half[axis] - origin[:, axis], half[axis] - origin[:, axis]]) / step, axis=0)
        first, last = np.maximum(first, ends[0]), np.minimum(last, ends[1])
    return first < last


def slab_coverage(block: Block, direction: np.ndarray, receiver: Receiver, cells: int) -> np.ndarray:
    """The hidden share of each footprint from cells x cells points, [points]."""
    (columns, rows), (x, y), (width, depth) = receiver.samples, receiver.center, receiver.size
    across = x - width / 2 + (np.arange(columns * cells) + 0.5) * width / (columns * cells)
    along = y - depth / 2 + (np.arange(rows * cells) + 0.5) * depth / (rows * cells)
    grid_x, grid_y = np.meshgrid(across, along)
    points = np.stack([grid_x.ravel(), grid_y.ravel(), np.zeros(grid_x.size)], axis=1)
    hidden = slab_hidden(block, points, direction).reshape(rows, cells, columns, cells)
    return hidden.mean(axis=(1, 3)).ravel()


def test_coverage_equals_the_slab_test_sampled_finely() -> None:
    found = shadow_coverage(BLOCK, DIRECTIONS, RECEIVER, lines=64)
    expected = np.stack([slab_coverage(BLOCK, d, RECEIVER, 64) for d in DIRECTIONS.numpy()])
    assert 0.05 < found.mean().item() < 0.5
    # a 64 x 64 grid counts the cells an edge passes through wrongly by half at most: about 1/64 of a footprint
    assert_close(found, torch.from_numpy(expected), rtol=0, atol=1.5 / 64)
    assert_close(found.mean(), torch.tensor(expected.mean()), rtol=0, atol=2e-4)


def test_intervals_end_where_the_slab_test_changes() -> None:
    """Just inside both ends the block hides the point and just outside it does not, to 1e-9."""
    y = torch.linspace(-1.2, 1.2, 41, dtype=torch.float64).expand(len(DIRECTIONS), -1)
    first, last = shadow_intervals(BLOCK, DIRECTIONS, y)
    some = first + 1e-6 < last
    assert some.any(dim=1).all()
    assert not some.all(dim=1).any()
    for k, direction in enumerate(DIRECTIONS.numpy()):
        for end, inwards in ((first, 1e-9), (last, -1e-9)):
            for shift, expected in ((inwards, True), (-inwards, False)):
                x = (end[k] + shift)[some[k]].numpy()
                points = np.stack([x, y[k][some[k]].numpy(), np.zeros_like(x)], axis=1)
                np.testing.assert_array_equal(slab_hidden(BLOCK, points, direction), expected)


def test_lines_past_the_shadow_have_an_empty_interval() -> None:
    first, last = shadow_intervals(BLOCK, DIRECTIONS, torch.full((len(DIRECTIONS), 1), 50.0, dtype=torch.float64))
    assert (first >= last).all()


@pytest.mark.parametrize("rotation", [0.0, 90.0, 20.0])
def test_from_straight_above_the_shadow_is_the_block_itself(rotation: float) -> None:
    """Two of the three plane segments remain: the third edge is seen as a point."""
    block = Block((2.0, 1.0, 3.0), rotation, (0.25, -0.5))
    up = vectors((0.0, 0.0, 1.0))
    coverage = shadow_coverage(block, up, Receiver((0.0, 0.0), (6.0, 6.0), (30, 30)), lines=32)
    assert_close(coverage.sum() * 0.04, torch.tensor(2.0, dtype=torch.float64), rtol=0, atol=2e-3)
    near = shadow_coverage(block, vectors((1e-13, 1e-13, 1.0)), Receiver((0.0, 0.0), (6.0, 6.0), (30, 30)), lines=32)
    assert_close(coverage, near)


@pytest.mark.parametrize("rotation", [0.0, 90.0])
@pytest.mark.parametrize("direction", [(1.0, 0.0, 1.0), (-1.0, 0.0, 1.0), (0.0, 1.0, 1.0), (0.0, -1.0, 1.0)])
def test_light_along_an_axis_casts_a_rectangle(rotation: float, direction: tuple[float, float, float]) -> None:
    """At 45 degrees the shadow is the base lengthened by the block's height, away from the light."""
    block = Block((1.0, 1.0, 2.0), rotation)
    receiver = Receiver((0.0, 0.0), (8.0, 8.0), (8, 8))
    coverage = shadow_coverage(block, vectors(direction), receiver, lines=8).reshape(8, 8)
    cells = torch.zeros(8, 8, dtype=torch.float64)
    low, high = (min(-0.5, -0.5 - 2 * s) for s in direction[:2]), (max(0.5, 0.5 - 2 * s) for s in direction[:2])
    edges = torch.arange(9, dtype=torch.float64) - 4
    (x0, y0), (x1, y1) = low, high
    x = (edges[1:].clamp(max=x1) - edges[:-1].clamp(min=x0)).clamp(min=0)
    y = (edges[1:].clamp(max=y1) - edges[:-1].clamp(min=y0)).clamp(min=0)
    cells = y[:, None] * x
    assert_close(coverage, cells)


def test_a_translation_keeps_its_float64_digits() -> None:
    """0.1 is no float32 number: a block moved by 0.1 equals a plane moved by -0.1 to 1e-14."""
    y = torch.linspace(-0.6, 0.6, 9, dtype=torch.float64).expand(len(DIRECTIONS), -1)
    moved = shadow_intervals(Block((1.0, 0.6, 1.2), 20.0, (0.1, 0.0)), DIRECTIONS, y)
    still = shadow_intervals(Block((1.0, 0.6, 1.2), 20.0), DIRECTIONS, y)
    for a, b in zip(moved, still, strict=True):
        assert_close(a - 0.1, b, rtol=0, atol=1e-13)


def test_interval_coverage_by_hand() -> None:
    first, last = torch.tensor([0.25, -3.0, 2.0, 1.5]), torch.tensor([2.5, 9.0, 1.0, 1.75])
    expected = torch.tensor([[0.75, 1, 0.5], [1, 1, 1], [0, 0, 0], [0, 0.25, 0]])
    assert_close(interval_coverage(first, last, 3), expected)


def test_lines_are_stratified_within_every_row() -> None:
    y = line_positions(RECEIVER, 4, DIRECTIONS)
    stratum = (y - (-0.05 - 1.5)) / (3.0 / 24)
    assert torch.equal(stratum.floor(), torch.arange(24.0, dtype=torch.float64).expand_as(y))
    assert_close(stratum - stratum.floor(), (stratum - stratum.floor())[:, :1].expand_as(y))
    assert len((stratum - stratum.floor())[:, 0].unique()) == len(DIRECTIONS)


def test_irradiance_sums_what_is_not_hidden() -> None:
    fluxes = torch.arange(1.0, 11, dtype=torch.float64).reshape(5, 2)
    found = block_irradiance(BLOCK, DIRECTIONS, fluxes, RECEIVER, lines=3)
    coverage = shadow_coverage(BLOCK, DIRECTIONS, RECEIVER, lines=3)
    assert_close(found, ((1 - coverage)[:, None, :] * fluxes[:, :, None]).sum(dim=0))


def test_chunks_change_only_the_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    generator = torch.Generator().manual_seed(0)
    directions = vectors(*(torch.randn(300, 3, generator=generator).abs() + 0.2).tolist())
    fluxes = torch.rand(300, 3, generator=generator, dtype=torch.float64)
    whole = block_irradiance(BLOCK, directions, fluxes, RECEIVER, lines=4)
    monkeypatch.setattr("torchlight.geometry.analytic_shadow.CHUNK_VALUES", 48 * 4 * 7)
    # each chunk numbers its directions anew, which moves lines within their strata; a lost chunk would cost 2 %
    limit = 0.01 * fluxes.sum(dim=0).max().item()
    assert_close(block_irradiance(BLOCK, directions, fluxes, RECEIVER, lines=4), whole, rtol=0, atol=limit)


def test_directions_decide_the_precision() -> None:
    single = block_irradiance(BLOCK, DIRECTIONS.float(), torch.ones(5, 3), RECEIVER)
    double = block_irradiance(BLOCK, DIRECTIONS, torch.ones(5, 3, dtype=torch.float64), RECEIVER)
    assert single.dtype == torch.float32
    assert_close(single.double(), double, rtol=0, atol=1e-5)
