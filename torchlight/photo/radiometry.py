"""From stored photograph values to values proportional to radiance."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchlight.errors import ConfigError

ENCODINGS = ("srgb", "linear", "gamma", "response", "raw")
DEFAULT_GAMMA = 2.2
SRGB_KNEE, LINEAR_KNEE = 0.04045, 0.0031308  # of IEC 61966-2-1: where its straight part ends


@dataclass(frozen=True, eq=False)
class Response:
    """A camera's inverse response: the exposure that each stored code stands for.

    Attributes:
        exposure: strictly increasing over the codes 0 to the top one, in units of the top code's.
    """

    exposure: Float[Tensor, "3 codes"]

    def __post_init__(self) -> None:
        if self.exposure.shape[-1] < 2 or not bool(self.exposure.isfinite().all()):
            raise ConfigError("response: expected at least two finite values per channel")
        if not bool((self.exposure.diff(dim=-1) > 0).all()) or bool((self.exposure < 0).any()):
            raise ConfigError("response: expected values above 0 that rise from every code to the next")


def resolve_encoding(encoding: str | None, bits: int | None) -> str:
    """Returns the encoding to use for a photograph.

    Args:
        encoding: what the scene file says, or None.
        bits: 8 or 16 for integer files, None for float files and developed RAW, which are linear whatever `encoding`
            says.

    Raises:
        ConfigError: an integer photograph whose encoding is not stated or said to be RAW, or an unknown encoding.
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
    if encoding == "raw":
        raise ConfigError(
            f"photo.encoding: raw, but the photograph has {bits} bits and is developed already; give the RAW file"
        )
    return encoding


def linearize(
    pixels: Float[Tensor, "*batch 3 height width"],
    encoding: str,
    gamma: float = DEFAULT_GAMMA,
    response: Response | None = None,
) -> Float[Tensor, "*batch 3 height width"]:
    """Returns values proportional to radiance.

    "srgb": v / 12.92 if v <= 0.04045, else ((v + 0.055) / 1.055)^2.4 (IEC 61966-2-1), not clamped.
    "gamma": max(v, 0)^gamma. "response": linear between the response's codes. "linear" and "raw": v.

    Raises:
        ConfigError: unknown encoding, or "response" without one.
    """
    _check_encoding(encoding)
    if encoding == "srgb":
        return torch.where(pixels > SRGB_KNEE, ((pixels.clamp(min=SRGB_KNEE) + 0.055) / 1.055) ** 2.4, pixels / 12.92)
    if encoding == "gamma":
        return pixels.clamp(min=0) ** gamma
    if encoding == "response":
        if response is None:
            raise ConfigError("photo.response: missing; name the file that `torchlight merge` wrote")
        return apply_response(pixels, response)
    return pixels


def encode(
    values: Float[Tensor, "*batch 3 height width"], encoding: str, gamma: float = DEFAULT_GAMMA
) -> Float[Tensor, "*batch 3 height width"]:
    """Returns what "srgb", "linear" or "gamma" stores of linear values: the inverse of `linearize`."""
    if encoding == "srgb":
        curve = 1.055 * values.clamp(min=LINEAR_KNEE) ** (1 / 2.4) - 0.055
        return torch.where(values > LINEAR_KNEE, curve, 12.92 * values)
    return values.clamp(min=0) ** (1 / gamma) if encoding == "gamma" else values


def apply_response(
    pixels: Float[Tensor, "*batch 3 height width"], response: Response
) -> Float[Tensor, "*batch 3 height width"]:
    """Returns the exposures of stored values in [0, 1], linear between codes."""
    table = response.exposure.to(pixels)
    last = table.shape[-1] - 1
    place = (pixels.nan_to_num(nan=0.0).clamp(0, 1) * last).movedim(-3, 0)
    below = place.floor().clamp(max=last - 1).long()
    share = place - below
    flat = below.flatten(start_dim=1)
    low = table.gather(1, flat).reshape(place.shape)
    high = table.gather(1, flat + 1).reshape(place.shape)
    return torch.lerp(low, high, share).movedim(0, -3)


def inverse_response(values: Float[Tensor, "3 height width"], response: Response) -> Float[Tensor, "3 height width"]:
    """Returns the stored values in [0, 1] of exposures: the inverse of `apply_response`, clamped to its codes."""
    table = response.exposure.to(values)
    last = table.shape[-1] - 1
    flat = values.flatten(start_dim=1).contiguous()
    below = (torch.searchsorted(table.contiguous(), flat, right=True) - 1).clamp(0, last - 1)
    low, high = table.gather(1, below), table.gather(1, below + 1)
    share = ((flat - low) / (high - low)).clamp(0, 1)
    return ((below + share) / last).reshape(values.shape)


def saturated(
    pixels: Float[Tensor, "*batch channels height width"], bits: int | None
) -> Bool[Tensor, "*batch height width"]:
    """Returns True where any channel holds the top code 2^bits - 1; for float files (`bits` None), infinity.

    Such a value is a lower bound, not a measurement.
    """
    top = float("inf") if bits is None else 1 - 0.5 / (2**bits - 1)
    return (pixels >= top).any(dim=-3)


def tabulated(encoding: str, codes: int, gamma: float = DEFAULT_GAMMA) -> Response:
    """Returns the inverse response of "srgb", "linear" or "gamma" for integer files of so many codes, in float64."""
    values = torch.linspace(0, 1, codes, dtype=torch.float64).expand(3, 1, codes)
    return Response(linearize(values, encoding, gamma)[:, 0])


def _check_encoding(encoding: str) -> None:
    if encoding not in ENCODINGS:
        raise ConfigError(f"photo.encoding: expected {' or '.join(ENCODINGS)}, got '{encoding}'")
