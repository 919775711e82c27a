"""`torchlight render`, and its round trip through `torchlight estimate`."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from torch.testing import assert_close
from workbench import CAMERA, LINEAR, RECTIFIED, SUN, contents, degrees_between, exr, light, scene_file
from workbench import torchlight as run

from torchlight.io.exr import read_exr, write_exr
from torchlight.io.images import read_photo

SEEN = RECTIFIED + CAMERA


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(autouse=True)
def small(shared: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Most tests share a few transports, so that rays are cast once."""
    monkeypatch.setenv("TORCHLIGHT_CACHE", str(shared))
    monkeypatch.setattr("torchlight.view.FINEST_SAMPLES", 96)


def white(path: Path) -> Path:
    write_exr(path, torch.ones(3, 8, 16), {})
    return path


@pytest.mark.parametrize("albedo", ["0.5", "[0.9, 0.5, 0.25]"])
def test_constant_light_shows_the_albedo_where_nothing_hides_it(tmp_path: Path, albedo: str) -> None:
    far = RECTIFIED.replace("[1, 0.6, 1.2]", "[0.02, 0.02, 0.02]").replace("[16, 16]", f"[16, 16], albedo: {albedo}")
    ran = run("render", scene_file(tmp_path, far), white(tmp_path / "l.exr"), "--out", tmp_path / "v.exr")
    assert (ran.code, ran.err) == (0, "")
    values, metadata = read_exr(tmp_path / "v.exr")
    expected = torch.tensor([0.5] * 3 if albedo == "0.5" else [0.9, 0.5, 0.25]).reshape(3, 1, 1)
    corners = torch.cat([values[:, :4], values[:, -4:]], dim=1)
    assert_close(corners, expected.expand_as(corners), rtol=2e-4, atol=0)
    assert metadata["values"] == "1 x albedo x irradiance / pi"
    assert metadata["light_is"] == "radiance x exposure"


@pytest.mark.parametrize("camera", ["", CAMERA])
def test_estimate_finds_the_sun_in_what_render_drew(tmp_path: Path, camera: str) -> None:
    scene = scene_file(tmp_path, RECTIFIED.replace("[16, 16]", "[24, 24]") + camera)
    ran = run("render", scene, light(tmp_path / "l.exr", 128), "--out", tmp_path / "v.exr", "--rays", 8192)
    assert (ran.code, ran.err) == (0, "")
    if camera:  # beyond the receiver the picture is black, and the mask says so
        scene.write_text(scene.read_text() + "mask: v_mask.png\n")
    ran = run("estimate", scene, tmp_path / "v.exr", "--out", tmp_path / "out", "--resolution", 8)
    assert (ran.code, ran.err) == (0, "")
    result = json.loads((tmp_path / "out/v/result.json").read_text())
    assert degrees_between(result["peak_direction"], SUN) < 3
    assert result["rms_255"] < 8  # the sun is 5 degrees wide, texels 11


def box_mask(samples: int) -> np.ndarray:
    """Which plane points of a fine grid, row 0 at the largest y, the block of the scene covers."""
    axis = (np.arange(samples) + 0.5) / samples * 4 - 2
    x, y = np.meshgrid(axis, axis[::-1])
    turn = np.radians(20)
    return (abs(x * np.cos(turn) + y * np.sin(turn)) < 0.5) & (abs(y * np.cos(turn) - x * np.sin(turn)) < 0.3)


def test_the_rectified_view_is_black_on_the_block_and_opaque(tmp_path: Path) -> None:
    scene = scene_file(tmp_path, RECTIFIED.replace("[16, 16]", "[64, 64]"))
    options = ("--rays", 256)
    assert run("render", scene, light(tmp_path / "l.exr"), "--out", tmp_path / "v.exr", *options).code == 0
    assert run("render", scene, light(tmp_path / "l.exr"), "--out", tmp_path / "v.png", *options).code == 0
    mask = cv2.imread(str(tmp_path / "v_mask.png"), cv2.IMREAD_UNCHANGED)
    picture = cv2.imread(str(tmp_path / "v.png"), cv2.IMREAD_UNCHANGED)
    assert mask is not None
    assert picture is not None
    assert picture.shape == (64, 64, 4)
    assert (picture[..., 3] == 255).all()
    cells = box_mask(1024).reshape(64, 16, 64, 16).mean(axis=(1, 3))
    assert (mask[cells == 0] == 255).mean() > 0.995
    assert (mask[cells == 1] == 0).all()
    values, _ = read_exr(tmp_path / "v.exr")
    assert bool((values[:, torch.from_numpy(mask == 0)] == 0).all())
    assert bool((values[:, torch.from_numpy(mask == 255)] > 0).all())


