"""`torchlight insert`: the pictures it writes, and one clear line for what it cannot do."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from torch import Tensor
from torch.testing import assert_close
from workbench import BOX, CAMERA, LINEAR, RECEIVER, RECTIFIED, Ran, exr, light, png, scene_file, torchlight

from torchlight.io.exr import read_exr, write_channels
from torchlight.io.images import read_photo, write_png
from torchlight.io.lights import write_light
from torchlight.light.environment import EnvironmentMap

PLATE = "v -0.3 -0.3 0\nv 0.3 -0.3 0\nv 0.3 0.3 0\nv -0.3 0.3 0\nv 0 0 0.6\n" + "".join(
    f"f {face}\n" for face in ("1 3 2", "1 4 3", "1 2 5", "2 3 5", "3 4 5", "4 1 5")
)
"""A pyramid."""
AT = ("--position", 1.0, -0.8, "--rays", 128)


@pytest.fixture
def desk(tmp_path: Path) -> Path:
    """A rectified photograph, its scene, its light and a mesh."""
    scene_file(tmp_path)
    png(tmp_path / "photo.png")
    light(tmp_path / "light.exr", 32)
    (tmp_path / "thing.obj").write_text(PLATE)
    return tmp_path


def insert(desk: Path, *more: object, out: str = "out.png", photo: str = "photo.png", scene: str = "scene.yaml") -> Ran:
    given = ("--scene", desk / scene, "--light", desk / "light.exr", "--object", desk / "thing.obj")
    return torchlight("insert", desk / photo, *given, "--out", desk / out, *more)


def codes(path: Path) -> Tensor:
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert image is not None
    return torch.from_numpy(image.astype(np.int64))


def test_a_composite_has_the_photograph_s_size_and_its_bits_where_nothing_changed(desk: Path) -> None:
    ran = insert(desk, *AT)
    assert ran.code == 0, ran.err
    assert "the object covers" in ran.out
    before, after = codes(desk / "photo.png"), codes(desk / "out.png")
    assert before.shape == after.shape
    assert before.dtype == after.dtype
    changed = (before != after).any(dim=-1)
    assert int(changed.sum()) > 0
    assert changed[12, 12] or changed[11, 12]  # (1, -0.8): column 12, row 11 of 16


def test_all_layers_agree_over_the_photograph(desk: Path) -> None:
    exr(desk / "photo.exr")
    ran = insert(desk, *AT, "--layer", "all", out="out.exr", photo="photo.exr")
    assert ran.code == 0, ran.err
    composite, _ = read_exr(desk / "out.exr")
    photo, _ = read_exr(desk / "photo.exr")
    import OpenEXR

    layers = {}
    for name in ("straight", "premultiplied"):
        with OpenEXR.File(str(desk / f"out_{name}.exr"), separate_channels=True) as file:
            layers[name] = torch.stack([torch.from_numpy(file.channels()[c].pixels.copy()) for c in "RGBA"])
    straight, premultiplied = layers["straight"], layers["premultiplied"]
    assert_close(straight[:3] * straight[3], premultiplied[:3], rtol=1e-5, atol=1e-6)
    assert_close(premultiplied[:3] + (1 - premultiplied[3]) * photo, composite, rtol=1e-5, atol=1e-6)
    assert composite.max() > 0


def test_sixteen_bits_stay_sixteen_and_jpeg_is_written(desk: Path) -> None:
    stored = (read_photo(desk / "photo.png").pixels * 65535).round().permute(1, 2, 0).contiguous().numpy()
    write_png(desk / "deep.png", stored.astype(np.uint16))
    assert insert(desk, *AT, photo="deep.png").code == 0
    deep = cv2.imread(str(desk / "out.png"), cv2.IMREAD_UNCHANGED)
    assert deep is not None
    assert deep.dtype == np.uint16
    assert insert(desk, *AT, out="out.jpg").code == 0
    assert codes(desk / "out.jpg").shape == (16, 16, 3)


def test_a_straight_layer_has_alpha(desk: Path) -> None:
    assert insert(desk, *AT, "--layer", "straight").code == 0
    layer = codes(desk / "out.png")
    assert layer.shape == (16, 16, 4)
    assert layer[..., 3].max() == 255
    assert layer[..., 3].min() < 5


def test_a_camera_s_photograph(desk: Path) -> None:
    scene_file(desk, BOX + RECEIVER + LINEAR + CAMERA, "camera.yaml")
    png(desk / "seen.png", torch.full((3, 72, 96), 0.5))
    ran = insert(desk, *AT, "--gloss", 0.2, "--bounce", photo="seen.png", scene="camera.yaml")
    assert ran.code == 0, ran.err
    before, after = codes(desk / "seen.png"), codes(desk / "out.png")
    assert 20 < int((before != after).any(dim=-1).sum()) < 72 * 96
    assert "times as bright as this light makes it" in ran.out  # a grey picture is not this light's


def test_light_that_the_photograph_does_not_determine_is_said(desk: Path) -> None:
    """Half of the sphere above the plane is doubtful, and the light is even: half of what reaches upright surfaces."""
    write_light(desk / "light.exr", EnvironmentMap(torch.ones(3, 8, 16)), {})
    doubtful = torch.ones(8, 16)
    doubtful[:, :8] = 0.0
    write_channels(desk / "confidence.exr", {"observability": doubtful}, {})
    ran = insert(desk, *AT)
    assert ran.code == 0, ran.err
    assert "determined: 50% of the light that reaches upright surfaces" in ran.out
    write_channels(desk / "confidence.exr", {"observability": torch.ones(8, 16)}, {})
    assert "determined:" not in insert(desk, *AT, "--overwrite").out


def test_units_scale_and_pose_say_the_same(desk: Path) -> None:
    assert insert(desk, *AT, "--scale", 0.5).code == 0
    first = codes(desk / "out.png")
    pose = "0.5,0,0,1, 0,0.5,0,-0.8, 0,0,0.5,0, 0,0,0,1"
    assert insert(desk, "--rays", 128, "--pose", pose, "--overwrite").code == 0
    assert torch.equal(codes(desk / "out.png"), first)
    assert insert(desk, *AT, "--units", "cm", "--scale", 0.05, "--overwrite").code == 0
    assert torch.equal(codes(desk / "out.png"), first)


LOW = "1,0,0,0, 0,1,0,0, 0,0,1,-0.25, 0,0,0,1"


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (("--pose", LOW), "--pose: the object lies 0.25 below the plane (its lowest point is at z = -0.25); raise it"),
        (("--pose", "1,2,3"), "--pose: expected 16 numbers separated by commas, row by row, got '1,2,3'"),
        (("--pose", LOW, "--scale", 2), "--pose: give it alone"),
        (("--position", 90, 0), "the picture shows neither the object nor its shadow: it stands around (90, 0, 0.3)"),
        (("--scale", 0), "scale: expected a number above 0"),
        (("--gloss", 2), "gloss: expected a share"),
        (("--layer", "premultiplied"), "a premultiplied layer is written as .exr"),
        (("--rays", 0), "rays: expected 1 to"),
    ],
)
def test_one_line_for_what_cannot_be(desk: Path, more: tuple[object, ...], message: str) -> None:
    ran = insert(desk, "--rays", 64, *more) if "--rays" not in more else insert(desk, *more)
    assert ran.code == 2
    assert message in ran.line
    assert not (desk / "out.png").exists()


def test_one_line_for_files_that_cannot_be(desk: Path) -> None:
    assert "expected a name that ends in .png, .jpg, .jpeg or .exr" in insert(desk, out="out.gif").line
    assert "there is no folder" in insert(desk, out="none/out.png").line
    (desk / "thing.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\n")
    assert "the mesh has no faces" in insert(desk).line
    (desk / "thing.obj").write_text(PLATE)
    scene_file(desk, BOX + RECEIVER + LINEAR + CAMERA, "camera.yaml")
    assert (
        "the photograph has 16 x 16 pixels but camera.image_size says 96 x 72" in insert(desk, scene="camera.yaml").line
    )
    broken = torch.full((3, 8, 16), 1.0)
    broken[0, 0, 0] = torch.nan
    exr(desk / "light.exr", broken)
    assert "NaN or infinite radiance" in insert(desk).line
    assert "already there" in insert(desk, out="photo.png").line


def test_a_near_light_s_scene_wants_a_near_light(desk: Path) -> None:
    scene_file(desk, BOX + RECEIVER + LINEAR + "light: {height: 9}\n", "near.yaml")
    assert "the scene says that its light stands at the height 9" in insert(desk, *AT, scene="near.yaml").line


def test_a_light_of_this_photograph_is_made_even_unless_told_otherwise(
    desk: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another photograph's light, or one that says nothing, is used as it is. (Twice as bright stands for even.)"""

    bounces = []

    def twice(photo: object, scene: object, light: EnvironmentMap, progress: object, bounce: bool) -> EnvironmentMap:
        bounces.append(bounce)
        return EnvironmentMap(2 * light.radiance)

    monkeypatch.setattr("torchlight.cli.insert.evened", twice)
    found = {"photo_sha256": read_photo(desk / "photo.png").sha256}
    plain = insert(desk, *AT, out="plain.exr")
    write_light(desk / "light.exr", EnvironmentMap(torch.ones(3, 32, 64)), found)
    evened = insert(desk, *AT, out="evened.exr")
    told = insert(desk, *AT, "--as-found", out="told.exr")
    bounced = insert(desk, *AT, "--bounce", out="bounced.exr")
    assert bounces == [False, True]  # --as-found asks for none
    for ran in (plain, evened, told, bounced):
        assert ran.code == 0, ran.err
    assert "--as-found uses it as it is" in evened.out
    assert "--as-found" not in plain.out + told.out
    pictures = [read_exr(desk / f"{name}.exr")[0] for name in ("evened", "told")]
    assert float((pictures[0] / pictures[1]).nan_to_num(0.0).max()) == pytest.approx(2.0, rel=1e-3)  # inside the object


