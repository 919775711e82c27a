from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import torch
from torch.testing import assert_close

from torchlight.errors import (
    CalibrationError,
    ConfigError,
    FormatError,
    SceneError,
    TorchlightError,
    TorchlightWarning,
)
from torchlight.geometry.primitives import box, cone, cylinder, sphere
from torchlight.geometry.transforms import transform
from torchlight.io.images import write_png
from torchlight.io.scene_file import load_scene

EXAMPLES = Path(__file__).parents[1] / "configs" / "scenes"
RECEIVER = "receiver: {size: [400, 300], samples: [128, 96]}\n"
BLOCK = "occluders: [{box: [100, 60, 120]}]\n"
CAMERA = """camera:
  image_size: [8, 6]
  K: [[10, 0, 4], [0, 10, 3], [0, 0, 1]]
  world_to_camera: [[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 500], [0, 0, 0, 1]]
"""
TETRAHEDRON = """v 0 0 0
v 10 0 0
v 0 10 0
v 0 0 10
f 1 3 2
f 1 2 4
f 2 3 4
f 3 1 4
"""


def write(folder: Path, text: str) -> Path:
    path = folder / "scene.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def refused(folder: Path, text: str, error: type[TorchlightError], *parts: str) -> None:
    """Checks class and parts of the one-line message, which begins with the file's name."""
    path = write(folder, text)
    with pytest.raises(error) as caught:
        load_scene(path)
    message = str(caught.value)
    assert message.startswith(str(path)), message
    assert "\n" not in message
    for part in parts:
        assert part in message, message


def occluders(*entries: str) -> str:
    return "occluders:\n" + "".join(f"  - {entry}\n" for entry in entries) + RECEIVER


@pytest.mark.parametrize("name", sorted(path.name for path in EXAMPLES.glob("*.yaml")))
def test_examples_load(name: str) -> None:
    scene = load_scene(EXAMPLES / name)
    assert scene.triangles[..., 2].max() > 0
    assert scene.triangles[..., 2].min() > -1e-9
    assert scene.encoding is not None


def test_there_is_an_example_of_each_kind() -> None:
    text = "".join(path.read_text() for path in EXAMPLES.glob("*.yaml"))
    keys = ("box", "cylinder", "cone", "sphere", "mesh", "matrix", "scale", "camera", "distortion", "mask", "albedo")
    assert [key for key in keys if f"{key}:" not in text] == []


def test_the_camera_example_sees_its_receiver() -> None:
    from torchlight.camera import project

    scene = load_scene(EXAMPLES / "block_camera.yaml")
    assert scene.camera is not None
    assert_close(scene.camera.position, torch.tensor([0.0, -500.0, 700.0], dtype=torch.float64), rtol=0, atol=1e-9)
    corners = torch.tensor([[x, y, 0.0] for x in (-200, 200) for y in (-150, 150)], dtype=torch.float64)
    pixels = project(scene.camera, corners)
    limit = torch.tensor(scene.camera.image_size, dtype=torch.float64)
    assert bool(((pixels > 0) & (pixels < limit - 1)).all())


