"""`torchlight target` and `torchlight calibrate` as a user calls them."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from PIL import Image
from sheet_photo import LENS, looking_at, photograph
from torch.testing import assert_close

from torchlight.cli import main
from torchlight.io.cameras import read_lens
from torchlight.io.images import write_png
from torchlight.io.target_file import read_target
from torchlight.photo.target import make_sheet

PLACES = [(0.0, -330.0, 350.0), (300.0, -150.0, 330.0), (-300.0, -50.0, 350.0), (30.0, 250.0, 330.0)]


def call(*words: object) -> int:
    with pytest.raises(SystemExit) as caught:
        main([str(word) for word in words])
    return int(str(caught.value.code))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Returns a folder with a sheet and four rendered photographs of it."""
    place = tmp_path_factory.mktemp("capture")
    assert call("target", "--out", place / "target.pdf") == 0
    for k, eye in enumerate(PLACES):
        write_png(place / f"{k}.png", photograph(LENS.at(looking_at(eye, (0.0, 0.0, 0.0), 40.0 * k)), seed=k))
    write_png(place / "wall.png", np.full((1200, 1600), 128, np.uint8))
    return place


def test_target_writes_pdf_png_and_yaml_and_tells_the_elevations(tmp_path: Path, capsys) -> None:
    code = call(
        "target", "--paper", "letter", "--object", "cylinder:12,30", "--pose", "10,-5,0", "--out", tmp_path / "a.pdf"
    )
    said = capsys.readouterr().out
    assert code == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.pdf", "a.png", "a.yaml"]
    assert (tmp_path / "a.pdf").read_bytes().startswith(b"%PDF")
    assert read_target(tmp_path / "a.yaml") == make_sheet("letter")
    assert "must measure 100 mm" in said
    # to the right side of the clean white: 74.95 - 10 - 12 mm for a cylinder of 30 mm
    assert f"{np.degrees(np.arctan2(30, 52.95)):.1f} degrees or more above the plane" in said
    assert "shadows may fall on markers" in said
    assert "the light's azimuth is seen, its height is not" in said
    assert "below" in said


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--object", "ball:3"), "--object ball:3: expected box:x,y,z"),
        (("--object", "box:30,20"), "expected box:x,y,z"),
        (("--object", "box:a,b,c"), "expected such as box:30,20,35"),
        (("--pose", "1,2"), "--pose 1,2: expected x,y,degrees"),
        (("--pose", "70,0,0"), "must stand within the clean white"),
        (("--out", "sheet.doc"), "ends in .pdf"),
    ],
)
def test_target_refuses_in_one_line(tmp_path: Path, capsys, words: tuple[str, ...], message: str) -> None:
    given = words if "--out" in words else (*words, "--out", str(tmp_path / "a.pdf"))
    assert call("target", *given) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_target_replaces_nothing_unasked(tmp_path: Path, capsys) -> None:
    (tmp_path / "a.yaml").write_text("mine")
    assert call("target", "--out", tmp_path / "a.pdf") == 2
    assert "already there" in capsys.readouterr().err
    assert (tmp_path / "a.yaml").read_text() == "mine"


def test_calibrate_finds_the_camera_and_names_what_it_left_out(folder: Path, tmp_path: Path, capsys) -> None:
    photos = [folder / f"{k}.png" for k in range(4)]
    out = tmp_path / "camera.json"
    code = call("calibrate", *photos, folder / "wall.png", "--target", folder / "target.yaml", "--out", out)
    said = capsys.readouterr()
    assert code == 1  # one photograph was left out
    assert "wall.png: no markers of the sheet are seen" in said.err
    assert "left out: wall.png" in said.out
    assert "+-" in said.out
    lens = read_lens(out)
    assert_close(lens.intrinsics[:2, :2].diag(), LENS.intrinsics[:2, :2].diag(), rtol=0.005, atol=0)
    document = json.loads(out.read_text())
    assert [view["name"] for view in document["views"]] == ["0.png", "1.png", "2.png", "3.png"]
    assert document["rejected"][0]["name"] == "wall.png"
    assert document["rms_pixels"] < 0.2
    assert cv2.imread(str(tmp_path / "camera.png")) is not None


