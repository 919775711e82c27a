"""Files as cameras write them, made by hand: EXIF blocks and an uncompressed DNG."""

from __future__ import annotations

import struct

import numpy as np

_LETTERS = {1: "B", 3: "H", 4: "I", 5: "II", 10: "ii"}
Entry = tuple[int, int, tuple[int, ...]]


def directory(entries: list[Entry], start: int, order: str = "<") -> bytes:
    """Returns a TIFF directory that begins at byte `start`, its long values behind it."""
    head, tail = struct.pack(order + "H", len(entries)), b""
    where = start + 2 + 12 * len(entries) + 4
    for tag, kind, values in sorted(entries):
        packed = struct.pack(order + _LETTERS[kind] * (len(values) // len(_LETTERS[kind])), *values)
        count = len(values) // len(_LETTERS[kind])
        inline = packed.ljust(4, b"\0") if len(packed) <= 4 else struct.pack(order + "I", where + len(tail))
        tail += b"" if len(packed) <= 4 else packed
        head += struct.pack(order + "HHI", tag, kind, count) + inline
    return head + struct.pack(order + "I", 0) + tail


def exif_block(entries: list[Entry], orientation: int = 1, order: str = "<") -> bytes:
    """Returns an EXIF block: an orientation, and entries in the directory that it points to."""
    main: list[Entry] = [(0x0112, 3, (orientation,)), (0x8769, 4, (38,))]
    header = struct.pack(order + "2sHI", b"II" if order == "<" else b"MM", 42, 8)
    return header + directory(main, 8, order) + directory(entries, 38, order)


def exposure_entries(
    time: tuple[int, int], aperture: tuple[int, int] | None = None, iso: int | None = None
) -> list[Entry]:
    entries: list[Entry] = [(0x829A, 5, time)]
    if aperture is not None:
        entries.append((0x829D, 5, aperture))
    if iso is not None:
        entries.append((0x8827, 3, (iso,)))
    return entries


def jpeg_with(jpeg: bytes, block: bytes) -> bytes:
    """Returns the JPEG with an EXIF block as its first segment."""
    segment = b"Exif\0\0" + block
    return jpeg[:2] + b"\xff\xe1" + struct.pack(">H", len(segment) + 2) + segment + jpeg[2:]


def dng(mosaic: np.ndarray, black: int, white: int, orientation: int = 1) -> bytes:
    """Returns a DNG of an RGGB mosaic whose camera sees linear Rec.709 and is balanced at equal channels."""
    height, width = mosaic.shape
    # camera <- XYZ of Rec.709 primaries with D65 white: an image of (1, 1, 1) is white as it is
    to_camera = np.array(
        [[3.2404542, -1.5371385, -0.4985314], [-0.969266, 1.8760108, 0.041556], [0.0556434, -0.2040259, 1.0572252]]
    )
    matrix = tuple(int(v) for number in (to_camera * 10000).round().flatten() for v in (number, 10000))
    entries: list[Entry] = [
        (254, 4, (0,)),
        (256, 4, (width,)),
        (257, 4, (height,)),
        (258, 3, (16,)),
        (259, 3, (1,)),
        (262, 3, (32803,)),
        (273, 4, (0,)),
        (274, 3, (orientation,)),
        (277, 3, (1,)),
        (278, 4, (height,)),
        (279, 4, (2 * height * width,)),
        (284, 3, (1,)),
        (33421, 3, (2, 2)),
        (33422, 1, (0, 1, 1, 2)),
        (50706, 1, (1, 4, 0, 0)),
        (50707, 1, (1, 1, 0, 0)),
        (50714, 4, (black,)),
        (50717, 4, (white,)),
        (50721, 10, matrix),
        (50728, 5, (1, 1, 1, 1, 1, 1)),
        (50778, 3, (21,)),
        (33434, 5, (1, 50)),
        (50708, 1, (*b"Hand", 0)),
    ]
    size = len(directory(entries, 8))
    entries = [(tag, kind, (8 + size,) if tag == 273 else values) for tag, kind, values in entries]
    return struct.pack("<2sHI", b"II", 42, 8) + directory(entries, 8) + mosaic.astype("<u2").tobytes()
