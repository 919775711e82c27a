"""OpenEXR pictures: linear float32 values, scanlines, ZIP, metadata as one JSON string.

The library writes non-contiguous arrays as garbage without a word and, in some versions, ignores a full disk:
arrays are made contiguous here, and what was written is read back and compared before it gets its name.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import torch
from jaxtyping import Float
from numpy.typing import NDArray
from torch import Tensor

from torchlight.errors import ConfigError, FormatError, ShapeError
from torchlight.io.atomic import partial_file
from torchlight.io.exr_container import check_exr
from torchlight.io.files import one_line, read_bytes, reason
from torchlight.light.primaries import PRIMARIES, check_primaries, convert_primaries, named

METADATA_ATTRIBUTE = "torchlight"
REC709_D65 = PRIMARIES["rec709"]
_CHANNELS = {1: "Y", 3: "RGB", 4: "RGBA"}


def read_exr(path: str | Path) -> tuple[Float[Tensor, "channels height width"], dict[str, Any]]:
    """Returns the picture, float32, and the metadata that `write_exr` stored (empty for others' files).

    Three channels if the file has R, G and B (bare, or within exactly one layer), otherwise its only colour channel,
    such as Y. Alpha is dropped: OpenEXR colours are premultiplied, so they already are the light that arrives.

    Colours of other primaries, which the attribute `chromaticities` names, are converted to Rec.709 (see
    `light.primaries`); the logger says so in one line.

    Raises:
        FormatError: missing, not OpenEXR, truncated, corrupt, or without such channels.
    """
    header, channels = _decode(path)
    names = _colour_channels(list(channels), path)
    image = torch.from_numpy(np.stack([channels[name].astype(np.float32) for name in names]))
    return _in_rec709(image, header, path), _metadata(header, path)


def read_channel(path: str | Path, name: str) -> Float[Tensor, "height width"]:
    """Returns one channel by its name, as `write_channels` writes them, float32.

    Raises:
        FormatError: as `read_exr`, or the file has no such channel.
    """
    _, channels = _decode(path)
    if name not in channels:
        raise FormatError(f"{path}: holds no channel {name!r}, only {', '.join(sorted(channels))}")
    return torch.from_numpy(channels[name].astype(np.float32))


def write_exr(
    path: str | Path,
    image: Float[Tensor, "channels height width"],
    metadata: Mapping[str, Any],
    *,
    openexr_envmap: bool = False,
    primaries: str = "rec709",
) -> None:
    """Writes a picture of 1 (Y), 3 (RGB) or 4 (RGBA) channels.

    Args:
        path: destination; it appears complete or not at all.
        image: linear values, of Rec.709 primaries, stored as float32.
        metadata: anything JSON can hold.
        openexr_envmap: marks a lat-long in OpenEXR's own convention (Y up, centre +Z), and only such a file.
        primaries: one of `light.primaries.PRIMARIES`, which colours are converted to; the file says so.

    Raises:
        ConfigError: unknown primaries.
        ShapeError: another number of channels.
        FormatError: the file cannot be written.
    """
    if image.shape[0] not in _CHANNELS:
        raise ShapeError(f"{path}: expected 1, 3 or 4 channels, got {image.shape[0]}")
    check_primaries(primaries)
    if image.shape[0] != 1:
        colours = convert_primaries(image[:3].flatten(start_dim=1), REC709_D65, PRIMARIES[primaries])
        image = torch.cat([colours.unflatten(-1, image.shape[1:]), image[3:]])
    planes = dict(zip(_CHANNELS[image.shape[0]], image, strict=True))
    write_channels(path, planes, metadata, openexr_envmap, primaries)


def write_channels(
    path: str | Path,
    planes: Mapping[str, Float[Tensor, "height width"]],
    metadata: Mapping[str, Any],
    openexr_envmap: bool = False,
    primaries: str = "rec709",
) -> None:
    """Writes channels of any name, such as those of layers ("deviation.R").

    Args:
        path: destination; it appears complete or not at all.
        planes: values of each channel, stored as float32.
        metadata: anything JSON can hold.
        openexr_envmap: as for `write_exr`.
        primaries: those that the colours are in.

    Raises:
        FormatError: the file cannot be written.
    """
    pixels = {name: plane.detach().to(device="cpu", dtype=torch.float32).numpy() for name, plane in planes.items()}
    channels = {name: np.ascontiguousarray(plane) for name, plane in pixels.items()}
    header: dict[str, Any] = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "chromaticities": PRIMARIES[primaries],
        METADATA_ATTRIBUTE: json.dumps(dict(metadata), sort_keys=True),
    }
    if openexr_envmap:
        header["envmap"] = OpenEXR.ENVMAP_LATLONG
    with partial_file(path) as temporary:
        try:
            OpenEXR.File(header, dict(channels)).write(str(temporary))
        except (RuntimeError, ValueError) as error:
            raise FormatError(f"{path}: cannot be written: {reason(error)}; is the disk full?") from error
        _check_written(temporary, channels, path)


def _decode(path: str | Path) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    check_exr(read_bytes(path), str(path))
    try:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            header = dict(file.header())
            channels = {name: channel.pixels for name, channel in file.channels().items()}
    except (RuntimeError, ValueError, TypeError) as error:
        raise FormatError(f"{path}: the OpenEXR file cannot be decoded: {reason(error)}; save it again") from error
    if len({plane.shape for plane in channels.values()}) > 1:
        raise FormatError(f"{path}: its channels have different sizes (subsampled colour); save it as plain RGB")
    return header, channels


def _colour_channels(names: list[str], path: str | Path) -> list[str]:
    layers = [name[:-1] for name in names if name.endswith("R") and {name[:-1] + "G", name[:-1] + "B"} <= set(names)]
    if "" in layers:
        return ["R", "G", "B"]
    if len(layers) == 1:
        return [layers[0] + letter for letter in "RGB"]
    colours = [name for name in names if name.rpartition(".")[2] not in ("A", "Z")]
    if len(colours) == 1:
        return colours
    found = one_line(", ".join(names), 120)
    raise FormatError(f"{path}: expected channels R, G, B or one channel such as Y, got {found}; save it as plain RGB")


def _in_rec709(
    image: Float[Tensor, "channels height width"], header: dict[str, Any], path: str | Path
) -> Float[Tensor, "channels height width"]:
    """Returns a picture in Rec.709 primaries; grey is grey in all."""
    stored = header.get("chromaticities")
    if stored is None:
        return image
    try:
        chromaticities = tuple(float(value) for value in np.ravel(stored))
        usual = np.allclose(chromaticities, REC709_D65, atol=5e-3)
    except (TypeError, ValueError) as error:
        raise FormatError(f"{path}: its primaries are not eight numbers; write it again") from error
    if usual or len(image) == 1:
        return image
    try:
        converted = convert_primaries(image.flatten(start_dim=1), chromaticities, REC709_D65)
    except ConfigError as error:
        raise FormatError(f"{path}: {error}") from error
    name = named(chromaticities) or "its own"
    logging.getLogger("torchlight").info(f"{path}: colours of {name} primaries are converted to Rec.709")
    return converted.unflatten(-1, image.shape[1:])


def _metadata(header: dict[str, Any], path: str | Path) -> dict[str, Any]:
    text = header.get(METADATA_ATTRIBUTE, "{}")
    try:
        metadata = json.loads(text)
    except (TypeError, ValueError, RecursionError) as error:
        raise FormatError(f"{path}: its '{METADATA_ATTRIBUTE}' attribute is not JSON; write it again") from error
    if not isinstance(metadata, dict):
        raise FormatError(f"{path}: its '{METADATA_ATTRIBUTE}' attribute is not a JSON object; write it again")
    return metadata


def _check_written(temporary: Path, channels: dict[str, NDArray[Any]], path: str | Path) -> None:
    try:
        _, stored = _decode(temporary)
    except FormatError as error:
        raise FormatError(f"{path}: could not be written completely; is the disk full?") from error
    same = stored.keys() == channels.keys() and all(
        np.array_equal(stored[name].view(np.int32), channels[name].view(np.int32)) for name in channels
    )
    if not same:
        raise FormatError(f"{path}: what was written does not read back the same; is the disk full?")
