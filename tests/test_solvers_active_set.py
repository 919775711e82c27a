"""The core ends on its own, whatever Gram matrix it is given."""

from __future__ import annotations

from itertools import pairwise

import pytest
import torch

from torchlight.solvers.active_set import Limits, minimize_nonnegative, violation


def gram_problem(seed: int, rows: int, columns: int) -> tuple[torch.Tensor, torch.Tensor]:
    g = torch.Generator().manual_seed(seed)
    matrix = torch.randn(rows, columns, generator=g, dtype=torch.float64)
    matrix = torch.nn.functional.normalize(torch.cat([matrix, matrix], dim=1), dim=0)
    target = torch.nn.functional.normalize(torch.randn(rows, generator=g, dtype=torch.float64), dim=0)
    return matrix.T @ matrix, target @ matrix


@pytest.mark.parametrize("most_entrants", [1, 1000])
@pytest.mark.parametrize("seed", range(5))
def test_dependent_columns_end_at_a_stationary_point(seed, most_entrants):
    gram, linear = gram_problem(seed, 10, 30)
    x, steps = minimize_nonnegative(gram, linear, torch.zeros(60).double(), 0.0, Limits(1e-12, 1000, most_entrants))
    assert steps < 1000
    assert x.min().item() >= 0
    assert violation(x > 0, linear - gram @ x) <= 1e-12


def test_single_entries_keep_the_passive_columns_independent():
    gram, linear = gram_problem(0, 10, 30)
    x, _ = minimize_nonnegative(gram, linear, torch.zeros(60).double(), 0.0, Limits(1e-12, 1000, 1))
    passive = x > 0
    assert 0 < int(passive.sum()) <= 10
    assert torch.linalg.eigvalsh(gram[passive][:, passive])[0].item() > 1e-8


def test_objective_falls_at_every_step_and_a_warm_start_needs_none():
    gram, linear = gram_problem(1, 40, 25)
    values, x, steps = [], torch.zeros(50).double(), 0
    for limit in range(0, 40):
        x, steps = minimize_nonnegative(gram, linear, torch.zeros(50).double(), 1e-12, Limits(1e-11, limit))
        values.append((x @ gram @ x / 2 - linear @ x).item())
    assert all(after <= before + 1e-15 for before, after in pairwise(values))
    assert values[-1] < values[0]
    assert steps < 39
    again, steps = minimize_nonnegative(gram, linear, x, 1e-12, Limits(1e-11, 100))
    assert steps == 0
    torch.testing.assert_close(again, x, rtol=0, atol=0)


def test_indefinite_gram_matrix_never_raises():
    gram, linear = gram_problem(2, 10, 30)
    gram.diagonal().sub_(1e-9)
    x, steps = minimize_nonnegative(gram, linear, torch.zeros(60).double(), 0.0, Limits(1e-12, 200))
    assert steps <= 200
    assert bool(torch.isfinite(x).all())
