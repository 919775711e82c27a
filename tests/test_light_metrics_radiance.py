"""Errors of radiance against plain loops in numpy, and by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torch.testing import assert_close

from torchlight.light_metrics import radiance as measures
from torchlight.light_metrics.radiance import (
    channel_scale_invariant_rmse,
    colour_angle,
    log_rmse,
    relative_error,
    relative_rmse,
    rmse,
    scale_invariant_rmse,
)

CLOSE = 1e-9


def lights(*batch: int) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(5)
    x, y = (torch.rand(*batch, 3, 30, generator=generator, dtype=torch.float64).exp2() - 1 for _ in range(2))
    return x, y, torch.rand(30, generator=generator, dtype=torch.float64)


def loop_rmse(x: np.ndarray, y: np.ndarray, w: np.ndarray) -> float:
    total = weight = 0.0
    for c in range(x.shape[0]):
        for p in range(x.shape[1]):
            total += w[p] * (x[c, p] - y[c, p]) ** 2
            weight += w[p]
    return math.sqrt(total / weight)


def test_equal_to_plain_loops() -> None:
    tensors = lights()
    x, y, w = (t.numpy() for t in tensors)
    assert float(rmse(*tensors)) == pytest.approx(loop_rmse(x, y, w), rel=CLOSE)
    assert float(relative_rmse(*tensors)) == pytest.approx(loop_rmse(x, y, w) / loop_rmse(y, 0 * y, w), rel=CLOSE)
    mean = sum(w[p] * y[c, p] for c in range(3) for p in range(30)) / (3 * w.sum())
    logs = [np.array([[math.log2(v + 1e-3 * mean) for v in row] for row in image]) for image in (x, y)]
    assert float(log_rmse(*tensors)) == pytest.approx(loop_rmse(logs[0], logs[1], w), rel=CLOSE)
    angles = [
        math.degrees(math.acos(x[:, p] @ y[:, p] / math.hypot(*x[:, p]) / math.hypot(*y[:, p]))) for p in range(30)
    ]
    assert float(colour_angle(*tensors)) == pytest.approx(float(np.average(angles, weights=w)), rel=1e-6)  # of acos


def test_scales_are_those_of_least_squares() -> None:
    tensors = lights()
    x, y, w = (t.numpy() for t in tensors)
    root = np.sqrt(w)
    (scale,), *_ = np.linalg.lstsq((x * root).reshape(-1, 1), (y * root).reshape(-1), rcond=None)
    found = scale_invariant_rmse(*tensors)
    assert float(found.scale) == pytest.approx(float(scale), rel=CLOSE)
    assert float(found.rmse) == pytest.approx(loop_rmse(scale * x, y, w), rel=CLOSE)
    scales = [np.linalg.lstsq((x[c] * root)[:, None], y[c] * root, rcond=None)[0][0] for c in range(3)]
    found = channel_scale_invariant_rmse(*tensors)
    assert found.scale.tolist() == pytest.approx(scales, rel=CLOSE)
    assert float(found.rmse) == pytest.approx(loop_rmse(np.array(scales)[:, None] * x, y, w), rel=CLOSE)


def test_closed_forms() -> None:
    """A light 0.5 too bright everywhere; one twice too bright; one with channels of its own scale; black."""
    _, y, w = lights()
    assert float(rmse(y + 0.5, y, w)) == pytest.approx(0.5, rel=CLOSE)
    assert float(relative_rmse(2 * y, y, w)) == pytest.approx(1, rel=CLOSE)
    assert float(log_rmse(2 * y + 1e9, y + 5e8, w, 1e-15)) == pytest.approx(1, rel=1e-6)  # the offset's share
    factors = torch.tensor([2.0, 0.5, 4.0], dtype=torch.float64)[:, None]
    assert_close(channel_scale_invariant_rmse(factors * y, y, w).scale, 1 / factors[:, 0])
    assert float(channel_scale_invariant_rmse(factors * y, y, w).rmse) == pytest.approx(0, abs=1e-12)
    assert float(scale_invariant_rmse(factors * y, y, w).rmse) > 0.01
    black = scale_invariant_rmse(0 * y, y, w)
    assert float(black.scale) == 0
    assert_close(black.rmse, rmse(0 * y, y, w))
    assert log_rmse(y, 0 * y, w).isnan()
    assert_close(
        relative_error(torch.tensor(1.1), torch.tensor(1.0)), torch.tensor(0.1, dtype=torch.float64), atol=1e-7, rtol=0
    )


def test_scale_invariance() -> None:
    x, y, w = lights()
    for measure in (scale_invariant_rmse, channel_scale_invariant_rmse):
        assert_close(measure(7.3 * x, y, w).rmse, measure(x, y, w).rmse)
        assert_close(measure(7.3 * x, y, w).scale, measure(x, y, w).scale / 7.3)
    assert_close(colour_angle(7.3 * x, y, w), colour_angle(x, y, w))


def test_colour_angles_by_hand() -> None:
    """Red against yellow is 45 degrees, against blue 90; black pixels have no colour; tiny angles keep their digits."""
    red, yellow, blue = (torch.tensor(v, dtype=torch.float64) for v in ([2.0, 0, 0], [1.0, 1, 0], [0, 0, 3.0]))
    x = torch.stack([red, red, 0 * red], dim=-1)
    y = torch.stack([yellow, blue, blue], dim=-1)
    assert float(colour_angle(x, y, torch.tensor([3.0, 1.0, 9.0]))) == pytest.approx((3 * 45 + 90) / 4, rel=CLOSE)
    near = red + torch.tensor([0, 1e-10, 0], dtype=torch.float64)
    assert float(colour_angle(red[:, None], near[:, None], torch.ones(1))) == pytest.approx(
        math.degrees(5e-11), rel=1e-5
    )
    assert colour_angle(0 * x, y, torch.ones(3)).isnan()


def test_weight_0_is_left_out() -> None:
    x, y, w = lights()
    w[7] = 0
    changed = x.clone()
    changed[:, 7] = 1e6
    for name in ("rmse", "relative_rmse", "log_rmse", "colour_angle"):
        assert_close(getattr(measures, name)(changed, y, w), getattr(measures, name)(x, y, w))


@pytest.mark.parametrize("batch", [(2,), (2, 3)])
def test_a_batch_gives_each_item_s_own_number(batch: tuple[int, ...]) -> None:
    x, y, w = lights(*batch)
    items = list(zip(x.reshape(-1, 3, 30), y.reshape(-1, 3, 30), strict=True))
    for measure in (rmse, relative_rmse, log_rmse, colour_angle):
        alone = torch.stack([measure(a, b, w) for a, b in items])
        assert_close(measure(x, y, w), alone.reshape(batch))
    for measure in (scale_invariant_rmse, channel_scale_invariant_rmse):
        found = measure(x, y, w)
        assert_close(found.rmse, torch.stack([measure(a, b, w).rmse for a, b in items]).reshape(batch))
        assert found.scale.shape == (batch if measure is scale_invariant_rmse else (*batch, 3))


def test_float32_is_summed_in_float64() -> None:
    x, y, w = lights()
    assert rmse(x.float(), y.float(), w.float()).dtype == torch.float64
    assert_close(rmse(1e-25 * x.float(), 1e-25 * y.float(), w), 1e-25 * rmse(x.float(), y.float(), w))
