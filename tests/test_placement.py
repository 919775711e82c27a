"""Where the object stands, from its shadow: truth by the analytic shadow or by cast rays, lights by formula."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest
import torch
from torch import Tensor
from torch.testing import assert_close
from workbench import BOX, LINEAR, RECEIVER, png, scene_file, torchlight

from torchlight import shadow_fit
from torchlight.geometry.analytic_shadow import Block
from torchlight.geometry.primitives import cylinder
from torchlight.geometry.receiver import Receiver
from torchlight.geometry.scene import Scene
from torchlight.inversion.adaptive import AdaptiveHaar
from torchlight.light import latlong
from torchlight.light.environment import EnvironmentMap
from torchlight.observing import observe
from torchlight.photo.observation import Observation, linear_photo
from torchlight.placement import shadow
from torchlight.placement.report import Placement, sentence
from torchlight.placement.shadow import refine
from torchlight.relighting import relight
from torchlight.synthetic import block_scene, block_values, eight_bit, expose, pixel_rays, receiver_image

STATED = Block((1.0, 0.6, 1.2), 20.0)
WRONG = Block((1.0, 0.6, 1.2), 23.0, (0.02, -0.015))  # what is true where the scene says `STATED`: 2 % and 3 degrees
PLANE = Receiver((0.0, 0.0), (4.0, 4.0), (32, 32))
RADIUS = math.hypot(1.0, 0.6) / 2
# azimuth, elevation and width of lamps in degrees, and their strength against a sky of 1
LIGHTS = {
    "one lamp": [(-60, 40, 4, 60)],
    "two lamps": [(100, 55, 6, 30), (-20, 35, 3, 60)],
    "three broad lamps": [(10, 60, 12, 12), (140, 45, 10, 12), (-110, 30, 8, 20)],
}


def lamps(name: str, height: int = 48) -> EnvironmentMap:
    """Returns a grey sky with lamps whose brightness falls off as a Gaussian of the chord."""
    directions = latlong.pixel_directions(height)
    total = 0.3 + 0.7 * directions[..., 2].clamp(min=0)
    for azimuth, elevation, width, strength in LIGHTS[name]:
        phi, theta = math.radians(azimuth), math.radians(elevation)
        axis = [math.cos(theta) * math.cos(phi), math.cos(theta) * math.sin(phi), math.sin(theta)]
        chord = (directions - torch.tensor(axis, dtype=torch.float64)).norm(dim=-1)
        total = total + strength * torch.exp(-((chord / math.radians(width)) ** 2) / 2)
    return EnvironmentMap(total * torch.tensor([1.0, 0.9, 0.7], dtype=torch.float64)[:, None, None])


def photographed(values: Tensor) -> Tensor:
    """Returns an 8-bit rectified photograph of the plane."""
    exposure = expose(values, torch.ones(PLANE.points, dtype=torch.bool))
    return receiver_image(eight_bit(values * exposure), PLANE)


@cache
def refined(light: str, true: Block) -> tuple[Scene, Placement]:
    """Returns what becomes of the stated scene when the block really stands elsewhere."""
    photo = linear_photo(photographed(block_values(true, PLANE, pixel_rays(lamps(light)))))
    return refine(block_scene(STATED, PLANE), lambda scene: observe(photo, scene))


def rms_of(placement: Placement) -> tuple[float, float]:
    """Returns the residual at the stated pose and where the object was left."""
    assert placement.rms_before is not None
    assert placement.rms_after is not None
    return placement.rms_before, placement.rms_after


def reach(x: float, y: float, degrees: float) -> float:
    """Returns how far a movement takes the block's points at most."""
    return math.hypot(x, y) + RADIUS * abs(math.radians(degrees))


@pytest.mark.parametrize("light", LIGHTS)
def test_a_wrong_place_is_found_to_a_fifth(light: str) -> None:
    _, found = refined(light, WRONG)
    error = (found.moved[0] - 0.02, found.moved[1] + 0.015, found.turned_degrees - 3.0)
    assert reach(*error) <= reach(0.02, -0.015, 3.0) / 5, found
    assert found.verdict == "moved"
    assert 1 <= found.steps <= shadow.MAX_STEPS
    assert rms_of(found)[1] < rms_of(found)[0]


