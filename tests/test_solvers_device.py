"""Least squares in lockstep, as a GPU does it: the compiled code's answers, and a host that is asked nothing."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial

import elsewhere
import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

from torchlight.devices import moved
from torchlight.solvers import (
    NNLS,
    LeastSquares,
    NonnegativeSynthesis,
    Solution,
    Status,
    device_nnls,
    device_steps,
    nnls,
)
from torchlight.solvers.active_set import STEP_LENGTHS, Limits, minimize_nonnegative
from torchlight.solvers.device_nnls import lockstep_minimizers
from torchlight.solvers.device_steps import Rules, alike, beginning, minimizers, stepped
from torchlight.solvers.device_synthesis import lockstep_synthesis

POINTS, COLUMNS, PHOTOS = 120, 40, 10


def seeded(seed: int) -> Callable[..., Tensor]:
    return partial(torch.rand, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def problem(kind: str) -> LeastSquares:
    """Returns one of the problems that are known to hurt."""
    random = seeded(hash_of(kind))
    matrix, light = random(POINTS, COLUMNS), random(PHOTOS, 3, COLUMNS) ** 6
    noise = 0.01 * (random(PHOTOS, 3, POINTS) - 0.5)
    if kind in ("like a transport", "masks"):
        matrix = torch.sigmoid((torch.linspace(0, 1, POINTS, dtype=torch.float64)[:, None] - random(COLUMNS)) * 20)
    if kind == "of low rank":
        matrix = random(POINTS, 12) @ random(12, COLUMNS)
    if kind == "equal columns":
        matrix[:, COLUMNS // 2 :] = matrix[:, : COLUMNS // 2]
    if kind == "badly scaled":
        matrix = matrix * 10.0 ** torch.linspace(-8, 8, COLUMNS, dtype=torch.float64)
        light = light / 10.0 ** torch.linspace(-8, 8, COLUMNS, dtype=torch.float64)
    if kind == "more columns than rows":
        matrix, noise = matrix[:20], noise[..., :20]
    samples = light @ matrix.T + noise
    if kind == "dark":
        samples = torch.zeros_like(samples)
    if kind == "noise alone":
        samples = random(PHOTOS, 3, POINTS) - 0.5
    if kind == "nothing but negative":
        samples = -samples
    if kind == "one is broken":
        samples[4, 1, 7], samples[2] = torch.nan, 0.0
    weights = (random(PHOTOS, POINTS) > 0.2).double() * (1 + random(PHOTOS, 1)) if kind == "masks" else None
    if weights is not None:
        weights[3, : POINTS // 2 + 10], weights[5], weights[8] = 0.0, 0.0, weights[7]
    return LeastSquares(matrix, samples, weights)


def hash_of(text: str) -> int:
    return sum(text.encode())


KINDS = (
    "random", "like a transport", "of low rank", "equal columns", "badly scaled", "more columns than rows", "dark",
    "noise alone", "nothing but negative", "one is broken", "masks",
)  # fmt: skip


def there(part: LeastSquares, device: torch.device) -> LeastSquares:
    return moved(part, device)


def in_lockstep(monkeypatch: pytest.MonkeyPatch) -> None:
    """Lets the CPU take the code of other devices."""
    monkeypatch.setattr(nnls, "batch_minimizers", lockstep_minimizers)
    monkeypatch.setattr(NonnegativeSynthesis, "_solve_items", lockstep_synthesis)


def assert_same_answers(found: Solution, right: Solution, gap: float) -> None:
    """Compares the objectives, of |b|^2 / 2 = 1, rather than coefficients, which ties leave open; and the statuses."""
    assert found.status.tolist() == right.status.tolist()
    solved = right.status == int(Status.CONVERGED)
    assert_close(
        found.relative_residual.cpu()[solved].square(), right.relative_residual[solved].square(), rtol=0, atol=gap
    )
    assert bool((found.kkt_residual.cpu()[solved] <= 1e-9).all())


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("ridge", [1e-12, 0.0])
def test_nonnegative_least_squares_in_lockstep_has_the_compiled_codes_objective(kind, ridge, device, monkeypatch):
    right = NNLS(ridge).solve(problem(kind))
    in_lockstep(monkeypatch)
    found = NNLS(ridge).solve(there(problem(kind), device))
    assert_same_answers(found, right, 1e-10)
    assert bool((found.coefficients >= 0).all())
    assert found.coefficients.device.type == found.gap.device.type == device.type


@pytest.mark.parametrize("kind", ["random", "like a transport", "masks"])
def test_unique_answers_are_the_same(kind, device, monkeypatch):
    ridge = 1e-3  # w is exact to 1e-11, so that x is to 1e-11 / ridge times the root of the number of columns
    right = NNLS(ridge).solve(problem(kind))
    in_lockstep(monkeypatch)
    found = NNLS(ridge).solve(there(problem(kind), device))
    assert_close(found.coefficients.cpu(), right.coefficients, rtol=0, atol=1e-7 * float(right.coefficients.max()))


@pytest.mark.parametrize("room", [1, 2**26], ids=["an item at a time", "all at once"])
def test_memory_for_fewer_items_changes_nothing(room, monkeypatch):
    right = NNLS().solve(problem("masks"))
    in_lockstep(monkeypatch)
    monkeypatch.setattr(device_steps, "ENTRIES_PER_CALL", room)
    monkeypatch.setattr(device_nnls, "ENTRIES_PER_CALL", room)
    assert_same_answers(NNLS().solve(problem("masks")), right, 1e-10)


def test_too_few_steps_are_said(device, monkeypatch):
    in_lockstep(monkeypatch)
    found = NNLS(max_steps=1).solve(there(problem("like a transport"), device))
    assert int(Status.STOPPED_SHORT) in found.status.flatten().tolist()
    assert found.steps.max() == 1


def test_cold_start_with_little_room_ends_where_the_twin_does(monkeypatch):
    monkeypatch.setattr(device_steps, "STEPS_PER_CHECK", 40)  # long enough to give up for want of room
    random = seeded(5)
    columns = torch.nn.functional.normalize(random(300, 150) - 0.5, dim=0)
    gram, linear = columns.T @ columns, (random(6, 150) - 0.2) / 10
    limits = Limits(1e-11, 5000)
    found, _ = minimizers(alike(gram, linear), torch.zeros_like(linear), 1e-12, limits)
    right = [minimize_nonnegative(gram, c, torch.zeros_like(c), 1e-12, limits)[0] for c in linear]
    assert (found > 0).sum(dim=1).max() > 2 * device_steps.LEAST_ROOM  # it had to ask for room
    assert_close(found, torch.stack(right), rtol=0, atol=1e-9)


def test_item_ends_by_itself_where_float64_is_exhausted():
    random = seeded(7)
    columns = torch.nn.functional.normalize(random(90, 60), dim=0)
    gram, linear = columns.T @ columns, torch.nn.functional.normalize(random(8, 90), dim=1) @ columns
    _, steps = minimizers(alike(gram, linear), torch.zeros_like(linear), 1e-12, Limits(0.0, 500))
    assert steps.max() < 100


@pytest.mark.parametrize("name", ["elsewhere", "cuda"])
def test_host_is_asked_nothing_between_two_checks(name):
    if name == "cuda" and not torch.cuda.is_available():
        pytest.skip("no CUDA device")
    other = elsewhere.register() if name == "elsewhere" else torch.device("cuda")
    random = seeded(6)
    columns = torch.nn.functional.normalize(random(90, 60), dim=0)
    gram, linear = (columns.T @ columns).to(other), (random(8, 90) @ columns).to(other)
    rules = Rules(1e-12, Limits(1e-11, 100), torch.tensor(STEP_LENGTHS, dtype=torch.float64).to(other))
    programs, state = alike(gram, linear), beginning(alike(gram, linear), torch.zeros_like(linear), rules)
    with forbidden_on_cuda(other), elsewhere.counting() as waits:
        after = stepped(programs, state, 60, rules)
    assert not waits
    assert int(after.steps.min()) > 0


@contextmanager
def forbidden_on_cuda(device: torch.device) -> Iterator[None]:
    """Makes CUDA raise wherever the host waits for it."""
    if device.type == "cuda":
        torch.cuda.set_sync_debug_mode("error")
    yield
    if device.type == "cuda":
        torch.cuda.set_sync_debug_mode("default")


def test_waits_do_not_grow_with_the_number_of_photographs(monkeypatch):
    device, counts = elsewhere.register(), []
    for photos in (2, 10):
        some = problem("random")
        some = LeastSquares(some.matrix, some.samples[:photos])
        with elsewhere.counting() as waits:
            NNLS().solve(there(some, device))
        counts.append(sum(waits.values()))
    assert max(counts) <= min(counts) + 2  # another check of what has ended, or two


def test_device_that_is_not_there_counts_and_refuses():
    device = elsewhere.register()
    here = torch.arange(3.0, device=device)
    with elsewhere.counting() as waits:
        assert bool((here > 1).any())
        here.cpu()
        here[here > 1].sum().item()
    assert sum(waits.values()) == 4
    with pytest.raises(RuntimeError, match="same device"):
        torch.add(here, torch.ones(3))
    with pytest.raises(RuntimeError, match="numpy"):
        here.numpy()


@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize("proximity", [1e-13, 1e-3], ids=["one round", "several rounds"])
def test_synthesis_in_lockstep_is_that_of_one_item_after_another(proximity, masked, device, monkeypatch):
    random = seeded(8)
    places = torch.linspace(-1, 1, 30, dtype=torch.float64)[:, None]
    synthesis = torch.cos(places.acos() * torch.arange(6))  # polynomials that must not be negative at 30 places
    matrix = random(50, 30) @ synthesis / 30
    samples = matrix @ torch.tensor([1.0, 0.5, 1.0, 0.0, 0.5, 0.3], dtype=torch.float64) + 0.05 * random(6, 3, 50)
    samples[2], samples[3] = 0.0, random(3, 50) - 0.5
    weights = (random(6, 50) > 0.1).double() if masked else torch.ones(6, 50, dtype=torch.float64)
    asked = LeastSquares(matrix, samples, weights, synthesis)
    right = NonnegativeSynthesis(proximity).solve(asked)
    assert right.status.tolist() == [[0] * 3] * 6
    in_lockstep(monkeypatch)
    found = NonnegativeSynthesis(proximity).solve(there(asked, device))
    assert_same_answers(found, right, 1e-9)
    assert_close(
        found.coefficients.cpu(), right.coefficients, rtol=0, atol=1e-7 * float(right.coefficients.abs().max())
    )
