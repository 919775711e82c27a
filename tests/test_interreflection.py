"""Light that an object throws back on the sheet: its closed form, why the albedo must be stated, its removal."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

from torchlight.errors import ConfigError, SceneError
from torchlight.geometry.analytic_shadow import Block
from torchlight.geometry.footprints import footprint_points, visible_samples
from torchlight.geometry.form_factors import form_factors
from torchlight.geometry.primitives import sphere
from torchlight.geometry.receiver import Receiver
from torchlight.geometry.scene import Scene
from torchlight.interreflection import SUBPOINTS, WHITE_PAPER, bounced_transport, is_convex, thrown_back, without
from torchlight.light import cubemap
from torchlight.observing import observe
from torchlight.photo.observation import Observation, linear_photo
from torchlight.solvers import NNLS, LeastSquares
from torchlight.synthetic import block_scene
from torchlight.transfer import Transfer, transport

RESOLUTION = 4
NOISE = 0.001


@cache
def scene() -> Scene:
    return block_scene(Block((1.0, 0.6, 1.2), 20.0), Receiver((0.0, 0.0), (4.0, 4.0), (24, 24)))


@cache
def transfer() -> Transfer:
    found = transport(scene(), RESOLUTION, 16)
    return Transfer(found.transport.double(), RESOLUTION)


@cache
def fine() -> Tensor:
    """Returns the transport of 16 texels."""
    return transport(scene(), 16, 4).transport.double()


@cache
def all_faces() -> Tensor:
    """Returns the form factors of the whole block, per sample."""
    points = footprint_points(scene().receiver, SUBPOINTS)
    factors = form_factors(scene().triangles.double(), points.reshape(-1, 3)).sum(dim=1)
    return factors.reshape(len(points), -1).mean(dim=1)


def used() -> Tensor:
    return visible_samples(scene())


def photographs(albedo: float) -> Observation:
    """Returns two photographs, each under a random light of three channels, with noise."""
    generator = torch.Generator().manual_seed(7)
    light = torch.rand(2, 3, transfer().transport.shape[1], generator=generator, dtype=torch.float64) ** 6
    direct = light @ transfer().transport.T / math.pi
    bounced = albedo * light @ bounced_transport(scene(), RESOLUTION).T / math.pi
    noise = NOISE * direct.amax() * torch.randn(direct.shape, generator=generator, dtype=torch.float64)
    return Observation(direct + bounced + noise, used().double().expand(2, -1))


def unexplained(seen: Observation) -> float:
    """Returns the root mean square of what is left beside the photographs of a black block, with the same noise."""
    return (seen.samples - photographs(0.0).samples)[..., used()].square().mean().sqrt().item()


def test_under_an_even_sky_every_side_is_lit_by_half_of_it_and_half_of_the_sheet() -> None:
    expected = all_faces() * math.pi * (0.5 + 0.5 * WHITE_PAPER)  # the top's own factor is 0
    assert_close(bounced_transport(scene(), RESOLUTION).sum(dim=1), expected, rtol=2e-3, atol=1e-9)  # midpoint rule


def test_an_even_sky_above_an_elevation_lights_a_wall_by_the_spherical_zone_s_share() -> None:
    e = math.radians(30.0)
    sky = math.pi / 2 - (e + math.sin(e) * math.cos(e))  # integral of 2 cos^2 from e to 90 degrees
    expected = all_faces() * (sky + 0.5 * WHITE_PAPER * math.pi)
    assert_close(bounced_transport(scene(), 16, e).sum(dim=1), expected, rtol=5e-3, atol=1e-9)  # cells cut by the edge


def test_an_object_as_bright_as_the_even_sky_behind_it_cannot_be_seen() -> None:
    """What the block hides it gives back: shadow and form factors, from independent code, add up to a bare plane."""
    received = transfer().transport.sum(dim=1) + math.pi * all_faces()
    assert_close(received[used()], torch.full_like(received[used()], math.pi), rtol=0.02, atol=0)


def test_a_black_object_explains_the_photograph_of_a_bright_one() -> None:
    """So no photograph tells the albedo: what a white block gives back looks like more light from above."""
    bounced = 0.6 * bounced_transport(scene(), 16).sum(dim=1)
    seen = (fine().sum(dim=1) + bounced)[None]
    light = NNLS().solve(LeastSquares(fine(), seen, used().double())).coefficients
    residual = (seen - light @ fine().T)[:, used()].square().mean().sqrt()
    assert residual < 0.05 * bounced[used()].square().mean().sqrt()


@pytest.mark.parametrize("albedo", [0.03, 0.085, 0.2])
def test_what_an_object_of_stated_albedo_throws_back_is_taken_away(albedo: float) -> None:
    seen = photographs(albedo)
    rest = without(seen, thrown_back(seen, scene(), transfer(), albedo))
    assert unexplained(rest) < 0.35 * unexplained(seen)


def test_an_albedo_that_is_off_by_half_still_helps() -> None:
    seen = photographs(0.1)
    for stated in (0.05, 0.15):
        assert unexplained(without(seen, thrown_back(seen, scene(), transfer(), stated))) < 0.8 * unexplained(seen)


def test_lamps_near_the_horizon_light_the_faces_by_way_of_the_sheet_alone() -> None:
    directions = cubemap.texel_directions(16)[cubemap.visible_texels(16)]
    low = (directions[:, 2] < 0.1).double()[None]  # the lowest row, all of it below 7.2 degrees
    light = low * (1 + directions[:, 0]) * torch.tensor([[1.0], [2.0], [3.0]], dtype=torch.float64)
    seen = Observation(light @ fine().T / math.pi, used().double())
    bare = light @ cubemap.cell_cosine_weights(cubemap.whole_texels(16))
    expected = 0.1 * all_faces() * WHITE_PAPER / 2 * bare[:, None] / math.pi
    assert_close(thrown_back(seen, scene(), Transfer(fine(), 16), 0.1), expected, rtol=0.05, atol=0)


def test_the_light_is_found_without_the_albedo_s_help() -> None:
    seen = photographs(0.1)
    once, twice = (thrown_back(seen, scene(), transfer(), albedo) for albedo in (0.1, 0.2))
    assert_close(twice, 2 * once)


def test_a_black_object_throws_nothing_back() -> None:
    assert not thrown_back(photographs(0.0), scene(), transfer(), 0.0).any()


def test_hidden_samples_stay_zero() -> None:
    seen = photographs(0.12)
    rest = without(seen, thrown_back(seen, scene(), transfer(), 0.12))
    assert not rest.samples[..., ~used()].any()


@pytest.mark.parametrize("albedo", [-0.1, 1.0, math.nan])
def test_an_impossible_albedo_is_refused(albedo: float) -> None:
    with pytest.raises(ConfigError, match=r"expected a number in \[0, 1\)"):
        thrown_back(photographs(0.0), scene(), transfer(), albedo)


def test_one_convex_object_is_told_from_others() -> None:
    block = scene().triangles
    assert is_convex(block)
    assert is_convex(1e-3 * sphere(1.0))
    assert not is_convex(torch.cat([block, block + torch.tensor([2.0, 0.0, 0.0])]))
    assert not is_convex(block.flip(1))  # seen from inside
    with pytest.raises(SceneError, match="one convex object only"):
        thrown_back(photographs(0.0), replace(scene(), triangles=block.flip(1)), transfer(), 0.1)


def test_observing_takes_away_what_a_stated_albedo_throws_back() -> None:
    """The sum of all three parts, by hand, and nothing where no albedo is stated."""
    seen = photographs(0.1)
    pictures = seen.samples.reshape(2, 3, 24, 24).flip(2)
    photo = linear_photo(pictures)
    plain, stated = (observe(photo, replace(scene(), occluder_albedo=albedo)) for albedo in (0.0, 0.1))
    expected = without(plain, thrown_back(plain, scene(), transport(scene(), 16, 12), 0.1))
    assert_close(stated.samples, expected.samples)
    assert (stated.samples < plain.samples)[:, :, used()].double().mean() > 0.5
