"""From stored photograph values to values proportional to radiance."""

from __future__ import annotations

from jaxtyping import Bool, Float
from kornia.color import rgb_to_linear_rgb
from torch import Tensor

from torchlight.errors import ConfigError

ENCODINGS = ("srgb", "linear")


def resolve_encoding(encoding: str | None, bits: int | None) -> str:
    """Returns the encoding to use for a photograph.

    Args:
        encoding: what the scene file says, or None.
        bits: 8 or 16 for integer files, None for float files, which are linear whatever `encoding` says.

    Raises:
        ConfigError: an integer photograph whose encoding is not stated, or an unknown encoding.
    """
    if encoding is not None:
        _check_encoding(encoding)
    if bits is None:
        return "linear"
    if encoding is None:
        raise ConfigError(
            f"photo.encoding: missing, and a {bits}-bit photograph does not say how it encodes radiance; "
            "add 'photo: {encoding: srgb}' for an ordinary camera picture or 'photo: {encoding: linear}'"
        )
    return encoding


def linearize(pixels: Float[Tensor, "*batch 3 height width"], encoding: str) -> Float[Tensor, "*batch 3 height width"]:
    """Returns values proportional to radiance.

    For "srgb": v / 12.92 if v <= 0.04045, else ((v + 0.055) / 1.055)^2.4 (IEC 61966-2-1), not clamped.

    Raises:
        ConfigError: unknown encoding.
    """
    _check_encoding(encoding)
    return rgb_to_linear_rgb(pixels) if encoding == "srgb" else pixels


def saturated(
    pixels: Float[Tensor, "*batch channels height width"], bits: int | None
) -> Bool[Tensor, "*batch height width"]:
    """Returns True where any channel holds the top code 2^bits - 1; for float files (`bits` None), infinity.

    Such a value is a lower bound, not a measurement.
    """
    top = float("inf") if bits is None else 1 - 0.5 / (2**bits - 1)
    return (pixels >= top).any(dim=-3)


def _check_encoding(encoding: str) -> None:
    if encoding not in ENCODINGS:
        raise ConfigError(f"photo.encoding: expected {' or '.join(ENCODINGS)}, got '{encoding}'")
