"""Mean directions and matched sources, by hand and against a Monte-Carlo free integral."""

from __future__ import annotations

import math

import pytest
import torch
from torch.testing import assert_close

from torchlight.light.directions import from_angles
from torchlight.light.environment import EnvironmentMap, rotate_about_z
from torchlight.light.peaks import Peaks, environment_peaks
from torchlight.light_metrics.directions import matched_peaks, mean_direction_error, mean_vector
from torchlight.light_metrics.grid import sample_weights

NAN = float("nan")


def towards(*degrees: tuple[float, float]) -> torch.Tensor:
    """Returns directions given by elevation and azimuth in degrees; a NaN stays one."""
    theta = torch.tensor([math.radians(90 - e) for e, _ in degrees], dtype=torch.float64)
    phi = torch.tensor([math.radians(a) for _, a in degrees], dtype=torch.float64)
    return from_angles(theta, phi)


def sun(row: int, column: int, height: int = 32) -> torch.Tensor:
    radiance = torch.zeros(3, height, 2 * height, dtype=torch.float64)
    radiance[:, row, column] = 1000.0
    return radiance


def test_a_sun_that_turns_about_z() -> None:
    """Turned by a columns at polar angle theta the direction moves by 2 asin(sin theta sin(turn / 2))."""
    weights = sample_weights(32, "upper")
    moved = mean_direction_error(sun(8, 20), sun(8, 24), weights)
    theta, turn = 8.5 * math.pi / 32, 4 * math.pi / 32
    # the mean over a pixel has a slightly smaller polar angle than its centre
    assert float(moved) == pytest.approx(math.degrees(2 * math.asin(math.sin(theta) * math.sin(turn / 2))), rel=1e-3)
    assert float(mean_direction_error(sun(8, 20), sun(8, 20), weights)) == pytest.approx(0, abs=1e-7)


def test_a_constant_sky_points_up_and_a_constant_sphere_nowhere() -> None:
    constant = torch.full((3, 16, 32), 2.0)
    up = mean_vector(constant, sample_weights(16, "upper"))
    assert_close(up, torch.tensor([0, 0, 2 * math.pi], dtype=torch.float64))
    nowhere = mean_vector(constant, sample_weights(16, "sphere"))
    assert_close(nowhere, torch.zeros(3, dtype=torch.float64), atol=1e-12, rtol=0)
    assert mean_direction_error(torch.zeros(3, 16, 32), constant, sample_weights(16, "upper")).isnan()


def test_sources_are_matched_to_the_nearest_that_is_free() -> None:
    reference = Peaks(towards((60, 0), (30, 90), (10, 180)), torch.tensor([0.6, 0.3, 0.1], dtype=torch.float64))
    light = Peaks(towards((30, 93), (55, 0), (NAN, NAN)), torch.tensor([0.5, 0.4, 0.0], dtype=torch.float64))
    found = matched_peaks(light, reference)
    side = math.degrees(2 * math.asin(math.cos(math.radians(30)) * math.sin(math.radians(1.5))))
    assert found.degrees[:2].tolist() == pytest.approx([5.0, side], rel=1e-9)
    assert found.degrees[2].isnan()
    assert (float(found.missed), float(found.extra)) == (1, 0)
    assert float(found.mean) == pytest.approx((0.6 * 5 + 0.3 * side) / 0.9, rel=1e-9)
    strongest = towards((60, 0), (30, 93))
    assert float(found.strongest) == pytest.approx(
        math.degrees(math.acos(float(strongest[0] @ strongest[1]))), rel=1e-9
    )


def test_no_source_takes_two_partners() -> None:
    two = Peaks(towards((60, 0), (58, 0)), torch.tensor([0.6, 0.4], dtype=torch.float64))
    one = Peaks(towards((58, 0), (NAN, NAN)), torch.tensor([1.0, 0.0], dtype=torch.float64))
    found = matched_peaks(one, two)
    assert found.degrees[0].item() == pytest.approx(2, rel=1e-9)
    assert found.degrees[1].isnan()
    assert float(matched_peaks(two, one).extra) == 1


def test_no_source_at_all() -> None:
    none = Peaks(torch.full((2, 3), NAN, dtype=torch.float64), torch.zeros(2, dtype=torch.float64))
    found = matched_peaks(none, Peaks(towards((60, 0), (NAN, NAN)), torch.tensor([1.0, 0.0], dtype=torch.float64)))
    assert found.strongest.isnan()
    assert found.mean.isnan()
    assert (float(found.missed), float(found.extra)) == (1, 0)


def test_a_batch_of_turned_suns_and_each_alone() -> None:
    suns = torch.stack([sun(8, 20), sun(4, 40)])
    reference = EnvironmentMap(suns)
    light = rotate_about_z(reference, 11.25)
    found = matched_peaks(environment_peaks(light), environment_peaks(reference))
    assert found.degrees.shape == (2, 8)
    for item in range(2):
        alone = matched_peaks(
            environment_peaks(EnvironmentMap(light.radiance[item])), environment_peaks(EnvironmentMap(suns[item]))
        )
        assert_close(found.degrees[item], alone.degrees, equal_nan=True)
        assert_close(found.mean[item], alone.mean)
    weights = sample_weights(32, "upper")
    both = mean_direction_error(light.radiance, suns, weights)
    assert_close(both[1], mean_direction_error(light.radiance[1], suns[1], weights))