def test_everything_that_the_contract_names(tmp_path: Path) -> None:
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "t.obj").write_text(TETRAHEDRON)
    mask = np.zeros((6, 8), dtype=np.uint8)
    mask[2, 3] = 7
    write_png(tmp_path / "mask.png", mask)
    text = (
        "units: mm\n"
        "occluders:\n"
        "  - {mesh: sub/t.obj, scale: 2, rotation_degrees: [0, 0, 17.0], translation: [300.0, 40, 0]}\n"
        "  - box: [100, 60, 120]\n"
        "  - {cylinder: {radius: 5, height: 7}, translation: [100, 0, 0]}\n"
        "  - {cone: {radius: 5, height: 7}, translation: [200, 0, 0]}\n"
        "  - {sphere: {radius: 5e0}, matrix: [[1, 0, 0, -100], [0, 1, 0, 0], [0, 0, 1, 1e-1], [0, 0, 0, 1]]}\n"
        "receiver: {center: [1, 2], size: [400, 300], samples: [128, 96], albedo: 0.8}\n"
        + CAMERA
        + "  distortion: [0.1, -0.2, 0.001, 0.002]\n"
        "photo: {encoding: linear}\n"
        "reference: smooth\n"
        "mask: mask.png\n"
    )
    scene = load_scene(write(tmp_path, text))
    mesh = scene.triangles[:4]
    turn = math.radians(17)
    top = torch.tensor([300.0, 40.0, 20.0], dtype=torch.float64)
    side = torch.tensor([300 + 20 * math.cos(turn), 40 + 20 * math.sin(turn), 0.0], dtype=torch.float64)
    for corner in (top, side):
        assert_close((mesh.reshape(-1, 3) - corner).norm(dim=1).amin().item(), 0.0, rtol=0, atol=1e-12)
    none = (0.0, 0.0, 0.0)
    rest = [
        box((100.0, 60.0, 120.0)),
        transform(cylinder(5.0, 7.0), 1.0, none, (100.0, 0.0, 0.0)),
        transform(cone(5.0, 7.0), 1.0, none, (200.0, 0.0, 0.0)),
        transform(sphere(5.0), 1.0, none, (-100.0, 0.0, 0.1)),
    ]
    assert_close(scene.triangles[4:], torch.cat(rest), rtol=0, atol=1e-12)
    assert scene.triangles.dtype == torch.float64
    receiver = scene.receiver
    assert (receiver.center, receiver.size, receiver.samples) == ((1.0, 2.0), (400.0, 300.0), (128, 96))
    assert receiver.albedo == (0.8, 0.8, 0.8)
    assert scene.camera is not None
    assert scene.camera.image_size == (8, 6)
    assert scene.camera.distortion.tolist() == [0.1, -0.2, 0.001, 0.002]
    assert scene.camera.intrinsics.tolist() == [[10, 0, 4], [0, 10, 3], [0, 0, 1]]
    assert_close(scene.camera.position, torch.tensor([0.0, 0.0, 500.0], dtype=torch.float64))
    assert (scene.units, scene.encoding, scene.reference) == ("mm", "linear", "smooth")
    assert scene.mask is not None
    assert scene.mask.nonzero().tolist() == [[2, 3]]


def test_what_may_be_left_out(tmp_path: Path) -> None:
    scene = load_scene(write(tmp_path, BLOCK + RECEIVER))
    assert scene.receiver.center == (0.0, 0.0)
    assert scene.receiver.albedo is None
    assert (scene.camera, scene.encoding, scene.mask) == (None, None, None)
    assert (scene.units, scene.reference) == ("unit", "uniform")
    scene = load_scene(write(tmp_path, BLOCK + RECEIVER.replace("}", ", albedo: [0.1, 0.2, 0.3]}") + CAMERA))
    assert scene.receiver.albedo == (0.1, 0.2, 0.3)
    assert scene.camera is not None
    assert scene.camera.distortion.tolist() == [0.0] * 5


