"""A scene whose camera is a calibrated lens and the printed sheet: every photograph has its own pose."""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from kornia.color import linear_rgb_to_rgb, rgb_to_linear_rgb
from numpy.typing import NDArray
from sheet_photo import LENS, SHEET, WHITE, looking_at, photograph
from torch.testing import assert_close
from workbench import torchlight

from torchlight.camera import Camera, Lens
from torchlight.errors import CalibrationError, ConfigError, FormatError, TorchlightError
from torchlight.geometry.primitives import box
from torchlight.geometry.receiver import Receiver
from torchlight.geometry.scene import Scene
from torchlight.geometry.transforms import transform
from torchlight.io.cameras import opencv_text
from torchlight.io.images import read_photo, write_png
from torchlight.io.scene_file import load_scene
from torchlight.io.target_file import write_target
from torchlight.light.environment import EnvironmentMap
from torchlight.observing import placed
from torchlight.photo.board_camera import BoardCamera
from torchlight.photo.target import DEFAULT_PROP
from torchlight.view import camera_view

SMALL = Lens(LENS.intrinsics * torch.tensor([[0.75], [0.75], [1.0]]), (1200, 900), LENS.distortion)
SCENE = """units: mm
occluders:
  - box: [30, 20, 35]
    rotation_degrees: [0, 0, 30]
receiver: {size: [140, 216], samples: [35, 54]}
camera: {intrinsics: camera.yml, board: target.yaml}
photo: {encoding: srgb}
"""
AZIMUTH, ELEVATION = math.radians(40.0), math.radians(50.0)
LAMP = (
    math.cos(ELEVATION) * math.cos(AZIMUTH),
    math.cos(ELEVATION) * math.sin(AZIMUTH),
    math.sin(ELEVATION),
)
POSES = {
    "front": looking_at((0.0, -300.0, 450.0), (0.0, 0.0, 0.0)),
    "side": looking_at((330.0, -120.0, 420.0), (0.0, 5.0, 0.0), 60.0),
}


def lamp() -> EnvironmentMap:
    """Returns a sky of 1 with a lamp of 3 degrees' radius."""
    rows, columns = 90, 180
    theta = (torch.arange(rows, dtype=torch.float64) + 0.5) * math.pi / rows
    phi = 2 * math.pi * (0.5 - (torch.arange(columns, dtype=torch.float64) + 0.5) / columns)
    z = theta.cos()[:, None].expand(rows, columns)
    x, y = theta.sin()[:, None] * phi.cos(), theta.sin()[:, None] * phi.sin()
    cosine = LAMP[0] * x + LAMP[1] * y + LAMP[2] * z
    radiance = 1 + 300.0 * (cosine > math.cos(math.radians(3)))
    return EnvironmentMap(radiance.expand(3, -1, -1).contiguous())


