from __future__ import annotations

import errno
import logging
import os
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
import torch
from torch.testing import assert_close

from torchlight.errors import ConfigError, FormatError, ShapeError
from torchlight.io import exr
from torchlight.io.exr import REC709_D65, read_exr, write_exr
from torchlight.io.exr_container import check_exr

HEADER = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}


def image(channels: int, height: int = 37, width: int = 23) -> torch.Tensor:
    generator = torch.Generator().manual_seed(7)
    return torch.randn(channels, height, width, generator=generator) * 1e5


def write_raw(path: Path, channels: dict[str, np.ndarray], **header: object) -> None:
    OpenEXR.File({**HEADER, **header}, channels).write(str(path))


@pytest.mark.parametrize("channels", [1, 3])
def test_round_trip_is_exact(tmp_path: Path, channels: int) -> None:
    picture = image(channels)
    metadata = {"units": "relative", "nested": {"values": [1, 2.5]}, "flag": True}
    write_exr(tmp_path / "a.exr", picture, metadata)
    back, stored = read_exr(tmp_path / "a.exr")
    assert_close(back, picture, rtol=0, atol=0)
    assert stored == metadata


def test_alpha_is_written_and_dropped_on_reading(tmp_path: Path) -> None:
    picture = image(4)
    write_exr(tmp_path / "a.exr", picture, {})
    with OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True) as file:
        assert sorted(file.channels()) == ["A", "B", "G", "R"]
    assert_close(read_exr(tmp_path / "a.exr")[0], picture[:3], rtol=0, atol=0)


def test_views_that_are_not_contiguous(tmp_path: Path) -> None:
    base = image(3)
    for view in (
        base.flip(0),
        base.flip(1),
        base.mT,
        base[:, 3:30, 2:20],
        base[:, ::2, ::3],
        base[:1].expand(3, -1, -1),
    ):
        write_exr(tmp_path / "a.exr", view, {})
        assert_close(read_exr(tmp_path / "a.exr")[0], view, rtol=0, atol=0)


def test_what_is_stored(tmp_path: Path) -> None:
    write_exr(tmp_path / "a.exr", image(3).double(), {"a": 1})
    write_exr(tmp_path / "b.exr", image(3), {}, openexr_envmap=True)
    with OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True) as file:
        header = dict(file.header())
        assert list(file.channels()) == ["B", "G", "R"]
        assert {channel.pixels.dtype.name for channel in file.channels().values()} == {"float32"}
    assert header["compression"] == OpenEXR.ZIP_COMPRESSION
    assert header["type"] == OpenEXR.scanlineimage
    assert header["torchlight"] == '{"a": 1}'
    np.testing.assert_allclose(header["chromaticities"], REC709_D65, atol=1e-7)
    assert "envmap" not in header
    with OpenEXR.File(str(tmp_path / "b.exr")) as file:
        assert file.header()["envmap"] == OpenEXR.ENVMAP_LATLONG


def test_not_finite_values_survive(tmp_path: Path) -> None:
    picture = torch.tensor([float("nan"), float("inf"), -1.0, 1e-40]).reshape(1, 2, 2)
    write_exr(tmp_path / "a.exr", picture, {})
    assert_close(read_exr(tmp_path / "a.exr")[0], picture, rtol=0, atol=0, equal_nan=True)


def test_others_files(tmp_path: Path) -> None:
    rgb = np.random.default_rng(0).random((6, 5, 3)).astype(np.float16)
    for compression in (OpenEXR.NO_COMPRESSION, OpenEXR.ZIPS_COMPRESSION, OpenEXR.PIZ_COMPRESSION):
        write_raw(tmp_path / "half.exr", {"RGB": rgb}, compression=compression)
        back, metadata = read_exr(tmp_path / "half.exr")
        np.testing.assert_array_equal(back.numpy(), rgb.astype(np.float32).transpose(2, 0, 1))
        assert metadata == {}
    layer = {f"Layer.{letter}": np.ascontiguousarray(rgb[..., index]) for index, letter in enumerate("RGB")}
    write_raw(tmp_path / "layer.exr", {**layer, "Depth.Z": np.ascontiguousarray(rgb[..., 0])})
    np.testing.assert_array_equal(read_exr(tmp_path / "layer.exr")[0].numpy(), back.numpy())


ACESCG = (0.713, 0.293, 0.165, 0.830, 0.128, 0.044, 0.32168, 0.33767)


