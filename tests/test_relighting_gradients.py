"""Gradients of shadows by the light, and relighting by one operator for many lights."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

import torchlight as tl
from torchlight.errors import SceneError, ShapeError
from torchlight.geometry.analytic_shadow import Block
from torchlight.light import cubature, latlong
from torchlight.light.environment import EnvironmentMap
from torchlight.light.overlap import latlong_to_texels
from torchlight.light.procedural import sun_and_window
from torchlight.light_plane import LightPlane
from torchlight.metrics import rms_255
from torchlight.synthetic import block_scene
from torchlight.transfer import transport

ALBEDO = (0.8, 0.5, 0.25)
RECEIVER = tl.Receiver((0.0, 0.0), (4.0, 4.0), (4, 4), ALBEDO)
SCENE = block_scene(Block((1.0, 0.6, 1.2), 20.0), RECEIVER)
EMPTY = tl.Scene(torch.zeros(0, 3, 3, dtype=torch.float64), RECEIVER)
RAYS = 400


def sky(height: int, *batch: int, seed: int = 0, dtype: torch.dtype = torch.float64) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(*batch, 3, height, 2 * height, generator=generator, dtype=torch.float64).exp().to(dtype)


def shown(radiance: Tensor) -> Tensor:
    return tl.relight(SCENE, EnvironmentMap(radiance, nonnegative=False), RAYS)


@pytest.fixture
def held(monkeypatch: pytest.MonkeyPatch) -> Callable[[Tensor], None]:
    """Holds the cells as one map wants them: relighting is then linear."""

    def hold(radiance: Tensor) -> None:
        table = cubature._flux_table(EnvironmentMap(radiance.detach(), nonnegative=False))
        cells = cubature._cut(table, RAYS, 0.0)
        monkeypatch.setattr(cubature, "_cut", lambda *_: cells)

    return hold


def gradient(radiance: Tensor, weights: Tensor) -> Tensor:
    radiance = radiance.clone().requires_grad_()
    return torch.autograd.grad((shown(radiance) * weights).sum(), radiance)[0]


def test_without_occluders_the_gradient_is_each_pixels_projected_solid_angle() -> None:
    radiance = sky(8).requires_grad_()
    values = tl.relight(EMPTY, EnvironmentMap(radiance), RAYS)
    (found,) = torch.autograd.grad(values[:, 0].sum(), radiance)
    share = latlong.row_projected_solid_angles(8, dtype=torch.float64) / torch.pi
    expected = torch.tensor(ALBEDO, dtype=torch.float64)[:, None, None] * share[:, None]
    assert_close(found, expected.expand(3, 8, 16), rtol=1e-12, atol=1e-15)


def test_the_way_back_is_the_adjoint_of_the_way_there(held: Callable[[Tensor], None]) -> None:
    held(sky(8))
    x, y = sky(8, seed=1), torch.randn(3, 16, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    assert_close((x * gradient(sky(8), y)).sum(), (shown(x) * y).sum(), rtol=1e-12, atol=0)


def test_gradients_agree_with_finite_differences_to_any_order(held: Callable[[Tensor], None]) -> None:
    radiance = sky(4).requires_grad_()
    held(radiance)
    assert torch.autograd.gradcheck(shown, radiance, eps=1e-3, atol=1e-9)

    def squares(light: Tensor) -> Tensor:
        return shown(light).square()

    assert torch.autograd.gradgradcheck(squares, radiance, eps=1e-3, atol=1e-6, fast_mode=True)


def test_the_derivative_is_that_of_the_integral_up_to_the_error_of_its_rays() -> None:
    """Along another light it is that light's shadow, whose own rays go elsewhere."""
    light, other, rays = sky(8).requires_grad_(), sky(8, seed=3), 4_000
    y = torch.zeros(3, 16, dtype=torch.float64)
    values = tl.relight(SCENE, EnvironmentMap(light), rays)
    expected = tl.relight(SCENE, EnvironmentMap(other), rays)
    for sample in (0, 5, 10):
        y[:] = 0
        y[1, sample] = 1
        (found,) = torch.autograd.grad((values * y).sum(), light, retain_graph=True)
        assert_close((found * other).sum(), expected[1, sample], rtol=0, atol=2e-2 * float(expected[1].max()))


