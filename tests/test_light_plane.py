"""Light on a plane over the receiver: shadows of rays to its points, and light found, stored and used as such."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import Tensor
from torch.testing import assert_close
from workbench import BOX, LINEAR, RECEIVER, png, scene_file, torchlight

from torchlight import estimate
from torchlight.errors import FormatError, SceneError, TorchlightError
from torchlight.geometry.footprints import footprint_points
from torchlight.geometry.primitives import box
from torchlight.geometry.receiver import Receiver
from torchlight.geometry.scene import Scene, shadowing
from torchlight.geometry.visibility import scene_occlusion
from torchlight.io.exr import write_exr
from torchlight.io.lights import read_light, write_light
from torchlight.io.scene_file import load_scene
from torchlight.joint import View, check_views
from torchlight.light.bases import Texels
from torchlight.light.environment import EnvironmentMap
from torchlight.light.latlong import pixel_directions
from torchlight.light_plane import CLEARANCE, LightPlane, stretched
from torchlight.near_light.height import height_deviation, height_sentence, lit_as_found
from torchlight.near_light.verdict import NearLight
from torchlight.photo.observation import Observation, linear_photo
from torchlight.precomputation import precompute, transport_key
from torchlight.relighting import relight
from torchlight.synthetic import receiver_image

PLANE = Receiver((3.0, -2.0), (60.0, 60.0), (30, 30))
BLOCK = box((12.0, 9.0, 14.0))
LIGHT = LightPlane(40.0, (3.0, -2.0))
LAMP = (33.0, -22.0)  # x and y of a lamp on that plane
NEAR = NearLight(True, 1e-9, 20.0, 2.0, 80.0, 50.0)


def of_lamp(place: Tensor, triangles: Tensor = BLOCK) -> Tensor:
    """Returns the share of every sample that a point of light reaches, by rays to it; no fall-off."""
    scene = Scene(triangles, PLANE)
    points = footprint_points(PLANE, 6).reshape(-1, 3)
    hidden = torch.from_numpy(scene_occlusion(scene).hidden_from(place.numpy(), points.numpy()))
    return 1 - hidden.double().reshape(PLANE.points, -1).mean(dim=1)


def spot(plane: LightPlane | None, height: int = 512) -> EnvironmentMap:
    """Returns the map that is bright where the lamp is seen from the plane's center, 1.5 pixels wide."""
    away = torch.tensor([*LAMP, LIGHT.height], dtype=torch.float64) - torch.tensor([3.0, -2.0, 0.0])
    towards = torch.nn.functional.normalize(away.double(), dim=0)
    cosine = (pixel_directions(height) @ towards).clamp(-1, 1)
    bright = (cosine.acos() < 1.5 * torch.pi / height).double()
    return EnvironmentMap(bright.expand(3, -1, -1).contiguous(), plane=plane)


def test_shadows_of_every_point_of_the_plane_are_those_of_a_direction() -> None:
    """By hand: a lamp (l, H) throws q at z to (H q - z l) / (H - z), a direction (u, v, 1) throws M q to M q - z u."""
    generator = torch.Generator().manual_seed(0)
    points = torch.rand(50, 3, generator=generator, dtype=torch.float64) * torch.tensor([40.0, 40.0, 80.0])
    lamps = torch.randn(50, 2, generator=generator, dtype=torch.float64) * 60
    plane = LightPlane(100.0, (7.0, -3.0))
    q, z = points[:, None, :2], points[:, None, 2:]
    near = (100.0 * q - z * lamps) / (100.0 - z)
    far = plane.stretch(points)[:, None]
    tangents = (lamps - torch.tensor([7.0, -3.0])) / 100.0
    assert_close(far[..., :2] - far[..., 2:] * tangents, near, rtol=1e-12, atol=1e-9)


