"""Area averages between lat-long grids, solid angles and first moments of pixels."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torch.testing import assert_close

from torchlight.errors import ConfigError, ShapeError
from torchlight.light import latlong
from torchlight.light_metrics.grid import check_height, common_height, first_moments, resampled, sample_weights


def random_map(height: int, *batch: int) -> torch.Tensor:
    generator = torch.Generator().manual_seed(height)
    return torch.rand(*batch, 3, height, 2 * height, generator=generator, dtype=torch.float64)


@pytest.mark.parametrize(("source", "target"), [(6, 4), (4, 6), (5, 8), (9, 2), (1, 4), (16, 8), (3, 3)])
def test_power_is_kept(source: int, target: int) -> None:
    radiance = random_map(source, 2)
    before = radiance.flatten(start_dim=-2) @ sample_weights(source, "sphere")
    after = resampled(radiance, target).flatten(start_dim=-2) @ sample_weights(target, "sphere")
    assert_close(after, before)


def test_a_pixel_holds_the_mean_over_many_points_of_it() -> None:
    """A uniform lattice in z and azimuth, which is uniform in solid angle, in plain numpy."""
    radiance, target, steps = random_map(5)[0].numpy(), 4, 400
    edges = np.cos(np.pi * np.arange(target + 1) / target)
    found = resampled(random_map(5), target)[0].numpy()
    for row, column in [(0, 0), (1, 5), (3, 2)]:
        z = edges[row] + (edges[row + 1] - edges[row]) * (np.arange(steps) + 0.5) / steps
        u = (column + (np.arange(steps) + 0.5) / steps) / (2 * target)
        rows = np.minimum((np.arccos(z) / np.pi * 5).astype(int), 4)
        mean = radiance[rows][:, (u * 10).astype(int)].mean()
        assert found[row, column] == pytest.approx(mean, abs=2 / steps)  # of a lattice with steps points a side


def test_to_coarser_and_constant() -> None:
    assert_close(resampled(torch.full((3, 7, 14), 2.5), 4), torch.full((3, 4, 8), 2.5))
    halved = resampled(random_map(8), 4)
    rows = latlong.row_solid_angles(8)
    top = (random_map(8)[:, :2] * rows[:2, None]).unflatten(-1, (8, 2)).sum(dim=(1, 3)) / (2 * rows[:2].sum())
    assert_close(halved[:, 0], top)


def test_weights_are_the_solid_angle_of_what_counts() -> None:
    assert_close(sample_weights(6, "sphere").sum().item(), 4 * math.pi)
    assert_close(sample_weights(6, "upper").sum().item(), 2 * math.pi)
    assert sample_weights(6, "upper")[36:].abs().max() == 0


def test_first_moments_against_many_points() -> None:
    """The sum over pixels of the moment's z, upper half, is pi; each equals a midpoint rule of 200 x 200."""
    moments = first_moments(4)
    assert_close(moments.sum(dim=0), torch.zeros(3, dtype=torch.float64), atol=1e-12, rtol=0)
    assert_close(moments[:16, 2].sum().item(), math.pi)
    theta = (torch.arange(200, dtype=torch.float64) + 0.5) / 200 * (math.pi / 4) + math.pi / 4
    phi = math.pi * (1 - (3 + (torch.arange(200, dtype=torch.float64) + 0.5) / 200) / 4)
    part = theta.sin()[:, None] * (math.pi / 800) ** 2
    x = (theta.sin()[:, None] * phi.cos() * part).sum()
    y = (theta.sin()[:, None] * phi.sin() * part).sum()
    z = (theta.cos()[:, None] * part).expand(-1, 200).sum()
    assert_close(moments[8 + 3], torch.stack([x, y, z]), atol=1e-5, rtol=0)  # of the midpoint rule


def test_the_common_grid_is_the_coarser_one_made_even() -> None:
    assert [common_height(256, 64), common_height(7, 64), common_height(1, 64)] == [64, 6, 2]
    for height in (0, 7, -2, 10_000):
        with pytest.raises(ConfigError, match="even number of rows"):
            check_height(height)


def test_what_is_no_latlong_is_refused() -> None:
    with pytest.raises(ShapeError, match="twice the height"):
        resampled(torch.zeros(3, 4, 9), 2)
