"""The split of a light's error: projections, Pythagoras, and scenes whose answer is known."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torch.testing import assert_close

from torchlight.analysis.observability import texel_solid_angles
from torchlight.errors import ConfigError, SceneError
from torchlight.geometry.analytic_shadow import Block
from torchlight.geometry.receiver import Receiver
from torchlight.geometry.scene import Scene
from torchlight.light.overlap import latlong_to_texels, texels_to_latlong
from torchlight.light_metrics.determined import determined_directions, split
from torchlight.light_metrics.grid import sample_weights
from torchlight.synthetic import block_scene
from torchlight.transfer import Transfer, transport

RECEIVER = Receiver((0.0, 0.0), (4.0, 4.0), (12, 12))
EVERY = torch.ones(144, dtype=torch.bool)


@pytest.fixture(scope="module")
def block() -> Transfer:
    return transport(block_scene(Block((1.0, 0.6, 1.2), 20.0), RECEIVER), 4, 8)


@pytest.fixture(scope="module")
def empty() -> Transfer:
    return transport(Scene(torch.zeros(0, 3, 3), RECEIVER), 4, 8)


def random_maps(*batch: int) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(1)
    x, y = (torch.rand(*batch, 3, 16, 32, generator=generator, dtype=torch.float64) for _ in range(2))
    return x, y


def test_squares_add_up(block: Transfer) -> None:
    x, y = random_maps(2)
    found = split(x, y, determined_directions(block, EVERY, 0.01))
    parts = found.determined.square() + found.null.square() + found.finer.square()
    assert_close(parts, found.total.square())
    assert float(found.determined.min()) > 0
    assert float(found.null.min()) > 0


def test_an_empty_plane_determines_its_irradiance_only(empty: Transfer) -> None:
    """All rows of T are the cosine weights c: one direction, with the projection (c . d) c / o over |c|^2 / o."""
    basis = determined_directions(empty, EVERY, 0.01)
    assert basis.rank == 1
    x, y = random_maps()
    found = split(x, y, basis)
    c = empty.transport[0].double()
    angles = texel_solid_angles(4)
    d = latlong_to_texels(x - y, 4)
    expected = (d @ c)[:, None] * (c / angles) / (c.square() / angles).sum()
    assert_close(found.determined_pattern, expected, atol=1e-6, rtol=0)  # T is float32
    assert_close(found.null_pattern @ c, torch.zeros(3, dtype=torch.float64), atol=1e-6, rtol=0)


def test_the_null_space_leaves_the_photograph_alone(block: Transfer) -> None:
    """What is called null changes no sample by more than its share of the noise; at no noise it changes nothing."""
    x, y = random_maps()
    exact = split(x, y, determined_directions(block, EVERY, 1e-9))
    assert float(block.transport.double().mv(exact.null_pattern[0]).abs().max()) < 1e-6
    assert float(exact.determined) > float(split(x, y, determined_directions(block, EVERY, 0.1)).determined)


def test_projection_equals_one_made_with_numpy(block: Transfer) -> None:
    noise, rows = 0.01, block.transport.double().numpy()
    angles = texel_solid_angles(4).numpy()
    matrix = rows / np.sqrt(angles)
    values, vectors = np.linalg.eigh(matrix.T @ matrix)
    level = (noise * rows.sum(axis=1).max()) ** 2 * len(angles) / (2 * math.pi)
    kept = vectors[:, values >= level]
    x, y = random_maps()
    d = latlong_to_texels(x - y, 4).numpy() * np.sqrt(angles)
    seen = d @ kept @ kept.T
    found = split(x, y, determined_directions(block, EVERY, noise))
    assert 5 < kept.shape[1] < len(angles)
    assert float(found.determined) == pytest.approx(math.sqrt((seen**2).sum() / (3 * 2 * math.pi)), rel=1e-6)
    assert float(found.null) == pytest.approx(math.sqrt(((d - seen) ** 2).sum() / (3 * 2 * math.pi)), rel=1e-6)


def test_a_difference_on_texels_has_nothing_finer(block: Transfer) -> None:
    """A lat-long of texels cuts some of them, so a little is left; a chessboard of pixels has nearly nothing else."""
    texels = torch.rand(3, 48, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    basis = determined_directions(block, EVERY, 0.01)
    smooth = split(texels_to_latlong(texels, 4, 64), torch.zeros(3, 64, 128, dtype=torch.float64), basis)
    assert float(smooth.finer) < 0.25 * float(smooth.total)
    board = ((torch.arange(64)[:, None] + torch.arange(128)) % 2 * 2.0 - 1).double().expand(3, -1, -1)
    fine = split(board, torch.zeros_like(board), basis)
    assert float(fine.total) == pytest.approx(1)
    assert float(fine.finer) > 0.99


def test_light_below_the_horizon_does_not_count(block: Transfer) -> None:
    x, y = random_maps()
    changed = x.clone()
    changed[:, 8:] += 5
    basis = determined_directions(block, EVERY, 0.01)
    assert_close(split(changed, y, basis).total, split(x, y, basis).total)
    weights = sample_weights(16, "upper")
    total = ((x - y).flatten(1).square().mean(dim=0) @ weights / weights.sum()).sqrt()
    assert_close(split(x, y, basis).total, total)


def test_bad_input(block: Transfer) -> None:
    with pytest.raises(ConfigError, match="noise"):
        determined_directions(block, EVERY, 0.0)
    with pytest.raises(SceneError, match="no sample"):
        determined_directions(block, ~EVERY, 0.01)
