"""The most even light that a photograph allows: closed forms, derivatives by autograd, equations of the minimum."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

from torchlight.analysis.evenness import Facts, bends, even_light, evenest, scales_of, unevenness

SCALES = scales_of(8)
TEXELS = 192
SHARED = (0, 0, 0)
APART = (0, 1, 2)


def drawn(seed: int) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.rand(TEXELS, generator=generator, dtype=torch.float64) + 0.2


def facts(rows: Tensor, truth: Tensor, sigma: float) -> Facts:
    """What rows tell without noise, round a light that explains them badly."""
    start = torch.ones_like(truth)
    gram = rows.T @ rows / sigma**2
    level = float((rows.sum(dim=0) * truth).sum() / rows.sum())
    return Facts(gram, rows.T @ (rows @ (truth - start)) / sigma**2, start, level)


def few_rows() -> Tensor:
    generator = torch.Generator().manual_seed(5)
    return torch.rand(40, TEXELS, generator=generator, dtype=torch.float64) * SCALES.areas


def entropies(x: Tensor, level: float) -> list[Tensor]:
    """D_j / l as they are written down, square by square."""
    found = []
    for j, square in enumerate(SCALES.square):
        total = x.new_zeros(())
        for q in range(SCALES.counts[j]):
            here = square == q
            area = SCALES.areas[here].sum()
            mean = (SCALES.areas * x)[here].sum() / area
            if j == 0:
                total = total + area * (mean * (mean / level).log() + level - mean)
                continue
            around = SCALES.square[j - 1] == SCALES.square[j - 1][here][0]
            above = (SCALES.areas * x)[around].sum() / SCALES.areas[around].sum()
            total = total + area * mean * (mean / above).log()
        found.append(total / level)
    return found


def test_scales_are_nested_squares_from_twelve_to_the_texels() -> None:
    assert SCALES.counts == (12, 48, 192)
    assert SCALES.dimensions == [12, 36, 144]
    assert_close(SCALES.areas.sum(), torch.tensor(1.0, dtype=torch.float64))
    for coarse, fine in zip(SCALES.square[:-1], SCALES.square[1:], strict=True):
        pairs = torch.stack([fine, coarse]).unique(dim=1)
        assert pairs.shape[1] == int(fine.max()) + 1  # each square lies within one


def test_unevenness_is_the_relative_entropy_of_every_scale() -> None:
    x = drawn(1)
    _, found = unevenness(x, SCALES, 0.7)
    assert_close(found, torch.stack(entropies(x, 0.7)))


def test_scales_together_are_the_entropy_against_an_even_sky() -> None:
    x, level = drawn(2), 0.7
    _, found = unevenness(x, SCALES, level)
    whole = (SCALES.areas * (x * (x / level).log() - x + level)).sum() / level
    assert_close(found.sum(), whole)


def test_gradients_and_second_derivatives_are_those_of_autograd() -> None:
    x = drawn(3).requires_grad_()
    gradients, _ = unevenness(x.detach(), SCALES, 0.7)
    second = bends(x.detach(), SCALES, 0.7)
    for j, value in enumerate(entropies(x, 0.7)):
        (gradient,) = torch.autograd.grad(value, x, create_graph=True)
        assert_close(gradients[j], gradient.detach())
        direction = drawn(4) - 0.7
        (along,) = torch.autograd.grad(gradient @ direction, x)
        assert_close(second[j] @ direction, along)


@pytest.mark.parametrize("shared", [SHARED, APART])
def test_where_nothing_is_told_the_sky_is_even(shared: tuple[int, ...]) -> None:
    nothing = torch.zeros(TEXELS, TEXELS, dtype=torch.float64)
    x, _ = evenest(Facts(nothing, nothing[0], drawn(5), 0.7), SCALES, shared)
    assert_close(x, torch.full_like(x, 0.7))


@pytest.mark.parametrize("shared", [SHARED, APART])
def test_where_everything_is_told_it_is_kept(shared: tuple[int, ...]) -> None:
    truth = drawn(6)
    rows = torch.diag(SCALES.areas)
    x, _ = evenest(facts(rows, truth, 1e-7), SCALES, shared)
    assert_close(x, truth, atol=1e-4, rtol=0)  # the prior's pull at a thousandth of the radiance's noise


@pytest.mark.parametrize("shared", [SHARED, APART])
def test_the_minimum_and_the_evidence_hold(shared: tuple[int, ...]) -> None:
    given = facts(few_rows(), drawn(7) ** 4, 1e-4)
    x, alphas = evenest(given, SCALES, shared)
    place = torch.tensor(shared)
    gradients, uneven = unevenness(x, SCALES, given.level)
    gradient = given.gram @ (x - given.start) - given.slopes + alphas[place] @ gradients
    size = (alphas[place] @ gradients.abs()).max()
    assert float(gradient.abs().max()) < 0.02 * float(size)  # alpha moved by a few per cent after the last step
    curved = bends(x, SCALES, given.level)
    hessian = given.gram + sum(alphas[place[j]] * bend for j, bend in enumerate(curved))
    inverse = torch.linalg.inv(hessian)
    for number, alpha in enumerate(alphas.tolist()):
        mine = [j for j, which in enumerate(shared) if which == number]
        told = sum(SCALES.dimensions[j] - alpha * float((inverse * curved[j]).sum()) for j in mine)
        assert 2 * alpha * float(uneven[mine].sum()) == pytest.approx(told, rel=0.06)  # settled to 5 %


def test_the_photograph_is_explained_and_the_rest_is_nearer_the_truth() -> None:
    """Rows that hardly see half of the texels; a light that explains them and is wild there."""
    rows = few_rows()
    rows[:, ::2] *= 0.02
    truth = 1 + 0.3 * torch.linspace(-1, 1, TEXELS, dtype=torch.float64)
    wild = truth.clone()
    wild[::2] = 40 * drawn(8)[::2] ** 6
    wild[1::2] += torch.linalg.lstsq(rows[:, 1::2], rows[:, ::2] @ (truth - wild)[::2]).solution
    sigma = 1e-3 * float((rows @ truth).max())
    level = float((rows @ truth).sum() / rows.sum())
    given = Facts(rows.T @ rows / sigma**2, torch.zeros_like(truth), wild, level)
    x = even_light(given, SCALES)
    assert float((rows @ (x - truth)).square().mean().sqrt()) < sigma
    off, before = (float((light - truth).square().mean().sqrt()) for light in (x, wild))
    assert off < 0.2
    assert before > 1.0


def test_a_black_channel_stays_as_it_is() -> None:
    nothing = torch.zeros(TEXELS, dtype=torch.float64)
    assert_close(even_light(Facts(torch.eye(TEXELS).double(), nothing, nothing, 0.0), SCALES), nothing)
