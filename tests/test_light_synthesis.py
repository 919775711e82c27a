"""From coefficients to a lat-long map: exact area averages of texels, wavelets and harmonics."""

from __future__ import annotations

import math

import pytest
import torch
from torch.testing import assert_close

from torchlight.light import cubemap, latlong
from torchlight.light.bases import Basis, HaarCubemap, SphericalHarmonics, Texels
from torchlight.light.directions import from_angles
from torchlight.light.environment import irradiance, power
from torchlight.light.harmonics import real_spherical_harmonics
from torchlight.light.synthesis import harmonics_to_latlong, map_height, synthesize, without_rounding


@pytest.mark.parametrize(
    ("basis", "width"),
    [
        (Texels(1), 512),
        (Texels(64), 512),
        (Texels(128), 1024),
        (HaarCubemap(128), 1024),
        (HaarCubemap(256), 1024),
        (HaarCubemap(512), 2048),
        (SphericalHarmonics(5, 32), 512),
        (SphericalHarmonics(2, 128), 1024),
    ],
)
def test_the_map_is_512_wide_at_least_and_8_pixels_per_texel_then_4(basis: Basis, width: int) -> None:
    assert 2 * map_height(basis) == width


@pytest.mark.parametrize("basis", [Texels(1), Texels(8), HaarCubemap(8)])
@pytest.mark.parametrize("batch", [(), (2,)])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_texels_keep_their_power(basis: Basis, batch: tuple[int, ...], dtype: torch.dtype) -> None:
    generator = torch.Generator().manual_seed(0)
    count = cubemap.texel_count(basis.resolution)
    texels = torch.rand(*batch, 3, count, generator=generator, dtype=dtype)
    light = synthesize(basis, basis.analysis(texels))
    assert light.radiance.shape == (*batch, 3, 256, 512)
    assert light.radiance.dtype == dtype
    assert light.nonnegative
    areas = cubemap.cell_solid_angles(cubemap.texel_cells(basis.resolution, 1))[:, 0]
    assert_close(power(light).double(), texels.double() @ areas, rtol=1e-5, atol=0)


def test_a_pixel_within_a_texel_has_its_radiance_and_the_ground_is_black() -> None:
    texels = torch.arange(1.0, 49.0, dtype=torch.float64).expand(3, -1)
    radiance = synthesize(Texels(4), texels).radiance
    directions = cubemap.texel_directions(4, 5)[cubemap.visible_texels(4)]
    row, column = latlong.pixel_indices(directions, 256)
    assert_close(radiance[:, row, column], texels.contiguous(), rtol=1e-9, atol=0)
    assert (radiance[:, 128:] == 0).all()


@pytest.mark.parametrize("degree", [0, 1, 5])
def test_constant_harmonics_light_an_open_plane_by_pi(degree: int) -> None:
    coefficients = torch.zeros(3, (degree + 1) ** 2, dtype=torch.float64)
    coefficients[:, 0] = math.sqrt(4 * math.pi)
    light = synthesize(SphericalHarmonics(degree, 8), coefficients)
    assert_close(light.radiance[:, :128], torch.ones(3, 128, 512, dtype=torch.float64), rtol=0, atol=1e-12)
    assert_close(irradiance(light), torch.full((3,), math.pi, dtype=torch.float64), rtol=1e-12, atol=0)
    assert light.nonnegative


@pytest.mark.parametrize("degree", [1, 4, 12])
def test_harmonics_are_averaged_over_pixels(degree: int) -> None:
    """Against a brute mean over 40 x 40 directions of equal solid angle in single pixels."""
    height = 256
    generator = torch.Generator().manual_seed(degree)
    coefficients = torch.randn(2, (degree + 1) ** 2, generator=generator, dtype=torch.float64)
    found = harmonics_to_latlong(coefficients, degree, height)
    steps = (torch.arange(40, dtype=torch.float64) + 0.5) / 40
    for row, column in ((0, 3), (1, 500), (20, 31), (90, 256), (127, 0)):
        top, bottom = math.cos(math.pi * row / height), math.cos(math.pi * (row + 1) / height)
        theta = torch.acos(top + (bottom - top) * steps)[:, None]
        phi = math.pi * (1 - (column + steps) / height)
        mean = real_spherical_harmonics(degree, from_angles(theta, phi)).mean(dim=(0, 1))
        assert_close(found[:, row, column], coefficients @ mean, rtol=0, atol=5e-3 if row < 2 else 1e-5)
    assert (found[:, height // 2 :] == 0).all()


def test_one_harmonic_by_hand() -> None:
    """Y_11 = sqrt(3 / 4 pi) x: positive in the middle of the map, which looks along +x; Y_1-1 = sqrt(3 / 4 pi) y."""
    for index, along in ((3, 0), (1, 1), (2, 2)):
        coefficients = torch.zeros(1, 4, dtype=torch.float64)
        coefficients[0, index] = 1.0
        found = harmonics_to_latlong(coefficients, 1, 256)[0, 10:128]
        expected = math.sqrt(3 / (4 * math.pi)) * latlong.pixel_directions(256)[10:128, :, along]
        assert_close(found, expected, rtol=0, atol=1e-4)  # a pixel's centre is not quite its mean


def test_negative_values_are_kept_and_said() -> None:
    texels = torch.ones(3, 48, dtype=torch.float64)
    texels[1, 5] = -0.5
    light = synthesize(Texels(4), texels)
    assert not light.nonnegative
    assert_close(light.radiance.min().item(), -0.5)
    dipole = torch.zeros(3, 4, dtype=torch.float64)
    dipole[:, 3] = 1.0
    assert not synthesize(SphericalHarmonics(1, 8), dipole).nonnegative


def test_rounding_is_not_negative_light() -> None:
    radiance = torch.tensor([1.0, -9e-7, -1.1e-6, 0.0]).reshape(1, 1, 4).expand(3, 1, 4)
    assert without_rounding(radiance)[0, 0].tolist() == pytest.approx([1.0, 0.0, -1.1e-6, 0.0])
    batch = torch.stack([radiance, radiance * 1e-3])  # each map is judged by its own largest value
    assert_close(without_rounding(batch)[1], without_rounding(radiance) * 1e-3)
    black = torch.zeros(3, 2, 4)
    assert torch.equal(without_rounding(black), black)
