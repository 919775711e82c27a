"""A thin foreign shadow on a photograph whose light is known."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.testing import assert_close

from torchlight.geometry.analytic_shadow import Block
from torchlight.geometry.receiver import Receiver
from torchlight.inversion.linear import default_solver
from torchlight.inversion.robust import HUBER, REJECTED, half_range, robust_weights
from torchlight.light.bases import Texels
from torchlight.observing import visible_part
from torchlight.photo.observation import Observation, Rejection
from torchlight.pipeline import explain, explain_robustly
from torchlight.synthetic import block_scene
from torchlight.transfer import transport


def test_weights_of_known_residuals() -> None:
    samples = torch.ones(2, 3, 101, dtype=torch.float64)
    weights = torch.ones(2, 101, dtype=torch.float64)
    weights[0, 0] = 0
    off = torch.linspace(-1, 1, 101, dtype=torch.float64).abs() * 0.1
    off[3] = 0.9
    predicted = samples + off
    deviation = 1.4826 * off.median().item()
    found = robust_weights(Observation(samples, weights), predicted)
    ratio = off / deviation
    expected = torch.where(ratio > REJECTED, 0.0, (HUBER / ratio).clamp(max=1))
    assert_close(found.weights[1], expected)
    assert found.weights[0, 0] == 0
    assert found.weights[1, 3] == 0
    assert_close(found.samples, samples)
    assert_close(found.rejections == Rejection.ROBUST, (weights > 0) & (found.weights == 0))


def test_a_perfect_fit_keeps_every_weight() -> None:
    samples = torch.rand(3, 50) + 0.5
    found = robust_weights(Observation(samples, torch.ones(50)), samples + 1e-4)
    assert_close(found.weights, torch.ones(50))


def test_a_range_by_hand() -> None:
    values = torch.zeros(2, 12, dtype=torch.float64)
    values[1, 5] = 2.0  # row 1 of 3, column 1 of 4
    found = half_range(values, (4, 3))
    assert_close(found[0], torch.zeros(12, dtype=torch.float64))
    assert_close(found[1].reshape(3, 4), torch.tensor([[1.0, 1, 1, 0]] * 3, dtype=torch.float64))


def test_an_edge_that_lies_half_a_sample_elsewhere_is_kept_and_a_foreign_one_is_not() -> None:
    x = torch.arange(32).repeat(24, 1).double()
    predicted = ((x - 9) / 2).clamp(0.2, 1).flatten().expand(3, -1)  # an edge two samples wide
    seen = ((x - 9.5) / 2).clamp(0.2, 1)
    seen[:, 22] = 0.5
    noise = 0.005 * torch.randn(24 * 32, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    given = Observation((seen.flatten() + noise).expand(3, -1), torch.ones(24 * 32, dtype=torch.float64))
    told, untold = (robust_weights(given, predicted, grid).rejections.reshape(24, 32) for grid in ((32, 24), None))
    assert int((told[:, :20] > 0).sum()) == 0
    assert int((untold[:, :20] > 0).sum()) > 24
    for found in (told, untold):
        assert bool((found[:, 22] == Rejection.ROBUST).all())


def foreign_shadow(receiver: Receiver) -> Tensor:
    """A stick's shadow: one column of samples, half as bright."""
    columns, rows = receiver.samples
    factor = torch.ones(rows, columns)
    factor[:, columns // 4] = 0.5
    return factor.flatten()


def test_a_foreign_shadow_is_let_go_of_and_the_light_is_right() -> None:
    receiver = Receiver((0.0, 0.0), (4.0, 4.0), (32, 32))
    scene = block_scene(Block((1.0, 0.6, 1.2), 20.0), receiver)
    basis, columns = Texels(4), transport(scene, 4, 8)
    generator = torch.Generator().manual_seed(0)
    light = torch.rand(3, columns.transport.shape[1], generator=generator)
    values = light @ columns.transport.T / torch.pi
    noisy = values * (1 + 0.002 * torch.randn(values.shape, generator=generator))
    visible = visible_part(scene)
    spoiled = Observation(noisy * foreign_shadow(receiver), visible.float())
    given = (spoiled, scene, columns, basis, default_solver(basis))
    robust, plain = explain_robustly(*given), explain(*given)
    errors = [((found.predicted - values)[:, visible]).square().mean().sqrt().item() for found in (robust, plain)]
    assert errors[0] < 0.002 * values.mean().item()
    assert errors[1] > 5 * errors[0]
    stick = (foreign_shadow(receiver) < 1) & visible
    weights = robust.observation.weights
    assert float((weights[stick] == 0).float().mean()) > 0.95
    assert float((weights[visible & ~stick] == 0).float().mean()) < 0.01
