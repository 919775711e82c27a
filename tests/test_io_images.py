from __future__ import annotations

import hashlib
import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from torch.testing import assert_close

from torchlight.errors import FormatError
from torchlight.io.containers import inspect
from torchlight.io.exif import upright
from torchlight.io.exr import write_exr
from torchlight.io.images import image_size, read_mask, read_photo, write_png
from torchlight.io.rgbe import write_hdr

RNG = np.random.default_rng(3)
EIGHT = RNG.integers(0, 256, (9, 13, 3), dtype=np.uint8)
SIXTEEN = RNG.integers(0, 65536, (9, 13, 3), dtype=np.uint16)


def encode(suffix: str, rgb: np.ndarray) -> bytes:
    pixels = rgb if rgb.ndim == 2 else np.ascontiguousarray(rgb[..., [2, 1, 0, *range(3, rgb.shape[2])]])
    done, data = cv2.imencode(suffix, pixels)
    assert done
    return data.tobytes()


def as_tensor(rgb: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(rgb.astype(np.float64) / np.iinfo(rgb.dtype).max).permute(2, 0, 1).float()


def with_orientation(jpeg: bytes, orientation: int) -> bytes:
    directory = struct.pack("<2sHIHHHIII", b"II", 42, 8, 1, 0x112, 3, 1, orientation, 0)
    segment = b"Exif\0\0" + directory
    return jpeg[:2] + b"\xff\xe1" + struct.pack(">H", len(segment) + 2) + segment + jpeg[2:]


@pytest.mark.parametrize("suffix", [".png", ".tiff", ".bmp"])
def test_lossless_eight_bits(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    path.write_bytes(encode(suffix, EIGHT))
    photo = read_photo(path)
    assert_close(photo.pixels, as_tensor(EIGHT), rtol=0, atol=1e-7)
    assert (photo.bits, photo.is_linear) == (8, False)
    assert photo.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    assert image_size(path) == (13, 9)


@pytest.mark.parametrize("suffix", [".png", ".tiff"])
def test_lossless_sixteen_bits(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    path.write_bytes(encode(suffix, SIXTEEN))
    photo = read_photo(path)
    assert_close(photo.pixels, as_tensor(SIXTEEN), rtol=0, atol=1e-7)
    assert (photo.bits, photo.is_linear) == (16, False)


def test_top_code_is_exactly_one(tmp_path: Path) -> None:
    for dtype in (np.uint8, np.uint16):
        (tmp_path / "a.png").write_bytes(encode(".png", np.full((2, 2, 3), np.iinfo(dtype).max, dtype=dtype)))
        assert_close(read_photo(tmp_path / "a.png").pixels, torch.ones(3, 2, 2), rtol=0, atol=0)


def test_grey_and_alpha(tmp_path: Path) -> None:
    (tmp_path / "grey.png").write_bytes(encode(".png", EIGHT[..., 0]))
    expected = as_tensor(EIGHT[..., :1]).expand(3, -1, -1)
    assert_close(read_photo(tmp_path / "grey.png").pixels, expected)
    (tmp_path / "alpha.png").write_bytes(encode(".png", np.dstack([EIGHT, EIGHT[..., 0]])))
    assert_close(read_photo(tmp_path / "alpha.png").pixels, as_tensor(EIGHT))


def test_float_files_are_linear(tmp_path: Path) -> None:
    picture = torch.rand(3, 9, 13) * 100
    write_exr(tmp_path / "a.exr", picture, {})
    write_exr(tmp_path / "y.exr", picture[:1], {})
    write_hdr(tmp_path / "a.hdr", picture)
    photo = read_photo(tmp_path / "a.exr")
    assert_close(photo.pixels, picture, rtol=0, atol=0)
    assert (photo.bits, photo.is_linear) == (None, True)
    assert_close(read_photo(tmp_path / "y.exr").pixels, picture[:1].expand(3, -1, -1), rtol=0, atol=0)
    assert_close(
        read_photo(tmp_path / "a.hdr").pixels / picture.amax(dim=0), picture / picture.amax(dim=0), rtol=0, atol=2**-8
    )
    assert [image_size(tmp_path / name) for name in ("a.exr", "y.exr", "a.hdr")] == [(13, 9)] * 3


@pytest.mark.parametrize("orientation", range(1, 9))
def test_orientation_is_applied_once_and_as_other_programs_do(tmp_path: Path, orientation: int) -> None:
    jpeg = encode(".jpg", EIGHT)
    (tmp_path / "turned.jpg").write_bytes(with_orientation(jpeg, orientation))
    applied = cv2.imread(str(tmp_path / "turned.jpg"), cv2.IMREAD_COLOR)
    assert applied is not None
    turned = read_photo(tmp_path / "turned.jpg")
    assert_close(turned.pixels, as_tensor(np.ascontiguousarray(applied[..., ::-1])), rtol=0, atol=1e-7)
    assert turned.exif.orientation == orientation
    assert image_size(tmp_path / "turned.jpg") == (applied.shape[1], applied.shape[0])


def tiff(rgb: np.ndarray, orientation: int) -> bytes:
    """Returns an uncompressed TIFF of one strip, written by hand."""
    height, width, _ = rgb.shape
    bits = 8 * rgb.itemsize
    entries = [(256, width), (257, height), (258, 134), (259, 1), (262, 2), (273, 140)]
    entries += [(274, orientation), (277, 3), (278, height), (279, rgb.nbytes)]
    body = struct.pack("<2sHIH", b"II", 42, 8, len(entries))
    for tag, value in entries:
        body += struct.pack("<HHIHH", tag, 3, 3 if tag == 258 else 1, value, 0)
    return body + struct.pack("<I3H", 0, bits, bits, bits) + rgb.astype(rgb.dtype.newbyteorder("<")).tobytes()


@pytest.mark.parametrize("picture", [EIGHT, SIXTEEN], ids=["8", "16"])
@pytest.mark.parametrize("orientation", range(1, 9))
def test_tiff_is_turned_once(tmp_path: Path, picture: np.ndarray, orientation: int) -> None:
    (tmp_path / "a.tiff").write_bytes(tiff(picture, orientation))
    expected = as_tensor(upright(picture, orientation))
    assert_close(read_photo(tmp_path / "a.tiff").pixels, expected, rtol=0, atol=1e-7)
    assert image_size(tmp_path / "a.tiff") == (expected.shape[2], expected.shape[1])


@pytest.mark.parametrize("suffix", [".jpg", ".tiff"])
def test_printing_inks_are_refused(tmp_path: Path, suffix: str) -> None:
    image = pytest.importorskip("PIL.Image")
    image.new("CMYK", (8, 6), (10, 20, 30, 40)).save(tmp_path / f"a{suffix}")
    for read in (read_photo, image_size):
        with pytest.raises(FormatError, match=r"of CMYK inks, not of light; save the original as RGB") as error:
            read(tmp_path / f"a{suffix}")
        assert "\n" not in str(error.value)


def test_jpeg_colours_and_kinds(tmp_path: Path) -> None:
    flat = np.zeros((32, 48, 3), dtype=np.uint8) + np.array([200, 90, 20], dtype=np.uint8)
    pixels = np.ascontiguousarray(flat[..., ::-1])
    for options in ([], [cv2.IMWRITE_JPEG_PROGRESSIVE, 1], [cv2.IMWRITE_JPEG_RST_INTERVAL, 2]):
        data = cv2.imencode(".jpg", pixels, options)[1].tobytes()
        (tmp_path / "a.jpg").write_bytes(data + b"trailing bytes of a phone")
        photo = read_photo(tmp_path / "a.jpg")
        assert_close(photo.pixels, as_tensor(flat), rtol=0, atol=0.012)
        for length in range(4, len(data), 5):
            with pytest.raises(FormatError, match=r"a\.jpg: truncated or corrupt JPEG"):
                inspect(data[:length], "a.jpg")


def test_jpeg_with_a_wrong_segment_length() -> None:
    data = encode(".jpg", EIGHT)
    with pytest.raises(FormatError, match=r"a\.jpg: truncated or corrupt JPEG: no marker at byte"):
        inspect(data[:4] + struct.pack(">H", struct.unpack_from(">H", data, 4)[0] - 3) + data[6:], "a.jpg")


def test_mask(tmp_path: Path) -> None:
    mask = np.zeros((4, 5, 3), dtype=np.uint8)
    mask[1, 2, 2] = 1
    mask[3, 0] = 255
    (tmp_path / "m.png").write_bytes(encode(".png", mask))
    expected = torch.zeros(4, 5, dtype=torch.bool)
    expected[1, 2] = expected[3, 0] = True
    assert_close(read_mask(tmp_path / "m.png"), expected)


@pytest.mark.parametrize("suffix", [".png", ".tiff", ".bmp", ".jpg"])
def test_every_truncation_is_noticed(tmp_path: Path, suffix: str, capfd: pytest.CaptureFixture[str]) -> None:
    data = encode(suffix, EIGHT)
    path = tmp_path / f"a{suffix}"
    for length in range(1, len(data), 3):
        path.write_bytes(data[:length])
        for read in (read_photo, image_size):
            with pytest.raises(FormatError) as error:
                read(path)
            assert str(error.value).startswith(f"{path}: ")
            assert "\n" not in str(error.value)
    assert capfd.readouterr() == ("", "")


def test_damaged_png_is_noticed(tmp_path: Path) -> None:
    data = bytearray(encode(".png", EIGHT))
    data[len(data) // 2] ^= 1
    (tmp_path / "a.png").write_bytes(data)
    with pytest.raises(FormatError, match=r"a\.png: truncated or corrupt PNG: wrong checksum"):
        read_photo(tmp_path / "a.png")


def png_of_size(width: int, height: int) -> bytes:
    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    header = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + header + chunk(b"IDAT", zlib.compress(b"\0" * 10)) + chunk(b"IEND", b"")


def test_bombs_are_refused_from_the_header(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(png_of_size(30_000, 30_000))
    for read in (read_photo, image_size):
        with pytest.raises(FormatError, match=r"a\.png: 30000 x 30000 pixels; expected 1 to 400,000,000 pixels"):
            read(tmp_path / "a.png")
    (tmp_path / "zero.png").write_bytes(png_of_size(0, 4))
    with pytest.raises(FormatError, match=r"zero\.png: 0 x 4 pixels"):
        read_photo(tmp_path / "zero.png")


def test_pixels_that_do_not_fill_the_picture(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(png_of_size(300, 300))
    with pytest.raises(FormatError, match=r"a\.png: the PNG cannot be decoded"):
        read_photo(tmp_path / "a.png")


def test_not_images(tmp_path: Path) -> None:
    (tmp_path / "empty.png").write_bytes(b"")
    (tmp_path / "text.png").write_text("this is text\nin two lines")
    (tmp_path / "folder.png").mkdir()
    for name, message in {
        "none.png": "no such file",
        "empty.png": "the file is empty",
        "text.png": "its content is not PNG, JPEG, TIFF, BMP, EXR or HDR",
        "folder.png": "expected a file, got a folder",
        "text.png/below.png": "cannot be read",
        "nul\0.png": "cannot be read",
    }.items():
        for read in (read_photo, read_mask, image_size):
            with pytest.raises(FormatError, match=message) as error:
                read(tmp_path / name)
            assert "\n" not in str(error.value)


def test_float_tiff_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.tiff").write_bytes(encode(".tiff", EIGHT.astype(np.float32)))
    with pytest.raises(FormatError, match=r"a\.tiff: TIFF of float32 values; save linear float values as EXR"):
        read_photo(tmp_path / "a.tiff")


@pytest.mark.parametrize("shape", [(4, 5), (4, 5, 1), (4, 5, 3), (4, 5, 4)])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_written_png_reads_back(tmp_path: Path, shape: tuple[int, ...], dtype: type) -> None:
    picture = RNG.integers(0, np.iinfo(dtype).max, shape, dtype=dtype, endpoint=True)[::-1]
    write_png(tmp_path / "a.png", picture)
    rgb = picture.reshape(4, 5, -1)[..., :3]
    expected = as_tensor(np.ascontiguousarray(np.broadcast_to(rgb, (4, 5, 3))))
    assert_close(read_photo(tmp_path / "a.png").pixels, expected, rtol=0, atol=1e-7)


def test_pictures_that_are_not_written(tmp_path: Path) -> None:
    for picture in (np.zeros((2, 2, 3)), np.zeros((2, 2, 2), dtype=np.uint8), np.zeros((0, 2), dtype=np.uint8)):
        with pytest.raises(FormatError, match=r"a\.png: expected uint8 or uint16 grey, RGB or RGBA"):
            write_png(tmp_path / "a.png", picture)
    with pytest.raises(FormatError, match="cannot be written"):
        write_png(tmp_path / "none" / "a.png", np.zeros((2, 2), dtype=np.uint8))
