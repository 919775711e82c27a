"""Views files: which photographs show one light, each with its scene file and its exposure.

photographs:
  - {scene: pose1.yaml, photo: pose1.jpg}
  - {scene: pose2.yaml, photo: pose2.jpg, exposure: exif}
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from torchlight.errors import ConfigError
from torchlight.io import fields
from torchlight.io.fields import Field
from torchlight.io.yaml_file import read_yaml

VIEWS_KEYS = ("photographs",)
VIEW_KEYS = ("scene", "photo", "exposure")
ESTIMATE, EXIF = "estimate", "exif"
Exposure = float | Literal["exif", "estimate"]


@dataclass(frozen=True)
class Pictured:
    """One photograph of a views file.

    Attributes:
        scene: its scene file.
        photo: the photograph.
        exposure: a positive number, "exif" (as the photograph records it) or "estimate" (found from the photographs).
    """

    scene: Path
    photo: Path
    exposure: Exposure


def read_views(path: str | Path) -> tuple[Pictured, ...]:
    """Returns the photographs that a views file lists; paths in it are relative to the file.

    Raises:
        FormatError: missing or not YAML.
        ConfigError: unknown or missing keys, wrong types, fewer than two photographs, one photograph twice, exposures
            that are not positive, or numbers beside "exif", whose units differ.
    """
    path = Path(path)
    document, _ = read_yaml(path)
    root = Field(document, path, "")
    known = fields.mapping(root, VIEWS_KEYS)
    example = "photographs: [{scene: pose1.yaml, photo: pose1.jpg}, {scene: pose2.yaml, photo: pose2.jpg}]"
    listed = fields.required(known, "photographs", root, example)
    views = [_pictured(item) for item in fields.items(listed, "a list of photographs with their scenes")]
    if len(views) < 2:
        listed.fail(f"expected at least two photographs, got {len(views)}; for one there is torchlight estimate")
    _check_once(listed, views)
    kinds = {type(view.exposure) if view.exposure not in (EXIF, ESTIMATE) else view.exposure for view in views}
    if {EXIF, float} <= kinds:
        listed.fail("numbers and 'exif' stand side by side as exposures, but their units differ; use one of them")
    return tuple(views)


def _pictured(field: Field) -> Pictured:
    known = fields.mapping(field, VIEW_KEYS)
    scene = fields.text(fields.required(known, "scene", field, "scene: pose1.yaml"))
    photo = fields.text(fields.required(known, "photo", field, "photo: pose1.jpg"))
    exposure = _exposure(known["exposure"]) if "exposure" in known else ESTIMATE
    return Pictured(field.file.parent / scene, field.file.parent / photo, exposure)


def _exposure(field: Field) -> Exposure:
    if field.value == EXIF:
        return EXIF
    if field.value == ESTIMATE:
        return ESTIMATE
    if isinstance(field.value, str):
        field.wrong_type("a number above 0, exif or estimate")
    return fields.positive(field)


def _check_once(field: Field, views: list[Pictured]) -> None:
    seen: set[Path] = set()
    for view in views:
        if view.photo in seen:
            raise ConfigError(field.describe(f"{view.photo} is listed twice; a photograph counts once"))
        seen.add(view.photo)