def test_files_that_are_not_scenes(tmp_path: Path) -> None:
    refused(tmp_path, "", FormatError, "the file is empty")
    refused(tmp_path, "# only a comment\n", FormatError, "holds no scene")
    refused(tmp_path, "hello world\n", ConfigError, "expected a mapping with keys among units, occluders")
    refused(tmp_path, "[1, 2]\n", ConfigError, "expected a mapping")
    refused(tmp_path, "a: [1, 2\nb: }\n", FormatError, "line 2: not valid YAML")
    refused(tmp_path, "a: b: c\n", FormatError, "line 1: not valid YAML")
    refused(tmp_path, "a: \x07\n", FormatError, "not valid YAML")
    refused(tmp_path, BLOCK + "---\n" + BLOCK, FormatError, "not valid YAML")
    refused(tmp_path, "[" * 5000, ConfigError, "line 1: nested more than 32 deep")
    refused(tmp_path, "- " * 33 + "x\n", ConfigError, "line 1: nested more than 32 deep")
    refused(tmp_path, "- " * 31 + "x\n", ConfigError, "expected a mapping")
    (tmp_path / "scene.png").write_bytes(b"\x89PNG\r\n\x1a\n\xff")
    with pytest.raises(FormatError, match=r"scene\.png: not a text file"):
        load_scene(tmp_path / "scene.png")
    with pytest.raises(FormatError, match=r"none\.yaml: no such file"):
        load_scene(tmp_path / "none.yaml")
    with pytest.raises(FormatError, match="expected a file, got a folder"):
        load_scene(tmp_path)


@pytest.mark.parametrize(
    "tag", ["!!python/object/apply:os.system [ls]", "!!python/name:os.system", "!mine 3", "!!str 3", "!!binary aGk="]
)
def test_tags_are_refused(tmp_path: Path, tag: str) -> None:
    refused(tmp_path, f"{BLOCK}{RECEIVER}units: {tag}\n", ConfigError, "line 3: the tag", "is not allowed")


def test_duplicate_keys_are_refused(tmp_path: Path) -> None:
    refused(tmp_path, BLOCK + RECEIVER + BLOCK, ConfigError, "line 3: the key 'occluders' appears twice")
    refused(tmp_path, occluders("{box: [1, 1, 1], box: [2, 2, 2]}"), ConfigError, "the key 'box' appears twice")


def test_aliases_are_limited(tmp_path: Path) -> None:
    scene = load_scene(
        write(tmp_path, "occluders: [{box: &b [1, 1, 1]}, {box: *b, translation: [5, 0, 0]}]\n" + RECEIVER)
    )
    assert len(scene.triangles) == 24
    bomb = "a0: &a0 [x, x]\n" + "".join(f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]\n" for n in range(1, 9))
    refused(tmp_path, bomb, ConfigError, "more than 32 aliases")
    doubling = "units: &a0 [x, x]\n" + "".join(f"a{n}: &a{n} [*a{n - 1}, *a{n - 1}]\n" for n in range(1, 17))
    refused(tmp_path, doubling, ConfigError, "unknown key")
    chain = "a0: &a0 " + "[" * 29 + "]" * 29 + "\n"
    chain += "".join(f"a{n}: &a{n} {'[' * 29}*a{n - 1}{']' * 29}\n" for n in range(1, 32))
    refused(tmp_path, chain, ConfigError, "unknown key")
    refused(tmp_path, "units: &a [*a]\n" + BLOCK + RECEIVER, ConfigError, "units: expected text")


def test_numbers_mean_what_they_look_like(tmp_path: Path) -> None:
    scene = load_scene(write(tmp_path, occluders("box: [1e2, 010, +1.5e+1]").replace("128", "012")))
    assert scene.receiver.samples == (12, 96)
    assert_close(scene.triangles.amax(dim=(0, 1)), torch.tensor([50.0, 5.0, 15.0], dtype=torch.float64))
    for value in ("12:30", "1_000", "0x10", "yes", "'3'", "true", "null", "2001-01-01"):
        refused(
            tmp_path, occluders(f"box: [{value}, 1, 1]"), ConfigError, "occluders[0].box[0]: expected a number, got"
        )