def test_another_center_shifts_the_directions_and_says_the_same() -> None:
    one, other = LightPlane(100.0, (7.0, -3.0)), LightPlane(100.0, (-20.0, 30.0))
    points = torch.tensor([[5.0, 9.0, 30.0], [-4.0, 2.0, 70.0]], dtype=torch.float64)
    shift = (torch.tensor(one.center) - torch.tensor(other.center)).double() / 100.0
    u = torch.tensor([0.3, -0.2], dtype=torch.float64)
    thrown = [m[:, :2] - m[:, 2:] * v for m, v in ((one.stretch(points), u), (other.stretch(points), u + shift))]
    assert_close(thrown[0], thrown[1], rtol=1e-12, atol=1e-12)


def test_a_near_lamp_relights_like_rays_to_it_and_a_distant_one_does_not() -> None:
    place = torch.tensor([*LAMP, LIGHT.height], dtype=torch.float64)
    true = of_lamp(place)
    near, far = (relight(Scene(BLOCK, PLANE), spot(plane), rays=3000)[0] for plane in (LIGHT, None))
    near, far = near / near.max(), far / far.max()
    assert (near - true).abs().mean() < 0.01  # the spot is a degree wide
    assert (far - true).abs().mean() > 3 * (near - true).abs().mean()


def test_light_found_under_its_plane_predicts_another_object_under_it() -> None:
    place = torch.tensor([*LAMP, LIGHT.height], dtype=torch.float64)
    scene = Scene(BLOCK, PLANE, light_plane=LIGHT)
    photo = linear_photo(receiver_image(of_lamp(place).expand(3, -1) + 0.1, PLANE).float())
    found = estimate(photo, scene, Texels(16), transfer=precompute(scene, 16, use_cache=False))
    assert found.light.plane == LIGHT
    far = replace(scene, light_plane=None)
    distant = estimate(photo, far, Texels(16), transfer=precompute(far, 16, use_cache=False))
    assert found.rms_255 < 0.6 * distant.rms_255
    moved = BLOCK + torch.tensor([-14.0, 8.0, 0.0])
    true = of_lamp(place, moved) + 0.1
    off = [
        (relight(Scene(moved, PLANE), one.light, rays=20_000)[0].double() - true).abs().mean()
        for one in (found, distant)
    ]
    assert off[0] < 0.5 * off[1]


def test_relighting_where_the_scene_says_otherwise_is_refused() -> None:
    scene = Scene(BLOCK, PLANE, light_plane=LIGHT)
    for plane in (None, replace(LIGHT, height=70.0)):
        with pytest.raises(SceneError, match="the scene says that its light stands at the height 40"):
            relight(scene, spot(plane, 8), rays=10)
    assert torch.equal(
        relight(scene, spot(LIGHT, 8), rays=10), relight(replace(scene, light_plane=None), spot(LIGHT, 8), rays=10)
    )


def test_the_transport_on_disk_is_that_of_the_height() -> None:
    scene = Scene(BLOCK, PLANE)
    keys = {transport_key(replace(scene, light_plane=plane), 4, 2) for plane in (None, LIGHT, LightPlane(61.0))}
    assert len(keys) == 3
    assert shadowing(scene) is scene
    assert_close(shadowing(replace(scene, light_plane=LIGHT)).triangles, stretched(BLOCK, Tensor([3.0, -2.0]), 1 / 40))


def test_a_file_remembers_where_its_light_stands(tmp_path: Path) -> None:
    write_light(tmp_path / "a.exr", spot(LIGHT, 8), {"method": "x"})
    assert read_light(tmp_path / "a.exr").plane == LIGHT
    write_light(tmp_path / "b.exr", spot(None, 8), {})
    assert read_light(tmp_path / "b.exr").plane is None
    for wrong in ({"height": -1.0, "center": [0, 0]}, {"height": 5.0}, "near"):
        write_exr(tmp_path / "c.exr", torch.ones(3, 8, 16), {"light_plane": wrong})
        with pytest.raises(FormatError, match=r"c\.exr: light"):
            read_light(tmp_path / "c.exr")


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("light: {height: 1.25}", "1.25 is not clear of the occluders, whose top is at 1.2"),
        ("light: {height: 0}", "light.height: expected a number above 0"),
        ("light: {center: [0, 0]}", "light.height: missing"),
        ("light: {heights: 3}", "unknown key; did you mean 'height'"),
        ("light: 3", "light: expected a mapping"),
        ("light: {height: 3}\noccluder_albedo: 0.1", "cannot be combined"),
    ],
)
def test_what_cannot_be_in_a_scene_file_is_one_line(tmp_path: Path, line: str, said: str) -> None:
    with pytest.raises(TorchlightError, match=said):
        load_scene(scene_file(tmp_path, BOX + RECEIVER + LINEAR + line + "\n"))


