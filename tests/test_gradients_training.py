"""What gradients are for: a network in front of a solve learns, and estimates carry a graph where they should."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from typing import Any

import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

import torchlight as tl
from torchlight.geometry.analytic_shadow import Block
from torchlight.geometry.receiver import Receiver
from torchlight.inversion.adaptive import solve_adaptive
from torchlight.light.bases import Basis
from torchlight.solvers import Solver
from torchlight.synthetic import block_scene
from torchlight.transfer import transport

SCENE = block_scene(Block((1.0, 0.6, 1.2), 20.0), Receiver((0.0, 0.0), (4.0, 4.0), (12, 12)))
MOVED = block_scene(Block((0.6, 1.0, 0.9), 50.0), Receiver((0.0, 0.0), (4.0, 4.0), (12, 12)))


def lights(count: int, texels: int, seed: int) -> Tensor:
    return torch.randn(count, 1, texels, generator=torch.Generator().manual_seed(seed), dtype=torch.float64).exp()


def test_a_network_learns_the_response_of_a_camera_through_a_solve() -> None:
    """Photographs are gamma encoded; the loss sees only how the light found relights another pose."""
    here, there = (transport(scene, 2, 8).to(dtype=torch.float64) for scene in (SCENE, MOVED))
    radiance = lights(6, 12, seed=0)
    linear = here.mv(radiance)
    photos, target = (linear / linear.max()) ** (1 / 2.2), there.mv(radiance) / linear.max()

    def relighting_loss(samples: Tensor) -> Tensor:
        found = tl.solve(here.transport, tl.Observation(samples, torch.ones_like(samples[:, 0])), tl.NNLS(1e-3))
        return (tl.irradiance(there.transport, found.coefficients) - target).square().mean()

    torch.manual_seed(0)
    network = torch.nn.Sequential(torch.nn.Linear(1, 16), torch.nn.Tanh(), torch.nn.Linear(16, 1)).double()
    optimizer = torch.optim.Adam(network.parameters(), lr=0.05)
    losses = []
    for _ in range(150):
        optimizer.zero_grad()
        loss = relighting_loss(network(photos[..., None])[..., 0].exp())
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    assert losses[-1] < 0.02 * losses[0]
    assert losses[-1] < 0.5 * relighting_loss(photos).item()  # better than taking the encoded values for linear ones


def test_weights_learn_to_leave_out_what_is_not_shadow() -> None:
    """A stain on the plane: its sample's weight falls when the light found is to be the true one."""
    here = transport(SCENE, 2, 8).to(dtype=torch.float64)
    radiance = lights(1, 12, seed=1)
    samples = here.mv(radiance)
    samples[..., 40] *= 0.2
    logits = torch.zeros(1, 144, dtype=torch.float64, requires_grad=True)
    found = tl.solve(here.transport, tl.Observation(samples, torch.sigmoid(logits)), tl.NNLS()).coefficients
    (gradient,) = torch.autograd.grad((found - radiance).square().sum(), logits)
    assert gradient.abs().argmax().item() == 40
    assert gradient[0, 40] > 0


def tracked(value: Any, name: str = "") -> list[str]:
    """Returns the names of the tensors within a result that require a gradient."""
    if isinstance(value, Tensor):
        return [name] if value.requires_grad else []
    if not is_dataclass(value) or isinstance(value, type):
        return []
    return [found for field in fields(value) for found in tracked(getattr(value, field.name), f"{name}.{field.name}")]


@pytest.mark.parametrize(
    ("basis", "solver"),
    [
        (tl.Texels(4), tl.NNLS()),
        (tl.HaarCubemap(4), tl.NNLS()),
        (tl.SphericalHarmonics(2, 4), tl.NonnegativeSynthesis()),
        (tl.Texels(4), tl.Ridge()),
        (tl.Texels(4), tl.ProjectedAdam(20)),
        (None, tl.AdaptiveHaar(4, 20)),
    ],
    ids=repr,
)
def test_estimates_carry_a_graph_only_where_one_was_asked_for(
    basis: Basis | None, solver: Solver | tl.AdaptiveHaar
) -> None:
    transfer = transport(SCENE, 4, 4)
    photo = torch.rand(3, 12, 12, generator=torch.Generator().manual_seed(0))
    plain = tl.estimate(photo, SCENE, basis, solver, transfer)
    assert tracked(plain) == []
    asked = tl.estimate(photo.requires_grad_(), SCENE, basis, solver, transfer)
    assert_close(asked.solution.coefficients.detach(), plain.solution.coefficients, rtol=0, atol=0)
    certificates = {".solution.relative_residual", ".solution.kkt_residual", ".solution.gap"}
    assert certificates.isdisjoint(tracked(asked))
    assert (".light.radiance" in tracked(asked)) == (basis is not None)  # the adaptive choice has no gradient
    if basis is not None:
        (gradient,) = torch.autograd.grad(asked.light.radiance.sum(), photo)
        assert bool(torch.isfinite(gradient).all())
        assert bool((gradient != 0).any())


def test_functions_once_chosen_are_solved_for_with_gradients() -> None:
    transfer = transport(SCENE, 4, 8).to(dtype=torch.float64)
    generator = torch.Generator().manual_seed(0)
    samples = transfer.mv(lights(1, 48, seed=0)[0])
    samples = samples * (1 + 0.02 * torch.randn(samples.shape, generator=generator, dtype=torch.float64))
    observation = tl.Observation(samples.requires_grad_(), torch.ones(144, dtype=torch.float64))
    settings = tl.AdaptiveHaar(4, 30)
    adaptive = solve_adaptive(transfer, observation, settings)
    kept = adaptive.refinement.kept[0]
    assert 9 < int(kept.sum()) < 48
    matrix, synthesis = transfer.project(settings.basis)[:, kept], settings.basis.synthesis_matrix()[:, kept]
    again = tl.solve(matrix, observation, tl.NonnegativeSynthesis(), synthesis).coefficients
    assert_close(again.detach(), adaptive.solution.coefficients[:, kept], rtol=0, atol=1e-6)
    (gradient,) = torch.autograd.grad(again.square().sum(), samples)
    assert bool((gradient != 0).any())