def test_unknown_keys_come_with_a_suggestion(tmp_path: Path) -> None:
    refused(tmp_path, BLOCK + RECEIVER + "unit: mm\n", ConfigError, "unit: unknown key; did you mean 'units'?")
    refused(tmp_path, BLOCK + RECEIVER + "xyz: 1\n", ConfigError, "xyz: unknown key; known keys: units, occluders")
    refused(tmp_path, BLOCK + RECEIVER + "<<: {units: mm}\n", ConfigError, "<<: unknown key")
    refused(tmp_path, BLOCK + RECEIVER + "3: 1\n", ConfigError, "3: unknown key")
    cases = {
        occluders(
            "{box: [1, 1, 1], rotation: [0, 0, 1]}"
        ): "occluders[0].rotation: unknown key; did you mean 'rotation_d",
        occluders(
            "cylinder: {radius: 1, heights: 1}"
        ): "occluders[0].cylinder.heights: unknown key; did you mean 'height'?",
        BLOCK + RECEIVER.replace("size", "sizes"): "receiver.sizes: unknown key; did you mean 'size'?",
        BLOCK + RECEIVER + CAMERA.replace("K", "k"): "camera.k: unknown key; known keys: image_size, K",
        BLOCK + RECEIVER + "photo: {coding: srgb}\n": "photo.coding: unknown key; did you mean 'encoding'?",
    }
    for text, message in cases.items():
        refused(tmp_path, text, ConfigError, message)


