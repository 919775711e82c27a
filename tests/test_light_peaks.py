from __future__ import annotations

import math

import pytest
import torch
from torch.testing import assert_close

from torchlight.errors import ShapeError
from torchlight.light import cubemap, latlong, peaks
from torchlight.light.directions import from_angles
from torchlight.light.environment import EnvironmentMap
from torchlight.light.procedural import SUN_AZIMUTH, SUN_ELEVATION, WINDOW_AZIMUTH, sun_and_window


def _angle(first: torch.Tensor, second: torch.Tensor) -> float:
    return math.degrees(math.acos(min(1.0, float(first.double() @ second.double()))))


def _direction(elevation: float, azimuth: float) -> torch.Tensor:
    angles = torch.tensor([90 - elevation, azimuth], dtype=torch.float64).deg2rad()
    return from_angles(angles[0], angles[1])


def test_the_mean_is_weighted_by_flux_within_twelve_degrees():
    directions = torch.stack([_direction(60, 0), _direction(71, 0), _direction(47, 0)])
    found = peaks.flux_peaks(directions, torch.tensor([2.0, 1.0, 1.5], dtype=torch.float64), count=4)
    mean = torch.nn.functional.normalize(2 * directions[0] + directions[1], dim=0)
    assert_close(peaks.peak_direction(found), mean)
    assert_close(found.directions[1], directions[2])
    assert_close(found.shares, torch.tensor([3 / 4.5, 1.5 / 4.5, 0, 0], dtype=torch.float64))
    assert found.directions[2:].isnan().all()


def test_dim_sources_are_left_out_and_absent_ones_go_last():
    directions = torch.stack([_direction(10, a) for a in (0, 60, 120, 125)])
    weights = torch.tensor([0.009, 0.975, 0.008, 0.008], dtype=torch.float64)
    found = peaks.flux_peaks(directions, weights, count=3)
    assert_close(found.shares, torch.tensor([0.975, 0.016, 0.0], dtype=torch.float64))
    assert found.directions[2].isnan().all()


def test_negative_flux_does_not_pull():
    directions = torch.stack([_direction(60, 0), _direction(65, 0)])
    found = peaks.flux_peaks(directions, torch.tensor([1.0, -0.9], dtype=torch.float64))
    assert_close(peaks.peak_direction(found), directions[0])


@pytest.mark.parametrize("batch", [(), (2,), (2, 2)])
def test_batches_equal_single_lights(batch):
    values = torch.rand(*batch, 3, cubemap.texel_count(8), generator=torch.Generator().manual_seed(0))
    together = peaks.texel_peaks(values**6, 8)
    flat, shares = together.directions.reshape(-1, 8, 3), together.shares.reshape(-1, 8)
    for index, single in enumerate(values.reshape(-1, *values.shape[-2:])):
        alone = peaks.texel_peaks(single**6, 8)
        assert_close(flat[index], alone.directions, equal_nan=True)
        assert_close(shares[index], alone.shares)


def test_black_light_has_no_peak():
    found = peaks.texel_peaks(torch.zeros(3, cubemap.texel_count(4)), 4)
    assert peaks.peak_direction(found).isnan().all()
    assert_close(found.shares, torch.zeros(8))


def test_texels_weigh_by_cosine_and_solid_angle():
    """Equal radiance high and low: the high one has the larger flux."""
    visible = cubemap.visible_texels(16)
    high, low = _direction(75, 0), _direction(8, 180)
    index = [int(torch.nonzero(visible == cubemap.texel_index(d, 16))) for d in (high, low)]
    values = torch.zeros(3, len(visible), dtype=torch.float64)
    values[:, index[0]], values[:, index[1]] = 1.0, 4.0
    found = peaks.texel_peaks(values, 16)
    assert _angle(peaks.peak_direction(found), high) < 5
    assert _angle(found.directions[1], low) < 5
    weights = cubemap.cosine_weights(16, 1)[index, 0] * torch.tensor([1.0, 4.0], dtype=torch.float64)
    assert_close(found.shares[:2], weights / weights.sum())


def test_the_procedural_sun_and_window_are_found():
    light = sun_and_window(128)
    sun = _direction(math.degrees(SUN_ELEVATION), math.degrees(SUN_AZIMUTH))
    found = peaks.environment_peaks(light)
    assert _angle(peaks.peak_direction(found), sun) < 2
    assert _angle(peaks.peak_direction(peaks.pixel_peaks(light)), sun) < 0.2
    azimuth = torch.atan2(found.directions[1, 1], found.directions[1, 0]).item()
    assert abs(math.degrees(azimuth - WINDOW_AZIMUTH)) < 15
    assert found.shares[0] > 0.3
    assert found.shares.sum() <= 1


@pytest.mark.parametrize("elevation", [5.0, 40.0, 89.0])
def test_one_pixel_is_its_own_peak(elevation):
    radiance = torch.zeros(3, 64, 128, dtype=torch.float64)
    row, column = latlong.pixel_indices(_direction(elevation, 33.0), 64)
    radiance[:, row, column] = 7.0
    found = peaks.pixel_peaks(EnvironmentMap(radiance))
    assert_close(peaks.peak_direction(found), latlong.pixel_directions(64)[row, column])
    assert_close(found.shares[0], torch.tensor(1.0, dtype=torch.float64))


def test_another_resolution_is_refused():
    with pytest.raises(ShapeError, match="visible texels"):
        peaks.texel_peaks(torch.zeros(3, 5), 4)
