"""The light as an 8-bit picture; without Matplotlib, whose import takes a quarter of a second."""

from __future__ import annotations

from dataclasses import dataclass
from io import BytesIO

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray
from torch import Tensor

from torchlight.light.environment import EnvironmentMap, flux, luminance
from torchlight.photo.radiometry import encode

PREVIEW_PERCENTILE = 98.0
PREVIEW_LEVEL = 0.8  # linear value given to that percentile of the pixels that hold light


@dataclass(frozen=True, eq=False)
class Preview:
    """A tone-mapped light, and what the tone map lost.

    Attributes:
        pixels: 8-bit sRGB lat-long picture.
        scale: the factor from radiance to linear picture values.
        clipped_flux: share of the luminance flux on the plane above white.
    """

    pixels: NDArray[np.uint8]
    scale: float
    clipped_flux: float

    @property
    def png(self) -> bytes:
        """The picture as PNG bytes."""
        return encode_png(self.pixels)


def preview(environment: EnvironmentMap) -> Preview:
    """Returns a tone-mapped picture of a map: one exposure for all, clipped to [0, 1], encoded as sRGB."""
    radiance = environment.radiance.detach().double().cpu()
    brightness = luminance(radiance.flatten(start_dim=1)).clamp(min=0)
    lit = brightness[brightness > 0]
    level = float(np.percentile(lit.numpy(), PREVIEW_PERCENTILE)) if len(lit) else 1.0
    scale = PREVIEW_LEVEL / level
    flows = flux(EnvironmentMap(radiance.clamp(min=0)))
    lost = flows * (1 - (1 / (radiance * scale).clamp(min=1e-12)).clamp(max=1))
    total = luminance(flows.flatten(start_dim=1)).sum().item()
    share = luminance(lost.flatten(start_dim=1)).sum().item() / total if total > 0 else 0.0
    return Preview(to_srgb8(radiance * scale), scale, share)


def to_srgb8(linear: Float[Tensor, "3 height width"]) -> np.ndarray:
    """Returns linear values as 8-bit sRGB, [height, width, 3]; clipped to [0, 1]."""
    encoded = encode(linear.clamp(0, 1), "srgb")
    return (encoded * 255).round().byte().permute(1, 2, 0).contiguous().numpy(force=True)


def encode_png(image: np.ndarray) -> bytes:
    """Returns an 8-bit picture, [height, width, 3 or 4], as PNG bytes."""
    from PIL import Image

    buffer = BytesIO()
    Image.fromarray(image).save(buffer, format="PNG")
    return buffer.getvalue()
