"""What matt objects tell of the light: closed forms under an even sky, a free albedo, a horizon that only they see."""

from __future__ import annotations

import functools
from dataclasses import replace

import pytest
import torch
from torch.testing import assert_close

from torchlight.camera import Camera
from torchlight.evenness import evened
from torchlight.facings import MATT, ROWS, Facings, facings_of, radiance_above, telling, texel_columns, weighed
from torchlight.geometry.analytic_shadow import Block
from torchlight.geometry.receiver import Receiver
from torchlight.geometry.scene import Scene
from torchlight.insertion.relit import Bounds, received
from torchlight.light import latlong
from torchlight.light.environment import EnvironmentMap
from torchlight.photo.observation import LinearPhoto, linear_photo
from torchlight.precomputation import precompute
from torchlight.synthetic import block_scene

SIZE = (120, 90)
RHO = (0.3, 0.2, 0.1)
PLANE_ALBEDO = 0.8
NORMALS = torch.tensor([[-1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]], dtype=torch.float64)


def camera() -> Camera:
    """At (-4, -4, 5), looking at the origin."""
    eye = torch.tensor([-4.0, -4.0, 5.0], dtype=torch.float64)
    forward = torch.nn.functional.normalize(-eye, dim=0)
    right = torch.nn.functional.normalize(torch.tensor([1.0, -1.0, 0.0], dtype=torch.float64), dim=0)
    axes = torch.stack([right, torch.linalg.cross(forward, right), forward])
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, :3], pose[:3, 3] = axes, -axes @ eye
    lens = torch.tensor([[150.0, 0, 59.5], [0, 150.0, 44.5], [0, 0, 1]], dtype=torch.float64)
    return Camera(lens, pose, SIZE, torch.zeros(5))


def scene() -> Scene:
    receiver = Receiver((0.0, 0.0), (4.0, 4.0), (24, 24), (PLANE_ALBEDO, PLANE_ALBEDO, PLANE_ALBEDO))
    block = block_scene(Block((1.0, 0.8, 1.2), rotation_degrees=0.0), receiver)
    return replace(block, camera=camera(), encoding="linear", occluder_matt=True)


def even_sky(radiance: float = 1.0) -> EnvironmentMap:
    return EnvironmentMap(torch.full((3, ROWS, 2 * ROWS), radiance))


@functools.lru_cache(maxsize=4)
def under_even_sky(noise: float) -> LinearPhoto:
    return pictured(even_sky(), noise)


def pictured(light: EnvironmentMap, noise: float = 0.0) -> LinearPhoto:
    """What the camera sees of the plane, and of the block with its own albedo."""
    here = scene()
    empty = linear_photo(torch.zeros(3, SIZE[1], SIZE[0]))
    shown = received(empty, here, light, Bounds(rays=2048), None)
    on_block = shown.values[6] == 1
    albedo = torch.where(on_block, torch.tensor(RHO).double()[:, None, None], PLANE_ALBEDO)
    picture = shown.values[:3] * albedo / torch.pi
    generator = torch.Generator().manual_seed(3)
    return linear_photo((picture * (1 + noise * torch.randn(picture.shape, generator=generator))).float())


def seen(noise: float = 0.0, bounce: bool = False) -> Facings:
    """Under the even sky."""
    found = facings_of(under_even_sky(noise), scene(), even_sky(), bounce)
    assert found is not None
    return found


def test_a_block_has_three_facings_of_which_uprights_see_half_the_sky() -> None:
    found = seen()
    order = (found.normals @ NORMALS.T).argmax(dim=0)
    assert_close(found.normals[order], NORMALS, atol=1e-6, rtol=0)
    lit = found.means(found.transport.sum(dim=1, keepdim=True))[order, 0]
    assert_close(lit, torch.pi * torch.tensor([0.5, 0.5, 1.0], dtype=torch.float64), rtol=2e-3, atol=0)
    shown = found.means(found.shown.T)[order]
    assert_close(shown, lit[:, None] * torch.tensor(RHO, dtype=torch.float64), rtol=1e-2, atol=0)
    assert not found.bounced.any()


