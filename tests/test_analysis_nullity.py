"""Nullity against bandwidth: eq. 8, the factored rank, and what fewer samples can never do."""

from __future__ import annotations

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor
from torch.testing import assert_close

from torchlight.analysis.nullity import ABSOLUTE_TOLERANCES, coupling, equations, nullity, recommended_bandwidth
from torchlight.analysis.sampling import harmonic_coefficients, random_rotations, rotated, sampling_set
from torchlight.analysis.spectrum import transfer_harmonics
from torchlight.errors import ConfigError, SceneError, ShapeError
from torchlight.geometry.analytic_shadow import Block
from torchlight.geometry.receiver import Receiver
from torchlight.synthetic import block_scene
from torchlight.transfer import transport

RECEIVER = Receiver((0.0, 0.0), (4.0, 4.0), (12, 12))


@pytest.fixture(scope="module")
def rows() -> Tensor:
    """T_lm of a block's 144 samples, l < 5."""
    scene = block_scene(Block((1.0, 0.6, 1.2), 20.0, (0.3, -0.2)), RECEIVER)
    return equations(transfer_harmonics(transport(scene, 16, 4), 4), RECEIVER.points)


def random_rows(seed: int, points: int = 40, bandwidth: int = 4) -> Tensor:
    """Rows whose columns fall off with the degree, so that ranks differ between tolerances."""
    generator = torch.Generator().manual_seed(seed)
    degree = torch.arange(bandwidth**2).double().sqrt().floor()
    return torch.randn(points, bandwidth**2, generator=generator, dtype=torch.float64) * 10.0 ** (-1.5 * degree)


# --- eq. 8 ---------------------------------------------------------------------------------------------------------


def test_the_matrix_gives_the_irradiance_of_light_that_is_zero_below(rows: Tensor) -> None:
    """a L over the directions above the plane = sum of T_lm L_lm with L_lm from eq. 7 and L = 0 below."""
    (turn,) = random_rotations(1, seed=5)
    sampling = rotated(sampling_set(5), turn)
    above = sampling.directions[:, 2] > 0
    light = torch.rand(45, generator=torch.Generator().manual_seed(1), dtype=torch.float64) * above
    expected = rows @ harmonic_coefficients(light, sampling, 5)
    assert_close(coupling(rows, 5, turn) @ light[above], expected, rtol=1e-12, atol=1e-15)


def test_the_unknowns_are_the_directions_above_the_plane(rows: Tensor) -> None:
    turns = random_rotations(6, seed=2)
    found = nullity(rows, turns)
    for k, turn in enumerate(turns):
        for bandwidth in range(1, 6):
            assert found.unknowns[bandwidth - 1, k] == coupling(rows, bandwidth, turn).shape[1]
    assert found.mean.shape == found.deviation.shape == (4, 5)


# --- the factored rank ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("source", ["block", "random", "few"])
def test_the_factored_rank_is_the_direct_one(rows: Tensor, source: str) -> None:
    matrix = {"block": rows, "random": random_rows(0), "few": rows[:7]}[source]
    turns = random_rotations(8, seed=0)
    found = nullity(matrix, turns)
    for bandwidth in range(1, math.isqrt(matrix.shape[1]) + 1):
        for k, turn in enumerate(turns):
            direct = coupling(matrix, bandwidth, turn)
            unknowns = direct.shape[1]
            ranks = [torch.linalg.matrix_rank(direct)] if unknowns else [torch.tensor(0)]  # MATLAB's own tolerance
            values = torch.linalg.svdvals(direct)
            ranks += [(values > tolerance).sum() for tolerance in ABSOLUTE_TOLERANCES]
            assert found.counts[:, bandwidth - 1, k].tolist() == [unknowns - int(rank) for rank in ranks]


def test_rank_is_at_most_b_squared_and_at_most_the_samples(rows: Tensor) -> None:
    found = nullity(rows[:3], random_rotations(10, seed=1))
    rank = found.unknowns - found.counts
    limits = torch.tensor([[1], [3], [3], [3], [3]])
    assert (rank <= limits).all()
    assert (rank.amax(dim=(0, 2)) == limits[:, 0]).all()


def test_the_untouched_set_has_a_nullity_of_its_own() -> None:
    """Even with every T_lm known: B/2 full rings above the plane, but only B - |m| harmonics for each m.

    So rank = sum over m of min(B - |m|, B / 2), and no scene can do better.
    """
    identity = torch.eye(3, dtype=torch.float64)[None]
    found = nullity(torch.eye(64, dtype=torch.float64), identity)
    for bandwidth in (2, 4, 6, 8):
        rank = sum(min(bandwidth - abs(m), bandwidth // 2) for m in range(1 - bandwidth, bandwidth))
        assert found.counts[0, bandwidth - 1, 0] == bandwidth // 2 * (2 * bandwidth - 1) - rank


def test_scaling_everything_changes_no_matlab_rank(rows: Tensor) -> None:
    turns = random_rotations(10, seed=4)
    assert torch.equal(nullity(rows, turns).counts[0], nullity(rows * 1e5, turns).counts[0])


# --- fewer samples -------------------------------------------------------------------------------------------------


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6), st.lists(st.integers(0, 39), min_size=1, max_size=39, unique=True))
def test_at_an_absolute_tolerance_nullity_never_falls_when_samples_are_removed(seed: int, kept: list[int]) -> None:
    everything = random_rows(seed)
    turns = random_rotations(4, seed=seed)
    whole, part = nullity(everything, turns), nullity(everything[kept], turns)
    assert (part.counts[1:] >= whole.counts[1:]).all()
    assert torch.equal(part.unknowns, whole.unknowns)
    for tolerance in ABSOLUTE_TOLERANCES:
        assert part.recommended(tolerance) <= whole.recommended(tolerance)


def test_a_larger_hidden_area_never_raises_the_recommended_bandwidth(rows: Tensor) -> None:
    turns = random_rotations(30, seed=0)
    columns = torch.arange(RECEIVER.points) % 12
    found = [nullity(rows[columns < count], turns) for count in (12, 9, 6, 3, 1)]
    for tolerance in ABSOLUTE_TOLERANCES:
        bandwidths = [item.recommended(tolerance) for item in found]
        assert bandwidths == sorted(bandwidths, reverse=True)
    assert found[0].mean[2, -1] < found[-1].mean[2, -1]


def test_the_recommended_bandwidth_ends_before_the_first_that_fails() -> None:
    for means, expected in (
        ([0.0, 0.2, 0.1, 0.74, 0.75], 4),
        ([0.0, 0.9, 0.1], 1),
        ([1.0, 0.0], 0),
        ([0.0, 0.0], 2),
    ):
        assert recommended_bandwidth(torch.tensor(means, dtype=torch.float64)) == expected


# --- what is refused -----------------------------------------------------------------------------------------------


def test_nothing_to_analyse_is_refused() -> None:
    turns = random_rotations(1, seed=0)
    with pytest.raises(SceneError, match="no sample of the receiver is left"):
        nullity(torch.zeros(0, 4), turns)
    with pytest.raises(SceneError, match="no light reaches any sample"):
        nullity(torch.zeros(3, 4), turns)
    with pytest.raises(SceneError, match="at least one sample, got 0"):
        equations(torch.zeros(0, 4), 0)
    with pytest.raises(ShapeError, match=r"expected B\^2 columns, got 5"):
        nullity(torch.ones(3, 5), turns)
    with pytest.raises(ConfigError, match="bandwidth: expected 1 to 32, got 0"):
        nullity(torch.ones(3, 0), turns)