def test_matt_objects_that_the_photograph_does_not_show_are_said_to_tell_nothing(
    desk: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("torchlight.cli.insert.evened", lambda photo, scene, light, **named: light)
    scene_file(desk, f"{RECTIFIED}occluder_matt: true\n", "matt.yaml")
    found = {"photo_sha256": read_photo(desk / "photo.png").sha256}
    write_light(desk / "light.exr", EnvironmentMap(torch.ones(3, 32, 64)), found)
    matt, plain = insert(desk, *AT, scene="matt.yaml"), insert(desk, *AT, out="plain.png")
    assert (matt.code, plain.code) == (0, 0)
    assert "occluder_matt: nothing more is told by it" in matt.out
    assert "occluder_matt" not in plain.out + insert(desk, *AT, "--as-found", scene="matt.yaml", out="as.png").out


def test_what_is_wrong_with_the_object_is_said_before_the_light_is_made_even(
    desk: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []
    monkeypatch.setattr("torchlight.cli.insert.evened", lambda *given, **named: asked.append(given))
    write_light(
        desk / "light.exr",
        EnvironmentMap(torch.ones(3, 32, 64)),
        {"photo_sha256": read_photo(desk / "photo.png").sha256},
    )
    (desk / "thing.obj").unlink()
    ran = insert(desk, *AT)
    assert (ran.code, "no such file" in ran.line, asked) == (2, True, [])
