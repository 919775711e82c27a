"""The structure of an OpenEXR file: header and chunk table, checked before the pixels are decoded.

The decoder reports a truncated file on the standard streams, many lines at a time, and allocates what the header
asks for; this walk finds both problems first. Layout: "OpenEXR File Layout", openexr.com.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass

from torchlight.errors import FormatError
from torchlight.io.files import check_size

MAGIC = b"\x76\x2f\x31\x01"
_UNSUPPORTED = {0x800: "a deep image", 0x1000: "a multi-part file"}
_TILED = 0x200
_LINES_PER_CHUNK = {0: 1, 1: 1, 2: 1, 3: 16, 4: 32, 5: 16, 6: 32, 7: 32, 8: 32, 9: 256}
_ZLIB_COMPRESSIONS = (2, 3)
_BYTES_PER_VALUE = (4, 2, 4)


@dataclass(frozen=True)
class ExrHeader:
    """What the header says about the picture's frame and how it is stored.

    Attributes:
        width: of the picture, in pixels.
        height: of the picture, in pixels.
        compression: OpenEXR's number for the method.
        tiled: whether pixels are stored as tiles rather than scanlines.
        pixel_bytes: all channels of one pixel, uncompressed; 0 if some channels are subsampled.
        end: where the header ends in the file.
    """

    width: int
    height: int
    compression: int
    tiled: bool
    pixel_bytes: int
    end: int


def check_exr(data: bytes, name: str) -> ExrHeader:
    """Returns the header of a single-part, flat file whose chunks are all present.

    Raises:
        FormatError: not an OpenEXR file, truncated, corrupt, deep, multi-part, cropped or too large.
    """
    header = exr_header(data, name)
    if not header.tiled and header.compression in _LINES_PER_CHUNK:
        _check_chunks(data, header, name)
    return header


def exr_header(data: bytes, name: str) -> ExrHeader:
    """Returns the header; raises FormatError as `check_exr` does, without looking at the chunks."""
    if not data.startswith(MAGIC):
        raise FormatError(f"{name}: not an OpenEXR file: its first bytes are not those of one")
    try:
        (version,) = struct.unpack_from("<I", data, 4)
        for flag, kind in _UNSUPPORTED.items():
            if version & flag:
                raise FormatError(f"{name}: {kind} is not supported; save one flat RGB layer as a single-part EXR")
        attributes, end = _attributes(data, 8)
        window = struct.unpack("<4i", attributes["dataWindow"])
        display = struct.unpack("<4i", attributes["displayWindow"])
        compression = attributes["compression"][0]
        pixel_bytes, channels = _pixel_bytes(attributes["channels"])
    except (struct.error, ValueError, KeyError, IndexError) as error:
        raise FormatError(f"{name}: the OpenEXR header is truncated or corrupt; copy or save it again") from error
    if window != display:
        raise FormatError(f"{name}: data window {window} differs from display window {display}; save it uncropped")
    width, height = window[2] - window[0] + 1, window[3] - window[1] + 1
    check_size(width, height, len(data), name, channels)
    return ExrHeader(width, height, compression, bool(version & _TILED), pixel_bytes, end)


def _attributes(data: bytes, position: int) -> tuple[dict[str, bytes], int]:
    """Returns every attribute's raw value and where the header ends."""
    found: dict[str, bytes] = {}
    while data[position] != 0:
        name_end = data.index(b"\0", position)
        type_end = data.index(b"\0", name_end + 1)
        (size,) = struct.unpack_from("<i", data, type_end + 1)
        start = type_end + 5
        if size < 0 or start + size > len(data):
            raise ValueError("an attribute reaches past the end")
        found[data[position:name_end].decode("latin-1")] = data[start : start + size]
        position = start + size
    return found, position + 1


def _pixel_bytes(channels: bytes) -> tuple[int, int]:
    """Returns the size of one pixel from the channel list, 0 if a channel is subsampled; and how many channels."""
    total, count, whole = 0, 0, True
    position = 0
    while channels[position] != 0:
        position = channels.index(b"\0", position) + 1
        kind, _, x_sampling, y_sampling = struct.unpack_from("<4i", channels, position)
        whole = whole and (x_sampling, y_sampling) == (1, 1)
        total, count = total + _BYTES_PER_VALUE[kind], count + 1
        position += 16
    return (total if whole else 0), count


def _check_chunks(data: bytes, header: ExrHeader, name: str) -> None:
    """Follows the offset table to every chunk of scanlines; zlib chunks carry a checksum, which is verified."""
    lines = _LINES_PER_CHUNK[header.compression]
    count = -(-header.height // lines)
    has_checksum = header.compression in _ZLIB_COMPRESSIONS and header.pixel_bytes > 0
    try:
        offsets = struct.unpack_from(f"<{count}Q", data, header.end)
        for index, offset in enumerate(offsets):
            _, size = struct.unpack_from("<ii", data, offset)
            if offset < header.end or size < 0 or offset + 8 + size > len(data):
                raise ValueError("a chunk reaches past the end")
            # a chunk that would not shrink is stored as it is, without a checksum
            plain = min(lines, header.height - index * lines) * header.width * header.pixel_bytes
            if has_checksum and size < plain:
                _check_zlib(data[offset + 8 : offset + 8 + size], plain)
    except (struct.error, ValueError, OverflowError) as error:
        raise FormatError(f"{name}: the OpenEXR file is truncated; copy or save it again") from error
    except zlib.error as error:
        raise FormatError(f"{name}: the OpenEXR file is corrupt: {error}; copy or save it again") from error


def _check_zlib(chunk: bytes, plain: int) -> None:
    """Raises zlib.error on a damaged or unfinished stream, or one of another length, in bounded memory."""
    inflate, length = zlib.decompressobj(), 0
    while not inflate.eof and length <= plain:
        piece = inflate.decompress(chunk, 1 << 24)
        chunk, length = inflate.unconsumed_tail, length + len(piece)
        if not piece and not chunk and not inflate.eof:
            raise zlib.error("a chunk is incomplete")
    if length != plain:
        raise zlib.error("a chunk is of another length than its lines")
