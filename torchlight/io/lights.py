"""Environment maps as files: any supported picture in, torchlight's lat-long in memory, EXR or HDR out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from jaxtyping import Float
from torch import Tensor

from torchlight.errors import ConfigError, FormatError, SceneError, ShapeError
from torchlight.io.exr import read_exr, write_exr
from torchlight.io.exr_container import MAGIC as EXR_MAGIC
from torchlight.io.fields import shown
from torchlight.io.files import read_bytes
from torchlight.io.rgbe import decode_hdr, write_hdr
from torchlight.light.environment import EnvironmentMap
from torchlight.light.formats import (
    CONVENTIONS,
    angular_to_latlong,
    cross_to_latlong,
    from_latlong,
    kind_of,
    to_latlong,
)
from torchlight.light_plane import LightPlane

_HDR_MAGIC = b"#?"
_OPENEXR_FAMILY = ("openexr", "usd", "mitsuba")
_FIXED_KINDS = {"cross": cross_to_latlong, "angular": angular_to_latlong}
_NAMES = {"cross": "a cube cross", "angular": "an angular map"}


def read_light(path: str | Path, convention: str | None = None) -> EnvironmentMap:
    """Returns the light in an EXR or HDR file, at its own resolution, float32.

    A picture of 2:1 is a lat-long, 3:4 a vertical cube cross, 1:1 an angular map.

    Args:
        path: the file, told apart by content.
        convention: of a lat-long, one of `formats.CONVENTIONS`; None = what the file's metadata says, else torchlight.

    Raises:
        ConfigError: an unknown convention, or one given for a cross or an angular map.
        FormatError: missing, neither EXR nor HDR, corrupt, of another shape, or with NaN or infinite pixels.
    """
    if convention is not None:
        _check_convention(convention)
    image, metadata = _read(path)
    try:
        kind = kind_of(image.shape[-2], image.shape[-1])
        stored = metadata.get("convention", "torchlight") if convention is None else convention
        radiance = from_latlong(image, str(stored)) if kind == "latlong" else _FIXED_KINDS[kind](image)
        nonnegative = bool(metadata.get("nonnegative", not bool((radiance < 0).any())))
        units, plane = str(metadata.get("units", "relative")), _plane(metadata.get("light_plane"))
        environment = EnvironmentMap(radiance, nonnegative=nonnegative, units=units, plane=plane)
    except (ConfigError, ShapeError, FormatError, SceneError) as error:
        raise FormatError(f"{path}: {error}") from error
    if kind != "latlong" and convention is not None:
        raise ConfigError(f"convention: {path} is no lat-long but {_NAMES[kind]}, whose axes are fixed; leave it out")
    return environment


def write_light(
    path: str | Path,
    environment: EnvironmentMap,
    metadata: Mapping[str, Any],
    *,
    convention: str = "torchlight",
) -> None:
    """Writes one map as a lat-long: .exr with everything, .hdr with negative values set to 0 and no metadata.

    A .hdr does not say that a light is near: what reads it takes it as far away.

    Args:
        path: its suffix chooses the format.
        environment: a single map.
        metadata: stored in the .exr beside the convention, units and whether values are non-negative.
        convention: one of `formats.CONVENTIONS`.

    Raises:
        ConfigError: an unknown convention.
        ShapeError: a batch of maps.
        FormatError: another suffix, or the file cannot be written.
    """
    _check_convention(convention)
    if environment.radiance.ndim != 3:
        raise ShapeError(f"{path}: expected one map [3, height, width], got {list(environment.radiance.shape)}")
    image = to_latlong(environment.radiance, convention)
    suffix = Path(path).suffix.lower()
    if suffix == ".exr":
        own = {"convention": convention, "units": environment.units, "nonnegative": environment.nonnegative}
        if environment.plane is not None:
            own["light_plane"] = asdict(environment.plane)
        write_exr(path, image, {**metadata, **own}, openexr_envmap=convention in _OPENEXR_FAMILY)
    elif suffix == ".hdr":
        write_hdr(path, image)
    else:
        raise FormatError(f"{path}: environment maps are written as .exr or .hdr; change the suffix")


def _read(path: str | Path) -> tuple[Float[Tensor, "3 height width"], dict[str, Any]]:
    data = read_bytes(path)
    if data.startswith(EXR_MAGIC):
        image, metadata = read_exr(path)
        return image.expand(3, -1, -1).contiguous(), metadata
    if data.startswith(_HDR_MAGIC):
        return decode_hdr(data, str(path)), {}
    raise FormatError(f"{path}: neither OpenEXR nor Radiance HDR; convert the environment map to one of them")


def _plane(stored: object) -> LightPlane | None:
    """Returns the plane that metadata name."""
    if stored is None:
        return None
    try:
        height, (x, y) = stored["height"], stored["center"]  # pyright: ignore[reportIndexIssue]
        return LightPlane(float(height), (float(x), float(y)))
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise FormatError(f"light_plane: expected a height and a center of two numbers, got {shown(stored)}") from error


def _check_convention(convention: str) -> None:
    if convention not in CONVENTIONS:
        raise ConfigError(f"convention: unknown name {convention!r}; choose one of {', '.join(CONVENTIONS)}")