def test_directions_are_counted_from_the_receivers_middle_by_default(tmp_path: Path) -> None:
    scene = load_scene(scene_file(tmp_path, BOX + RECEIVER + LINEAR + "light: {height: 9}\n"))
    assert scene.light_plane == LightPlane(9.0, scene.receiver.center)
    scene = load_scene(scene_file(tmp_path, BOX + RECEIVER + LINEAR + "light: {height: 9, center: [1, 2]}\n"))
    assert scene.light_plane == LightPlane(9.0, (1.0, 2.0))


def test_photographs_of_lights_in_different_places_are_not_solved_together() -> None:
    observation = Observation(torch.ones(3, PLANE.points), torch.ones(PLANE.points))
    views = [View(Scene(BLOCK, PLANE, light_plane=plane), observation) for plane in (LIGHT, None)]
    with pytest.raises(SceneError, match="light does not stand in one place"):
        check_views(views)


def test_a_found_height_is_taken_only_where_it_is_told() -> None:
    scene = Scene(BLOCK, PLANE, units="mm")
    lit = lit_as_found(scene, NEAR)
    assert lit.light_plane == LightPlane(50.0, PLANE.center)
    assert height_sentence(lit, NEAR) == "the light is taken as standing at 50 +- 5 mm, as its shadow tells"
    assert_close(height_deviation(NEAR), 5.0)
    low = replace(NEAR, height=CLEARANCE * 14.0 - 0.01)
    for near, why in ((None, "does not tell"), (replace(NEAR, flagged=False), "not found near"), (low, "not clear")):
        assert lit_as_found(scene, near) is scene
        assert why in height_sentence(scene, near)


def test_the_command_finds_the_height_and_says_so_everywhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("torchlight.batch.looking.near_light", lambda scene, observation: replace(NEAR, height=6.0))
    photo = png(tmp_path / "photo.png", torch.full((3, 32, 32), 0.5))
    scene = scene_file(tmp_path, BOX + RECEIVER + LINEAR)
    options = ("--no-cache", "--method", "texels", "--resolution", 4, "--estimate-height")
    ran = torchlight("estimate", scene, photo, "--out", tmp_path / "out", *options)
    assert ran.code == 0, ran.err
    assert "the light is taken as standing at 6" in ran.out
    assert "the light is near" not in ran.err
    result = json.loads((tmp_path / "out" / "photo" / "result.json").read_text())
    middle = list(load_scene(scene).receiver.center)
    assert result["light_plane"] == {"height": 6.0, "center": middle, "estimated": True}
    assert read_light(tmp_path / "out" / "photo" / "light.exr").plane == LightPlane(6.0, (middle[0], middle[1]))


def test_options_that_contradict_the_scene_are_one_line(tmp_path: Path) -> None:
    photo = png(tmp_path / "photo.png", torch.full((3, 32, 32), 0.5))
    for more, options, said in (
        ("light: {height: 9}\n", [], "the scene states light.height"),
        ("occluder_albedo: 0.05\n", [], "the scene states occluder_albedo"),
        ("", ["--skip-near-test"], "needs the near-light test"),
    ):
        scene = scene_file(tmp_path, BOX + RECEIVER + LINEAR + more)
        ran = torchlight("estimate", scene, photo, "--out", tmp_path / "out", "--estimate-height", *options)
        assert ran.code == 2
        assert said in ran.err
        assert ran.err.count("\n") == 1
