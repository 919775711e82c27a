"""Photographs and masks as tensors, and pictures as PNG files."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float
from numpy.typing import NDArray
from torch import Tensor

from torchlight.errors import FormatError
from torchlight.io.atomic import write_atomically
from torchlight.io.camera_files import heif_size, is_heif, is_raw, raw_size, read_heif, read_raw
from torchlight.io.containers import inspect
from torchlight.io.exif import Exif, read_exif, turned_size, upright
from torchlight.io.exr import read_exr
from torchlight.io.exr_container import MAGIC as EXR_MAGIC
from torchlight.io.exr_container import exr_header
from torchlight.io.files import read_bytes, reason, sha256_of
from torchlight.io.rgbe import decode_hdr, hdr_size

_HDR_MAGIC = b"#?"
_BITS = {np.dtype(np.uint8): 8, np.dtype(np.uint16): 16}


@dataclass(frozen=True, eq=False)
class Photo:
    """A photograph as stored: no transfer curve removed; upright, as its EXIF orientation asks.

    Attributes:
        pixels: RGB, row 0 at the top, float32; integer files divided by their top code, EXR and HDR as they are, RAW
            in shares of the white level and infinite where saturated.
        bits: 8 or 16 for integer files, None for EXR, HDR and RAW.
        sha256: of the file.
        is_linear: whether values are known to be proportional to radiance (EXR, HDR and RAW).
        exif: exposure and how the camera was held, as the file says.
    """

    pixels: Float[Tensor, "3 height width"]
    bits: int | None
    sha256: str
    is_linear: bool
    exif: Exif = field(default_factory=Exif)


def read_photo(path: str | Path) -> Photo:
    """Returns the photograph in a PNG, JPEG, TIFF, BMP, EXR, HDR or HEIC file, told apart by content, or in a RAW file.

    Grey is repeated over the channels and alpha is dropped. An EXIF orientation is applied, once: the picture is as
    every viewer shows it, and so are a camera's intrinsics and masks. RAW and HEIC need the extra `raw`.

    Raises:
        FormatError: missing, a folder, empty, truncated, corrupt, not an image, CMYK, more than 400 megapixels, or the
            extra `raw` is needed and absent.
    """
    try:
        return _read_photo(path)
    except MemoryError as error:
        raise FormatError(f"{path}: so many pixels do not fit in the memory that is free; use a smaller one") from error


def _read_photo(path: str | Path) -> Photo:
    data = read_bytes(path)
    digest = sha256_of(data)
    if data.startswith(EXR_MAGIC):
        image, _ = read_exr(path)
        return Photo(image.expand(3, -1, -1).contiguous(), None, digest, True)
    if data.startswith(_HDR_MAGIC):
        return Photo(decode_hdr(data, str(path)), None, digest, True)
    if is_raw(path):
        raw = read_raw(data, str(path))
        return Photo(_channels_first(raw.pixels), None, digest, True, raw.exif)
    if is_heif(data):
        heif = read_heif(data, str(path))
        stored, exif = heif.pixels, heif.exif
    else:
        exif = read_exif(data)
        stored = _decode(data, str(path), exif.orientation)
    bits = _BITS[stored.dtype]
    return Photo(_channels_first(stored.astype(np.float32) / np.float32(2**bits - 1)), bits, digest, False, exif)


def read_mask(path: str | Path) -> Bool[Tensor, "height width"]:
    """Returns True where any channel is not zero: pixels that may be used. Raises FormatError as `read_photo`."""
    return (read_photo(path).pixels.abs() > 0).any(dim=0)


def image_size(path: str | Path) -> tuple[int, int]:
    """Returns width and height of what `read_photo` returns, without decoding it, and raises as it does."""
    data = read_bytes(path)
    if data.startswith(EXR_MAGIC):
        header = exr_header(data, str(path))
        return header.width, header.height
    if data.startswith(_HDR_MAGIC):
        return hdr_size(data, str(path))
    if is_raw(path):
        return raw_size(data, str(path))
    if is_heif(data):
        return heif_size(data, str(path))
    container = inspect(data, str(path))
    return turned_size(container.width, container.height, read_exif(data).orientation)


def write_png(path: str | Path, image: NDArray[Any]) -> None:
    """Writes uint8 or uint16 pixels of shape (height, width), (height, width, 3) RGB or (height, width, 4) RGBA.

    Raises:
        FormatError: another dtype or shape, or the file cannot be written.
    """
    channels = image.shape[2] if image.ndim == 3 else 1
    if image.dtype not in _BITS or image.ndim not in (2, 3) or channels not in (1, 3, 4) or image.size == 0:
        raise FormatError(f"{path}: expected uint8 or uint16 grey, RGB or RGBA, got {image.dtype} {image.shape}")
    order = {1: None, 3: cv2.COLOR_RGB2BGR, 4: cv2.COLOR_RGBA2BGRA}[channels]
    encoded, data = cv2.imencode(".png", image if order is None else cv2.cvtColor(image, order))
    if not encoded:
        raise FormatError(f"{path}: the picture could not be encoded as PNG; got shape {image.shape}")
    write_atomically(path, data.tobytes())


def _channels_first(pixels: NDArray[Any]) -> Float[Tensor, "3 height width"]:
    return torch.from_numpy(np.ascontiguousarray(pixels.transpose(2, 0, 1)))


def _decode(data: bytes, name: str, orientation: int) -> NDArray[Any]:
    """Returns uint8 or uint16 RGB pixels of shape (height, width, 3), upright."""
    container = inspect(data, name)
    try:
        # IMREAD_UNCHANGED keeps the bit depth, and the pixels as stored: except that OpenCV always turns TIFF
        image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise FormatError(f"{name}: the {container.kind} cannot be decoded: {reason(error)}; save it again") from error
    if image is None:
        raise FormatError(f"{name}: the {container.kind} cannot be decoded: it is corrupt; save it again")
    if image.dtype not in _BITS:
        raise FormatError(f"{name}: {container.kind} of {image.dtype} values; save linear float values as EXR")
    if container.kind != "TIFF":
        image = upright(image, orientation)
    if image.shape[1::-1] != turned_size(container.width, container.height, orientation):
        raise FormatError(f"{name}: decoded to {image.shape[1]} x {image.shape[0]} pixels, not as its header says")
    return _to_rgb(image)


def _to_rgb(image: NDArray[Any]) -> NDArray[Any]:
    channels = 1 if image.ndim == 2 else image.shape[2]
    if channels < 3:
        grey = image.reshape(*image.shape[:2], channels)[..., :1]
        return np.repeat(grey, 3, axis=2)
    return np.ascontiguousarray(image[..., 2::-1])
