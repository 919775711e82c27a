"""docs/extend.md: its basis and its solver are short, and right; that the page runs as it stands is tested with all."""

from __future__ import annotations

import ast
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from torch.testing import assert_close

from torchlight.geometry.analytic_shadow import Block
from torchlight.geometry.receiver import Receiver
from torchlight.light.bases import Basis
from torchlight.light.cubemap import cosine_weights
from torchlight.photo.observation import linear_photo
from torchlight.solvers import LeastSquares, Solver
from torchlight.synthetic import block_scene
from torchlight.transfer import transport

PAGE = (Path(__file__).parent.parent / "docs" / "extend.md").read_text()
BLOCKS = re.findall(r"^```python\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
IMPORTS, PHOTOGRAPH, BASIS, BANDS, SOLVER, COMPARISON = BLOCKS
LINES = 20


@pytest.fixture(scope="module")
def page() -> SimpleNamespace:
    """All names after the page's code has run, but on a small photograph of six bands that are known."""
    scene = block_scene(Block((1.0, 0.6, 1.2), 20.0), Receiver((0.0, 0.0), (4.0, 4.0), (16, 16)))
    transfer = transport(scene, 16, 2)
    names: dict[str, Any] = {"scene": scene, "transfer": transfer}
    exec(IMPORTS + BASIS, names)
    names["truth"] = torch.tensor([[0.1, 0.2, 0.4, 0.7, 0.9, 1.0]]).expand(3, -1) * torch.tensor([[1.0], [0.8], [0.6]])
    values = transfer.mv(names["Bands"](6).synthesis(names["truth"])) / torch.pi
    names["photo"] = linear_photo(values.reshape(3, 16, 16).flip(-2))
    exec(BANDS + SOLVER + COMPARISON, names)
    return SimpleNamespace(**names)


@pytest.mark.parametrize("code", [BASIS, SOLVER], ids=["basis", "solver"])
def test_a_basis_and_a_solver_take_twenty_lines(code: str) -> None:
    (definition,) = ast.parse(code).body
    assert isinstance(definition, ast.ClassDef)
    assert len([line for line in code.splitlines() if line.strip()]) <= LINES


def test_they_are_what_the_protocols_ask_for(page: SimpleNamespace) -> None:
    assert isinstance(page.Bands(6), Basis)
    assert isinstance(page.Multiplicative(), Solver)


def test_the_basis_cuts_the_hemisphere_into_bands(page: SimpleNamespace) -> None:
    matrix = page.Bands(6).synthesis_matrix()
    assert_close(matrix.sum(dim=1), torch.ones(768, dtype=torch.float64))
    coefficients = torch.rand(2, 3, 6, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    assert_close(page.Bands(6).analysis(page.Bands(6).synthesis(coefficients)), coefficients)
    # the integral of cos(theta) over a band of heights [a, b] is pi (b^2 - a^2); texels are assigned whole
    edges = torch.linspace(0, 1, 7, dtype=torch.float64)
    exact = torch.pi * edges.square().diff()
    assert_close(cosine_weights(16, 1)[:, 0] @ matrix, exact, atol=0.06, rtol=0)


def test_the_sky_comes_back_from_its_photograph(page: SimpleNamespace) -> None:
    assert_close(page.bands.solution.coefficients, page.truth, atol=1e-4, rtol=0)
    assert page.bands.rms_255.item() < 0.01


def test_the_solver_comes_close_to_the_exact_one_and_never_below_it(page: SimpleNamespace) -> None:
    assert bool((page.ours.solution.coefficients >= 0).all())
    residual = page.ours.solution.relative_residual.square()
    best = page.exact.solution.relative_residual.square()
    assert bool((residual >= best - 1e-12).all())
    assert bool((residual - best <= page.ours.solution.gap + 1e-9).all())
    page.ours.solution.check()
    assert page.ours.rms_255.item() < 0.5


def test_the_solver_lowers_the_objective_at_every_step(page: SimpleNamespace) -> None:
    generator = torch.Generator().manual_seed(2)
    matrix = torch.rand(30, 8, generator=generator, dtype=torch.float64)
    samples = torch.rand(1, 30, generator=generator, dtype=torch.float64)
    found = [page.Multiplicative(steps=k).solve(LeastSquares(matrix, samples)).relative_residual for k in (1, 2, 5, 50)]
    assert [value.item() for value in found] == sorted((value.item() for value in found), reverse=True)
