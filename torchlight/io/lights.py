"""Environment maps as files: any supported picture in, torchlight's lat-long in memory, any supported picture out."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from jaxtyping import Float
from torch import Tensor

from torchlight.errors import ConfigError, FormatError, SceneError, ShapeError
from torchlight.io.coefficients import decode_coefficients
from torchlight.io.exr import read_exr, write_exr
from torchlight.io.exr_container import MAGIC as EXR_MAGIC
from torchlight.io.files import read_bytes
from torchlight.io.planes import plane_of
from torchlight.io.rgbe import decode_hdr, write_hdr
from torchlight.light.environment import EnvironmentMap
from torchlight.light.formats import check_kind, from_picture, grid_as_fine, is_latlong, kind_of, to_picture
from torchlight.light.primaries import PRIMARIES, check_primaries, convert_primaries
from torchlight.light.sampled import SampledLight, clipped_share, converted, sampled, to_environment

_HDR_MAGIC = b"#?"
_OPENEXR_FAMILY = ("openexr", "usd", "mitsuba")
_OWN_KEYS = ("convention", "units", "nonnegative", "light_plane", "primaries")
_NAMES = {"cross": "a cube cross", "angular": "an angular map", "strip": "a cube strip"}


def read_light(path: str | Path, convention: str | None = None) -> EnvironmentMap:
    """Returns the light in an EXR, HDR or JSON (spherical harmonics) file as a lat-long of like detail, float32.

    A picture of 2:1 is a lat-long, 3:4 a vertical cube cross, 6:1 a cube strip, 1:1 an angular map, unless the file's
    metadata or `convention` name another kind.

    Args:
        path: the file, told apart by content.
        convention: one of `formats.KINDS`; None = what the file's metadata says, else torchlight's for a lat-long.

    Raises:
        ConfigError: an unknown convention, or a lat-long's given for another kind of picture.
        FormatError: missing, neither EXR nor HDR, corrupt, of another shape, or with NaN or infinite pixels.
    """
    return read_described(path, convention)[0]


def read_described(path: str | Path, convention: str | None = None) -> tuple[EnvironmentMap, dict[str, Any]]:
    """Returns what `read_light` does, and what else an EXR's metadata say: method, hashes and the like."""
    light, said = read_stored(path, convention)
    return replace(to_environment(light), nonnegative=light.nonnegative), said


def read_sampled(path: str | Path, convention: str | None = None) -> SampledLight:
    """Returns the light in a file on the grid that it is stored on, float32; otherwise as `read_light`."""
    return read_stored(path, convention)[0]


def read_stored(path: str | Path, convention: str | None = None) -> tuple[SampledLight, dict[str, Any]]:
    """Returns what `read_sampled` does, and what else an EXR's metadata say: method, hashes and the like."""
    if convention is not None:
        check_kind(convention)
    data = read_bytes(path)
    if data.lstrip()[:1] == b"{":
        return _checked_coefficients(data, path, convention), {}
    image, metadata = _read(data, path)
    try:
        kind = _kind(image, metadata, convention)
        values, grid = from_picture(image, kind)
        units, plane = str(metadata.get("units", "relative")), plane_of(metadata.get("light_plane"))
        light = SampledLight(values, grid, _is_nonnegative(values, metadata), units, plane)
    except (ConfigError, ShapeError, FormatError, SceneError) as error:
        raise FormatError(f"{path}: {error}") from error
    if convention not in (None, kind):
        raise ConfigError(f"convention: {path} is no lat-long but {_NAMES[kind]}, whose axes are fixed; leave it out")
    return light, {key: value for key, value in metadata.items() if key not in _OWN_KEYS}


