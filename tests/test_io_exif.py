"""EXIF blocks written by hand, and the exposures of real photographs."""

from __future__ import annotations

import struct
from pathlib import Path

import cv2
import numpy as np
import pytest
from cameras import exif_block, exposure_entries, jpeg_with
from realdata import data_path

from torchlight.io.exif import Exif, parse_exif, read_exif, turned_size, upright
from torchlight.io.images import read_photo

JPEG = cv2.imencode(".jpg", np.full((6, 8, 3), 90, dtype=np.uint8))[1].tobytes()
FULL = exposure_entries((1, 50), (28, 10), 400)


@pytest.mark.parametrize("order", ["<", ">"])
def test_entries_of_a_jpeg(tmp_path: Path, order: str) -> None:
    (tmp_path / "a.jpg").write_bytes(jpeg_with(JPEG, exif_block(FULL, 6, order)))
    found = read_photo(tmp_path / "a.jpg").exif
    assert (found.orientation, found.time, found.aperture, found.iso) == (6, 1 / 50, 2.8, 400)
    assert found.missing == ()
    assert found.exposure == pytest.approx(4 / 50 / 2.8**2, rel=1e-12)


def test_entries_of_a_png(tmp_path: Path) -> None:
    png = cv2.imencode(".png", np.full((6, 8, 3), 90, dtype=np.uint8))[1].tobytes()
    block = exif_block(FULL)
    chunk = struct.pack(">I4s", len(block), b"eXIf") + block
    assert read_exif(png[:33] + chunk + b"\0\0\0\0" + png[33:]).time == 1 / 50


def test_what_is_missing_is_said_and_counts_as_constant() -> None:
    only_time = parse_exif(exif_block(exposure_entries((1, 8))))
    assert only_time.missing == ("aperture", "ISO")
    assert only_time.exposure == 1 / 8
    assert Exif(aperture=4.0, iso=100.0).exposure is None
    assert read_exif(JPEG).missing == ("exposure time", "aperture", "ISO")


@pytest.mark.parametrize("time", [(0, 1), (1, 0), (0, 0)])
def test_times_that_are_none(time: tuple[int, int]) -> None:
    assert parse_exif(exif_block(exposure_entries(time))).time is None


def test_damage_is_no_exif_and_never_an_error() -> None:
    block = exif_block(FULL, 3)
    whole = jpeg_with(JPEG, block)
    for length in range(len(block)):
        parse_exif(block[:length])
        read_exif(whole[:length])
    rng = np.random.default_rng(0)
    for _ in range(500):
        spoiled = bytearray(block)
        for place in rng.integers(0, len(block), 3):
            spoiled[place] = rng.integers(0, 256)
        parse_exif(bytes(spoiled))
    assert read_exif(b"") == read_exif(b"\xff\xd8") == parse_exif(b"MM\0\x2a") == Exif()


@pytest.mark.parametrize("orientation", range(1, 9))
def test_turned_size_is_that_of_the_turned_picture(orientation: int) -> None:
    height, width = upright(np.zeros((3, 5, 3)), orientation).shape[:2]
    assert turned_size(5, 3, orientation) == (width, height)


def test_exposures_of_a_bracket_by_a_real_camera() -> None:
    folder = data_path("brackets", "desktop01")
    times = [read_exif(file.read_bytes()) for file in sorted(folder.glob("*.jpg"))]
    nominal = [1, 2, 4, 8, 15, 30, 60, 125, 250, 500, 1000, 1600, 3200, 6400, 8000]
    assert [round(1 / exif.time) for exif in times if exif.time] == nominal
    assert {(exif.aperture, exif.iso, exif.missing) for exif in times} == {(4.0, 100.0, ())}
