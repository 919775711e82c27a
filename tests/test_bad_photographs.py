"""What a user's mistakes with photographs get: one line that says what, where and what to do, and nothing written."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from cameras import exif_block, exposure_entries, jpeg_with
from PIL import Image
from sheet_photo import LENS, SHEET, looking_at, photograph
from workbench import BOX, CAMERA, LINEAR, RECEIVER, contents, png, scene_file, shadow
from workbench import torchlight as run

from torchlight.camera import Lens
from torchlight.io.cameras import opencv_text
from torchlight.io.images import write_png
from torchlight.io.target_file import write_target
from torchlight.photo.target import DEFAULT_PROP

HALF = Lens(LENS.intrinsics * torch.tensor([[0.5], [0.5], [1.0]]), (800, 600), LENS.distortion)
TILTED = {"a": (0.0, -300.0, 330.0), "b": (260.0, 120.0, 340.0), "c": (-250.0, 150.0, 330.0)}
STRAIGHT = {"e": (0.0, 1.0, 480.0), "f": (25.0, 1.0, 440.0), "g": (-25.0, 1.0, 460.0)}
WITH_CAMERA = BOX + RECEIVER + CAMERA + LINEAR


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Photographs of the sheet: three good, three from one tilt, and every way to spoil one."""
    place = tmp_path_factory.mktemp("bad")
    write_target(place / "target.yaml", SHEET, DEFAULT_PROP)
    (place / "camera.yml").write_text(opencv_text(HALF))
    for seed, (name, eye) in enumerate((TILTED | STRAIGHT).items()):
        at = (eye[0], 0.0, 0.0) if name in STRAIGHT else (0.0, 0.0, 0.0)
        write_png(place / f"{name}.png", photograph(HALF.at(looking_at(eye, at)), seed))
    good = cv2.imread(str(place / "a.png"))
    assert good is not None
    write_png(place / "blurred.png", cv2.GaussianBlur(good, (0, 0), 12))
    write_png(place / "wall.png", np.full((600, 800, 3), 128, np.uint8))
    write_png(place / "cropped.png", np.ascontiguousarray(good[:, 20:]))
    jpeg = cv2.imencode(".jpg", good)[1].tobytes()
    (place / "turned.jpg").write_bytes(jpeg_with(jpeg, exif_block(exposure_entries((1, 50)), 6)))
    Image.fromarray(good).convert("CMYK").save(place / "inks.jpg")
    return place


CALIBRATE = {
    "no markers": ("wall b c d", 2, "no markers of the sheet are seen, at least 4 are needed; check that it is this"),
    "blurred": ("blurred b c", 2, "blurred.png: no markers of the sheet are seen"),
    "too few": ("a b", 2, "calibration: 2 usable photographs of the board, at least 3 are needed, 10 to 20 are good"),
    "one tilt": ("e f g", 2, "all 3 photographs look at the board from one tilt"),
    "mixed sizes": ("a b c cropped", 2, "a.png has 800 x 600 pixels but cropped.png 780 x 600; use photographs of one"),
    "turned by EXIF": ("a b c turned", 2, "a.png has 800 x 600 pixels but turned.jpg 600 x 800; use photographs of on"),
    "inks": ("inks a b", 2, "inks.jpg: a JPEG of CMYK inks, not of light; save the original as RGB"),
    "one missing": ("a b gone", 2, "gone.png: no such file"),
}


def named(folder: Path, names: str) -> list[Path]:
    found = [next(folder.glob(f"{name}.[pj]*"), folder / f"{name}.png") for name in names.split()]
    return [path for path in found if path.stem != "d"]


@pytest.mark.parametrize("case", CALIBRATE)
def test_calibrate(folder: Path, tmp_path: Path, case: str) -> None:
    names, code, message = CALIBRATE[case]
    ran = run("calibrate", *named(folder, names), "--target", folder / "target.yaml", "--out", tmp_path / "c.json")
    lines = ran.err.splitlines()
    assert ran.code == code
    assert len([line for line in lines if message in line]) == 1, ran.err
    assert len(lines) == 1 + ("usable photograph" in lines[-1] and len(lines) > 1)  # then also: too few are left
    assert "Traceback" not in ran.err
    assert contents(tmp_path) == []


