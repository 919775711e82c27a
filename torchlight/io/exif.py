"""What a camera writes beside its pixels: how the photograph was held, and how long it was exposed (EXIF 2.32)."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

UPRIGHT = 1
_ORIENTATION, _DIRECTORY = 0x0112, 0x8769
_TIME, _APERTURE, _ISO, _FOCAL_LENGTH, _FOCAL_LENGTH_35MM = 0x829A, 0x829D, 0x8827, 0x920A, 0xA405
_LETTERS = {1: "B", 3: "H", 4: "I", 5: "II", 9: "i", 10: "ii"}
_TIFF_ORDERS = {b"II": "<", b"MM": ">"}
_JPEG_SCAN = 0xDA


@dataclass(frozen=True)
class Exif:
    """The entries that matter to radiometry; None where the file does not hold them.

    Attributes:
        orientation: 1 to 8; which turn or mirroring shows the picture upright.
        time: exposure time in seconds.
        aperture: f-number N.
        iso: sensitivity.
        focal_length: in mm.
        focal_length_35mm: of a 35 mm film camera with the same diagonal angle of view, in mm.
    """

    orientation: int = UPRIGHT
    time: float | None = None
    aperture: float | None = None
    iso: float | None = None
    focal_length: float | None = None
    focal_length_35mm: float | None = None

    @property
    def exposure(self) -> float | None:
        """Exposure time x ISO / 100 / N^2, in seconds: what a pixel's value is proportional to beside radiance.

        Aperture or ISO that the file does not hold count as constant (1 and 100); None without a time.
        """
        if self.time is None:
            return None
        return self.time * (self.iso or 100) / 100 / (self.aperture or 1) ** 2

    @property
    def missing(self) -> tuple[str, ...]:
        """Which of exposure time, aperture and ISO the file does not hold."""
        named = {"exposure time": self.time, "aperture": self.aperture, "ISO": self.iso}
        return tuple(name for name, value in named.items() if value is None)


def read_exif(data: bytes) -> Exif:
    """Returns the EXIF entries of a JPEG, PNG, TIFF or TIFF-like (DNG, NEF, CR2, ARW) file.

    A file without them, or with damaged ones, has none: they are never worth refusing a picture for.
    """
    block = _exif_block(data)
    return Exif() if block is None else parse_exif(block)


def parse_exif(block: bytes) -> Exif:
    """Returns the entries of an EXIF block, which is a small TIFF file; none where it is damaged."""
    try:
        order = _TIFF_ORDERS[block[:2]]
        main = _directory(block, order, struct.unpack_from(order + "I", block, 4)[0])
        detail = _directory(block, order, int(main[_DIRECTORY])) if _DIRECTORY in main else {}
    except (KeyError, ValueError, struct.error):
        return Exif()
    tags = {**main, **detail}
    turn = main.get(_ORIENTATION, UPRIGHT)
    return Exif(
        int(turn) if turn in range(1, 9) else UPRIGHT,
        _positive(tags.get(_TIME)),
        _positive(tags.get(_APERTURE)),
        _positive(tags.get(_ISO)),
        _positive(tags.get(_FOCAL_LENGTH)),
        _positive(tags.get(_FOCAL_LENGTH_35MM)),
    )


def upright(pixels: NDArray, orientation: int) -> NDArray:
    """Returns pixels of shape (height, width, ...) turned and mirrored as an EXIF orientation asks (EXIF 4.6.4)."""
    mirrored = pixels[:, ::-1] if orientation in (2, 4, 5, 7) else pixels
    turns = {3: 2, 4: 2, 5: 1, 6: 3, 7: 3, 8: 1}.get(orientation, 0)
    return np.ascontiguousarray(np.rot90(mirrored, turns))


def turned_size(width: int, height: int, orientation: int) -> tuple[int, int]:
    """Returns width and height after `upright`."""
    return (height, width) if orientation >= 5 else (width, height)


def _positive(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) and value > 0 else None


def _exif_block(data: bytes) -> bytes | None:
    if data[:2] in _TIFF_ORDERS:
        return data
    if data.startswith(b"\xff\xd8"):
        return _jpeg_block(data)
    if data.startswith(b"\x89PNG"):
        return _png_block(data)
    return None


def _jpeg_block(data: bytes) -> bytes | None:
    """Follows the segments before the first scan to the APP1 segment that begins with "Exif"."""
    position = 2
    while position + 4 <= len(data) and data[position] == 0xFF and data[position + 1] != _JPEG_SCAN:
        (length,) = struct.unpack_from(">H", data, position + 2)
        body = data[position + 4 : position + 2 + length]
        if data[position + 1] == 0xE1 and body.startswith(b"Exif\0\0"):
            return body[6:]
        position += 2 + max(length, 2)
    return None


def _png_block(data: bytes) -> bytes | None:
    position = 8
    while position + 8 <= len(data):
        length, kind = struct.unpack_from(">I4s", data, position)
        if kind == b"eXIf":
            return data[position + 8 : position + 8 + length]
        position += 12 + length
    return None


def _directory(block: bytes, order: str, position: int) -> dict[int, float]:
    """Returns the first number of every numeric entry of a TIFF directory; fractions as their quotient."""
    (count,) = struct.unpack_from(order + "H", block, position)
    tags = {}
    for index in range(count):
        place = position + 2 + 12 * index
        tag, kind, values = struct.unpack_from(order + "HHI", block, place)
        letters = _LETTERS.get(kind)
        if letters is None or values < 1:
            continue
        size = struct.calcsize(order + letters)
        where = place + 8 if size * values <= 4 else struct.unpack_from(order + "I", block, place + 8)[0]
        numbers = struct.unpack_from(order + letters, block, where)
        tags[tag] = float(numbers[0]) if len(numbers) == 1 else numbers[0] / numbers[1] if numbers[1] else math.nan
    return tags
