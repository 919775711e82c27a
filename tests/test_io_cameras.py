"""Camera files: round trips, literal files of each program, half pixels, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import pytest
import torch
from realdata import data_path
from torch.testing import assert_close

from torchlight.calibration import Calibration, Rejected
from torchlight.camera import Lens
from torchlight.errors import CalibrationError, ConfigError, FormatError, TorchlightError
from torchlight.io.cameras import colmap_text, nerfstudio_text, read_lens, read_poses, write_camera
from torchlight.photo.boards import BoardView

K = torch.tensor([[900.0, 0, 512.5], [0, 880.0, 380.25], [0, 0, 1]], dtype=torch.float64)
DISTORTION = torch.tensor([-0.21, 0.07, 0.0012, -0.0008, -0.01], dtype=torch.float64)
LENS = Lens(K, (1024, 768), DISTORTION)
POSE = torch.tensor([[1.0, 0, 0, 0], [0, -0.6, -0.8, 0], [0, 0.8, -0.6, 5], [0, 0, 0, 1]], dtype=torch.float64)
VIEW = BoardView("a.jpg", torch.zeros(6, 3).double(), torch.zeros(6, 2).double(), (1024, 768))
FOUND = Calibration(
    LENS, torch.ones(9).double(), (VIEW,), (POSE,), (torch.full((6, 2), 0.1).double(),), (Rejected("b.jpg", "blurred"),)
)


def same(one: Lens, other: Lens) -> None:
    assert_close(one.intrinsics, other.intrinsics, rtol=1e-12, atol=0)
    assert_close(one.distortion[:5], other.distortion[:5], rtol=1e-12, atol=1e-15)
    assert one.image_size == other.image_size


@pytest.mark.parametrize("name", ["camera.json", "camera.yml", "camera.yaml", "cameras.txt", "transforms.json"])
def test_every_format_gives_back_what_it_was_given(tmp_path: Path, name: str) -> None:
    write_camera(tmp_path / name, FOUND)
    same(read_lens(tmp_path / name), LENS)


def test_colmap_and_nerfstudio_centres_lie_half_a_pixel_on() -> None:
    assert colmap_text(Lens(K, (1024, 768), DISTORTION[:4])).splitlines()[1] == (
        "1 OPENCV 1024 768 900.0 880.0 513.0 380.75 -0.21 0.07 0.0012 -0.0008"
    )
    document = json.loads(nerfstudio_text(FOUND))
    assert (document["cx"], document["cy"], document["fl_x"], document["k3"]) == (513.0, 380.75, 900.0, -0.01)
    # as docs/conventions.md writes the same camera: camera to world, y up, z backward
    blender = [[1.0, 0, 0, 0], [0, 0.6, -0.8, -4], [0, 0.8, 0.6, 3], [0, 0, 0, 1]]
    assert_close(torch.tensor(document["frames"][0]["transform_matrix"]), torch.tensor(blender), atol=1e-6, rtol=0)


def test_nerfstudio_poses_come_back(tmp_path: Path) -> None:
    write_camera(tmp_path / "transforms.json", FOUND)
    poses = read_poses(tmp_path / "transforms.json")
    assert list(poses) == ["a.jpg"]
    assert_close(poses["a.jpg"], POSE, atol=1e-12, rtol=0)


def test_opencv_reads_what_is_written(tmp_path: Path) -> None:
    write_camera(tmp_path / "camera.yml", FOUND)
    storage = cv2.FileStorage(str(tmp_path / "camera.yml"), cv2.FILE_STORAGE_READ)
    assert_close(torch.from_numpy(storage.getNode("camera_matrix").mat()), K)
    assert storage.getNode("image_width").real() == 1024


def test_opencvs_published_camera_is_read() -> None:
    lens = read_lens(data_path("calib", "opencv_chessboard", "left_intrinsics.yml"))
    assert lens.image_size == (640, 480)
    assert_close(lens.intrinsics[0], torch.tensor([535.91573396163199, 0, 342.28315473308373]).double())
    assert lens.distortion.tolist()[:2] == [-0.26637260909660682, -0.038588898922304653]


@pytest.mark.parametrize(
    ("model", "numbers", "expected"),
    [
        ("SIMPLE_PINHOLE", "900 320 240", [900, 900, 319.5, 239.5, 0, 0, 0, 0, 0]),
        ("PINHOLE", "900 880 320 240", [900, 880, 319.5, 239.5, 0, 0, 0, 0, 0]),
        ("SIMPLE_RADIAL", "900 320 240 -0.1", [900, 900, 319.5, 239.5, -0.1, 0, 0, 0, 0]),
        ("RADIAL", "900 320 240 -0.1 0.02", [900, 900, 319.5, 239.5, -0.1, 0.02, 0, 0, 0]),
        ("OPENCV", "900 880 320 240 1 2 3 4", [900, 880, 319.5, 239.5, 1, 2, 3, 4, 0]),
        ("FULL_OPENCV", "900 880 320 240 1 2 3 4 5 6 7 8", [900, 880, 319.5, 239.5, 1, 2, 3, 4, 5, 6, 7, 8]),
    ],
)
def test_every_colmap_model_is_read(tmp_path: Path, model: str, numbers: str, expected: list[float]) -> None:
    path = tmp_path / "cameras.txt"
    path.write_text(f"# a comment\n7 {model} 640 480 {numbers}\n")
    lens = read_lens(path)
    values = [*lens.intrinsics[[0, 1, 0, 1], [0, 1, 2, 2]].tolist(), *lens.distortion.tolist()]
    assert values == expected


def test_the_own_file_tells_the_evidence(tmp_path: Path) -> None:
    write_camera(tmp_path / "camera.json", FOUND)
    document = json.loads((tmp_path / "camera.json").read_text())
    assert document["rejected"] == [{"name": "b.jpg", "reason": "blurred"}]
    assert document["views"][0]["name"] == "a.jpg"
    assert_close(document["rms_pixels"], 0.1 * 2**0.5)
    assert document["standard_deviations"]["fx"] == 1


@pytest.mark.parametrize(
    ("text", "error", "message"),
    [
        ("{", FormatError, "not valid JSON"),
        ("{}", ConfigError, "image_size: missing"),
        ('{"image_size": [4, 3], "K": 5, "distortion": []}', ConfigError, "K: expected a list"),
        ('{"image_size": [4, 3], "K": [[1,0,0],[0,1,0],[0,0,1]], "distortion": [1]}', CalibrationError, "distortion"),
        ("%YAML:1.0\n---\na: 1\n", FormatError, "camera_matrix and distortion_coefficients are missing"),
        ("1 FOV 640 480 1 2 3\n", ConfigError, "camera model FOV: expected one of"),
        ("1 PINHOLE 640 480 1 2 3\n", FormatError, "PINHOLE has 4 parameters, got 3"),
        ("1 PINHOLE 640 480 1 2 3 four\n", FormatError, "not a cameras.txt"),
        ('{"fl_x": 1, "camera_model": "OPENCV_FISHEYE"}', ConfigError, "other models are not supported"),
        ('{"fl_x": 1}', ConfigError, "cx, cy, w, h missing"),
        ('{"fl_x": 9, "cx": 1, "cy": 1, "w": 2, "h": 2, "k4": 0.1}', ConfigError, "k4 is not zero"),
        ("", FormatError, ""),
    ],
)
def test_what_is_no_camera_is_one_line(tmp_path: Path, text: str, error: type[TorchlightError], message: str) -> None:
    path = tmp_path / "camera"
    path.write_text(text)
    with pytest.raises(error) as caught:
        read_lens(path)
    assert message in str(caught.value)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_what_a_format_cannot_hold_is_refused(tmp_path: Path) -> None:
    tilted = Lens(K, (1024, 768), torch.full((14,), 0.01).double())
    with pytest.raises(ConfigError, match="COLMAP holds at most"):
        colmap_text(tilted)
    with pytest.raises(FormatError, match=r"expected a name such as camera\.json"):
        write_camera(tmp_path / "camera.xyz", FOUND)
