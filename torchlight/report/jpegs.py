"""Photographs as small JPEGs; without Matplotlib, since it is done before there is light."""

from __future__ import annotations

import cv2
import numpy as np
import torch
from jaxtyping import Float, UInt8
from numpy.typing import NDArray
from torch import Tensor

from torchlight.preview import to_srgb8

PHOTO_PIXELS = 720  # the longer side of the photograph in a page
PHOTO_QUALITY = 82


def photograph(pixels: Float[Tensor, "3 height width"], linear: bool) -> bytes:
    """Returns a photograph as a small JPEG; linear values are encoded, floating ones with white at their 99.5 %.

    Args:
        pixels: as stored.
        linear: whether they are proportional to radiance.
    """
    height, width = pixels.shape[-2:]
    factor = min(1.0, PHOTO_PIXELS / max(height, width))
    size = (max(1, round(width * factor)), max(1, round(height * factor)))
    planes = [cv2.resize(plane, size, interpolation=cv2.INTER_AREA) for plane in pixels.cpu().numpy()]
    small = torch.from_numpy(np.stack(planes)).nan_to_num(0.0, 1.0, 0.0)
    if linear:
        white = float(np.quantile(small.numpy(), 0.995)) if float(small.max()) > 1 else 1.0
        stored = to_srgb8(small / max(white, 1e-12))
    else:
        stored = (small.clamp(0, 1) * 255).round().byte().permute(1, 2, 0).numpy()
    return jpeg(stored, PHOTO_QUALITY)


def jpeg(picture: UInt8[np.ndarray, "height width 3"], quality: int) -> bytes:
    """Returns an RGB picture as JPEG."""
    _, data = cv2.imencode(".jpg", np.ascontiguousarray(picture[..., ::-1]), [cv2.IMWRITE_JPEG_QUALITY, quality])
    return data.tobytes()


def size_of_jpeg(data: bytes) -> tuple[int, int]:
    """Returns width and height of a JPEG."""
    picture = unpacked(data)
    return picture.shape[1], picture.shape[0]


def unpacked(data: bytes) -> NDArray[np.uint8]:
    """Returns the RGB pixels of a JPEG."""
    picture = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_COLOR)
    if picture is None:
        raise ValueError("not a picture")
    return picture[..., ::-1].astype(np.uint8)
