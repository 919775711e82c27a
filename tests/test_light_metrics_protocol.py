"""The three-sphere protocol: every published quirk, written out in plain numpy."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch.testing import assert_close

from torchlight.errors import ConfigError
from torchlight.light.environment import EnvironmentMap
from torchlight.light_metrics.protocol import (
    MATERIALS,
    PROTOCOLS,
    Protocol,
    Tone,
    background_pixels,
    check_protocol,
    named_protocol,
    sphere_score,
    sphere_test,
    toned,
)
from torchlight.light_metrics.spheres import SphereView, picture, sphere_view

VIEW = sphere_view(9, (0.0, -16.0, 2.0))
CLOSE = 1e-9


def spheres(view: SphereView = VIEW) -> tuple[torch.Tensor, torch.Tensor]:
    """Returns the pixels of two random spheres, a few of them black."""
    generator = torch.Generator().manual_seed(3)
    x, y = (torch.rand(3, len(view.normals), generator=generator, dtype=torch.float64) * 2 for _ in range(2))
    x[:, 5], y[:, 8] = 0, 0
    return x, y


def whole(values: torch.Tensor, width: int, height: int) -> np.ndarray:
    """Returns the picture [height, width, 4] as a renderer with a transparent film gives it: colour and coverage."""
    size = VIEW.inside.shape[0]
    image = np.zeros((height, width, 4))
    square = np.concatenate([picture(values, VIEW.inside).numpy(), VIEW.inside.numpy()[None]]).transpose(1, 2, 0)
    image[:size, :size] = square
    return image


def test_published_scores_written_out() -> None:
    """StyleLight's numbers on a 30 x 18 picture: what the evaluation does pixel by pixel, with its own conventions."""
    x, y = spheres()
    protocol = replace(PROTOCOLS["stylelight"], frame=(2 * 30 / 9, 2 * 18 / 9))
    score = sphere_score(x, y, protocol, VIEW)
    pred, gt = whole(x, 30, 18), whole(y, 30, 18)
    on = pred[..., 3] > 0
    count = on.sum()
    p, g = pred[on][:, :3], gt[on][:, :3]
    assert float(score.rmse) == pytest.approx(math.sqrt(((p - g) ** 2).sum() / count), rel=CLOSE)
    a, b, c = (p**2).sum(), -2 * (p * g).sum(), (g**2).sum()
    assert float(score.si_rmse) == pytest.approx(math.sqrt((4 * a * c - b * b) / (4 * a) / count), rel=CLOSE)
    assert float(score.scale) == pytest.approx(-b / (2 * a), rel=CLOSE)
    total = 0.0
    for one, other in zip(p, g, strict=True):
        if one.any() and other.any():
            total += math.degrees(math.acos(min(1, one @ other / math.hypot(*one) / math.hypot(*other))))
    assert float(score.angle) == pytest.approx(total / count, rel=1e-6)  # of acos
    low, high = ([np.percentile(i[..., :3], q) for i in (pred, gt)] for q in (0.01, 99.9))
    n = [(i[on][:, :3] - lo) / (hi - lo) for i, lo, hi in zip((pred, gt), low, high, strict=True)]
    assert float(score.norm_rmse) == pytest.approx(math.sqrt(((n[0] - n[1]) ** 2).sum() / count), rel=CLOSE)


def test_plain_scores_written_out() -> None:
    x, y = spheres()
    score = sphere_score(x, y, Protocol(), VIEW)
    p, g = x.numpy().T, y.numpy().T
    assert float(score.rmse) == pytest.approx(math.sqrt(np.mean((p - g) ** 2)), rel=CLOSE)
    scale = (p * g).sum() / (p * p).sum()
    assert float(score.si_rmse) == pytest.approx(math.sqrt(np.mean((scale * p - g) ** 2)), rel=CLOSE)
    both = p.any(axis=1) & g.any(axis=1)
    assert both.sum() == len(p) - 2
    cosines = (p * g).sum(axis=1)[both] / np.linalg.norm(p[both], axis=1) / np.linalg.norm(g[both], axis=1)
    assert float(score.angle) == pytest.approx(np.degrees(np.arccos(cosines)).mean(), rel=1e-6)


def test_whole_pictures_count_their_background() -> None:
    x, y = spheres()
    frame = (2 * 30 / 9, 2 * 18 / 9)
    score = sphere_score(x, y, Protocol(pixels="image", frame=frame, black="zero"), VIEW)
    pred, gt = whole(x, 30, 18)[..., :3], whole(y, 30, 18)[..., :3]
    assert background_pixels(VIEW, frame) == pytest.approx(30 * 18 - len(VIEW.normals))
    assert float(score.rmse) == pytest.approx(math.sqrt(np.mean((pred - gt) ** 2)), rel=CLOSE)
    normed = [(i - np.percentile(i, 0.01)) / (np.percentile(i, 99.9) - np.percentile(i, 0.01)) for i in (pred, gt)]
    assert float(score.norm_rmse) == pytest.approx(math.sqrt(np.mean((normed[0] - normed[1]) ** 2)), rel=CLOSE)
    sphere = sphere_score(x, y, Protocol(black="zero"), VIEW)
    assert float(score.angle) == pytest.approx(float(sphere.angle) * len(VIEW.normals) / (30 * 18), rel=CLOSE)


