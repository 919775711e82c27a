"""Shadows under known light: an unclipped sun against the analytic shadow, and the laws of irradiance."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from realdata import data_path
from torch import Tensor
from torch.testing import assert_close

from torchlight import relighting
from torchlight.errors import ShapeError
from torchlight.geometry import primitives
from torchlight.geometry.analytic_shadow import Block, block_irradiance
from torchlight.geometry.receiver import Receiver
from torchlight.geometry.scene import Scene
from torchlight.geometry.transforms import transform
from torchlight.io.images import read_photo
from torchlight.light import environment as environments
from torchlight.light.environment import EnvironmentMap
from torchlight.light.latlong import row_boundaries
from torchlight.metrics import rms_255
from torchlight.photo.observation import linear_photo
from torchlight.relighting import albedo_over_pi, irradiance, ray_offsets, relight

BLOCK = Block((1.0, 0.6, 1.2), 20.0, (0.3, -0.2))
RECEIVER = Receiver((0.0, 0.0), (4.0, 4.0), (20, 20))
ALBEDO = (0.8, 0.5, 0.25)


def block_scene(receiver: Receiver = RECEIVER) -> Scene:
    triangles = transform(
        primitives.box(BLOCK.size), 1.0, (0.0, 0.0, BLOCK.rotation_degrees), (*BLOCK.translation, 0.0)
    )
    return Scene(triangles, receiver)


def pixel_light(radiance: Tensor, rows: Tensor, columns: Tensor, cuts: int) -> tuple[Tensor, Tensor]:
    """Directions and exact fluxes of cuts x cuts parts of some pixels of a lat-long map [3, height, width]."""
    height = radiance.shape[-2]
    edges = row_boundaries(height).clamp(max=math.pi / 2).sin().square()
    part = (torch.arange(cuts, dtype=torch.float64) + 0.5) / cuts
    sine = torch.lerp(edges[rows, None, None], edges[rows + 1, None, None], part[:, None])
    phi = math.pi * (1 - (columns[:, None, None] + part) / height)
    sine, phi = torch.broadcast_tensors(sine, phi)
    radius = sine.sqrt()
    directions = torch.stack([radius * phi.cos(), radius * phi.sin(), (1 - sine).sqrt()], dim=-1)
    share = (edges[rows + 1] - edges[rows]) * math.pi / height / 2 / cuts**2
    fluxes = (radiance[:, rows, columns] * share).T[:, None, :].expand(-1, cuts**2, -1)
    return directions.reshape(-1, 3), fluxes.reshape(-1, 3)


def upper_pixels(height: int) -> tuple[Tensor, Tensor]:
    row, column = torch.meshgrid(torch.arange(height // 2), torch.arange(2 * height), indexing="ij")
    return row.reshape(-1), column.reshape(-1)


def coarse_sky() -> Tensor:
    """A sky of 64 x 32 patches, heavy-tailed and coloured."""
    generator = torch.Generator().manual_seed(8)
    return torch.exp(torch.randn(3, 32, 64, generator=generator, dtype=torch.float64))


def with_sun(sky: Tensor, pixels: list[tuple[int, int]], share: float) -> Tensor:
    """The sky at 512 x 256 pixels with a sun of some of them that carries a share of the flux in each channel."""
    fine = sky.repeat_interleave(8, dim=1).repeat_interleave(8, dim=2)
    total = environments.irradiance(EnvironmentMap(fine))
    only = torch.zeros_like(fine)
    for row, column in pixels:
        only[:, row, column] = 1.0
    return fine + only * (total / environments.irradiance(EnvironmentMap(only)) * share / (1 - share))[:, None, None]


@pytest.mark.parametrize("pixels", [[(61, 300)], [(88, 40), (88, 41)]])
def test_an_unclipped_sun_leaves_a_residual_of_at_most_0_3(pixels: list[tuple[int, int]]) -> None:
    """70 % of the flux from one or two pixels of 0.7 degrees: the shadow's edge is as sharp as the pixel is small."""
    sky = coarse_sky()
    fine = with_sun(sky, pixels, 0.7)
    found = relight(block_scene(), EnvironmentMap(fine))
    only = fine - with_sun(sky, pixels, 0.0)
    rows, columns = (torch.tensor(axis) for axis in zip(*pixels, strict=True))
    expected = block_irradiance(BLOCK, *pixel_light(only, rows, columns, 41), RECEIVER, lines=8)
    expected += block_irradiance(BLOCK, *pixel_light(sky, *upper_pixels(32), 5), RECEIVER, lines=2)
    rms = rms_255(found, expected / math.pi, torch.ones(400, dtype=torch.float64))
    assert_close(rms.item(), 0.0, rtol=0, atol=0.3)
    assert expected.min() < 0.4 * expected.max()


def test_the_sun_of_a_real_sky_leaves_a_residual_of_at_most_0_3() -> None:
    """noon_grass: 1024 x 512 pixels, a sun of 64,260 times the sky."""
    radiance = read_photo(data_path("probes", "noon_grass_1k.hdr")).pixels.double()
    receiver = replace(RECEIVER, samples=(16, 16))
    found = relight(block_scene(receiver), EnvironmentMap(radiance))
    rows, columns = upper_pixels(512)
    flux = environments.flux(EnvironmentMap(radiance)).sum(dim=0)[rows, columns]
    bright = flux > 1e-4 * flux.sum()
    expected = block_irradiance(BLOCK, *pixel_light(radiance, rows[bright], columns[bright], 9), receiver, lines=4)
    # the faint rest, at one direction per 4 x 4 pixels
    faint = torch.zeros_like(radiance)
    faint[:, rows[~bright], columns[~bright]] = radiance[:, rows[~bright], columns[~bright]]
    exact = environments.flux(EnvironmentMap(faint))
    pooled = torch.nn.functional.avg_pool2d(exact, 4) * 16
    coarse_rows, coarse_columns = upper_pixels(128)
    directions, _ = pixel_light(pooled, coarse_rows, coarse_columns, 1)
    expected += block_irradiance(BLOCK, directions, pooled[:, coarse_rows, coarse_columns].T, receiver, lines=2)
    rms = rms_255(found, expected / math.pi, torch.ones(256, dtype=torch.float64))
    assert_close(rms.item(), 0.0, rtol=0, atol=0.3)


