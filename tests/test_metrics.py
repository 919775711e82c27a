"""Residuals by hand, and what a weight of 0 keeps out of them."""

from __future__ import annotations

import math

import pytest
import torch
from torch.testing import assert_close

from torchlight.metrics import brightest, fit_scale, rms_255, rms_relative

NAN = float("nan")
OBSERVED = torch.tensor([[2.0, 4.0, 9.0], [1.0, 3.0, 9.0]])
PREDICTED = torch.tensor([[3.0, 4.0, 0.0], [1.0, 1.0, 0.0]])
WEIGHTS = torch.tensor([1.0, 1.0, 0.0])


def test_rms_255_by_hand() -> None:
    """Residuals 1, 0, 0, -2 over two points and two channels; the largest valid value is 4."""
    assert_close(rms_255(PREDICTED, OBSERVED, WEIGHTS), torch.tensor(255 * math.sqrt(5 / 4) / 4))


def test_rms_relative_by_hand() -> None:
    assert_close(rms_relative(PREDICTED, OBSERVED, WEIGHTS), torch.tensor(math.sqrt(5 / 30)))


def test_fit_scale_by_hand() -> None:
    """Least squares per channel: (3 2 + 4 4) / (9 + 16) and (1 + 3) / 2."""
    scale = fit_scale(PREDICTED, OBSERVED, WEIGHTS)
    assert_close(scale, torch.tensor([22 / 25, 2.0]))
    better = rms_255(PREDICTED * scale[:, None], OBSERVED, WEIGHTS)
    for factor in (0.99, 1.01):
        assert rms_255(PREDICTED * scale[:, None] * factor, OBSERVED, WEIGHTS) > better


def test_brightest_is_the_largest_valid_value() -> None:
    assert_close(brightest(OBSERVED, WEIGHTS), torch.tensor(4.0))
    assert brightest(OBSERVED, torch.zeros(3)).isnan()
    assert brightest(-OBSERVED, WEIGHTS).isnan()
    assert brightest(torch.zeros(3, 3), WEIGHTS).isnan()


@pytest.mark.parametrize("junk", [NAN, float("inf"), 1e30])
def test_nothing_under_a_weight_of_zero_counts(junk: float) -> None:
    predicted, observed = PREDICTED.clone(), OBSERVED.clone()
    predicted[:, 2], observed[:, 2] = -junk, junk
    for measure in (rms_255, rms_relative, fit_scale):
        assert_close(measure(predicted, observed, WEIGHTS), measure(PREDICTED, OBSERVED, WEIGHTS))


def test_weights_say_which_points_are_valid_and_not_how_much_they_count() -> None:
    assert_close(rms_255(PREDICTED, OBSERVED, 0.1 * WEIGHTS), rms_255(PREDICTED, OBSERVED, WEIGHTS))


def test_no_valid_point_gives_no_number() -> None:
    for measure in (rms_255, rms_relative, fit_scale):
        assert measure(PREDICTED, OBSERVED, torch.zeros(3)).isnan().all()


@pytest.mark.parametrize("batch", [(), (2,), (2, 3)])
def test_a_batch_gives_each_item_s_own_number(batch: tuple[int, ...]) -> None:
    generator = torch.Generator().manual_seed(0)
    predicted, observed = (torch.rand(*batch, 3, 20, generator=generator, dtype=torch.float64) for _ in range(2))
    weights = (torch.rand(*batch, 20, generator=generator) > 0.3).double()
    for measure in (rms_255, rms_relative, fit_scale):
        found = measure(predicted, observed, weights)
        assert found.shape == ((*batch, 3) if measure is fit_scale else batch)
        alone = [
            measure(p, o, w)
            for p, o, w in zip(
                predicted.reshape(-1, 3, 20), observed.reshape(-1, 3, 20), weights.reshape(-1, 20), strict=True
            )
        ]
        assert_close(found.reshape(len(alone), -1), torch.stack(alone).reshape(len(alone), -1))


def test_small_values_in_float32_do_not_vanish() -> None:
    """Squares of 1e-25 underflow float32; the sums are taken in float64."""
    tiny = 1e-25
    assert_close(rms_255(PREDICTED * tiny, OBSERVED * tiny, WEIGHTS), rms_255(PREDICTED, OBSERVED, WEIGHTS))
    assert_close(fit_scale(PREDICTED * tiny, OBSERVED * tiny, WEIGHTS), fit_scale(PREDICTED, OBSERVED, WEIGHTS))