def test_missing_keys_come_with_an_example(tmp_path: Path) -> None:
    refused(tmp_path, RECEIVER, ConfigError, "occluders: missing; for example 'occluders: [{box:")
    refused(tmp_path, BLOCK, ConfigError, "receiver: missing; for example 'receiver: {size:")
    refused(tmp_path, BLOCK + "receiver: {size: [1, 1]}\n", ConfigError, "receiver.samples: missing; for example")
    refused(tmp_path, BLOCK + "receiver: {samples: [1, 1]}\n", ConfigError, "receiver.size: missing")
    refused(tmp_path, occluders("cone: {radius: 1}"), ConfigError, "occluders[0].cone.height: missing")
    for key in ("image_size", "K", "world_to_camera"):
        camera = "".join(line + "\n" for line in CAMERA.splitlines() if f"  {key}:" not in line)
        refused(tmp_path, BLOCK + RECEIVER + camera, ConfigError, f"camera.{key}: missing; for example")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (BLOCK + RECEIVER + "units: 3\n", "units: expected text, got 3"),
        ("occluders: {box: [1, 1, 1]}\n" + RECEIVER, "occluders: expected a list of occluders"),
        (occluders("[1, 2]"), "occluders[0]: expected a mapping"),
        (occluders("{}"), "occluders[0]: expected exactly one of mesh, box, cylinder, cone, sphere (found none)"),
        (occluders("{box: [1, 1, 1], sphere: {radius: 1}}"), "occluders[0]: expected exactly one of"),
        (occluders("box: 3"), "occluders[0].box: expected a list of 3 numbers, got 3"),
        (occluders("box: [1, 1]"), "occluders[0].box: expected a list of 3 numbers, got [1, 1]"),
        (occluders("sphere: 3"), "occluders[0].sphere: expected a mapping with keys among radius"),
        (occluders("mesh: 3"), "occluders[0].mesh: expected text, got 3"),
        (occluders("{box: [1, 1, 1], scale: [1, 1, 1]}"), "occluders[0].scale: expected a number"),
        (occluders("{box: [1, 1, 1], matrix: [1, 0, 0, 1]}"), "occluders[0].matrix[0]: expected a list of 4 numbers"),
        (BLOCK + "receiver: [1, 2]\n", "receiver: expected a mapping"),
        (BLOCK + RECEIVER.replace("128", "128.0"), "receiver.samples[0]: expected an integer, got 128.0"),
        (BLOCK + RECEIVER.replace("}", ", albedo: [1, 1]}"), "receiver.albedo: expected a list of 3 numbers"),
        (BLOCK + RECEIVER + CAMERA.replace("[0, 10, 3]", "[0, 10]"), "camera.K[1]: expected a list of 3 numbers"),
        (BLOCK + RECEIVER + CAMERA + "  distortion: 0.1\n", "camera.distortion: expected a list of 4, 5, 8, 12, 14"),
        (
            BLOCK + RECEIVER + "photo: sRGB\n",
            "photo.encoding: expected srgb or linear or gamma or response or raw, got",
        ),
        (BLOCK + RECEIVER + "photo: {encoding: sRGB}\n", "photo.encoding: expected srgb or linear or gamma"),
        (BLOCK + RECEIVER + "photo: {encoding: [srgb]}\n", "or raw, got ['srgb']"),
        (BLOCK + RECEIVER + "reference: flat\n", "reference.method: expected uniform or smooth or stack"),
        (BLOCK + RECEIVER + "mask: 3\n", "mask: expected text"),
        (
            occluders("{box: [1, 1, 1], scale: 2, matrix: [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}"),
            "occluders[0].matrix: expected either matrix or scale, rotation_degrees, translation, not both (found",
        ),
    ],
)
def test_wrong_types(tmp_path: Path, text: str, message: str) -> None:
    refused(tmp_path, text, ConfigError, message)


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ("box: [100, 0, 120]", "occluders[0].box: expected three extents above 0, got [100, 0, 120]"),
        ("box: [100, -1, 120]", "occluders[0].box: expected three extents above 0"),
        ("box: [100, .nan, 120]", "occluders[0].box[1]: expected a finite number, got nan"),
        ("box: [.inf, 1, 120]", "occluders[0].box[0]: expected a finite number, got inf"),
        (f"box: [1{'0' * 400}, 1, 1]", "occluders[0].box[0]: expected a finite number"),
        ("cylinder: {radius: 0, height: 1}", "occluders[0].cylinder.radius: expected a number above 0, got 0"),
        ("cylinder: {radius: 1, height: -2}", "occluders[0].cylinder.height: expected a number above 0, got -2"),
        ("cone: {radius: 1, height: 0.0}", "occluders[0].cone.height: expected a number above 0"),
        ("sphere: {radius: -1}", "occluders[0].sphere.radius: expected a number above 0"),
        ("{box: [1, 1, 1], scale: 0}", "occluders[0].scale: expected a number above 0"),
        ("{box: [1, 1, 1], translation: [0, 0, -1]}", "occluders[0].box: lies wholly on or below the plane"),
        ("{box: [1, 1, 1], rotation_degrees: [180, 0, 0]}", "occluders[0].box: lies wholly on or below the plane"),
        ("{box: [1, 1, 1], translation: [0, 0, 1e308], scale: 1e308}", "occluders[0].box: too large once placed"),
        ("{cylinder: {radius: 4, height: 1e308}}", "occluders[0].cylinder: too large once placed"),
        (
            "{box: [1, 1, 1], matrix: [[1,0,0,0],[0,1,0,0],[0,0,0,1],[0,0,0,1]]}",
            "occluders[0].matrix: flattens the mesh (singular)",
        ),
        (
            "{box: [1, 1, 1], matrix: [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,2]]}",
            "occluders[0].matrix: expected finite rows [A|t] and a last row [0, 0, 0, 1]",
        ),
    ],
)
def test_occluders_that_cast_no_shadow(tmp_path: Path, entry: str, message: str) -> None:
    refused(tmp_path, occluders(entry), SceneError, message)


def test_no_occluder(tmp_path: Path) -> None:
    refused(tmp_path, "occluders: []\n" + RECEIVER, SceneError, "occluders: no occluder")


