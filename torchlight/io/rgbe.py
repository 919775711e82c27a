"""Radiance pictures (.hdr): three 8-bit mantissas and one shared exponent per pixel.

A mantissa m with exponent byte e stands for m 2^(e - 136); e = 0 is black. Radiance's own `colr_color` reads
(m + 1/2) 2^(e - 136) because its writer truncates; most other tools read m 2^(e - 136). This reader follows the
latter, so that a file means here what it means elsewhere, and the writer rounds to nearest instead of truncating,
which makes it unbiased for those readers: the error is at most 2^-8 of a pixel's largest channel.

Format: G. Ward, "Real Pixels", Graphics Gems II (1991), and the Radiance file format reference.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from numpy.typing import NDArray
from torch import Tensor

from torchlight.errors import FormatError
from torchlight.io.atomic import write_atomically
from torchlight.io.files import check_size, one_line, read_bytes
from torchlight.light.primaries import PRIMARIES, check_primaries, convert_primaries, named

_MAX_HEADER = 65_536
_RESOLUTION = re.compile(rb"([+-])([XY])\s+(\d{1,9})\s+([+-])([XY])\s+(\d{1,9})\s*")
_MIN_RLE_WIDTH, _MAX_RLE_WIDTH = 8, 32_767


def read_hdr(path: str | Path) -> Float[Tensor, "3 height width"]:
    """Returns linear RGB, float32, row 0 at the top.

    Values are divided by the header's EXPOSURE and COLORCORR, as the format asks. Colours of primaries that
    `light.primaries` knows are converted to Rec.709; all others, Radiance's own among them, are taken as Rec.709, as
    other programs do.

    Raises:
        FormatError: missing, not a Radiance RGBE picture, truncated or corrupt.
    """
    return decode_hdr(read_bytes(path), str(path))


def decode_hdr(data: bytes, name: str) -> Float[Tensor, "3 height width"]:
    """Returns the picture in `data`; `name` is what error messages call it. See `read_hdr`."""
    variables, axes, start = _header(data, name)
    (sign_outer, axis_outer, outer), (sign_inner, _, inner) = axes
    rgbe = _scanlines(data, start, outer, inner, name)
    if sign_outer == ("+" if axis_outer == "Y" else "-"):
        rgbe = rgbe[::-1]
    if sign_inner == ("-" if axis_outer == "Y" else "+"):
        rgbe = rgbe[:, ::-1]
    if axis_outer == "X":
        rgbe = rgbe.transpose(1, 0, 2)
    scale = np.ldexp(np.float32(1), np.arange(256) - 136).astype(np.float32)
    scale[0] = 0
    image = rgbe[..., :3].astype(np.float32) * scale[rgbe[..., 3:]]
    exposure = _exposure(variables, name)
    if exposure != (1.0, 1.0, 1.0):
        image /= np.asarray(exposure, dtype=np.float32)
    return _in_rec709(torch.from_numpy(np.ascontiguousarray(image.transpose(2, 0, 1))), variables)


def hdr_size(data: bytes, name: str) -> tuple[int, int]:
    """Returns width and height from the header alone."""
    _, ((_, axis, outer), (_, _, inner)), _ = _header(data, name)
    return (inner, outer) if axis == "Y" else (outer, inner)


def write_hdr(path: str | Path, image: Float[Tensor, "3 height width"], *, primaries: str = "rec709") -> None:
    """Writes linear RGB as a Radiance picture; negative values, which the format cannot hold, become 0.

    Args:
        path: destination.
        image: linear values, of Rec.709 primaries.
        primaries: one of `light.primaries.PRIMARIES`, which colours are converted to; other than Rec.709 are named in
            the header.

    Raises:
        ConfigError: unknown primaries.
        FormatError: NaN, infinite or too large values (2^127 and more), or the file cannot be written.
    """
    check_primaries(primaries)
    linear = image.detach().to(device="cpu", dtype=torch.float64)
    linear = convert_primaries(linear.flatten(start_dim=1), PRIMARIES["rec709"], PRIMARIES[primaries])
    values = linear.unflatten(-1, image.shape[1:]).clamp_min(0).numpy().transpose(1, 2, 0)
    if not np.isfinite(values).all() or values.max(initial=0.0) >= 2.0**127:
        raise FormatError(f"{path}: NaN, infinite or larger than 1.7e38: a .hdr file cannot hold such values")
    height, width = values.shape[:2]
    stated = "" if primaries == "rec709" else f"PRIMARIES= {' '.join(map(str, PRIMARIES[primaries]))}\n"
    header = f"#?RADIANCE\n# torchlight\n{stated}FORMAT=32-bit_rle_rgbe\n\n-Y {height} +X {width}\n"
    write_atomically(path, header.encode() + _pack(_mantissas(values)))


def _header(data: bytes, name: str) -> tuple[dict[str, list[str]], tuple[tuple[str, str, int], ...], int]:
    if not data.startswith(b"#?"):
        raise FormatError(f"{name}: not a Radiance .hdr picture: it does not begin with #?RADIANCE")
    end = data.find(b"\n\n", 0, _MAX_HEADER)
    stop = data.find(b"\n", end + 2, end + 2 + 256) if end >= 0 else -1
    if stop < 0:
        raise FormatError(f"{name}: the .hdr header does not end; the file is truncated or not a Radiance picture")
    variables: dict[str, list[str]] = {}
    for line in data[:end].decode("latin-1").splitlines()[1:]:
        key, equals, value = line.partition("=")
        if equals and not line.startswith("#"):
            variables.setdefault(key.strip(), []).append(value.strip())
    if variables.get("FORMAT", ["32-bit_rle_rgbe"])[-1] != "32-bit_rle_rgbe":
        raise FormatError(f"{name}: FORMAT={one_line(variables['FORMAT'][-1], 40)}; only 32-bit_rle_rgbe is read")
    match = _RESOLUTION.fullmatch(data[end + 2 : stop])
    if match is None or match[2] == match[5]:
        line = one_line(data[end + 2 : stop].decode("latin-1"), 40)
        raise FormatError(f"{name}: expected a resolution such as '-Y 512 +X 1024', got '{line}'")
    sign_1, axis_1, size_1, sign_2, axis_2, size_2 = (part.decode() for part in match.groups())
    axes = ((sign_1, axis_1, int(size_1)), (sign_2, axis_2, int(size_2)))
    check_size(axes[0][2], axes[1][2], len(data), name)
    return variables, axes, stop + 1


def _in_rec709(image: Float[Tensor, "3 height width"], variables: dict[str, list[str]]) -> Tensor:
    """Returns a picture in Rec.709, if its header names primaries that are known."""
    try:
        stored = [float(value) for value in variables.get("PRIMARIES", [""])[-1].split()]
        name = named(stored)
    except ValueError:
        name = None
    if name is None or name == "rec709":
        return image
    return convert_primaries(image.flatten(start_dim=1), PRIMARIES[name], PRIMARIES["rec709"]).unflatten(
        -1, image.shape[1:]
    )


def _exposure(variables: dict[str, list[str]], name: str) -> tuple[float, ...]:
    """Returns the product of all EXPOSURE and COLORCORR lines, per channel."""
    product = np.ones(3)
    try:
        for value in variables.get("EXPOSURE", []):
            product *= float(value)
        for value in variables.get("COLORCORR", []):
            product *= np.array([float(part) for part in value.split()]).reshape(3)
    except ValueError as error:
        raise FormatError(f"{name}: EXPOSURE or COLORCORR is not a number; write the file again") from error
    if not (np.isfinite(product).all() and (product > 0).all()):
        raise FormatError(f"{name}: EXPOSURE or COLORCORR is not positive; write the file again")
    return tuple(product.tolist())


def _scanlines(data: bytes, position: int, rows: int, width: int, name: str) -> NDArray[np.uint8]:
    lines = []
    try:
        for _ in range(rows):
            if _is_run_length_encoded(data, position, width):
                line, position = _read_components(data, position + 4, width)
            else:
                line, position = _read_pixels(data, position, width)
            lines.append(line)
    except IndexError as error:
        raise FormatError(f"{name}: truncated: scanline {len(lines)} of {rows} is incomplete; copy it again") from error
    except ValueError as error:
        raise FormatError(f"{name}: corrupt: scanline {len(lines)} of {rows}: {error}; copy it again") from error
    return np.stack(lines)


def _is_run_length_encoded(data: bytes, position: int, width: int) -> bool:
    if not _MIN_RLE_WIDTH <= width <= _MAX_RLE_WIDTH:
        return False
    if data[position] != 2 or data[position + 1] != 2 or data[position + 2] & 128:
        return False
    if (data[position + 2] << 8 | data[position + 3]) != width:
        raise ValueError("its length does not match the header")
    return True


def _read_components(data: bytes, position: int, width: int) -> tuple[NDArray[np.uint8], int]:
    """Returns one scanline of four run-length encoded components, and where it ends."""
    line = bytearray()
    for component in range(1, 5):
        end = component * width
        while len(line) < end:
            count = data[position]
            if count > 128:
                line += data[position + 1 : position + 2] * (count - 128)
                position += 2
            elif count:
                line += data[position + 1 : position + 1 + count]
                position += 1 + count
            else:
                raise ValueError("a run of length zero")
        if len(line) != end:
            raise ValueError("a run crosses the end of the line")
    return np.frombuffer(bytes(line), dtype=np.uint8).reshape(4, width).T, position


def _read_pixels(data: bytes, position: int, width: int) -> tuple[NDArray[np.uint8], int]:
    """Returns one scanline of whole pixels, in which (1, 1, 1, n) repeats the pixel before it."""
    end = position + 4 * width
    flat = np.frombuffer(data[position:end], dtype=np.uint8)
    if flat.size == 4 * width and not (flat.reshape(-1, 4)[:, :3] == 1).all(axis=1).any():
        return flat.reshape(-1, 4), end
    line = bytearray()
    shift = 0
    while len(line) < 4 * width:
        pixel = data[position : position + 4]
        if len(pixel) < 4:
            raise IndexError
        position += 4
        if pixel[:3] == b"\x01\x01\x01":
            if not line or shift > 16:
                raise ValueError("a repeat without a pixel before it")
            line += line[-4:] * (pixel[3] << shift)
            shift += 8
        else:
            line += pixel
            shift = 0
    if len(line) != 4 * width:
        raise ValueError("a run crosses the end of the line")
    return np.frombuffer(bytes(line), dtype=np.uint8).reshape(-1, 4), position


def _mantissas(values: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Returns R, G, B mantissas and the exponent byte, rounded to nearest."""
    peak = values.max(axis=-1, keepdims=True)
    _, exponent = np.frexp(peak)
    rounds_up = np.rint(np.ldexp(peak, 8 - exponent)) > 255
    exponent = exponent + rounds_up
    mantissa = np.rint(np.ldexp(values, 8 - exponent))
    holds = (peak > 0) & (exponent > -128)
    rgbe = np.concatenate([mantissa, exponent + 128.0], axis=-1)
    return np.where(holds, rgbe, 0).astype(np.uint8)


def _pack(rgbe: NDArray[np.uint8]) -> bytes:
    """Returns the scanlines, run-length framed without runs (photographs have none), plain where too short or long."""
    height, width = rgbe.shape[:2]
    if not _MIN_RLE_WIDTH <= width <= _MAX_RLE_WIDTH:
        return rgbe.tobytes()
    planes = rgbe.transpose(0, 2, 1)
    pieces = [np.broadcast_to(np.array([2, 2, width >> 8, width & 255], dtype=np.uint8), (height, 4))]
    for component in range(4):
        for start in range(0, width, 128):
            block = planes[:, component, start : start + 128]
            pieces += [np.full((height, 1), block.shape[1], dtype=np.uint8), block]
    return np.concatenate(pieces, axis=1).tobytes()