def test_per_pixel_is_larger_by_the_root_of_3() -> None:
    x, y = spheres()
    plain, pixel = (sphere_score(x, y, Protocol(per=per), VIEW) for per in ("value", "pixel"))
    for name in ("rmse", "si_rmse", "norm_rmse"):
        assert_close(getattr(pixel, name), math.sqrt(3) * getattr(plain, name))


def test_clipped_to_ldr() -> None:
    x, y = spheres()
    score = sphere_score(x, y, Protocol(clip=0.5), VIEW)
    clipped = np.minimum(x.numpy(), 0.5) - np.minimum(y.numpy(), 0.5)
    assert float(score.rmse) == pytest.approx(math.sqrt(np.mean(clipped**2)), rel=CLOSE)


def test_the_tone_curve_written_out() -> None:
    """a L^(1 / 2.4), the median of the positive values at 0.5, each map with its own a; black stays black."""
    generator = torch.Generator().manual_seed(0)
    radiance = (
        torch.rand(2, 3, 4, 8, generator=generator, dtype=torch.float64)
        * torch.tensor([1.0, 30.0])[:, None, None, None]
    )
    radiance[0, :, :2] = 0
    found = toned(radiance, Tone())
    for item in range(2):
        power = radiance[item].numpy() ** (1 / 2.4)
        expected = power * 0.5 / np.percentile(power[power > 0], 50)
        assert found[item].numpy() == pytest.approx(expected, rel=CLOSE)
    assert float(toned(torch.zeros(3, 4, 8, dtype=torch.float64), Tone()).abs().max()) == 0


def test_equal_lights_have_no_error_and_a_brighter_one_only_its_scale() -> None:
    light = EnvironmentMap(torch.rand(3, 16, 32, generator=torch.Generator().manual_seed(1), dtype=torch.float64))
    brighter = EnvironmentMap(4 * light.radiance)
    protocol = Protocol(size=8, map_height=None)
    for name in MATERIALS:
        same = sphere_test(light, light, protocol).scores[name]
        assert float(same.rmse) == pytest.approx(0, abs=1e-12)
        score = sphere_test(brighter, light, protocol).scores[name]
        assert float(score.scale) == pytest.approx(0.25, rel=CLOSE)
        assert (float(score.si_rmse), float(score.norm_rmse)) == pytest.approx((0, 0), abs=1e-9)
        assert float(score.rmse) > 0.1
    styled = sphere_test(brighter, light, replace(PROTOCOLS["stylelight"], size=8, map_height=16))
    assert float(styled.scores["mirror"].rmse) == pytest.approx(0, abs=1e-9)  # each map has its own exposure


def test_a_furnace_shows_the_albedo_and_maps_are_averaged_first() -> None:
    light = EnvironmentMap(torch.ones(3, 8, 16, dtype=torch.float64))
    test = sphere_test(light, light, Protocol(size=8, albedo=0.8, map_height=4))
    for values in test.light.values():
        assert_close(values, torch.full_like(values, 0.8), rtol=3e-4, atol=0)  # diffuse; see docs
    fine = torch.zeros(3, 8, 16, dtype=torch.float64)
    fine[..., ::2] = 1
    averaged = sphere_test(EnvironmentMap(fine), light, Protocol(size=8, map_height=4))
    assert_close(averaged.light["mirror"], torch.full_like(averaged.light["mirror"], 0.5))


def test_a_batch_and_each_alone() -> None:
    radiance = torch.rand(2, 2, 3, 4, 8, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    protocol = replace(PROTOCOLS["stylelight"], size=6, map_height=None)
    together = sphere_test(EnvironmentMap(radiance[0]), EnvironmentMap(radiance[1]), protocol).scores
    alone = sphere_test(EnvironmentMap(radiance[0, 1]), EnvironmentMap(radiance[1, 1]), protocol).scores
    for name in MATERIALS:
        for field in ("rmse", "si_rmse", "scale", "norm_rmse", "angle"):
            assert_close(getattr(together[name], field)[1], getattr(alone[name], field))


def test_what_cannot_be() -> None:
    for wrong in (Protocol(map_height=7), Protocol(clip=0.0), Protocol(size=0), Protocol(frame=(1.0, 3.0))):
        with pytest.raises(ConfigError):
            check_protocol(wrong)
    assert named_protocol("plain") == Protocol()
    with pytest.raises(ConfigError, match="stylelight"):
        named_protocol("other")
