"""Camera RAW (DNG, CR2, CR3, NEF, ARW, ...) through rawpy and HEIC through pillow-heif: the extra `raw`."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from io import BytesIO
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from torchlight.errors import FormatError
from torchlight.io.exif import Exif, parse_exif, read_exif
from torchlight.io.files import MAX_PIXELS, reason

RAW_SUFFIXES = frozenset(
    (".dng", ".cr2", ".cr3", ".nef", ".nrw", ".arw", ".raf", ".orf", ".rw2", ".pef", ".srw", ".3fr", ".iiq")
)
_HEIF_BRANDS = (b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"mif1", b"msf1")
_DEMOSAIC_REACH = 2  # pixels: demosaicing interpolates within a 5 x 5 window
_QUARTER_TURNS = {0: 0, 3: 2, 5: 1, 6: 3}  # LibRaw's flip, counter-clockwise


@dataclass(frozen=True, eq=False)
class Developed:
    """Pixels of shape (height, width, 3), upright, and what the camera wrote beside them."""

    pixels: NDArray[Any]
    exif: Exif


def is_raw(path: str | Path) -> bool:
    """Returns whether a name is that of a camera's RAW file; by content many of them are ordinary TIFF."""
    return Path(path).suffix.lower() in RAW_SUFFIXES


def is_heif(data: bytes) -> bool:
    """Returns whether the content is HEIF: an ISO media file of one of its brands (ISO 23008-12)."""
    return data[4:8] == b"ftyp" and data[8:12] in _HEIF_BRANDS


def read_raw(data: bytes, name: str) -> Developed:
    """Returns float32 values in linear Rec.709, 1 = white level, infinite within reach of a saturated photosite.

    The camera's black level is subtracted and the colours are scaled by LibRaw's daylight balance of the camera
    model, whatever the photograph shows: photographs of one camera keep their ratios. No brightening, no curve.

    Raises:
        FormatError: rawpy is absent, or LibRaw cannot read the file.
    """
    rawpy = _extra("rawpy", name)
    try:
        with rawpy.imread(BytesIO(data)) as raw:
            _check_size(raw.sizes.width, raw.sizes.height, name)
            values = raw.postprocess(
                output_bps=16,
                gamma=(1, 1),
                no_auto_bright=True,
                adjust_maximum_thr=0.0,  # LibRaw otherwise moves the white level towards the brightest pixel
                use_camera_wb=False,
                use_auto_wb=False,
                output_color=rawpy.ColorSpace.sRGB,
                highlight_mode=rawpy.HighlightMode.Clip,
            )
            full = (raw.raw_image_visible >= raw.white_level).astype(np.uint8)
            full = full if full.ndim == 2 else full.max(axis=2)
            flip = _QUARTER_TURNS.get(raw.sizes.flip, 0)
    except (rawpy.LibRawError, ValueError) as error:
        raise FormatError(f"{name}: LibRaw cannot read it: {reason(error)}; convert it to DNG") from error
    window = np.ones((2 * _DEMOSAIC_REACH + 1,) * 2, dtype=np.uint8)
    saturated = np.rot90(cv2.dilate(full, window), flip) > 0
    pixels = values.astype(np.float32) / np.float32(65535)
    if saturated.shape != pixels.shape[:2]:
        raise FormatError(f"{name}: its pixels are not square; convert it to 16-bit TIFF")
    pixels[saturated] = np.inf
    return Developed(pixels, read_exif(data))


def read_heif(data: bytes, name: str) -> Developed:
    """Returns uint8 or uint16 RGB pixels; the file's own turns are applied, so its EXIF orientation no longer counts.

    Raises:
        FormatError: pillow-heif is absent, or the file is damaged.
    """
    image = _opened_heif(data, name)
    try:
        pixels = np.asarray(image)
    except (ValueError, RuntimeError, EOFError, OSError) as error:
        raise FormatError(f"{name}: truncated or corrupt HEIC: {reason(error)}; copy it again") from error
    block = image.info.get("exif") or b""
    exif = parse_exif(block.removeprefix(b"Exif\0\0"))
    colours = pixels[..., None] if pixels.ndim == 2 else pixels
    colours = colours[..., :3] if colours.shape[2] >= 3 else np.repeat(colours[..., :1], 3, axis=2)
    return Developed(np.ascontiguousarray(colours), exif)


def heif_size(data: bytes, name: str) -> tuple[int, int]:
    """Returns width and height of a HEIC file."""
    return _opened_heif(data, name).size


def raw_size(data: bytes, name: str) -> tuple[int, int]:
    """Returns width and height of the developed RAW file."""
    rawpy = _extra("rawpy", name)
    try:
        with rawpy.imread(BytesIO(data)) as raw:
            size = raw.sizes.width, raw.sizes.height
            return size[::-1] if raw.sizes.flip in (5, 6) else size
    except (rawpy.LibRawError, ValueError) as error:
        raise FormatError(f"{name}: LibRaw cannot read it: {reason(error)}; convert it to DNG") from error


def _opened_heif(data: bytes, name: str) -> Any:
    heif = _extra("pillow_heif", name)
    try:
        image = heif.open_heif(data, convert_hdr_to_8bit=False)
    except (ValueError, RuntimeError, EOFError, OSError) as error:
        raise FormatError(f"{name}: truncated or corrupt HEIC: {reason(error)}; copy it again") from error
    _check_size(image.size[0], image.size[1], name)
    return image


def _check_size(width: int, height: int, name: str) -> None:
    if width * height > MAX_PIXELS:
        raise FormatError(f"{name}: {width} x {height} pixels; expected 1 to {MAX_PIXELS:,} pixels")


def _extra(module: str, name: str) -> Any:
    try:
        return import_module(module)
    except ImportError as error:
        package = module.replace("_", "-")
        raise FormatError(f"{name}: needs {package}, which is not installed: pip install 'torchlight[raw]'") from error
