"""The fall-off of the unshadowed plane: a known quadratic in log brightness, found again outside a shadow."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

from torchlight.errors import ConfigError
from torchlight.geometry.receiver import Receiver, sample_centers
from torchlight.photo.observation import Observation
from torchlight.photo.reference import Reference, divide, photographed, quadratic_terms, smooth, stack, upper_median

RECEIVER = Receiver((30.0, -10.0), (400.0, 300.0), (32, 24))
POSITIONS = sample_centers(RECEIVER)
COEFFICIENTS = torch.tensor([[0.0, 0.3, -0.2, -0.4, 0.1, -0.25], [0.0, -0.1, 0.1, -0.2, 0.0, -0.1], [0.0] * 6])
WITHIN = (POSITIONS - torch.tensor(RECEIVER.center)) / (torch.tensor(RECEIVER.size) / 2)


def known_falloff() -> Tensor:
    """exp of a quadratic in the receiver's own [-1, 1] coordinates, three channels, mean 1."""
    x, y = WITHIN.unbind(dim=-1)
    terms = torch.stack([torch.ones_like(x), x, y, x * x, x * y, y * y])
    values = (COEFFICIENTS.double() @ terms).exp()
    return values / values.mean(dim=-1, keepdim=True)


def hard_shadow(share: float, depth: float) -> Tensor:
    """A factor per sample: `depth` on the band of x that covers this share of the receiver, else 1."""
    x = WITHIN[:, 0]
    inside = (x > -0.2) & (x < -0.2 + 2 * share)
    return torch.where(inside, torch.full_like(x, depth), torch.ones_like(x))


def observed(values: Tensor) -> Observation:
    return Observation(values, torch.ones_like(values[..., 0, :]))


@pytest.mark.parametrize("share", [0.0, 0.03, 0.15])
@pytest.mark.parametrize("depth", [0.01, 0.15, 0.5])
def test_a_known_falloff_is_recovered_under_a_hard_shadow(share: float, depth: float) -> None:
    falloff = known_falloff()
    shadow = hard_shadow(share, depth)
    found = smooth(observed(0.37 * falloff * shadow), POSITIONS).falloff
    lit = divide(observed(0.37 * falloff * shadow), Reference(found)).samples
    # the shape is exact; the mean over all samples, shadow included, sets the level
    assert_close(found / found.mean(dim=-1, keepdim=True), falloff, rtol=1e-6, atol=0)
    assert_close(lit / lit.amax(dim=-1, keepdim=True), shadow.expand_as(lit), rtol=1e-6, atol=0)
    assert_close(found.mean(dim=-1), torch.ones(3, dtype=torch.float64))


def test_noise_of_a_percent_costs_less_than_a_percent() -> None:
    generator = torch.Generator().manual_seed(3)
    noise = (0.01 * torch.randn(3, RECEIVER.points, generator=generator, dtype=torch.float64)).exp()
    found = smooth(observed(known_falloff() * hard_shadow(0.15, 0.15) * noise), POSITIONS).falloff
    assert_close(found / found.mean(dim=-1, keepdim=True), known_falloff(), rtol=0.01, atol=0)


def test_glints_are_left_out() -> None:
    values = known_falloff()
    values[:, 100:110] *= 5
    found = smooth(observed(values), POSITIONS).falloff
    assert_close(found / found.mean(dim=-1, keepdim=True), known_falloff(), rtol=1e-6, atol=0)


def test_samples_of_weight_zero_and_black_samples_play_no_part() -> None:
    values, weights = known_falloff() * 0.5, torch.ones(RECEIVER.points, dtype=torch.float64)
    weights[:100] = 0
    values[:, :100] = float("nan")
    values[:, 100:110] = 0.0
    found = smooth(Observation(values, weights), POSITIONS).falloff
    assert found.isfinite().all()
    assert_close(found / found.mean(dim=-1, keepdim=True), known_falloff(), rtol=1e-6, atol=0)