def test_other_primaries_are_converted_and_said(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """By the published matrix; grey is grey."""
    caplog.set_level(logging.INFO, "torchlight")
    green = np.zeros((2, 2, 3), dtype=np.float32)
    green[..., 1] = 2
    write_raw(tmp_path / "a.exr", {"RGB": green}, chromaticities=ACESCG)
    expected = torch.tensor([-0.62179, 1.14080, -0.12897])[:, None, None].expand(3, 2, 2) * 2
    assert_close(read_exr(tmp_path / "a.exr")[0], expected, atol=2e-5, rtol=0)
    assert [record.getMessage() for record in caplog.records] == [
        f"{tmp_path}/a.exr: colours of acescg primaries are converted to Rec.709"
    ]
    write_raw(tmp_path / "grey.exr", {"Y": green[..., 1].copy()}, chromaticities=ACESCG)
    assert_close(read_exr(tmp_path / "grey.exr")[0], torch.full((1, 2, 2), 2.0), atol=0, rtol=0)
    assert len(caplog.records) == 1


def test_colours_are_written_in_the_primaries_asked_for(tmp_path: Path) -> None:
    image = torch.rand(4, 3, 2, generator=torch.Generator().manual_seed(0))
    write_exr(tmp_path / "a.exr", image, {}, primaries="acescg")
    with OpenEXR.File(str(tmp_path / "a.exr")) as file:
        assert file.header()["chromaticities"] == pytest.approx(ACESCG, abs=1e-6)
        stored = torch.from_numpy(file.channels()["RGBA"].pixels).permute(2, 0, 1)
    assert_close(stored[0], (torch.tensor([0.613097, 0.339523, 0.047379])[:, None, None] * image[:3]).sum(0))
    assert_close(stored[3], image[3], atol=0, rtol=0)
    assert_close(read_exr(tmp_path / "a.exr")[0], image[:3], atol=1e-6, rtol=0)
    with pytest.raises(ConfigError, match="choose one of rec709"):
        write_exr(tmp_path / "b.exr", image, {}, primaries="p3")


def test_primaries_on_one_line_are_refused(tmp_path: Path) -> None:
    line = (0.1, 0.1, 0.2, 0.2, 0.3, 0.3, 0.3127, 0.3290)
    write_raw(tmp_path / "a.exr", {"RGB": np.ones((2, 2, 3), dtype=np.float32)}, chromaticities=line)
    with pytest.raises(FormatError, match=r"a\.exr: primaries: red, green and blue lie on one line"):
        read_exr(tmp_path / "a.exr")


def test_unsuitable_channels(tmp_path: Path) -> None:
    plane = np.ones((2, 2), dtype=np.float32)
    write_raw(tmp_path / "a.exr", {"X": plane, "Y": plane})
    with pytest.raises(FormatError, match=r"a\.exr: expected channels R, G, B or one channel such as Y, got X, Y"):
        read_exr(tmp_path / "a.exr")
    with pytest.raises(ShapeError, match="expected 1, 3 or 4 channels, got 2"):
        write_exr(tmp_path / "b.exr", torch.zeros(2, 2, 2), {})


def test_every_truncation_is_noticed(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    write_exr(tmp_path / "a.exr", image(3), {"a": 1})
    data = (tmp_path / "a.exr").read_bytes()
    cut = tmp_path / "cut.exr"
    for length in [*range(1, 900, 7), *range(900, len(data), 997), len(data) - 1]:
        cut.write_bytes(data[:length])
        with pytest.raises(FormatError) as error:
            read_exr(cut)
        assert str(error.value).startswith(f"{cut}: ")
        assert "\n" not in str(error.value)
    assert capfd.readouterr() == ("", "")


def test_damage_is_noticed_quietly(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    write_exr(tmp_path / "a.exr", torch.linspace(0, 1, 60 * 40).round(decimals=2).reshape(1, 60, 40), {})
    data = bytearray((tmp_path / "a.exr").read_bytes())
    for index in range(len(data) - 30, len(data) - 20):
        data[index] ^= 0xFF
    (tmp_path / "a.exr").write_bytes(data)
    with pytest.raises(FormatError, match=r"a\.exr: the OpenEXR file is corrupt"):
        read_exr(tmp_path / "a.exr")
    assert capfd.readouterr() == ("", "")


def test_missing_empty_folder_and_text(tmp_path: Path) -> None:
    (tmp_path / "empty.exr").write_bytes(b"")
    (tmp_path / "text.exr").write_text("hello")
    (tmp_path / "folder.exr").mkdir()
    for name, message in {
        "none.exr": "no such file",
        "empty.exr": "the file is empty",
        "text.exr": "not an OpenEXR file",
        "folder.exr": "got a folder",
    }.items():
        with pytest.raises(FormatError, match=f"{name}: .*{message}"):
            read_exr(tmp_path / name)


def test_huge_sizes_are_refused_from_the_header(tmp_path: Path) -> None:
    write_exr(tmp_path / "a.exr", image(1), {})
    data = (tmp_path / "a.exr").read_bytes()
    small, huge = (np.array([0, 0, w - 1, h - 1], dtype="<i4").tobytes() for w, h in ((23, 37), (70_000, 70_000)))
    assert data.count(small) == 2
    with pytest.raises(FormatError, match="70000 x 70000 pixels"):
        check_exr(data.replace(small, huge), "a.exr")
    with pytest.raises(FormatError, match="save it uncropped"):
        check_exr(data.replace(small, huge, 1), "a.exr")
    for flag in (0x08, 0x10):
        with pytest.raises(FormatError, match="single-part"):
            check_exr(data[:5] + bytes([flag]) + data[6:], "a.exr")


def test_full_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full_disk(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "replace", full_disk)
    with pytest.raises(FormatError, match=r"a\.exr: cannot be written: the disk is full"):
        write_exr(tmp_path / "a.exr", image(3), {})
    assert list(tmp_path.iterdir()) == []


def test_a_library_that_writes_half_a_file_is_found_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Careless:
        def __init__(self, *_: object) -> None:
            pass

        def write(self, path: str) -> None:
            Path(path).write_bytes(whole[: len(whole) // 2])

    write_exr(tmp_path / "a.exr", image(3), {})
    whole = (tmp_path / "a.exr").read_bytes()
    monkeypatch.setattr(exr.OpenEXR, "File", Careless)
    with pytest.raises(FormatError, match=r"b\.exr: could not be written completely; is the disk full\?"):
        write_exr(tmp_path / "b.exr", image(3), {})
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.exr"]


def test_a_library_that_writes_other_pixels_is_found_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(exr, "_decode", lambda _: ({}, {name: np.zeros((37, 23), dtype=np.float32) for name in "RGB"}))
    with pytest.raises(FormatError, match=r"a\.exr: what was written does not read back the same"):
        write_exr(tmp_path / "a.exr", image(3), {})
    assert list(tmp_path.iterdir()) == []