def write_light(
    path: str | Path,
    environment: EnvironmentMap,
    metadata: Mapping[str, Any],
    *,
    convention: str = "torchlight",
    primaries: str = "rec709",
) -> None:
    """Writes one map: .exr with everything, .hdr with negative values set to 0 and no metadata.

    What the format cannot hold, negative radiance and that a light is near, the logger says in one line each.

    Args:
        path: its suffix chooses the format.
        environment: a single map.
        metadata: stored in the .exr beside the convention, units and whether values are non-negative.
        convention: one of `formats.KINDS`; a cube map or an angular map gets the detail of the lat-long.
        primaries: one of `light.primaries.PRIMARIES`, which colours are converted to.

    Raises:
        ConfigError: an unknown convention or primaries.
        ShapeError: a batch of maps.
        FormatError: another suffix, or the file cannot be written.
    """
    check_kind(convention)
    if environment.radiance.ndim != 3:
        raise ShapeError(f"{path}: expected one map [3, height, width], got {list(environment.radiance.shape)}")
    light = sampled(environment)
    light = converted(light, grid_as_fine(convention, light.grid))
    write_sampled(path, light, metadata, convention=convention, primaries=primaries)


def write_sampled(
    path: str | Path,
    light: SampledLight,
    metadata: Mapping[str, Any],
    *,
    convention: str = "torchlight",
    primaries: str = "rec709",
) -> None:
    """Writes light on the grid of a kind as that kind's picture; otherwise as `write_light`."""
    check_kind(convention)
    check_primaries(primaries)
    suffix = Path(path).suffix.lower()
    image = to_picture(light.radiance, light.grid, convention)
    if suffix == ".exr":
        own = {"convention": convention, "units": light.units, "nonnegative": light.nonnegative}
        if light.plane is not None:
            own["light_plane"] = asdict(light.plane)
        if primaries != "rec709":
            own["primaries"] = primaries
        envmap = convention in _OPENEXR_FAMILY
        write_exr(path, image, {**metadata, **own}, openexr_envmap=envmap, primaries=primaries)
    elif suffix == ".hdr":
        say_what_is_lost(path, light, primaries)
        write_hdr(path, image, primaries=primaries)
    else:
        raise FormatError(f"{path}: environment maps are written as .exr or .hdr; change the suffix")


def say_what_is_lost(path: str | Path, light: SampledLight, primaries: str = "rec709") -> None:
    """Logs one line each for what a picture that is no EXR does not hold: negative radiance, and a near light."""
    logger = logging.getLogger("torchlight")
    colours = convert_primaries(light.radiance, PRIMARIES["rec709"], PRIMARIES[primaries])
    share = clipped_share(replace(light, radiance=colours, nonnegative=False))
    if share > 0:
        logger.info(f"{path}: negative radiance is set to 0, {100 * share:.2g} % of the flux; .exr keeps it")
    if light.plane is not None:
        logger.info(f"{path}: does not say that the light stands {light.plane}: taken as far away; .exr keeps it")


def _kind(image: Float[Tensor, "3 height width"], metadata: Mapping[str, Any], convention: str | None) -> str:
    """Returns the kind of a picture: as named, as its metadata say, or, where both are a lat-long's, as its shape."""
    named = str(metadata.get("convention", "torchlight")) if convention is None else convention
    check_kind(named)
    if not is_latlong(named):
        return named
    shape = kind_of(image.shape[-2], image.shape[-1])
    return named if shape == "latlong" else shape


def _is_nonnegative(values: Float[Tensor, "3 pixels"], metadata: Mapping[str, Any]) -> bool:
    """Returns what the metadata declare; where they declare nothing, or of other primaries, what is found."""
    declared = metadata.get("nonnegative")
    if declared is None or (declared and metadata.get("primaries", "rec709") != "rec709"):
        return not bool((values < 0).any())
    return bool(declared)


def _read(data: bytes, path: str | Path) -> tuple[Float[Tensor, "3 height width"], dict[str, Any]]:
    if data.startswith(EXR_MAGIC):
        image, metadata = read_exr(path)
        return image.expand(3, -1, -1).contiguous(), metadata
    if data.startswith(_HDR_MAGIC):
        return decode_hdr(data, str(path)), {}
    raise FormatError(f"{path}: neither OpenEXR nor Radiance HDR; convert the environment map to one of them")


def _checked_coefficients(data: bytes, path: str | Path, convention: str | None) -> SampledLight:
    if convention is not None:
        raise ConfigError(f"convention: {path} holds spherical harmonics, whose axes are fixed; leave it out")
    return decode_coefficients(data, str(path))
