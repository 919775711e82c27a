"""The plane of a near light, as files name it."""

from __future__ import annotations

from torchlight.errors import FormatError
from torchlight.io.fields import shown
from torchlight.light_plane import LightPlane


def plane_of(stored: object) -> LightPlane | None:
    """Returns the plane that metadata name; raises FormatError for anything else."""
    if stored is None:
        return None
    try:
        height, (x, y) = stored["height"], stored["center"]  # pyright: ignore[reportIndexIssue]
        return LightPlane(float(height), (float(x), float(y)))
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise FormatError(f"light_plane: expected a height and a center of two numbers, got {shown(stored)}") from error
