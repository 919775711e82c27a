"""The structure of PNG, JPEG, TIFF and BMP files: is the file whole, and how large is the picture.

OpenCV may return a damaged file half decoded, and allocates what the header asks for; this walk comes first.
Damage inside a JPEG's entropy-coded data cannot be told from a picture without decoding it and is not found here.
"""

from __future__ import annotations

import re
import struct
import zlib
from dataclasses import dataclass

from torchlight.errors import FormatError
from torchlight.io.files import check_size

_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_JPEG_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_JPEG_NEXT_MARKER = re.compile(rb"\xff+([^\x00\xff\xd0-\xd7])")
_INKS = 4
_TIFF_WIDTH, _TIFF_HEIGHT = 256, 257
_TIFF_COLOURS, _TIFF_SEPARATED = 262, 5
_TIFF_OFFSETS_AND_COUNTS = ((273, 279), (324, 325))
_TIFF_SIZES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8}


@dataclass(frozen=True)
class Container:
    """The kind of an image file and the size of its picture in pixels."""

    kind: str
    width: int
    height: int


def inspect(data: bytes, name: str) -> Container:
    """Returns kind and size of a whole PNG, JPEG, TIFF or BMP file.

    Raises:
        FormatError: none of these, truncated, corrupt, CMYK, or more than 400 megapixels.
    """
    found = [entry for entry in _KINDS if data.startswith(entry[0])]
    if not found:
        raise FormatError(
            f"{name}: its content is not PNG, JPEG, TIFF, BMP, EXR or HDR, nor HEIC or RAW; convert it to one of these"
        )
    _, kind, walk = found[0]
    try:
        width, height = walk(data)
    except _PrintColoursError as error:
        raise FormatError(f"{name}: a {kind} of CMYK inks, not of light; save the original as RGB") from error
    except (struct.error, IndexError, KeyError, ValueError, OverflowError) as error:
        detail = str(error) if isinstance(error, _DamagedError) else "it ends early or its structure is broken"
        raise FormatError(f"{name}: truncated or corrupt {kind}: {detail}; copy or save it again") from error
    check_size(width, height, len(data), name)
    return Container(kind, width, height)


class _DamagedError(ValueError):
    """A reason that is fit to be shown."""


class _PrintColoursError(Exception):
    """Four inks instead of three lights: how much light they stand for is not in the file."""


def _walk_png(data: bytes) -> tuple[int, int]:
    """Follows the chunks, each with its checksum, to IEND (PNG specification, section 5)."""
    size = None
    pixels = False
    position = len(_PNG_SIGNATURE)
    while True:
        length, kind = struct.unpack_from(">I4s", data, position)
        end = position + 8 + length
        (checksum,) = struct.unpack_from(">I", data, end)
        if zlib.crc32(memoryview(data)[position + 4 : end]) != checksum:
            raise _DamagedError(f"wrong checksum at byte {position}")
        if size is None:
            if kind != b"IHDR":
                raise _DamagedError("it does not begin with IHDR")
            size = struct.unpack_from(">II", data, position + 8)
        pixels = pixels or kind == b"IDAT"
        if kind == b"IEND":
            break
        position = end + 4
    if not pixels:
        raise _DamagedError("it holds no pixels")
    return size


def _walk_jpeg(data: bytes) -> tuple[int, int]:
    """Follows the segments through every scan to the end-of-image marker (ITU T.81, annex B)."""
    size = None
    scans = 0
    position = 2
    while True:
        match = _JPEG_NEXT_MARKER.search(data, position)
        if match is None:
            raise _DamagedError("no end-of-image marker")
        if match.start() != position and not scans:
            raise _DamagedError(f"no marker at byte {position}")
        marker = match[1][0]
        position = match.end()
        if marker == 0xD9:
            break
        (length,) = struct.unpack_from(">H", data, position)
        if marker in _JPEG_FRAMES:
            height, width = struct.unpack_from(">HH", data, position + 3)
            size = width, height
            if data[position + 7] == _INKS:
                raise _PrintColoursError
        scans += marker == 0xDA
        position += length
    if size is None or not scans:
        raise _DamagedError("it holds no picture")
    return size


def _walk_tiff(data: bytes) -> tuple[int, int]:
    """Reads the first directory and checks that every strip or tile lies within the file (TIFF 6.0, section 2)."""
    order = "<" if data[:2] == b"II" else ">"
    (position,) = struct.unpack_from(order + "I", data, 4)
    (entries,) = struct.unpack_from(order + "H", data, position)
    tags = {}
    for index in range(entries):
        tag, kind, count = struct.unpack_from(order + "HHI", data, position + 2 + 12 * index)
        tags[tag] = kind, count, _tiff_position(data, order, kind, count, position + 10 + 12 * index)
    struct.unpack_from(order + "I", data, position + 2 + 12 * entries)
    for offsets, counts in _TIFF_OFFSETS_AND_COUNTS:
        if offsets not in tags:
            continue
        pieces = zip(_tiff_values(data, order, tags[offsets]), _tiff_values(data, order, tags[counts]), strict=True)
        if any(offset + count > len(data) for offset, count in pieces):
            raise _DamagedError("pixels reach past the end of the file")
        if _TIFF_COLOURS in tags and _tiff_values(data, order, tags[_TIFF_COLOURS])[0] == _TIFF_SEPARATED:
            raise _PrintColoursError
        return _tiff_values(data, order, tags[_TIFF_WIDTH])[0], _tiff_values(data, order, tags[_TIFF_HEIGHT])[0]
    raise _DamagedError("it holds no pixels")


def _tiff_position(data: bytes, order: str, kind: int, count: int, position: int) -> int:
    """Returns where an entry's values lie: in the entry itself if they fit its four bytes, else elsewhere."""
    size = _TIFF_SIZES.get(kind, 1) * count
    if size > 4:
        (position,) = struct.unpack_from(order + "I", data, position)
    if position + size > len(data):
        raise _DamagedError("a table reaches past the end of the file")
    return position


def _tiff_values(data: bytes, order: str, entry: tuple[int, int, int]) -> tuple[int, ...]:
    kind, count, position = entry
    letter = {1: "B", 3: "H", 4: "I"}[kind]
    return struct.unpack_from(f"{order}{count}{letter}", data, position)


def _walk_bmp(data: bytes) -> tuple[int, int]:
    """Reads the headers and, for uncompressed pixels, checks that all rows are there."""
    (start,) = struct.unpack_from("<I", data, 10)
    header, width, height = struct.unpack_from("<Iii", data, 14)
    if header < 40:
        raise _DamagedError("an unsupported header")
    bits, compression = struct.unpack_from("<HI", data, 28)
    row = (width * bits + 31) // 32 * 4
    if compression in (0, 3) and start + row * abs(height) > len(data):
        raise _DamagedError("rows are missing")
    return width, abs(height)


_KINDS = (
    (_PNG_SIGNATURE, "PNG", _walk_png),
    (b"\xff\xd8\xff", "JPEG", _walk_jpeg),
    (b"II*\0", "TIFF", _walk_tiff),
    (b"MM\0*", "TIFF", _walk_tiff),
    (b"BM", "BMP", _walk_bmp),
)