def shaded(camera: Camera, seed: int) -> NDArray[np.uint8]:
    """Returns an 8-bit sRGB photograph: the page's print times the plane's light, the box black."""
    size = (SHEET.paper[0] - 2, SHEET.paper[1] - 2)
    middle = (SHEET.paper[0] / 2 - SHEET.origin[0], SHEET.paper[1] / 2 - SHEET.origin[1])
    triangles = transform(box((30.0, 20.0, 35.0)), 1.0, (0.0, 0.0, 30.0), (0.0, 0.0, 0.0))
    view = camera_view(Scene(triangles, Receiver(middle, size, (160, 224)), camera), camera, lamp(), 2048)
    codes = torch.from_numpy(photograph(camera, seed).astype(np.float32))
    paper = rgb_to_linear_rgb((codes / 255).expand(3, -1, -1)) * (255 / WHITE)
    linear = view.values / view.values.max() * 0.9 * paper
    return (linear_rgb_to_rgb(linear.clamp(0, 1)) * 255).round().byte().permute(1, 2, 0).contiguous().numpy()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Returns a folder with the scene, the sheet, the camera and two photographs from different sides."""
    place = tmp_path_factory.mktemp("board")
    write_target(place / "target.yaml", SHEET, DEFAULT_PROP)
    (place / "camera.yml").write_text(opencv_text(SMALL))
    (place / "scene.yaml").write_text(SCENE)
    for name, pose in POSES.items():
        write_png(place / f"{name}.png", shaded(SMALL.at(pose), len(name)))
    write_png(place / "wall.png", np.full((900, 1200, 3), 128, np.uint8))
    return place


def test_each_photograph_has_the_pose_that_its_markers_show(folder: Path) -> None:
    scene = load_scene(folder / "scene.yaml")
    assert scene.camera is None
    for name, true in POSES.items():
        camera = placed(scene, read_photo(folder / f"{name}.png"), name).camera
        assert camera is not None
        assert_close(camera.world_to_camera[:3, :3], true[:3, :3], atol=2e-3, rtol=0)
        assert (camera.world_to_camera[:3, 3] - true[:3, 3]).norm().item() < 0.3


def test_estimate_finds_the_lamp_from_photographs_of_two_poses(folder: Path, tmp_path: Path) -> None:
    photos = [folder / "front.png", folder / "side.png", folder / "wall.png"]
    ran = torchlight(
        "estimate", folder / "scene.yaml", *photos, "--out", tmp_path, "--method", "texels", "--resolution", "16",
        "--no-cache",
    )  # fmt: skip
    assert ran.code == 1
    assert "wall.png: no markers of the sheet are seen" in ran.err
    assert "front.png: pose from" in ran.err
    for name, pose in POSES.items():
        result = json.loads((tmp_path / name / "result.json").read_text())
        camera, peak = result["camera"], result["peak_direction"]
        assert_close(torch.tensor(camera["world_to_camera"]).double(), pose, atol=0.3, rtol=0)
        assert 0 < camera["rms_pixels"] < 0.3
        assert 4 <= camera["markers"] <= len(SHEET.markers)
        assert camera["intrinsics_sha256"] == hashlib.sha256((folder / "camera.yml").read_bytes()).hexdigest()
        assert camera["board_sha256"] == hashlib.sha256((folder / "target.yaml").read_bytes()).hexdigest()
        cosine = sum(a * b for a, b in zip(peak, LAMP, strict=True))
        assert math.degrees(math.acos(cosine)) < 1


@pytest.mark.parametrize(
    ("old", "new", "error", "message"),
    [
        ("board: target.yaml", "boards: target.yaml", ConfigError, "camera.boards: unknown key; did you mean 'board'?"),
        (", board: target.yaml", "", ConfigError, "camera.board: missing; for example 'board: target.yaml'"),
        ("size: [140, 216]", "size: [150, 216]", ConfigError, "receiver: reaches over the sheet's markers"),
        ("intrinsics: camera.yml", "intrinsics: none.yml", FormatError, "camera: "),
        ("board: target.yaml", "board: scene.yaml", ConfigError, "camera: "),
    ],
)
def test_mistakes_in_the_scene_file_are_one_line(
    folder: Path, old: str, new: str, error: type[TorchlightError], message: str
) -> None:
    path = folder / "mistaken.yaml"
    assert old in SCENE
    path.write_text(SCENE.replace(old, new))
    with pytest.raises(error) as caught:
        load_scene(path)
    assert str(caught.value).startswith(f"{path}: {message}")
    assert "\n" not in str(caught.value)


def test_a_photograph_of_another_size_and_another_sheet_are_refused(folder: Path) -> None:
    scene = load_scene(folder / "scene.yaml")
    assert scene.finder is not None
    pixels = read_photo(folder / "front.png").pixels
    with pytest.raises(CalibrationError, match=r"small.png: 1100 x 900 pixels, but the camera was calibrated at"):
        scene.finder(pixels[:, :, 50:1150].contiguous(), False, "small.png")
    shuffled = BoardCamera(SMALL, replace(SHEET, markers=(*SHEET.markers[7:], *SHEET.markers[:7])))
    with pytest.raises(CalibrationError, match=r"front.png: .*check that"):
        shuffled(pixels, False, "front.png")