def test_columns_of_texels_are_those_of_the_sky_in_parts() -> None:
    transport = seen().transport
    assert_close(texel_columns(transport, 8).sum(dim=1), transport.sum(dim=1))
    lit = torch.zeros(3, ROWS, 2 * ROWS)
    lit[:, 40:60, 100:120] = 1.0
    above = radiance_above(EnvironmentMap(lit))
    assert_close(above, lit[:, : ROWS // 2].double().flatten(start_dim=1))


def test_finer_light_is_seen_by_its_means() -> None:
    generator = torch.Generator().manual_seed(1)
    fine = torch.rand(3, 2 * ROWS, 4 * ROWS, generator=generator)
    angles = latlong.row_solid_angles(2 * ROWS).double()[:ROWS, None]
    coarse = latlong.row_solid_angles(ROWS).double()[: ROWS // 2].repeat_interleave(2 * ROWS)
    flux = (fine[:, :ROWS].double() * angles).sum(dim=(1, 2))
    assert_close((radiance_above(EnvironmentMap(fine)) * coarse).sum(dim=1), flux)


def test_the_right_light_is_told_to_stay_whatever_the_albedo() -> None:
    sky = even_sky()
    found = seen()
    for gram, slopes in telling(found, sky, 8):
        wanted = torch.linalg.lstsq(gram + 1e-6 * gram.diagonal().mean() * torch.eye(len(gram)), slopes[:, None])
        assert float(wanted.solution.abs().max()) < 0.01
    darker = replace(found, shown=found.shown / 7)
    for one, other in zip(telling(found, sky, 8), telling(darker, sky, 8), strict=True):
        assert_close(other, one)


@pytest.mark.parametrize("noise", [0.1, 1.0])
def test_noise_of_pixels_does_not_pull(noise: float) -> None:
    """e'Pe, chi squared with two degrees of freedom; of pixels half of which are black a facing's mean is off too."""
    found = seen(noise)
    lit = radiance_above(even_sky()) @ found.transport.T
    for shown, light in zip(found.shown, lit, strict=True):
        weight, _, e = weighed(found, shown, light)
        assert float(e @ weight @ e) < 12


def test_noise_of_pixels_makes_them_tell_less() -> None:
    weights = [weighed(seen(noise), seen(noise).shown[0], seen().transport.sum(dim=1))[0] for noise in (0.0, 1.0)]
    assert float(weights[1].trace()) < 0.2 * float(weights[0].trace())


def test_a_wrong_face_is_told() -> None:
    """Uprights that are a fifth brighter are off by ten times what a matt object may be."""
    found = seen()
    lit = found.transport.sum(dim=1)
    brighter = torch.where(found.normals[found.facing, 2] < 0.5, 1.2, 1.0) * lit
    weight, _, e = weighed(found, found.shown[0], brighter)
    assert float(e @ weight @ e) > 0.2 * (0.2 / MATT) ** 2


def test_of_a_common_factor_nothing_is_told() -> None:
    found = seen()
    weight, v, _ = weighed(found, found.shown[0], found.transport.sum(dim=1))
    assert_close(weight @ v, torch.zeros_like(v), atol=1e-9 * float(weight.abs().max()), rtol=0)


def test_from_straight_above_nothing_is_told() -> None:
    flat = replace(scene(), camera=None)
    assert facings_of(linear_photo(torch.ones(3, 48, 48)), flat, even_sky()) is None


def test_the_plane_throws_light_on_uprights_only() -> None:
    """Half of what they would get of an endless plane without their own shadow, or more: albedo x pi / 2."""
    found = seen(bounce=True)
    order = (found.normals @ NORMALS.T).argmax(dim=0)
    left, front, top = found.means(found.bounced.T)[order, 0].tolist()
    assert top == 0
    for upright in (left, front):
        assert 0.5 * PLANE_ALBEDO * torch.pi / 2 < upright < PLANE_ALBEDO * torch.pi / 2


@pytest.mark.parametrize("matt", [True, False])
def test_a_horizon_that_the_plane_hardly_sees(matt: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of uprights' light a tenth or more stays wrong without the block's own pixels, and 4 % at most with them."""
    monkeypatch.setattr("torchlight.evenness.PASSES", 1)
    monkeypatch.setattr("torchlight.evenness.WORSE", 1e9)
    sky = even_sky()
    sky.radiance[:, ROWS // 2 - round(ROWS * 12 / 180) : ROWS // 2] = 3.0
    light = evened(
        pictured(sky, 0.003), replace(scene(), occluder_matt=matt), even_sky(), precompute(scene(), 8, use_cache=False)
    )
    found = seen()
    lit, true = (found.means(found.transport @ radiance_above(each).T) for each in (light, sky))
    off = float((lit / true - 1).abs().max())
    assert off < 0.04 if matt else off > 0.1


def test_black_objects_tell_nothing() -> None:
    found = seen()
    for gram, slopes in telling(replace(found, shown=torch.zeros_like(found.shown)), even_sky(), 8):
        assert torch.isfinite(gram).all()
        assert float(slopes.abs().max()) < 1e-6
