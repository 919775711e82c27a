"""The observability map against a dense model, finite differences of the estimate, and laws of adding photographs."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

from torchlight.analysis.observability import (
    coarsened,
    degrees_of_freedom,
    observability,
    stacked,
    texel_solid_angles,
    whitened,
)
from torchlight.errors import ConfigError, SceneError, ShapeError
from torchlight.geometry import primitives
from torchlight.geometry.analytic_shadow import Block
from torchlight.geometry.receiver import Receiver
from torchlight.geometry.scene import Scene
from torchlight.geometry.transforms import transform
from torchlight.light import cubemap
from torchlight.synthetic import block_scene
from torchlight.transfer import Transfer, transport

RECEIVER = Receiver((0.0, 0.0), (4.0, 4.0), (10, 10))
EMPTY = torch.zeros(0, 3, 3, dtype=torch.float64)
TEXELS = cubemap.texel_count(4)


def block_transfer(turn: float = 20.0) -> Transfer:
    return transport(block_scene(Block((1.0, 0.6, 1.2), turn, (0.3, -0.2)), RECEIVER), 4, 8)


@pytest.fixture(scope="module")
def transfer() -> Transfer:
    return block_transfer()


def everything() -> Tensor:
    return torch.ones(RECEIVER.points, dtype=torch.bool)


# --- the model -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("noise", "prior"), [(0.01, 1.0), (0.1, 1.0), (0.01, 3.0)])
def test_it_agrees_with_the_normal_equations(transfer: Transfer, noise: float, prior: float) -> None:
    seen = observability(whitened(transfer, everything(), noise), prior)
    matrix = transfer.transport.double()
    s = noise * matrix.sum(dim=1).max()
    gram = matrix.T @ matrix / s**2
    inverse = torch.linalg.inv(gram + torch.eye(TEXELS, dtype=torch.float64) / prior**2)
    assert_close(seen.diagonal, (inverse @ gram).diagonal(), rtol=1e-8, atol=1e-10)
    assert_close(seen.deviation, inverse.diagonal().sqrt(), rtol=1e-8, atol=1e-10)


def test_it_agrees_with_a_dense_svd(transfer: Transfer) -> None:
    equations = whitened(transfer, everything(), 0.01)
    seen = observability(equations)
    _, values, vectors = torch.linalg.svd(equations.transport)
    share = values.square() / (values.square() + 1)
    assert_close(seen.diagonal, (vectors[: len(values)].square() * share[:, None]).sum(dim=0), rtol=1e-9, atol=1e-12)
    assert_close(seen.singular_values, values, rtol=1e-9, atol=1e-9)
    assert_close(seen.degrees_of_freedom, share.sum().item(), rtol=1e-10, atol=0)


def test_it_is_how_the_ridge_solution_answers_to_each_texel(transfer: Transfer) -> None:
    """Finite differences of argmin |T x - b|^2 / s^2 + |x - mean|^2 / tau^2 over the truth that b comes from."""
    equations = whitened(transfer, everything(), 0.02)
    seen = observability(equations)
    identity = torch.eye(TEXELS, dtype=torch.float64)
    system = torch.cat([equations.transport, identity])
    truth = torch.rand(TEXELS, generator=torch.Generator().manual_seed(0), dtype=torch.float64)

    def estimate(light: Tensor) -> Tensor:
        right = torch.cat([equations.transport @ light, torch.ones(TEXELS, *light.shape[1:], dtype=torch.float64)])
        return torch.linalg.lstsq(system, right).solution

    step = 1e-3
    changed = estimate(truth[:, None] + step * identity) - estimate(truth[:, None])
    assert_close(seen.diagonal, changed.diagonal() / step, rtol=1e-6, atol=1e-9)


def test_fewer_samples_than_texels_are_no_special_case(transfer: Transfer) -> None:
    few = torch.arange(RECEIVER.points) % 9 == 0
    equations = whitened(transfer, few, 0.01)
    seen = observability(equations)
    gram = equations.transport.T @ equations.transport
    expected = torch.linalg.solve(gram + torch.eye(TEXELS, dtype=torch.float64), gram).diagonal()
    assert_close(seen.diagonal, expected, rtol=1e-7, atol=1e-10)
    assert len(seen.singular_values) == int(few.sum())


@pytest.mark.parametrize("points", [10, 100])
def test_degrees_of_freedom_by_cholesky(transfer: Transfer, points: int) -> None:
    equations = whitened(transfer, torch.arange(RECEIVER.points) < points, 0.01)
    expected = observability(equations).degrees_of_freedom
    assert_close(degrees_of_freedom(equations.transport), expected, rtol=1e-9, atol=0)


# --- what cannot be seen -------------------------------------------------------------------------------------------


def test_a_texel_behind_everything_is_flagged() -> None:
    """A ceiling over the plane: its middle hides the zenith from every sample, its rim lets the horizon in."""
    ceiling = transform(primitives.box((40.0, 40.0, 0.1)), 1.0, (0.0, 0.0, 0.0), (0.0, 0.0, 5.0))
    found = transport(Scene(ceiling, RECEIVER), 8, 4)
    seen = observability(whitened(found, everything(), 0.01))
    elevation = cubemap.texel_directions(8, 5)[cubemap.visible_texels(8)][:, 2].asin().rad2deg()
    high = elevation > 35  # the rim is 18 to 22 away and 5 up: 13 to 16 degrees, 11 in the corners
    assert high.sum() > 80
    assert not seen.reached[high].any()
    assert torch.equal(seen.diagonal[high], torch.zeros_like(seen.diagonal[high]))
    assert torch.equal(seen.deviation[high], torch.ones_like(seen.diagonal[high]))
    assert seen.reached[elevation < 5].all()
    assert not seen.determined[high].any()


def test_an_empty_plane_determines_nothing_but_the_mean(transfer: Transfer) -> None:
    """All samples are equal: one degree of freedom, however many samples."""
    found = transport(Scene(EMPTY, RECEIVER), 4, 1)
    seen = observability(whitened(found, everything(), 0.01))
    assert_close(seen.degrees_of_freedom, 1.0, rtol=1e-2, atol=0)
    assert observability(whitened(transfer, everything(), 0.01)).degrees_of_freedom > 10


# --- several photographs -------------------------------------------------------------------------------------------


def test_another_photograph_never_lowers_the_resolution(transfer: Transfer) -> None:
    first, second = (whitened(item, everything(), 0.05) for item in (transfer, block_transfer(75.0)))
    alone, both = observability(first), observability(stacked([first, second]))
    assert (both.diagonal >= alone.diagonal - 1e-12).all()
    assert (both.diagonal >= observability(second).diagonal - 1e-12).all()
    assert both.degrees_of_freedom > alone.degrees_of_freedom + 1


def test_the_same_photograph_twice_is_half_the_noise_variance(transfer: Transfer) -> None:
    once = whitened(transfer, everything(), 0.05)
    twice = observability(stacked([once, once]))
    expected = observability(whitened(transfer, everything(), 0.05 / math.sqrt(2)))
    assert_close(twice.diagonal, expected.diagonal, rtol=1e-9, atol=1e-12)


def test_scenes_of_different_resolution_are_not_stacked(transfer: Transfer) -> None:
    other = Transfer(torch.ones(3, cubemap.texel_count(2)), 2)
    with pytest.raises(ShapeError, match="stacked scenes: expected one resolution, got 2 and 4"):
        stacked([transfer, other])
    with pytest.raises(ShapeError, match="got no scene"):
        stacked([])


# --- texels --------------------------------------------------------------------------------------------------------


def test_the_upper_hemisphere_has_2_pi(transfer: Transfer) -> None:
    assert_close(texel_solid_angles(16).sum().item(), 2 * math.pi, rtol=1e-13, atol=0)
    seen = observability(whitened(transfer, everything(), 0.01))
    assert_close(seen.share(torch.ones(TEXELS, dtype=torch.bool)), 1.0, rtol=1e-12, atol=0)
    top = torch.arange(TEXELS) >= TEXELS - 16  # the top face comes last and covers a third of the hemisphere
    assert_close(seen.share(top), 1 / 3, rtol=1e-12, atol=0)


@pytest.mark.parametrize("resolution", [2, 4, 8])
def test_coarser_texels_are_sums(resolution: int) -> None:
    weights = cubemap.cosine_weights(8, 1).T
    found = coarsened(Transfer(weights, 8), resolution)
    assert_close(found.transport, cubemap.cosine_weights(resolution, 1).T, rtol=1e-12, atol=1e-15)


def test_coarser_texels_hold_the_same_directions() -> None:
    """One fine texel after the other: its coarse texel is the one that its centre falls into."""
    unit = Transfer(torch.eye(cubemap.texel_count(8)), 8)
    fine = cubemap.texel_directions(8, 5)[cubemap.visible_texels(8)]
    expected = torch.searchsorted(cubemap.visible_texels(4), cubemap.texel_index(fine, 4))
    assert torch.equal(coarsened(unit, 4).transport.argmax(dim=1), expected)


# --- what is refused -----------------------------------------------------------------------------------------------


def test_bad_input_is_refused(transfer: Transfer) -> None:
    with pytest.raises(ConfigError, match="noise: expected a positive share"):
        whitened(transfer, everything(), 0.0)
    with pytest.raises(SceneError, match="no sample of the receiver is left"):
        whitened(transfer, ~everything(), 0.01)
    dark = Transfer(torch.zeros(3, TEXELS), 4)
    with pytest.raises(SceneError, match="no light reaches any sample"):
        whitened(dark, torch.ones(3, dtype=torch.bool), 0.01)
    with pytest.raises(ConfigError, match="prior: expected a positive deviation"):
        observability(whitened(transfer, everything(), 0.01), prior=0.0)
    with pytest.raises(ShapeError, match="resolution 4 cannot be summed to 3"):
        coarsened(transfer, 3)