@pytest.mark.parametrize("light", LIGHTS)
def test_the_error_is_what_the_deviation_says(light: str) -> None:
    _, found = refined(light, WRONG)
    errors = (found.moved[0] - 0.02, found.moved[1] + 0.015, found.turned_degrees - 3.0)
    for error, deviation in zip(errors, found.deviation, strict=True):
        assert deviation is not None
        assert abs(error) <= 4 * deviation, found


@pytest.mark.parametrize("light", LIGHTS)
def test_a_right_place_is_left_within_three_deviations(light: str) -> None:
    _, found = refined(light, STATED)
    for movement, deviation in zip((*found.moved, found.turned_degrees), found.deviation, strict=True):
        assert deviation is not None
        assert abs(movement) <= 3 * deviation, found
    assert rms_of(found)[1] <= rms_of(found)[0]


def test_the_scene_is_where_the_report_says() -> None:
    scene, found = refined("one lamp", WRONG)
    expected = block_scene(Block(STATED.size, 20.0 + found.turned_degrees, found.moved), PLANE)
    assert_close(scene.triangles, expected.triangles, rtol=0, atol=1e-12)
    assert scene.receiver == PLANE


def test_what_is_left_as_stated_is_the_stated_scene() -> None:
    stated = block_scene(STATED, PLANE)
    far = replace(stated, triangles=stated.triangles + torch.tensor([5000.0, 0.0, 0.0], dtype=torch.float64))
    scene, found = refine(far, lambda _: Observation(torch.ones(3, PLANE.points), torch.ones(PLANE.points)))
    assert scene is far
    assert not found.changed
    assert found.deviation == (None, None, None)
    assert found.verdict == "left as stated: the shadow does not tell its place to within a sample"


def test_a_round_object_is_moved_and_never_turned() -> None:
    scene = Scene(cylinder(0.4, 1.2, 64), PLANE)
    true = replace(scene, triangles=scene.triangles + torch.tensor([0.03, -0.02, 0.0], dtype=torch.float64))
    photo = linear_photo(photographed(relight(true, lamps("two lamps"), rays=20_000)))
    _, found = refine(scene, lambda here: observe(photo, here))
    assert found.deviation[2] is None
    assert abs(found.turned_degrees) < 0.05
    assert math.hypot(found.moved[0] - 0.03, found.moved[1] + 0.02) <= math.hypot(0.03, 0.02) / 5, found


def test_moving_the_object_is_moving_the_plane_the_other_way() -> None:
    frame = shadow_fit.frame_of(block_scene(STATED, PLANE))
    fit = some_fit(frame)
    shift = torch.tensor([0.3, -0.7, 0.0], dtype=torch.float64)
    x, y, _ = (shift * frame.unit).tolist()
    plane = replace(frame.scene, receiver=replace(PLANE, center=(-x, -y)))
    moved = shadow_fit.shown(shadow_fit.at(frame, shift), fit)
    assert_close(moved, shadow_fit.shown(plane, fit), rtol=0, atol=1e-9 * moved.max().item())
    assert (moved - shadow_fit.shown(frame.scene, fit)).abs().max() > 0.01 * moved.max()


def test_a_turn_is_about_the_middle_of_the_surface() -> None:
    apart = torch.cat([block_scene(Block((1.0, 1.0, 1.0), 0.0, (x, 2.0)), PLANE).triangles for x in (-1.0, 1.0)])
    frame = shadow_fit.frame_of(Scene(apart, PLANE))
    assert_close(frame.middle, torch.tensor([0.0, 2.0], dtype=torch.float64), rtol=0, atol=1e-12)
    quarter = torch.tensor([0.0, 0.0, math.pi / 2 / frame.unit[2].item()], dtype=torch.float64)
    turned = shadow_fit.at(frame, quarter).triangles
    assert_close(turned[..., :2].amin(dim=(0, 1)), torch.tensor([-0.5, 0.5], dtype=torch.float64), rtol=0, atol=1e-12)
    assert_close(turned[..., :2].amax(dim=(0, 1)), torch.tensor([0.5, 3.5], dtype=torch.float64), rtol=0, atol=1e-12)


