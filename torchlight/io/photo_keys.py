"""The scene file's `photo` and `reference`: how photographs encode radiance and what they are divided by."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

from jaxtyping import Float
from torch import Tensor

from torchlight.errors import TorchlightError
from torchlight.io import fields
from torchlight.io.fields import Field
from torchlight.io.images import read_photo
from torchlight.io.response_file import read_response
from torchlight.photo.radiometry import ENCODINGS

PHOTO_KEYS = ("encoding", "gamma", "response")
REFERENCE_KEYS = ("method", "photo", "photos", "albedo")
REFERENCES = ("uniform", "smooth", "stack", "photo", "albedo")
_MAY_HAVE_ALBEDO = ("smooth", "albedo")
Read = TypeVar("Read")


def photo_keys(field: Field) -> dict[str, Any]:
    """Returns the scene's encoding, gamma and response; a bare word is the encoding."""
    if isinstance(field.value, str):
        field = replace(field, value={"encoding": field.value})
    known = fields.mapping(field, PHOTO_KEYS)
    encoding = fields.choice(known["encoding"], ENCODINGS) if "encoding" in known else None
    for key, meant in (("gamma", "gamma"), ("response", "response")):
        if key in known and encoding != meant:
            known[key].fail(f"counts with 'encoding: {meant}' only")
    found: dict[str, Any] = {"encoding": encoding}
    if "gamma" in known:
        found["gamma"] = fields.positive(known["gamma"])
    if encoding == "response":
        file = fields.required(known, "response", field, "response: hdr_response.json")
        found["response"] = _read(file, read_response).exposure
    return found


def reference_keys(field: Field, receiver: Field) -> dict[str, Any]:
    """Returns the scene's reference, its photographs and albedo map; a bare word is the method."""
    if isinstance(field.value, str):
        field = replace(field, value={"method": field.value})
    known = fields.mapping(field, REFERENCE_KEYS)
    method = fields.choice(fields.required(known, "method", field, "method: smooth"), REFERENCES)
    for key, meant in (("photo", ("photo",)), ("photos", ("stack",)), ("albedo", _MAY_HAVE_ALBEDO)):
        if key in known and method not in meant:
            known[key].fail(f"counts with 'method: {' or '.join(meant)}' only")
    found: dict[str, Any] = {"reference": method}
    if method == "photo":
        found["reference_photos"] = (_path(fields.required(known, "photo", field, "photo: empty.jpg")),)
    if "photos" in known:
        listed = fields.items(known["photos"], "a list of at least three photographs")
        found["reference_photos"] = tuple(_path(item) for item in listed)
    if method == "albedo":
        fields.required(known, "albedo", field, "albedo: albedo.png")
    if "albedo" in known:
        if isinstance(receiver.value, dict) and "albedo" in receiver.value:
            known["albedo"].fail("receiver.albedo is given too; keep one of them")
        found["albedo_map"] = _albedo_map(known["albedo"])
    return found


def _albedo_map(field: Field) -> Float[Tensor, "3 rows columns"]:
    values = _read(field, read_photo).pixels
    if not bool((values > 0).any()) or bool((values > 1).any()) or bool((values < 0).any()):
        field.fail("expected albedos in (0, 1], linear, 0 where unknown; got none or others")
    return values


def _path(field: Field) -> Path:
    """Returns the path of a file that is there; raises the field's error otherwise."""
    path = field.file.parent / fields.text(field)
    if not path.is_file():
        field.fail(f"{path}: no such file; check the name and the folder")
    return path


def _read(field: Field, reader: Callable[[Path], Read]) -> Read:
    """Returns what a reader makes of the file that a field names; its errors name the field too."""
    try:
        return reader(field.file.parent / fields.text(field))
    except TorchlightError as error:
        raise type(error)(field.describe(str(error))) from error