def test_a_bad_photograph_among_good_ones_is_named_and_the_others_count(folder: Path, tmp_path: Path) -> None:
    photos = named(folder, "a b c blurred inks")
    ran = run("calibrate", *photos, "--target", folder / "target.yaml", "--out", tmp_path / "c.json")
    assert ran.code == 1
    assert [line.split(": ")[1].rsplit("/", 1)[-1] for line in ran.err.splitlines()] == ["blurred.png", "inks.jpg"]
    assert ran.out.count("left out: ") == 2
    assert contents(tmp_path) == ["c.json", "c.png"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--target", "{}/target.yaml", "--ruler", "97"), "should measure 100 mm but measures 97 mm"),
        (("--chessboard", "9x6", "--square", "25", "--ruler", "240"), "measure 250 mm but measures 240 mm"),
        (("--chessboard", "9x6"), "--square missing: expected millimetres above 0, such as 28 or 28mm"),
    ],
)
def test_a_print_of_another_scale_is_caught(
    folder: Path, tmp_path: Path, options: tuple[str, ...], message: str
) -> None:
    words = [word.format(folder) for word in options]
    ran = run("calibrate", *named(folder, "a b c"), *words, "--out", tmp_path / "c.json")
    assert ran.code == 2
    assert message in ran.line
    assert contents(tmp_path) == []


def board_scene(folder: Path, mask: str = "") -> Path:
    text = BOX + "receiver: {size: [40, 40], samples: [8, 8]}\nphoto: {encoding: srgb}\n" + mask
    board = f"camera: {{intrinsics: {folder / 'camera.yml'}, board: {folder / 'target.yaml'}}}\n"
    return scene_file(folder, text + board, f"board{len(mask)}.yaml")


def sixteen_bits(folder: Path) -> tuple[Path, Path]:
    image = (shadow() * 65535).round().int().numpy().astype(np.uint16).transpose(1, 2, 0)
    write_png(folder / "sixteen.png", np.ascontiguousarray(image))
    return scene_file(folder, BOX + RECEIVER, "silent.yaml"), folder / "sixteen.png"


def turned(folder: Path) -> tuple[Path, Path]:
    jpeg = cv2.imencode(".jpg", np.full((72, 96, 3), 99, np.uint8))[1].tobytes()
    (folder / "held.jpg").write_bytes(jpeg_with(jpeg, exif_block(exposure_entries((1, 50)), 8)))
    return scene_file(folder, WITH_CAMERA, "camera.yaml"), folder / "held.jpg"


def small_mask(folder: Path) -> tuple[Path, Path]:
    write_png(folder / "mask.png", np.full((36, 48), 255, np.uint8))
    return scene_file(folder, WITH_CAMERA + "mask: mask.png\n", "masked.yaml"), png(folder / "any.png")


def small_mask_of_a_board(folder: Path) -> tuple[Path, Path]:
    write_png(folder / "mask.png", np.full((36, 48), 255, np.uint8))
    return board_scene(folder, "mask: mask.png\n"), folder / "a.png"


ESTIMATE = {
    "16 bits, encoding unsaid": (sixteen_bits, "photo.encoding: missing, and a 16-bit photograph does not say how it"),
    "inks": (lambda f: (board_scene(f), f / "inks.jpg"), "inks.jpg: a JPEG of CMYK inks, not of light; save the origi"),
    "no markers": (lambda f: (board_scene(f), f / "wall.png"), "wall.png: no markers of the sheet are seen, at"),
    "blurred": (lambda f: (board_scene(f), f / "blurred.png"), "blurred.png: no markers of the sheet are seen"),
    "another size": (lambda f: (board_scene(f), f / "cropped.png"), "cropped.png: 780 x 600 pixels, but the camera"),
    "turned by EXIF": (turned, "held.jpg: the photograph has 72 x 96 pixels but camera.image_size says 96 x 72; use"),
    "a mask of another size": (small_mask, "mask: {}/mask.png has 48 x 36 pixels, but camera.image_size is 96 x 72"),
    "a mask of another size than a board's photograph": (
        small_mask_of_a_board,
        "a.png: mask: 48 x 36 pixels, but the photograph has 800 x 600; draw the mask over the photograph at its full",
    ),
}


@pytest.mark.parametrize("case", ESTIMATE)
def test_estimate(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, case: str) -> None:
    monkeypatch.setenv("TORCHLIGHT_CACHE", str(tmp_path / "cache"))
    make, message = ESTIMATE[case]
    scene, photo = make(folder)
    options = ("--out", tmp_path / "out", "--method", "texels", "--resolution", 4)
    ran = run("estimate", scene, photo, *options)
    lines = [line for line in ran.err.splitlines() if "pose from" not in line and "may not be determined" not in line]
    assert ran.code == 2
    assert len([line for line in lines if message.format(folder) in line]) == 1, ran.err
    assert "Traceback" not in ran.err
    assert not (tmp_path / "out" / photo.stem).exists()