def test_meshes_that_cannot_be_used(tmp_path: Path) -> None:
    (tmp_path / "points.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\n")
    (tmp_path / "nan.obj").write_text("v 0 0 0\nv 1 0 nan\nv 0 1 0\nf 1 2 3\n")
    (tmp_path / "flat.obj").write_text("v 0 0 1\nv 1 0 1\nv 2 0 1\nf 1 2 3\n")
    (tmp_path / "plate.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    key = "occluders[1].mesh: "
    for name, error, message in (
        ("none.ply", FormatError, "none.ply: no such file"),
        ("points.obj", FormatError, "the mesh has no faces"),
        ("nan.obj", FormatError, "NaN or infinite"),
        ("flat.obj", SceneError, "has no area"),
        ("plate.obj", SceneError, "wholly on or below the plane"),
        ("scene.yaml", FormatError, "'.yaml' is not a mesh format"),
    ):
        refused(tmp_path, occluders("{box: [1, 1, 1], translation: [50, 0, 0]}", f"mesh: {name}"), error, key, message)


def test_a_partly_sunk_occluder_is_pointed_out(tmp_path: Path) -> None:
    path = write(tmp_path, occluders("{box: [10, 10, 10], translation: [0, 0, -1]}"))
    with pytest.warns(TorchlightWarning) as record:
        scene = load_scene(path)
    assert len(scene.triangles) == 12
    message = str(record[0].message)
    assert message.startswith(f"{path}: occluders[0].box: lies partly below the plane (down to z = -1)")
    assert "\n" not in message


def test_rounding_below_the_plane_is_not_pointed_out(tmp_path: Path) -> None:
    load_scene(write(tmp_path, occluders("{box: [10, 10, 10], translation: [0, 0, -1e-5]}")))


@pytest.mark.parametrize(
    ("first", "second", "message"),
    [
        ("box: [1, 1, 1]", "box: [1, 1, 1]", "occluders[0].box: changes nothing: it lies within occluders[1].box"),
        ("box: [9, 9, 9]", "{sphere: {radius: 4}, translation: [0, 0, 0.5]}", "occluders[1].sphere: changes nothing"),
        ("cone: {radius: 1, height: 2}", "cylinder: {radius: 1, height: 2}", "occluders[0].cone: changes nothing"),
        ("mesh: t.obj", "mesh: t.obj", "occluders[0].mesh: changes nothing: it lies within occluders[1].mesh"),
        ("mesh: t.obj", "box: [20, 20, 10]", "occluders[0].mesh: changes nothing: it lies within occluders[1].box"),
        (
            "{box: [2, 2, 2], matrix: [[-1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}",
            "box: [1, 1, 1]",
            "occluders[1].box: changes nothing",
        ),
    ],
)
def test_hidden_occluders(tmp_path: Path, first: str, second: str, message: str) -> None:
    (tmp_path / "t.obj").write_text(TETRAHEDRON)
    refused(tmp_path, occluders(first, second), SceneError, message)


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ("box: [1, 1, 1]", "box: [1, 1, 1.01]\n    translation: [0.1, 0, 0]"),
        ("sphere: {radius: 1}", "{box: [1.5, 1.5, 1.5], translation: [0, 0, 0.25]}"),
        ("mesh: t.obj", "{box: [1, 1, 1], translation: [1, 1, 0]}"),
    ],
)
def test_occluders_that_overlap_are_kept(tmp_path: Path, first: str, second: str) -> None:
    (tmp_path / "t.obj").write_text(TETRAHEDRON)
    assert len(load_scene(write(tmp_path, occluders(first, second))).triangles) > 12


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("[128, 96]", "[0, 96]"), "receiver.samples: expected two positive integers"),
        (("[128, 96]", "[1000000, 1000000]"), "receiver.samples: 1000000 x 1000000 is more than"),
        (("[128, 96]", "[99999999999999999999999, 1]"), "receiver.samples: 99999999999999999999999 x 1 is more than"),
        (("[400, 300]", "[400, 0]"), "receiver.size: expected two positive lengths"),
        (("[400, 300]", "[.inf, 1]"), "receiver.size[0]: expected a finite number"),
        (("}", ", albedo: 0}"), "receiver.albedo: expected values in (0, 1]"),
        (("}", ", albedo: 80}"), "receiver.albedo: expected values in (0, 1]"),
        (("}", ", center: [0, .nan]}"), "receiver.center[1]: expected a finite number"),
    ],
)
def test_receivers_that_cannot_be(tmp_path: Path, change: tuple[str, str], message: str) -> None:
    refused(tmp_path, BLOCK + RECEIVER.replace(*change), SceneError, message)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("[0, 10, 3]", "[0, .nan, 3]"), "camera.K[1][1]: expected a finite number, got nan"),
        (("[0, 10, 3]", "[0, -10, 3]"), "camera.K: expected [[fx, 0, cx]"),
        (("[1, 0, 0, 0]", "[2, 0, 0, 0]"), "camera.world_to_camera: not a rigid motion"),
        (("[0, -1, 0, 0]", "[0, 1, 0, 0]"), "camera.world_to_camera: not a rigid motion"),
        (("[8, 6]", "[8, 0]"), "camera.image_size: expected two positive integers"),
        (("[8, 6]", "[80000, 60000]"), "camera.image_size: expected two positive integers, at most 400,000,000 pixels"),
        (("camera:\n", "camera:\n  distortion: [1, 2, 3]\n"), "camera.distortion: expected a list of 4, 5, 8, 12, 14"),
        (("camera:\n", "camera:\n  distortion: [0, 0, 0, .inf]\n"), "camera.distortion[3]: expected a finite number"),
    ],
)
def test_cameras_that_cannot_be(tmp_path: Path, change: tuple[str, str], message: str) -> None:
    refused(tmp_path, BLOCK + RECEIVER + CAMERA.replace(*change), CalibrationError, message)


