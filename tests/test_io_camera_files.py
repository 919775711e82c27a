"""RAW and HEIC: exact values of a mosaic made by hand; one clear line where the extra is absent."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from cameras import dng, exif_block, exposure_entries
from torch.testing import assert_close
from workbench import RECTIFIED, degrees_between, exr, scene_file, shadow, torchlight

from torchlight.errors import FormatError
from torchlight.io.exif import upright
from torchlight.io.images import image_size, read_photo

BLACK, WHITE = 512, 15872
HEIC = b"\0\0\0\x18ftypheic\0\0\0\0mif1heic" + bytes(64)


def mosaic() -> np.ndarray:
    """Two grey fields of ratio 1 to 4 above black, and a saturated square."""
    values = np.full((64, 96), BLACK + 1000)
    values[:, :48] = BLACK + 4000
    values[20:24, 60:64] = WHITE + 100
    return values


@pytest.mark.parametrize("orientation", [1, 3, 6, 8])
def test_raw_is_linear_above_black_upright_and_infinite_where_saturated(tmp_path: Path, orientation: int) -> None:
    pytest.importorskip("rawpy")
    (tmp_path / "a.dng").write_bytes(dng(mosaic(), BLACK, WHITE, orientation))
    photo = read_photo(tmp_path / "a.dng")
    assert (photo.bits, photo.is_linear, photo.exif.time) == (None, True, 1 / 50)
    shares = upright((mosaic() - BLACK) / (WHITE - BLACK), orientation)
    assert image_size(tmp_path / "a.dng") == shares.shape[::-1]
    saturated = np.zeros((64, 96), dtype=bool)
    saturated[18:26, 58:66] = True  # two pixels around: demosaicing spreads them
    saturated = torch.from_numpy(upright(saturated, orientation))
    assert torch.equal(photo.pixels.isinf(), saturated.expand(3, -1, -1))
    edge = np.zeros((64, 96), dtype=bool)
    edge[:, 44:52] = edge[14:30, 54:70] = True
    inside = ~torch.from_numpy(upright(edge, orientation))
    expected = torch.from_numpy(shares).float().expand(3, -1, -1)
    assert_close(photo.pixels[:, inside], expected[:, inside], rtol=2e-3, atol=0)


def test_damaged_raw(tmp_path: Path) -> None:
    pytest.importorskip("rawpy")
    (tmp_path / "a.dng").write_bytes(dng(mosaic(), BLACK, WHITE)[:200])
    for read in (read_photo, image_size):
        with pytest.raises(FormatError, match=r"a\.dng: LibRaw cannot read it") as error:
            read(tmp_path / "a.dng")
        assert "\n" not in str(error.value)


def test_heic_round_trip(tmp_path: Path) -> None:
    heif = pytest.importorskip("pillow_heif")
    flat = np.zeros((64, 96, 3), dtype=np.uint8) + np.array([200, 90, 20], dtype=np.uint8)
    file = heif.from_bytes(mode="RGB", size=(96, 64), data=flat.tobytes())
    block = exif_block(exposure_entries((1, 8)), 6)
    file.save(tmp_path / "a.heic", quality=95, exif=b"Exif\0\0" + block)
    photo = read_photo(tmp_path / "a.heic")
    assert (photo.bits, photo.is_linear, photo.exif.time) == (8, False, 1 / 8)
    assert image_size(tmp_path / "a.heic") == (photo.pixels.shape[2], photo.pixels.shape[1])
    assert_close(photo.pixels.mean(dim=(1, 2)) * 255, torch.tensor([200.0, 90.0, 20.0]), rtol=0, atol=2)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_heic_is_turned_once(tmp_path: Path, orientation: int) -> None:
    heif = pytest.importorskip("pillow_heif")
    corners = np.zeros((64, 96, 3), dtype=np.uint8) + np.array([240], dtype=np.uint8)
    corners[:32, :48], corners[:32, 48:], corners[32:, :48] = (250, 10, 10), (10, 250, 10), (10, 10, 250)
    file = heif.from_bytes(mode="RGB", size=(96, 64), data=corners.tobytes())
    file.save(tmp_path / "a.heic", quality=95, exif=b"Exif\0\0" + exif_block(exposure_entries((1, 8)), orientation))
    photo = read_photo(tmp_path / "a.heic")
    expected = torch.from_numpy(upright(corners, orientation).copy()).permute(2, 0, 1)
    assert photo.pixels.shape == expected.shape
    assert image_size(tmp_path / "a.heic") == (expected.shape[2], expected.shape[1])
    places = (slice(None), slice(5, None, expected.shape[1] - 11), slice(5, None, expected.shape[2] - 11))
    assert_close(photo.pixels[places] * 255, expected[places].float(), rtol=0, atol=3)


def test_heic_of_more_than_eight_bits(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    heif = pytest.importorskip("pillow_heif")
    monkeypatch.setattr(heif.options, "SAVE_HDR_TO_12_BIT", True)
    values = np.full((64, 96, 3), 30000, dtype=np.uint16)
    values[:, :48] = 60000
    heif.from_bytes(mode="RGB;16", size=(96, 64), data=values.tobytes()).save(tmp_path / "a.heic", quality=-1)
    photo = read_photo(tmp_path / "a.heic")
    assert (photo.bits, photo.is_linear) == (16, False)
    found = torch.stack([photo.pixels[:, 5, 5], photo.pixels[:, 5, 90]])
    assert_close(found, torch.tensor([[60000.0], [30000.0]]).expand(2, 3) / 65535, rtol=0, atol=1 / 4095)


@pytest.mark.parametrize("kind", ["dng", "heic"])
def test_a_cameras_own_file_gives_the_light_of_the_same_pixels(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    monkeypatch.setenv("TORCHLIGHT_CACHE", str(tmp_path / "cache"))
    grey = shadow().mean(dim=0).repeat_interleave(8, dim=0).repeat_interleave(8, dim=1).numpy()
    if kind == "dng":
        pytest.importorskip("rawpy")
        (tmp_path / "a.dng").write_bytes(dng((BLACK + 0.9 * grey * (WHITE - BLACK)).round().astype(int), BLACK, WHITE))
    else:
        heif = pytest.importorskip("pillow_heif")
        codes = np.repeat((255 * grey).round().astype(np.uint8)[..., None], 3, axis=2)
        heif.from_bytes(mode="RGB", size=(128, 128), data=codes.tobytes()).save(tmp_path / "a.heic", quality=98)
    encoding = {"dng": "raw", "heic": "linear"}[kind]
    scene = scene_file(tmp_path, RECTIFIED.replace("encoding: linear", f"encoding: {encoding}"))
    options = ("--method", "texels", "--resolution", 4, "--out", tmp_path / "out")
    ran = torchlight("estimate", scene, tmp_path / f"a.{kind}", *options)
    assert ran.code == 0, ran.err
    result = json.loads((tmp_path / "out" / "a" / "result.json").read_text())
    plain = torchlight("estimate", scene_file(tmp_path), exr(tmp_path / "b.exr"), *options)
    assert plain.code == 0
    expected = json.loads((tmp_path / "out" / "b" / "result.json").read_text())
    assert result["visible"] == expected["visible"]
    assert degrees_between(result["peak_direction"], expected["peak_direction"]) < 0.5
    assert result["exposure"]["time"] == {"dng": 1 / 50, "heic": None}[kind]


def test_damaged_heic(tmp_path: Path) -> None:
    pytest.importorskip("pillow_heif")
    (tmp_path / "a.heic").write_bytes(HEIC)
    for read in (read_photo, image_size):
        with pytest.raises(FormatError, match=r"a\.heic: truncated or corrupt HEIC") as error:
            read(tmp_path / "a.heic")
        assert "\n" not in str(error.value)


@pytest.mark.parametrize(("name", "package"), [("a.dng", "rawpy"), ("a.CR3", "rawpy"), ("a.heic", "pillow-heif")])
def test_without_the_extra_one_line_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, package: str
) -> None:
    monkeypatch.setitem(sys.modules, package.replace("-", "_"), None)
    (tmp_path / name).write_bytes(HEIC)
    for read in (read_photo, image_size):
        with pytest.raises(FormatError) as error:
            read(tmp_path / name)
        expected = f"needs {package}, which is not installed: pip install 'torchlight[raw]'"
        assert str(error.value) == f"{tmp_path / name}: {expected}"