def test_too_few_samples_leave_the_photograph_as_it_is() -> None:
    values = known_falloff()
    weights = torch.zeros(RECEIVER.points, dtype=torch.float64)
    weights[:23] = 1
    assert_close(smooth(Observation(values, weights), POSITIONS).falloff, torch.ones_like(values))


@pytest.mark.parametrize("batch", [(2,), (2, 2)])
def test_each_photograph_and_channel_has_its_own_fit(batch: tuple[int, ...]) -> None:
    generator = torch.Generator().manual_seed(1)
    level = torch.rand(*batch, 1, 1, generator=generator, dtype=torch.float64) + 0.1
    power = torch.rand(*batch, 3, 1, generator=generator, dtype=torch.float64)
    values = level * known_falloff() ** power
    found = smooth(observed(values), POSITIONS).falloff
    assert found.shape == values.shape
    assert_close(
        divide(observed(values), Reference(found)).samples, values.mean(dim=-1, keepdim=True).expand_as(values)
    )


def test_division_keeps_the_weights() -> None:
    weights = torch.tensor([1.0, 0.0])
    found = divide(Observation(torch.tensor([[6.0, 0.0]]), weights), Reference(torch.tensor([[2.0, 4.0]])))
    assert_close(found.samples, torch.tensor([[3.0, 0.0]]))
    assert torch.equal(found.weights, weights)


def test_terms_do_not_depend_on_the_unit_or_the_place() -> None:
    moved = 25.4 * POSITIONS + torch.tensor([1000.0, -7.0], dtype=torch.float64)
    assert_close(quadratic_terms(moved), quadratic_terms(POSITIONS))
    corners = quadratic_terms(torch.tensor([[0.0, 0.0], [2.0, 1.0]]))
    assert_close(corners, torch.tensor([[1.0, -1, -1, 1, 1, 1], [1, 1, 1, 1, 1, 1]]))


def test_a_single_row_of_samples_is_fitted_along_its_length() -> None:
    positions = sample_centers(Receiver((0.0, 0.0), (4.0, 1.0), (64, 1)))
    x = positions[:, 0] / 2
    values = (0.3 * x - 0.2 * x * x).exp().expand(3, -1)
    found = smooth(observed(values), positions).falloff
    assert_close(found, values / values.mean(dim=-1, keepdim=True))


def blotches() -> Tensor:
    """An albedo or vignetting that no polynomial follows: random, from 0.2 to 1, per channel and sample."""
    generator = torch.Generator().manual_seed(5)
    return 0.2 + 0.8 * torch.rand(3, RECEIVER.points, generator=generator, dtype=torch.float64)


def test_a_photograph_of_the_empty_plane_removes_every_factor_exactly() -> None:
    """v = albedo vignetting E / pi, and the same without the object at another exposure per channel."""
    factor, shadow = blotches(), hard_shadow(0.3, 0.2) * (1 - 0.3 * WITHIN[:, 1] ** 2)
    exposure = torch.tensor([[0.5], [2.0], [7.0]], dtype=torch.float64)
    photo, empty = observed(0.4 * factor * shadow), observed(exposure * factor)
    found = divide(photo, photographed(empty, photo))
    level = 0.4 * factor.mean(dim=-1, keepdim=True)
    assert_close(found.samples, level * shadow, rtol=1e-12, atol=0)
    assert_close(found.weights, photo.weights)


@pytest.mark.parametrize("batch", [(2,), (2, 3)])
def test_one_empty_plane_serves_a_batch(batch: tuple[int, ...]) -> None:
    generator = torch.Generator().manual_seed(1)
    light = torch.rand(*batch, 3, RECEIVER.points, generator=generator, dtype=torch.float64) + 0.1
    photo, empty = observed(blotches() * light), observed(blotches())
    found = divide(photo, photographed(empty, photo)).samples
    assert_close(found, blotches().mean(dim=-1, keepdim=True) * light, rtol=1e-12, atol=0)