def test_masks_that_cannot_be_used(tmp_path: Path) -> None:
    write_png(tmp_path / "small.png", np.ones((5, 8), dtype=np.uint8))
    write_png(tmp_path / "zero.png", np.zeros((6, 8), dtype=np.uint8))
    (tmp_path / "text.png").write_text("hello")
    scene = BLOCK + RECEIVER
    refused(tmp_path, scene + "mask: none.png\n", FormatError, "mask: ", "none.png: no such file")
    refused(tmp_path, scene + "mask: text.png\n", FormatError, "mask: ", "text.png: its content is not PNG")
    refused(tmp_path, scene + "mask: zero.png\n", ConfigError, "mask: ", "zero.png is zero everywhere")
    message = "has 8 x 5 pixels, but camera.image_size is 8 x 6; they must agree"
    refused(tmp_path, scene + CAMERA + "mask: small.png\n", ConfigError, "mask: ", message)
    assert load_scene(write(tmp_path, scene + "mask: small.png\n")).mask is not None


def test_many_occluders(tmp_path: Path) -> None:
    rows = [f"{{box: [1, 1, 1], translation: [{2 * index}, 0, 0]}}" for index in range(300)]
    assert len(load_scene(write(tmp_path, occluders(*rows))).triangles) == 3600
    refused(
        tmp_path, occluders(*["box: [1, 1, 1]"] * 1001), SceneError, "occluders: 1001 occluders are more than 1,000"
    )


def test_matt_occluders(tmp_path: Path) -> None:
    assert not load_scene(write(tmp_path, BLOCK + RECEIVER)).occluder_matt
    assert load_scene(write(tmp_path, BLOCK + RECEIVER + "occluder_matt: true\n")).occluder_matt
    refused(tmp_path, BLOCK + RECEIVER + "occluder_matt: 1\n", ConfigError, "occluder_matt: expected true or false")


def test_the_albedo_of_occluders(tmp_path: Path) -> None:
    assert load_scene(write(tmp_path, BLOCK + RECEIVER)).occluder_albedo == 0.0
    assert load_scene(write(tmp_path, BLOCK + RECEIVER + "occluder_albedo: 0.085\n")).occluder_albedo == 0.085
    for value in ("-0.1", "1"):
        refused(tmp_path, BLOCK + RECEIVER + f"occluder_albedo: {value}\n", ConfigError, "expected a number in [0, 1)")
