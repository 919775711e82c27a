"""Pictures of the viewer: the shadow moves with the light, exposure, residual; no viser is needed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch.testing import assert_close

from torchlight.geometry.analytic_shadow import Block
from torchlight.geometry.receiver import Receiver
from torchlight.light.environment import EnvironmentMap, rotate_about_z
from torchlight.light.procedural import sun_and_window
from torchlight.relighting import relight
from torchlight.synthetic import block_scene
from torchlight.transfer import transport
from torchlight.viewer import stage
from torchlight.viewer.pictures import MIN_SIDE, dome_picture, enlarged, white_scale
from torchlight.viewer.stage import Stage, dome, everything, manageable, of_results, plane, predicted

RECEIVER = Receiver((0.0, 0.0), (4.0, 4.0), (8, 8), (0.5, 0.5, 0.5))


@pytest.fixture(scope="module")
def shown() -> Stage:
    scene = block_scene(Block((1.0, 0.6, 1.2), 20.0), RECEIVER)
    light = sun_and_window(32, dtype=torch.float32)
    shadow = relight(scene, light, 4096)
    return Stage(scene, light, transport(scene, 16, 2), shadow, everything(64))


@pytest.mark.parametrize("degrees", [0.0, 37.0, -120.0])
def test_the_shadow_is_that_of_the_turned_light(shown: Stage, degrees: float) -> None:
    """Against rays cast at the map's own resolution; texels of 5 degrees blur the sun's edge."""
    expected = relight(shown.scene, rotate_about_z(shown.light, degrees), 4096)
    assert_close(predicted(shown, degrees), expected, atol=0.08 * float(expected.max()), rtol=0)


def test_what_the_plane_shows(shown: Stage) -> None:
    assert shown.observed is not None
    pictures = {layer: plane(shown, layer, 0.0, 0.0) for layer in shown.layers}
    assert set(pictures) == {"observed", "predicted", "residual"}
    for image in pictures.values():
        assert (image.shape, image.dtype) == ((MIN_SIDE, MIN_SIDE, 3), np.uint8)
    side = MIN_SIDE // 8
    corner = shown.observed.reshape(3, 8, 8)[:, 7, 0] * stage.exposure(shown)  # the largest y is on top
    linear = (pictures["observed"][side // 2, side // 2] / 255.0) ** 2.2
    assert linear == pytest.approx(corner.numpy(), abs=0.03)  # sRGB is nearly a power of 2.2
    assert pictures["observed"].max() == 255
    assert plane(shown, "observed", 0.0, -2.0).max() < 150
    middle = plane(replace(shown, observed=predicted(shown, 0.0)), "residual", 0.0, 0.0)
    assert np.abs(middle.astype(int) - 247).max() < 4  # nothing is left: the middle of the colours
    turned = plane(shown, "residual", 90.0, 0.0)
    assert turned.reshape(-1, 3).std(axis=0).max() > 20


def test_unused_samples_are_grey(shown: Stage) -> None:
    used = shown.used.clone()
    used[0] = False
    for layer in ("observed", "residual"):
        image = plane(replace(shown, used=used), layer, 0.0, 0.0)
        assert image[-1, 0].tolist() == [140, 140, 140]  # sample 0 is at the lower left


def test_a_scene_alone_shows_its_shadow(shown: Stage) -> None:
    alone = replace(shown, observed=None)
    assert alone.layers == ("predicted",)
    assert plane(alone, "predicted", 0.0, 0.0).max() == 255
    assert stage.exposure(alone) == pytest.approx(1 / float(predicted(alone, 0.0).max()))


def test_the_dome_shows_the_upper_half(shown: Stage) -> None:
    image = dome(shown, 0.0)
    assert image.shape == (16, 64, 3)
    assert dome(shown, 2.0).mean() > image.mean() > dome(shown, -2.0).mean()
    assert dome_picture(EnvironmentMap(torch.ones(3, 1, 2)), 1.0).shape == (1, 2, 3)


def test_large_maps_are_averaged_before_they_are_turned() -> None:
    fine = EnvironmentMap(torch.rand(3, 1024, 2048, generator=torch.Generator().manual_seed(0)))
    assert manageable(fine).height == 256
    assert manageable(EnvironmentMap(torch.ones(3, 300, 600))).height == 300


def test_results_of_another_receiver_are_not_shown() -> None:
    tensors = {"samples": torch.ones(3, 64), "weights": torch.ones(64)}
    assert of_results(tensors, 64) is not None
    assert of_results(tensors, 63) is None
    assert of_results({}, 64) is None


def test_small_pictures_are_enlarged_and_black_has_a_scale() -> None:
    assert enlarged(np.zeros((100, 300, 3), dtype=np.uint8)).shape == (300, 900, 3)
    assert enlarged(np.zeros((300, 300, 3), dtype=np.uint8)).shape == (300, 300, 3)
    assert white_scale(torch.zeros(3, 4), torch.ones(4, dtype=torch.bool)) == 1