def test_samples_that_the_empty_plane_does_not_show_are_left_out() -> None:
    weights = torch.ones(RECEIVER.points, dtype=torch.float64)
    weights[:50] = 0
    values = blotches()
    values[:, :50] = 0
    values[1, 60] = 0  # black in one channel: no ratio
    photo = observed(blotches())
    found = divide(photo, photographed(Observation(values, weights), photo))
    assert found.weights[:50].sum() == 0
    assert found.weights[60] == 0
    assert found.weights.sum() == RECEIVER.points - 51
    assert found.samples.isfinite().all()
    kept = found.weights > 0
    assert_close(found.samples[:, kept].std(dim=-1), torch.zeros(3, dtype=torch.float64), rtol=0, atol=1e-12)


def moved_shadows(photos: int) -> tuple[Tensor, Tensor]:
    """Photographs of a blotchy plane at random exposures; a shadow of a quarter of it in another place each time."""
    generator = torch.Generator().manual_seed(2)
    exposure = (0.5 + torch.rand(photos, 3, 1, generator=generator, dtype=torch.float64)) * 3
    x = WITHIN[:, 0]
    place = torch.linspace(-1, 0.5, photos, dtype=torch.float64)[:, None]
    shadow = torch.where((x > place) & (x < place + 0.5), 0.2, 1.0).double()[:, None]
    return exposure * blotches() * shadow, shadow


@pytest.mark.parametrize("photos", [4, 5, 8])
def test_a_stack_finds_the_plane_between_moving_shadows_exactly(photos: int) -> None:
    values, shadow = moved_shadows(photos)
    plane = stack(Observation(values, torch.ones(photos, RECEIVER.points, dtype=torch.float64)))
    ratio = plane.samples / blotches()
    assert_close(ratio, ratio[:, :1].expand_as(ratio), rtol=1e-9, atol=0)
    first = Observation(values[0], torch.ones(RECEIVER.points, dtype=torch.float64))
    lit = divide(first, photographed(plane, first)).samples
    assert_close(lit / lit.amax(dim=-1, keepdim=True), shadow[0].expand_as(lit), rtol=1e-9, atol=0)


def test_samples_that_too_few_photographs_show_are_left_out() -> None:
    values, _ = moved_shadows(5)
    weights = torch.ones(5, RECEIVER.points, dtype=torch.float64)
    weights[:3, 7], weights[:2, 8] = 0, 0
    plane = stack(Observation(values, weights))
    assert plane.weights[7] == 0
    assert plane.weights.sum() == RECEIVER.points - 1


def test_a_stack_needs_three_photographs() -> None:
    values, _ = moved_shadows(2)
    for samples, weights in ((values, values[:, 0]), (values[0], values[0, 0])):
        with pytest.raises(ConfigError, match="stack needs at least 3 photographs in which the object moved"):
            stack(Observation(samples, weights))


def test_upper_median() -> None:
    nan = float("nan")
    values = torch.tensor([[1.0, 4, nan, nan], [2, 3, 5, nan], [3, 2, 6, nan], [4, 1, nan, nan]])[:, None]
    assert_close(upper_median(values), torch.tensor([[3.0, 3, 6, nan]]), equal_nan=True)
    assert_close(upper_median(values[:3]), torch.tensor([[2.0, 3, 6, nan]]), equal_nan=True)


def test_the_level_is_the_mean_over_samples_that_both_show() -> None:
    photo = Observation(blotches(), (torch.arange(RECEIVER.points) >= 300).double())
    found = divide(photo, photographed(observed(blotches()), photo))
    level = blotches()[:, 300:].mean(dim=-1, keepdim=True)
    assert_close(found.samples[:, 300:], level.expand(-1, RECEIVER.points - 300), rtol=1e-12, atol=0)