def some_fit(frame: shadow_fit.Frame) -> shadow_fit.Fit:
    """Returns the fit of the stated block to a photograph of it under two lamps."""
    photo = linear_photo(photographed(block_values(STATED, PLANE, pixel_rays(lamps("two lamps")))))
    still = torch.zeros(3, dtype=torch.float64)
    return shadow_fit.solved(frame, still, lambda scene: observe(photo, scene), AdaptiveHaar())


def test_the_jacobian_is_what_remains_when_the_light_follows(monkeypatch: pytest.MonkeyPatch) -> None:
    # with an observation that the light explains exactly, r(q) = (1 - P(q)) (A(q) c - b) has the derivative J at once
    monkeypatch.setattr(shadow_fit, "DIFFERENCE", 0.1)
    monkeypatch.setattr(shadow_fit, "CELLS_PER_EDGE", 192)
    frame = shadow_fit.frame_of(block_scene(STATED, PLANE))
    fit = some_fit(frame)
    target = fit.matrix @ fit.radiance
    J = shadow_fit.jacobian(frame, fit)
    assert (fit.matrix.T @ J).abs().max() <= 1e-9 * fit.matrix.norm() * J.norm()

    def remaining(pose: Tensor) -> Tensor:
        columns = [shadow_fit.shown(shadow_fit.at(frame, pose), only(fit, k)) for k in range(len(fit.radiance))]
        matrix = torch.stack(columns, dim=1) * fit.observation.weights.sqrt()[:, None]
        return matrix @ torch.linalg.lstsq(matrix, target[:, None]).solution[:, 0] - target

    for k, ahead in enumerate(0.1 * torch.eye(3, dtype=torch.float64)):
        slope = (remaining(ahead) - remaining(-ahead)) / 0.2
        assert (slope - J[:, k]).norm() <= 0.05 * J[:, k].norm()


def only(fit: shadow_fit.Fit, square: int) -> shadow_fit.Fit:
    """Returns the fit with radiance 1 on one square alone."""
    one = slice(square, square + 1)
    return replace(
        fit, squares=fit.squares[one], radiance=torch.ones_like(fit.radiance[one]), matrix=fit.matrix[:, one]
    )


def test_the_line_says_what_moved_and_how_sure_it_is() -> None:
    moved = Placement("shadow", (1.25, -0.5), 2.0, (0.1, 0.2, None), 3.0, 1.0, 2, "moved")
    assert sentence(moved, "mm") == (
        "the object was moved by (1.25, -0.5) mm, turned by 2 degrees; x +- 0.1 mm, y +- 0.2 mm; "
        "RMS 3.00 -> 1.00 of 255"
    )
    still = Placement("shadow", (0.0, 0.0), 0.0, (None, None, None), 3.0, 3.0, 0, "left as stated: for a reason")
    assert sentence(still, "mm") == "the object was left as stated: for a reason; RMS 3.00 -> 3.00 of 255"


def test_the_command_moves_the_object_and_says_so(tmp_path: Path) -> None:
    photo = png(tmp_path / "photo.png", photographed(block_values(WRONG, PLANE, pixel_rays(lamps("one lamp")))))
    scene = scene_file(tmp_path, BOX + RECEIVER.replace("[16, 16]", "[32, 32]") + LINEAR)
    out = tmp_path / "out"
    ran = torchlight("estimate", scene, photo, "--out", out, "--resolution", 32, "--no-cache", "--refine-pose")
    assert ran.code == 0, ran.err
    assert f"{photo}: the object was moved by (" in ran.out
    result = json.loads((out / "photo" / "result.json").read_text())
    found = result["placement"]
    error = reach(found["moved"][0] - 0.02, found["moved"][1] + 0.015, found["turned_degrees"] - 3)
    assert error <= reach(0.02, -0.015, 3) / 5
    assert set(found) == {
        *("by", "moved", "turned_degrees", "deviation", "rms_before", "rms_after", "steps", "verdict")
    }
    assert result["rms_255"] < 0.8 * found["rms_before"]  # the light was found with the object where it was moved