def test_one_photograph_with_a_focal_length_is_a_rough_start(folder: Path, tmp_path: Path, capsys) -> None:
    exif = Image.Exif()
    exif.get_ifd(0x8769)[0xA405] = 31
    Image.open(folder / "0.png").convert("RGB").save(tmp_path / "one.jpg", quality=95, exif=exif)
    out = tmp_path / "camera.json"
    assert call("calibrate", tmp_path / "one.jpg", "--target", folder / "target.yaml", "--out", out) == 0
    assert "rough: one photograph and an EXIF focal length of 31 mm" in capsys.readouterr().out
    assert_close(read_lens(out).intrinsics[0, 0].item(), 2000 * 31 / (36**2 + 24**2) ** 0.5)
    assert json.loads(out.read_text())["rough"]


@pytest.mark.parametrize(
    ("photos", "words", "message"),
    [
        ((), (), "--photos"),
        (("0.png",), ("--target", "target.yaml"), "no EXIF focal length"),
        (("wall.png",), ("--target", "target.yaml"), "no photograph shows the board"),
        (("0.png", "wall.png"), ("--target", "target.yaml"), "1 usable photograph of the board, at least 3"),
        (("0.png", "1.png", "2.png"), ("--target", "target.yaml", "--ruler", "97"), "the print is at 97.0%"),
        (("0.png",), ("--chessboard", "9x6", "--square", "28mm", "--ruler", "270mm"), "should measure 280 mm"),
        (("0.png",), (), "exactly one of --target, --chessboard and --charuco, found none"),
        (("0.png",), ("--chessboard", "9x6"), "--square missing: expected millimetres"),
        (("0.png",), ("--chessboard", "9", "--square", "3"), "--chessboard 9: expected columns x rows"),
        (("0.png",), ("--target", "target.yaml", "--charuco", "5x7"), "found --target and --charuco"),
    ],
)
def test_calibrate_refuses_in_one_line(
    folder: Path, tmp_path: Path, capsys, monkeypatch, photos: tuple[str, ...], words: tuple[str, ...], message: str
) -> None:
    monkeypatch.chdir(folder)
    assert call("calibrate", *photos, *words, "--out", tmp_path / "camera.json") == 2
    lines = capsys.readouterr().err.strip().splitlines()
    if photos:
        assert message in lines[-1]
        assert all(line.startswith("torchlight: ") for line in lines)
    assert not list(tmp_path.iterdir())


def test_mixed_sizes_are_one_line(folder: Path, tmp_path: Path, capsys) -> None:
    picture = cv2.imread(str(folder / "3.png"), cv2.IMREAD_GRAYSCALE)
    assert picture is not None
    write_png(tmp_path / "turned.png", np.ascontiguousarray(np.rot90(picture)).astype(np.uint8))
    photos = [folder / "0.png", folder / "1.png", tmp_path / "turned.png"]
    code = call("calibrate", *photos, "--target", folder / "target.yaml", "--out", tmp_path / "camera.json")
    assert code == 2
    assert "0.png has 1600 x 1200 pixels but turned.png 1200 x 1600" in capsys.readouterr().err


def test_the_format_follows_the_name(folder: Path, tmp_path: Path) -> None:
    photos = [folder / f"{k}.png" for k in range(4)]
    lenses = []
    for name in ("camera.json", "camera.yml"):
        assert (
            call("calibrate", *photos, "--target", folder / "target.yaml", "--out", tmp_path / name, "--overwrite") == 0
        )
        lenses.append(read_lens(tmp_path / name))
    # OpenCV's YAML holds 16 digits, and its calibration adds up in an order of its own
    torch.testing.assert_close(lenses[0].intrinsics, lenses[1].intrinsics, rtol=1e-9, atol=0)