def test_a_gradient_is_of_the_maps_own_kind_and_of_no_other_map() -> None:
    maps = sky(8, 2, 2, dtype=torch.float32).requires_grad_()
    values = shown(maps)
    assert (values.shape, values.dtype) == ((2, 2, 3, 16), torch.float32)
    (found,) = torch.autograd.grad(values[1, 0].sum(), maps)
    assert found.dtype == torch.float32
    assert float(found[1, 0].abs().max()) > 0
    assert float(found[0].abs().max()) == float(found[1, 1].abs().max()) == 0
    alone = gradient(maps[1, 0].detach(), torch.ones(3, 16))
    assert torch.equal(found[1, 0], alone)


def test_asking_for_a_gradient_changes_no_bit_and_not_asking_records_nothing() -> None:
    radiance = sky(8)
    plain, asked = shown(radiance), shown(radiance.clone().requires_grad_())
    assert torch.equal(plain, asked)
    assert not plain.requires_grad


# --- by one operator -------------------------------------------------------------------------------------------------


def test_one_operator_agrees_with_rays() -> None:
    scene = block_scene(Block((1.0, 0.6, 1.2), 20.0), replace(RECEIVER, samples=(16, 16)))
    light = sun_and_window(32)
    accurate = tl.relight(scene, light, 4_096)
    ones = torch.ones(256, dtype=accurate.dtype)
    errors = [
        rms_255(tl.relight_by(transport(scene, resolution, 192 // resolution), scene, light), accurate, ones).item()
        for resolution in (4, 16)
    ]
    assert errors[1] < 1.5
    assert errors[1] < 0.3 * errors[0]


def test_even_light_on_an_empty_plane_is_its_albedo_times_the_light() -> None:
    maps = torch.tensor([0.7, 2.0], dtype=torch.float64)[:, None, None, None].expand(2, 3, 8, 16)
    found = tl.relight_by(transport(EMPTY, 4, 48), EMPTY, EnvironmentMap(maps.contiguous()))
    expected = maps[:, :, 0, :1] * torch.tensor(ALBEDO, dtype=torch.float64)[:, None]
    assert_close(found, expected.expand(2, 3, 16), rtol=1e-4, atol=0)  # float32, and 48 directions along a texel


def test_it_is_linear_and_its_gradient_is_its_adjoint() -> None:
    transfer = transport(SCENE, 4, 8).to(dtype=torch.float64)
    radiance = sky(8, 2).requires_grad_()

    def by(light: Tensor) -> Tensor:
        return tl.relight_by(transfer, SCENE, EnvironmentMap(light, nonnegative=False))

    y = torch.randn(2, 3, 16, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    (found,) = torch.autograd.grad((by(radiance) * y).sum(), radiance)
    other = sky(8, 2, seed=1)
    assert_close((other * found).sum(), (by(other) * y).sum(), rtol=1e-12, atol=0)
    factor = torch.tensor(ALBEDO, dtype=torch.float64)[:, None] / torch.pi
    texels = latlong_to_texels(radiance.detach(), 4)
    assert_close(by(radiance.detach()), texels @ transfer.transport.T * factor, rtol=1e-12, atol=0)
    assert torch.autograd.gradcheck(by, sky(4, 2).requires_grad_(), fast_mode=True)


def test_a_transport_of_another_scene_is_refused() -> None:
    transfer, light = transport(EMPTY, 2, 2), EnvironmentMap(torch.ones(3, 4, 8))
    with pytest.raises(ShapeError, match="16 samples, but the scene's receiver has 64"):
        tl.relight_by(transfer, replace(EMPTY, receiver=replace(RECEIVER, samples=(8, 8))), light)
    near = replace(light, plane=LightPlane(3.0))
    with pytest.raises(SceneError, match="this light stands near"):
        tl.relight_by(transfer, EMPTY, near)
    stated = replace(EMPTY, light_plane=near.plane)
    assert tl.relight_by(transfer, stated, near).shape == (3, 16)
