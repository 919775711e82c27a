"""Pictures made from photographs, stored as the photograph was: its encoding and depth, or linear as EXR."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float
from numpy.typing import NDArray
from torch import Tensor

from torchlight.errors import ConfigError, FormatError
from torchlight.io.atomic import write_atomically
from torchlight.io.exr import write_exr
from torchlight.io.images import Photo, write_png
from torchlight.photo.radiometry import DEFAULT_GAMMA, Response, encode, inverse_response

PICTURES = (".png", ".jpg", ".jpeg", ".exr")
WITH_ALPHA = (".png", ".exr")
JPEG_QUALITY = 95


@dataclass(frozen=True, eq=False)
class Storage:
    """How linear values become stored ones.

    Attributes:
        encoding: "srgb", "linear", "gamma" or "response".
        bits: of a PNG: 8 or 16. A JPEG has 8.
        gamma: of "gamma".
        response: of "response".
    """

    encoding: str = "srgb"
    bits: int = 8
    gamma: float = DEFAULT_GAMMA
    response: Response | None = None

    def stored(self, linear: Float[Tensor, "3 height width"]) -> Float[Tensor, "3 height width"]:
        """Returns stored values in [0, 1]; what is brighter than white is clipped."""
        values = linear.clamp(0, 1)
        if self.encoding != "response":
            return encode(values, self.encoding, self.gamma)
        if self.response is None:
            raise ConfigError("photo.response: missing; name the file that `torchlight merge` wrote")
        return inverse_response(values, self.response)


@dataclass(frozen=True, eq=False)
class Untouched:
    """What need not be encoded again: a photograph's stored pixels, and where the new picture differs from it."""

    pixels: Float[Tensor, "3 height width"]
    changed: Bool[Tensor, "height width"]


def storage_of(photo: Photo, encoding: str | None, gamma: float, response: Float[Tensor, "3 codes"] | None) -> Storage:
    """Returns how a photograph was stored; float photographs, which are linear, become 8-bit sRGB outside an EXR."""
    if photo.bits is None or encoding in (None, "raw"):
        return Storage()
    return Storage(encoding, photo.bits, gamma, None if response is None else Response(response))


def write_picture(
    path: Path,
    linear: Float[Tensor, "channels height width"],
    storage: Storage,
    metadata: Mapping[str, Any],
    untouched: Untouched | None = None,
) -> float:
    """Writes a picture of 3 channels, or 4 with alpha, and returns the share of pixels that were clipped.

    A .exr gets the linear values as they are. In a .png colours are encoded and alpha is not.

    Args:
        path: .png, .jpg, .jpeg or .exr.
        linear: values; alpha in [0, 1].
        storage: of a .png or .jpg.
        metadata: of a .exr.
        untouched: pixels that are stored as they were.

    Raises:
        ConfigError: another suffix, or alpha in a JPEG.
        FormatError: the file cannot be written.
    """
    check_suffix(path, len(linear) == 4)
    if path.suffix.lower() == ".exr":
        write_exr(path, linear, metadata)
        return 0.0
    png = path.suffix.lower() == ".png"
    bits = storage.bits if png else 8
    codes = encoded(linear, storage, bits, untouched).permute(1, 2, 0).contiguous().numpy()
    write = write_png if png else write_jpeg
    write(path, codes.astype(np.uint16 if bits == 16 else np.uint8))
    return (linear[:3] > 1).any(dim=0).double().mean().item()


def encoded(
    linear: Float[Tensor, "channels height width"], storage: Storage, bits: int, untouched: Untouched | None
) -> Float[Tensor, "channels height width"]:
    """Returns integer codes of so many bits, as floats."""
    top = 2**bits - 1
    stored = storage.stored(linear[:3].double())
    if untouched is not None:
        stored = torch.where(untouched.changed, stored, untouched.pixels.double())
    return (torch.cat([stored, linear[3:].double().clamp(0, 1)]) * top).round()


def check_suffix(path: Path, alpha: bool = False) -> None:
    """Raises ConfigError unless a picture of that name can be written."""
    known = WITH_ALPHA if alpha else PICTURES
    if path.suffix.lower() not in known:
        why = ", which hold alpha" if alpha else ""
        raise ConfigError(f"{path}: expected a name that ends in {', '.join(known[:-1])} or {known[-1]}{why}")


def write_jpeg(path: Path, codes: NDArray[Any]) -> None:
    """Writes 8-bit RGB codes of shape (height, width, 3); raises FormatError where that cannot be done."""
    image = cv2.cvtColor(codes, cv2.COLOR_RGB2BGR)
    done, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    if not done:
        raise FormatError(f"{path}: the picture could not be encoded as JPEG; use .png")
    write_atomically(path, data.tobytes())