def ray_cast(width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
    """Which pixels of the undistorted camera show the receiver, and which the block: slabs, in numpy."""
    pose = np.array(
        [[1, 0, 0, 0], [0, -0.813733471206735, -0.5812381937190965, 0], [0, 0.5812381937190965, -0.813733471206735, 7]]
    )
    rotation, shift = pose[:, :3], pose[:, 3]
    column, row = np.meshgrid(np.arange(width), np.arange(height))
    local = np.stack([(column - 47.5) / 102, (row - 35.5) / 102, np.ones_like(column, dtype=float)], axis=-1)
    directions, origin = local @ rotation, -rotation.T @ shift
    turn = np.radians(20)
    axes = np.array([[np.cos(turn), np.sin(turn), 0], [-np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    low, high = np.array([-0.5, -0.3, 0.0]), np.array([0.5, 0.3, 1.2])
    start, along = axes @ origin, directions @ axes.T
    first, second = (low - start) / along, (high - start) / along
    block = np.minimum(first, second).max(axis=-1) < np.maximum(first, second).min(axis=-1)
    depth = -origin[2] / directions[..., 2]
    plane = origin[:2] + depth[..., None] * directions[..., :2]
    return (abs(plane) <= 2).all(axis=-1) & ~block, block


def test_the_cameras_view_is_where_rays_say(tmp_path: Path) -> None:
    straight = SEEN.replace("  distortion: [-0.05, 0.01, 0, 0, 0]\n", "")
    scene = scene_file(tmp_path, straight)
    ran = run("render", scene, white(tmp_path / "l.exr"), "--out", tmp_path / "v.png", "--rays", 256)
    assert (ran.code, ran.err) == (0, "")
    assert run("render", scene, white(tmp_path / "l.exr"), "--out", tmp_path / "v.exr", "--rays", 256).code == 0
    picture = cv2.imread(str(tmp_path / "v.png"), cv2.IMREAD_UNCHANGED)
    mask = cv2.imread(str(tmp_path / "v_mask.png"), cv2.IMREAD_UNCHANGED)
    assert picture is not None
    assert mask is not None
    plane, block = ray_cast(96, 72)
    assert 200 < block.sum() < plane.sum()
    assert (~(plane | block)).any()
    assert ((mask == 255) != plane).sum() <= 4  # pixels whose ray grazes an edge
    assert ((picture[..., 3] == 255) != (plane | block)).sum() <= 4
    values, _ = read_exr(tmp_path / "v.exr")
    assert values.shape == (3, 72, 96)
    assert bool((values[:, torch.from_numpy(mask == 0)] == 0).all())
    lit = (values[:, torch.from_numpy(mask == 255)] > 0.1).all(dim=0)  # the block hides part of the sky, never all
    assert int((~lit).sum()) <= 1  # the pixel of the foot's nearest corner has no free sample round it


def test_display_pictures_are_exposed_encoded_and_say_what_they_clipped(tmp_path: Path) -> None:
    small_box = RECTIFIED.replace("[1, 0.6, 1.2]", "[0.02, 0.02, 0.02]")
    linear = scene_file(tmp_path, small_box)
    curve = scene_file(tmp_path, small_box.replace(LINEAR, ""), "srgb.yaml")
    source = white(tmp_path / "l.exr")
    assert "8-bit linear, 0.0%" in run("render", linear, source, "--out", tmp_path / "a.png", "--exposure", 0.5).out
    assert "8-bit srgb, 0.0%" in run("render", curve, source, "--out", tmp_path / "b.png", "--exposure", 0.5).out
    assert (
        "100.0% of the receiver's pixels clipped"
        in run("render", linear, source, "--out", tmp_path / "c.png", "--exposure", 3).out
    )
    means = [read_photo(tmp_path / name).pixels[:, :3].mean().item() * 255 for name in ("a.png", "b.png", "c.png")]
    assert_close(means, [128.0, 188.0, 255.0], rtol=0, atol=1.5)  # 0.5 in sRGB is 188


def test_conventions_turn_the_light(tmp_path: Path) -> None:
    scene, source = scene_file(tmp_path), light(tmp_path / "l.exr")
    for name in ("torchlight", "openexr"):
        options = ("--out", tmp_path / f"{name}.exr", "--convention", name, "--rays", 1024)
        assert run("render", scene, source, *options).code == 0
    ours, theirs = (read_exr(tmp_path / f"{name}.exr")[0] for name in ("torchlight", "openexr"))
    assert (ours - theirs).abs().max() > 0.1 * ours.max()


# --- refusals ------------------------------------------------------------------------------------------------------


def test_existing_pictures_need_overwrite_masks_too(tmp_path: Path) -> None:
    scene, source, out = scene_file(tmp_path), white(tmp_path / "l.exr"), tmp_path / "v.exr"
    (tmp_path / "v_mask.png").write_text("drawn by hand")
    ran = run("render", scene, source, "--out", out)
    assert ran.code == 2
    assert "v_mask.png" in ran.line
    assert "--overwrite" in ran.line
    assert not out.exists()
    assert run("render", scene, source, "--out", out, "--overwrite").code == 0
    assert "v.exr" in run("render", scene, source, "--out", out).line


@pytest.mark.parametrize(
    ("name", "options", "says"),
    [
        ("v.jpg", (), "v.jpg"),
        ("none/v.png", (), "there is no folder"),
        ("folder.exr", ("--overwrite",), "folder.exr"),
        ("v.png", ("--exposure", "nan"), "--exposure"),
        ("v.png", ("--exposure", "0"), "--exposure"),
        ("v.png", ("--exposure", "inf"), "--exposure"),
        ("v.exr", ("--exposure", "1e39"), "--exposure"),
        ("v.png", ("--rays", 0), "rays"),
        ("v.png", ("--rays", -5), "rays"),
        ("v.png", ("--rays", 10**12), "rays"),
    ],
)
def test_bad_requests(tmp_path: Path, name: str, options: tuple[object, ...], says: str) -> None:
    (tmp_path / "folder.exr").mkdir()
    before = contents(scene_file(tmp_path).parent)
    ran = run("render", tmp_path / "scene.yaml", white(tmp_path / "l.exr"), "--out", tmp_path / name, *options)
    assert ran.code == 2
    assert says in ran.line
    assert contents(tmp_path) == sorted([*before, "l.exr"])


def lights(folder: Path) -> dict[str, tuple[Path, str]]:
    torch.manual_seed(0)
    nan = torch.rand(3, 8, 16)
    nan[1, 2, 3] = torch.nan
    for name, image in (("shape", torch.rand(3, 20, 30)), ("nan", nan), ("odd", torch.rand(3, 3, 6))):
        write_exr(folder / f"{name}.exr", image, {"convention": "openexr"} if name == "odd" else {})
    write_exr(folder / "word.exr", torch.rand(3, 8, 16), {"convention": "upside down"})
    write_exr(folder / "lie.exr", torch.rand(3, 8, 16) - 0.5, {"nonnegative": True})
    (folder / "text.exr").write_text("a light")
    (folder / "empty.hdr").write_text("")
    return {
        "missing.exr": (folder / "missing.exr", "no such file"),
        "shape.exr": (folder / "shape.exr", "30 x 20 pixels"),
        "nan.exr": (folder / "nan.exr", "NaN"),
        "odd.exr": (folder / "odd.exr", "quarter turn"),
        "word.exr": (folder / "word.exr", "upside down"),
        "lie.exr": (folder / "lie.exr", "non-negative"),
        "text.exr": (folder / "text.exr", "neither OpenEXR nor Radiance HDR"),
        "empty.hdr": (folder / "empty.hdr", "empty"),
    }


@pytest.mark.parametrize(
    "name", ["missing.exr", "shape.exr", "nan.exr", "odd.exr", "word.exr", "lie.exr", "text.exr", "empty.hdr"]
)
def test_bad_lights(tmp_path: Path, name: str) -> None:
    path, says = lights(tmp_path)[name]
    scene, photo = scene_file(tmp_path), exr(tmp_path / "p.exr")
    for ran in (run("render", scene, path, "--out", tmp_path / "v.exr"), run("evaluate", scene, photo, path)):
        assert ran.code == 2
        assert name in ran.line
        assert says in ran.line
    assert not (tmp_path / "v.exr").exists()


@pytest.mark.parametrize("shape", [(16, 12), (8, 8), (1, 2), (1, 1), (8, 16)])
def test_every_kind_of_light_is_drawn(tmp_path: Path, shape: tuple[int, int]) -> None:
    """Cross, angular map, the smallest lat-long and angular map, lat-long: constant light is constant in all."""
    write_exr(tmp_path / "l.exr", torch.ones(3, *shape), {})
    far = scene_file(tmp_path, RECTIFIED.replace("[1, 0.6, 1.2]", "[0.02, 0.02, 0.02]"))
    ran = run("render", far, tmp_path / "l.exr", "--out", tmp_path / "v.exr")
    assert (ran.code, ran.err) == (0, "")
    values, _ = read_exr(tmp_path / "v.exr")
    assert_close(values[:, :4], torch.ones(3, 4, 16), rtol=3e-4, atol=0)


def test_a_full_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    source = white(tmp_path / "l.exr")
    monkeypatch.setattr("os.fsync", full)
    for name in ("v.exr", "v.png"):
        ran = run("render", scene_file(tmp_path), source, "--out", tmp_path / name, "--rays", 16)
        assert ran.code == 2
        assert f"{name}: cannot be written: the disk is full" in ran.line
    assert contents(tmp_path) == ["l.exr", "scene.yaml"]
