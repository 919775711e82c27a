from __future__ import annotations

import math

import pytest
import torch
from torch.testing import assert_close

from torchlight.errors import ShapeError
from torchlight.light import cubemap, latlong, overlap

SIZES = [(1, 5), (2, 2), (3, 7), (4, 16), (16, 64), (16, 15)]


def _texel_totals(shared: overlap.Overlap) -> torch.Tensor:
    return shared.areas.new_zeros(shared.texel_count).index_add(0, shared.texels, shared.areas)


def _pixel_totals(shared: overlap.Overlap) -> torch.Tensor:
    return shared.areas.new_zeros(2 * shared.height**2).index_add(0, shared.pixels, shared.areas)


@pytest.mark.parametrize(("resolution", "height"), SIZES)
def test_every_visible_texel_has_its_exact_solid_angle(resolution, height):
    shared = overlap.plane_overlap(resolution, height)
    exact = cubemap.cell_solid_angles(cubemap.texel_cells(resolution, 1))[:, 0]
    assert_close(_texel_totals(shared), exact, atol=0, rtol=1e-7)
    assert_close(shared.areas.sum().item(), 2 * math.pi, atol=0, rtol=1e-12)


@pytest.mark.parametrize(("resolution", "height"), SIZES)
def test_the_whole_sphere_is_shared_out(resolution, height):
    shared = overlap.sphere_overlap(resolution, height)
    assert_close(_texel_totals(shared), cubemap.solid_angles(resolution).flatten().repeat(6), atol=0, rtol=1e-7)
    pixels = latlong.row_solid_angles(height).repeat_interleave(2 * height)
    assert_close(_pixel_totals(shared), pixels, atol=0, rtol=1e-11)
    assert len(torch.unique(shared.pixels * shared.texel_count + shared.texels)) == len(shared.areas)


def test_large_cross_faces_use_uniform_strips(monkeypatch):
    monkeypatch.setattr(overlap, "MAXIMUM_CORNER_RESOLUTION", 8)
    shared = overlap.sphere_overlap(16, 32)
    # Texel corners of the top face fall within strips there: an error by construction, small and stated.
    assert_close(_texel_totals(shared), cubemap.solid_angles(16).flatten().repeat(6), atol=0, rtol=5e-2)
    assert_close(shared.areas.sum().item(), 4 * math.pi, atol=0, rtol=1e-12)


@pytest.mark.parametrize(("resolution", "height"), [(4, 8), (3, 5), (8, 6)])
def test_shared_areas_against_counting_random_directions(resolution, height):
    generator = torch.Generator().manual_seed(0)
    count = 1_000_000
    directions = torch.randn(count, 3, generator=generator, dtype=torch.float64)
    row, column = latlong.pixel_indices(directions, height)
    texels = 6 * resolution**2
    key = (row * 2 * height + column) * texels + cubemap.texel_index(directions, resolution)
    counted = torch.bincount(key, minlength=2 * height**2 * texels).double() * (4 * math.pi / count)
    shared = overlap.sphere_overlap(resolution, height)
    exact = torch.zeros_like(counted).index_add(0, shared.pixels * texels + shared.texels, shared.areas)
    # six standard deviations of the count in the largest shared area
    deviation = 6 * 4 * math.pi * math.sqrt(exact.max().item() / (4 * math.pi) / count)
    assert_close(counted, exact, atol=deviation, rtol=0)


def test_a_single_texel_lands_where_it_is():
    values = torch.zeros(cubemap.texel_count(8), dtype=torch.float64)
    values[37] = 1.0
    image = overlap.texels_to_latlong(values, 8, 128)
    directions = latlong.pixel_directions(128)
    weights = image * latlong.row_solid_angles(128)[:, None]
    index = cubemap.visible_texels(8)[37]
    assert (cubemap.texel_index(directions[image > 0.999], 8) == index).all()
    mean = torch.nn.functional.normalize(torch.einsum("hw,hwi->i", weights, directions), dim=0)
    cells = cubemap.texel_cells(8, 32)
    inner = (cubemap.cell_directions(cells) * cubemap.cell_solid_angles(cells)[..., None])[37].sum(0)
    # Pixels on the border count at their own centres, a few thousandths of their width off.
    assert_close(mean, torch.nn.functional.normalize(inner, dim=0), atol=2e-4, rtol=0)


@pytest.mark.parametrize("batch", [(), (3,), (2, 3)])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_energy_is_kept_both_ways(batch, dtype):
    generator = torch.Generator().manual_seed(1)
    rtol = 1e-12 if dtype == torch.float64 else 1e-5
    omega = latlong.row_solid_angles(32, dtype=dtype)[:, None]
    texel_omega = cubemap.cell_solid_angles(cubemap.texel_cells(8, 1))[:, 0].to(dtype)
    values = torch.rand(*batch, cubemap.texel_count(8), generator=generator, dtype=dtype)
    image = overlap.texels_to_latlong(values, 8, 32)
    assert image.dtype == dtype
    assert_close((image * omega).sum((-2, -1)), (values * texel_omega).sum(-1), atol=0, rtol=max(rtol, 1e-7))
    radiance = torch.rand(*batch, 32, 64, generator=generator, dtype=dtype)
    texels = overlap.latlong_to_texels(radiance, 8)
    upper = (radiance * omega)[..., :16, :].sum((-2, -1))
    assert_close((texels * texel_omega).sum(-1), upper, atol=0, rtol=max(rtol, 1e-7))


def test_constants_stay_constant_and_the_ground_stays_dark():
    image = overlap.texels_to_latlong(torch.ones(cubemap.texel_count(16), dtype=torch.float64), 16, 64)
    assert_close(image[:32], torch.ones(32, 128, dtype=torch.float64), atol=1e-11, rtol=0)
    assert_close(image[32:], torch.zeros(32, 128, dtype=torch.float64))
    texels = overlap.latlong_to_texels(torch.ones(64, 128, dtype=torch.float64), 16)
    assert_close(texels, torch.ones_like(texels))
    faces = overlap.latlong_to_cubemap(torch.ones(64, 128, dtype=torch.float64), 16)
    assert_close(faces, torch.ones(6, 16, 16, dtype=torch.float64))
    whole = overlap.cubemap_to_latlong(torch.ones(6, 16, 16, dtype=torch.float64), 64)
    assert_close(whole, torch.ones(64, 128, dtype=torch.float64), atol=1e-11, rtol=0)


def test_fine_pixels_return_the_texels():
    values = torch.rand(6, 4, 4, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    back = overlap.latlong_to_cubemap(overlap.cubemap_to_latlong(values, 256), 4)
    # Only the pixels that straddle two texels mix them.
    assert_close(back, values, atol=0.05, rtol=0)
    assert (back - values).abs().max() > 1e-4


def test_gradients_pass_through():
    values = torch.rand(cubemap.texel_count(2), dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda v: overlap.texels_to_latlong(v, 2, 4), (values,))


def test_bad_sizes_are_refused():
    with pytest.raises(ShapeError, match="visible texels"):
        overlap.texels_to_latlong(torch.zeros(5), 4, 8)
    with pytest.raises(ShapeError, match="positive sizes"):
        overlap.plane_overlap(0, 8)
    with pytest.raises(ShapeError, match="twice the height"):
        overlap.latlong_to_texels(torch.zeros(8, 8), 4)