def test_constant_light_on_an_empty_plane_is_its_albedo_times_the_light() -> None:
    receiver = replace(RECEIVER, albedo=ALBEDO)
    scene = Scene(torch.zeros(0, 3, 3, dtype=torch.float64), receiver)
    found = relight(scene, EnvironmentMap(torch.full((3, 32, 64), 0.7, dtype=torch.float64)), rays=500)
    expected = torch.tensor(ALBEDO, dtype=torch.float64)[:, None] * 0.7
    assert_close(found, expected.expand(3, 400), rtol=1e-12, atol=0)


def test_light_from_below_the_plane_does_not_count() -> None:
    radiance = torch.zeros(3, 32, 64, dtype=torch.float64)
    radiance[:, 16:] = 5.0
    assert_close(relight(block_scene(), EnvironmentMap(radiance), rays=500), torch.zeros(3, 400, dtype=torch.float64))


def test_a_fully_covered_plane_is_black() -> None:
    scene = Scene(primitives.box((40.0, 40.0, 1.0)), RECEIVER)
    assert torch.equal(relight(scene, EnvironmentMap(coarse_sky()), rays=500), torch.zeros(3, 400, dtype=torch.float64))


@pytest.mark.parametrize("batch", [(1,), (2,), (2, 2)])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_maps_of_a_batch_are_lit_one_by_one(batch: tuple[int, ...], dtype: torch.dtype) -> None:
    count = math.prod(batch)
    maps = torch.stack([coarse_sky().roll(9 * k, dims=-1).to(dtype) for k in range(count)])
    found = relight(block_scene(), EnvironmentMap(maps.reshape(*batch, 3, 32, 64)), rays=600)
    assert found.shape == (*batch, 3, 400)
    assert found.dtype == dtype
    for k, image in enumerate(found.reshape(count, 3, 400)):
        assert torch.equal(image, relight(block_scene(), EnvironmentMap(maps[k]), rays=600))


def test_negative_radiance_darkens() -> None:
    """A map of the sum of two has the sum of their images only on the same rays; on an empty plane it is exact."""
    scene = Scene(torch.zeros(0, 3, 3, dtype=torch.float64), RECEIVER)
    sky = coarse_sky() - 1.5
    found = relight(scene, EnvironmentMap(sky, nonnegative=False), rays=500)
    expected = environments.irradiance(EnvironmentMap(sky, nonnegative=False)) / math.pi
    assert_close(found, expected[:, None].expand(3, 400))


def test_the_size_of_the_blocks_changes_rounding_only(monkeypatch: pytest.MonkeyPatch) -> None:
    expected = relight(block_scene(), EnvironmentMap(coarse_sky()), rays=600)
    assert torch.equal(relight(block_scene(), EnvironmentMap(coarse_sky()), rays=600), expected)
    monkeypatch.setattr(relighting, "RAYS_PER_BLOCK", 400 * 7)
    assert_close(relight(block_scene(), EnvironmentMap(coarse_sky()), rays=600), expected, rtol=1e-12, atol=0)


def test_progress_ends_at_the_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(relighting, "RAYS_PER_BLOCK", 400 * 100)
    seen: list[tuple[int, int]] = []
    relight(block_scene(), EnvironmentMap(coarse_sky()), 600, lambda done, work: seen.append((done, work)))
    assert seen[0][0] == 100
    assert seen[-1][0] == seen[-1][1] >= 600


def test_irradiance_of_coefficients_by_hand() -> None:
    matrix = torch.tensor([[1.0, 2.0], [3.0, 4.0], [0.0, 1.0]])
    assert_close(irradiance(matrix, torch.tensor([10.0, 1.0])), torch.tensor([12.0, 34.0, 1.0]))
    assert irradiance(matrix, torch.zeros(5, 4, 2)).shape == (5, 4, 3)


def test_albedo_over_pi_by_hand() -> None:
    like = torch.zeros(1, dtype=torch.float64)
    assert_close(albedo_over_pi(RECEIVER, like), torch.full((3, 1), 1 / math.pi, dtype=torch.float64))
    coloured = albedo_over_pi(replace(RECEIVER, albedo=ALBEDO), like)
    assert_close(coloured, torch.tensor(ALBEDO, dtype=torch.float64)[:, None] / math.pi)


def test_ray_offsets_fill_the_footprint_evenly() -> None:
    unit = ray_offsets(4096, RECEIVER) / 0.2 + 0.5
    counts = torch.bincount(((unit * 16).long() * torch.tensor([16, 1])).sum(dim=1), minlength=256)
    assert counts.shape == (256,)
    assert counts.min() >= 13
    assert counts.max() <= 19


@pytest.mark.parametrize("kind", [torch.float16, torch.bfloat16])
def test_half_precision_is_refused(kind: torch.dtype) -> None:
    with pytest.raises(ShapeError, match=f"radiance: expected float32 or float64, got {kind}"):
        relight(block_scene(), EnvironmentMap(torch.ones(3, 8, 16, dtype=kind)))
    with pytest.raises(ShapeError, match=f"photograph: expected float32 or float64, got {kind}"):
        linear_photo(torch.ones(3, 4, 4, dtype=kind))
