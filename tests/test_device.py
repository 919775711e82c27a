"""The whole story on another device: the CPU's answers, everything left there, and nothing fetched on the way."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from functools import cache

import elsewhere
import pytest
import torch
from torch import Tensor
from torch.testing import assert_close
from workbench import BLOCK, png, scene_file, shadow, torchlight

import torchlight as tl
from torchlight.geometry.receiver import Receiver
from torchlight.inversion import nodes
from torchlight.inversion.adaptive import AdaptiveHaar, solve_adaptive
from torchlight.inversion.gain import ProjectedGain
from torchlight.inversion.level_by_level import LevelByLevel
from torchlight.inversion.linear import solve
from torchlight.photo.observation import Observation
from torchlight.pipeline import Estimate, estimate, explain, resolve_method
from torchlight.precomputation import Columns, columns_for, deepened
from torchlight.solvers import NNLS, NonnegativeSynthesis, ProjectedAdam, Ridge
from torchlight.synthetic import block_scene
from torchlight.transfer import transport

RECEIVER = Receiver((0.0, 0.0), (4.0, 4.0), (16, 16))
SCENE = block_scene(BLOCK, RECEIVER)

METHODS = {
    "texels": (tl.Texels(4), NNLS()),
    "texels by ridge": (tl.Texels(4), Ridge(1e-6)),
    "texels by Adam": (tl.Texels(4), ProjectedAdam(steps=40)),
    "haar": (tl.HaarCubemap(4), NNLS()),
    "haar by ridge": (tl.HaarCubemap(4), Ridge(1e-6)),
    "harmonics": (tl.SphericalHarmonics(2, 4), NonnegativeSynthesis()),
    "harmonics by ridge": (tl.SphericalHarmonics(2, 4), Ridge()),
    "adaptive": (None, AdaptiveHaar(8, 48)),
    "adaptive, the paper's rule": (None, AdaptiveHaar(4, 40, rule=LevelByLevel())),
    "adaptive, shared": (None, AdaptiveHaar(4, 48, rule=ProjectedGain(shared=True))),
}
ON_THE_CPU = "adaptive, the paper's rule"


def photographs() -> Tensor:
    return torch.stack([shadow(), 0.5 * shadow().flip(0)]).double()


def observed(device: torch.device) -> Observation:
    return Observation(photographs().flatten(-2).to(device), torch.ones(2, RECEIVER.points).double().to(device))


def tensors(data: object, name: str = "") -> Iterator[tuple[str, Tensor]]:
    """Yields every tensor of a result with its name."""
    if isinstance(data, Tensor):
        yield name, data
    elif is_dataclass(data):
        for field in fields(data):
            yield from tensors(getattr(data, field.name), f"{name}.{field.name}")


def on(device: torch.device, data: object) -> None:
    for name, tensor in tensors(data):
        assert tensor.device.type == device.type, name


@cache
def on_cpu(method: str) -> Estimate:
    return estimate(photographs(), SCENE, *METHODS[method], transfer=columns_on(torch.device("cpu"), method))


def columns_on(device: torch.device, method: str) -> Columns:
    """Returns what the method takes of the scene: of few directions, which keeps the device that is not there fast."""
    basis, solver = resolve_method(*METHODS[method])
    if isinstance(solver, AdaptiveHaar):
        return columns_for(SCENE, basis, solver, use_cache=False, device=device)
    return transport(SCENE, basis.resolution, 6, device=device)


@pytest.mark.parametrize("method", METHODS)
def test_estimate_is_the_cpus_and_stays_on_its_device(method, device):
    right = on_cpu(method)
    basis, solver = resolve_method(*METHODS[method])
    found = estimate(photographs().to(device), SCENE, basis, solver, columns_on(device, method))
    on(device, found)
    assert found.rms_255.device.type == device.type
    assert found.solution.status.tolist() == right.solution.status.tolist()
    scale = float(right.predicted.abs().max())
    assert_close(found.predicted.cpu(), right.predicted, rtol=0, atol=1e-6 * scale)
    brightest = float(right.light.radiance.abs().max())
    assert_close(found.light.radiance.cpu(), right.light.radiance, rtol=0, atol=1e-5 * brightest)
    assert_close(found.peaks.directions.cpu(), right.peaks.directions, rtol=0, atol=1e-4, equal_nan=True)


@pytest.mark.parametrize("method", [name for name in METHODS if name != ON_THE_CPU])
def test_after_visibility_no_data_come_back_to_the_host(method):
    device = elsewhere.register()
    basis, solver = resolve_method(*METHODS[method])
    seen, columns = observed(device), columns_on(device, method)
    with elsewhere.counting() as waits:
        explain(seen, SCENE, columns, basis, solver)
    assert waits["_to_copy"] == waits["copy_"] == 0, waits


def test_of_the_adaptive_method_the_host_learns_which_squares_to_cast_and_no_more(monkeypatch):
    device, asked, squares = elsewhere.register(), [], nodes.squares
    monkeypatch.setattr(nodes, "squares", lambda tree, wanted: asked.append(len(wanted)) or squares(tree, wanted))
    solver, coarse = AdaptiveHaar(8, 48), transport(SCENE, 2, 6)
    right = solve_adaptive(deepened(SCENE, coarse, 8), observed(torch.device("cpu")), solver)
    times = len(asked)
    with elsewhere.counting() as waits:
        found = solve_adaptive(deepened(SCENE, coarse.to(device), 8), observed(device), solver)
    on(device, found)
    assert len(asked) == 2 * times > 0
    assert waits["_to_copy"] == times, waits
    assert waits["copy_"] == 0, waits
    assert torch.equal(found.refinement.kept.cpu(), right.refinement.kept)
    assert_close(found.irradiance.cpu(), right.irradiance, rtol=0, atol=1e-9)


def test_the_papers_rule_goes_to_the_host_once():
    device, solver = elsewhere.register(), AdaptiveHaar(4, 40, rule=LevelByLevel())
    seen, columns = observed(device), columns_on(device, ON_THE_CPU)
    with elsewhere.counting() as waits:
        solve_adaptive(columns, seen, solver)
    assert waits == {"_to_copy": 2}  # samples and weights


def test_trees_grow_together(monkeypatch):
    """The host does not wait more often for six photographs than for two."""
    device, solver = elsewhere.register(), AdaptiveHaar(4, 48)
    dense = transport(SCENE, 4, 6, device=device)
    waited = []
    for copies in (1, 3):
        seen = observed(device)
        seen = Observation(seen.samples.repeat(copies, 1, 1), seen.weights.repeat(copies, 1))
        with elsewhere.counting() as waits:
            solve_adaptive(dense, seen, solver)
        waited.append(sum(waits.values()))
    assert waited[0] == waited[1]


def test_adaptive_method_works_where_its_columns_are(device):
    solver = AdaptiveHaar(2, 12)
    seen, dense = observed(torch.device("cpu")), transport(SCENE, 2, 6)
    right = solve_adaptive(dense, seen, solver)
    found = solve_adaptive(dense.to(device), seen, solver)
    on(torch.device("cpu"), found)
    assert torch.equal(found.refinement.kept, right.refinement.kept)
    assert_close(found.irradiance, right.irradiance, rtol=0, atol=1e-9)


@pytest.mark.parametrize("solver", [NNLS(1e-3), Ridge(1e-3)], ids=["nnls", "ridge"])
def test_gradients_of_a_solve_are_the_cpus(solver, device):
    random = torch.Generator().manual_seed(3)
    problem = (torch.rand(60, 20, generator=random), torch.rand(4, 3, 60, generator=random), torch.ones(4, 60))
    found = {}
    for where in (torch.device("cpu"), device):
        matrix, samples, weights = (part.double().to(where).requires_grad_() for part in problem)
        light = solve(matrix, Observation(samples, weights), solver).coefficients
        light.square().sum().backward()
        found[where.type] = (matrix.grad, samples.grad, weights.grad)
    for here, right in zip(found[device.type], found["cpu"], strict=True):
        assert here.device.type == device.type
        assert_close(here.cpu(), right, rtol=1e-8, atol=1e-9)


def test_cuda_where_there_is_none_is_one_line(tmp_path, monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    files = scene_file(tmp_path), png(tmp_path / "photo.png")
    ran = torchlight("estimate", *files, "--out", tmp_path / "out", "--device", "cuda")
    assert ran.code == 2
    assert "--device cuda: this torch finds no GPU; use --device auto or cpu" in ran.line
