"""Manifests: the photographs of a batch, one per line (JSONL) or row (CSV), or a pattern of file names.

{"photo": "day1/IMG_0412.jpg", "scene": "day1.yaml", "exposure": 0.008, "tags": {"sky": "clear"}}

    photo,scene,mask,exposure,name,tags
    day1/IMG_0412.jpg,day1.yaml,,exif,,sky=clear;hour=9

Only `photo` is needed where the call names a scene. Files are relative to the manifest.
"""

from __future__ import annotations

import csv
import glob
import hashlib
import io
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Any

from torchlight.errors import ConfigError, FormatError
from torchlight.io import fields
from torchlight.io.fields import Field
from torchlight.io.files import one_line, read_bytes

EXIF = "exif"
KEYS = ("photo", "scene", "mask", "exposure", "name", "tags")
MANIFESTS = (".jsonl", ".csv")
MAX_MANIFEST_BYTES = 1 << 28
MAX_NAME = 200  # bytes of a part; file systems allow 255
MAX_NAMES = 2000  # bytes of all parts; systems allow 4096 for a whole path


@dataclass(frozen=True)
class Entry:
    """One photograph of a batch.

    Attributes:
        name: of its folder in the output, parts separated by "/"; unique in the batch.
        photo: the file.
        scene: its scene file.
        mask: picture of the pixels that may be used, instead of the scene's; None = the scene's.
        exposure: what its linear values are divided by, a number or `EXIF`; None = 1.
        tags: pairs of texts that are carried into the tables.
    """

    name: str
    photo: Path
    scene: Path
    mask: Path | None = None
    exposure: float | str | None = None
    tags: tuple[tuple[str, str], ...] = ()

    @property
    def digest(self) -> str:
        """SHA-256 of everything but the name: whether a finished photograph was this one."""
        parts = [str(self.photo), str(self.scene), str(self.mask), repr(self.exposure)]
        return hashlib.sha256(json.dumps(parts).encode()).hexdigest()


def read_entries(sources: Sequence[str], scene: Path | None) -> list[Entry]:
    """Returns the photographs that a manifest lists, or that file names and patterns name, in their order.

    Args:
        sources: one manifest, or photographs and patterns such as "photos/*.jpg".
        scene: scene file of those photographs that name none.

    Raises:
        FormatError: a manifest that cannot be read; a pattern that matches nothing.
        ConfigError: a line that is wrong (it is named), two photographs of one name, no scene.
    """
    manifests = [source for source in sources if Path(source).suffix.lower() in MANIFESTS]
    if manifests and len(sources) > 1:
        raise ConfigError(f"{manifests[0]}: a manifest stands alone; put all photographs into one")
    entries = list(listed(Path(sources[0]), scene) if manifests else found(sources, scene))
    if not entries:
        raise ConfigError("no photograph given; usage: torchlight batch MANIFEST|PATTERN --scene SCENE --out DIR")
    return unique(entries)


def unique(entries: list[Entry]) -> list[Entry]:
    """Returns the entries; raises ConfigError where two would share a folder, or one would lie inside another's."""
    by_name: dict[str, Entry] = {}
    for entry in entries:
        other = by_name.setdefault(entry.name.casefold(), entry)  # some file systems do not tell cases apart
        if other is not entry:
            raise ConfigError(
                f"{other.photo} and {entry.photo} would both be written to {entry.name}; give one another 'name'"
            )
    for entry in entries:
        for parent in PurePosixPath(entry.name).parents:
            if str(parent).casefold() in by_name:
                raise ConfigError(
                    f"{entry.name} would be written inside the folder of {parent}; give it another 'name'"
                )
    return entries


def as_row(entry: Entry) -> dict[str, Any]:
    """Returns the line of a JSONL manifest that names a photograph, its files absolute."""
    files = {"photo": entry.photo, "scene": entry.scene, "mask": entry.mask}
    row: dict[str, Any] = {"name": entry.name}
    row |= {key: str(file.absolute()) for key, file in files.items() if file is not None}
    row |= {} if entry.exposure is None else {"exposure": entry.exposure}
    return row | ({"tags": dict(entry.tags)} if entry.tags else {})


# --- manifests -----------------------------------------------------------------------------------------------------


def listed(path: Path, scene: Path | None) -> Iterator[Entry]:
    """Yields the photographs of a manifest."""
    try:
        text = read_bytes(path, MAX_MANIFEST_BYTES).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise FormatError(f"{path}: not a text file; expected UTF-8, one photograph per line") from error
    rows = csv_rows(path, text) if path.suffix.lower() == ".csv" else json_rows(path, text)
    read = [row(field, scene) for field in rows]
    base = common_folder([path.absolute().parent], [entry.photo for entry in read])
    for entry in read:
        yield entry if entry.name else replace(entry, name=derived(entry.photo, base))


def json_rows(path: Path, text: str) -> Iterator[Field]:
    """Yields the JSON objects of a file, one per line."""
    for number, line in enumerate(text.splitlines(), start=1):
        if not line.strip():
            continue
        try:
            document = json.loads(line, object_pairs_hook=without_duplicates)
        except (ValueError, RecursionError) as error:
            raise FormatError(f"{path}, line {number}: not JSON: {one_line(str(error))}") from error
        yield Field(document, Path(f"{path}, line {number}"), "")


def without_duplicates(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Returns a mapping; raises ValueError where a key appears twice."""
    found: dict[str, Any] = {}
    for key, value in pairs:
        if key in found:
            raise ValueError(f"the key '{key}' appears twice")
        found[key] = value
    return found


def csv_rows(path: Path, text: str) -> Iterator[Field]:
    """Yields the rows of a table as mappings; empty cells are left out."""
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    try:
        head = next(reader, [])
        if len(set(head)) < len(head):
            raise FormatError(f"{path}, line 1: a column appears twice; keep one")
        for cells in reader:
            if not any(cells):
                continue
            place = Path(f"{path}, line {reader.line_num}")
            if len(cells) != len(head):
                raise FormatError(f"{place}: {len(cells)} cells, but the first line names {len(head)} columns")
            cell = {key: value for key, value in zip(head, cells, strict=True) if value}
            yield Field(typed(cell), place, "")
    except csv.Error as error:
        raise FormatError(f"{path}, line {reader.line_num}: not CSV: {one_line(str(error))}") from error


def typed(cells: Mapping[str, str]) -> dict[str, Any]:
    """Returns a row's texts as the values that JSON would hold."""
    row: dict[str, Any] = dict(cells)
    if "exposure" in row and row["exposure"] != EXIF:
        with suppress(ValueError):  # said with its place when the row is read
            row["exposure"] = float(row["exposure"])
    if "tags" in row:
        pairs = [part.partition("=") for part in row["tags"].split(";") if part.strip()]
        row["tags"] = {key.strip(): value.strip() for key, _, value in pairs}
    return row


def row(field: Field, scene: Path | None) -> Entry:
    """Returns what one line says; its name is empty where it is to be derived."""
    known = fields.mapping(field, KEYS)
    folder = Path(str(field.file).rpartition(", line ")[0]).parent
    photo = fields.text(fields.required(known, "photo", field, '"photo": "IMG_0001.jpg"'))
    if "scene" not in known and scene is None:
        raise ConfigError(field.describe("names no scene; add 'scene', or pass --scene for all"))
    return Entry(
        name=own_name(known["name"]) if "name" in known else "",
        photo=folder / photo,
        scene=folder / fields.text(known["scene"]) if "scene" in known else Path(scene or ""),
        mask=folder / fields.text(known["mask"]) if "mask" in known else None,
        exposure=exposure(known["exposure"]) if "exposure" in known else None,
        tags=tags(known["tags"]) if "tags" in known else (),
    )


def own_name(field: Field) -> str:
    """Returns a name that a manifest gives."""
    name = fields.text(field)
    try:
        return checked_name(name)
    except ConfigError as error:
        raise ConfigError(field.describe(str(error))) from error


def exposure(field: Field) -> float | str:
    """Returns a number above 0 or `EXIF`."""
    if field.value == EXIF:
        return EXIF
    if isinstance(field.value, str):
        field.wrong_type(f"a number above 0 or {EXIF}")
    return fields.positive(field)


def tags(field: Field) -> tuple[tuple[str, str], ...]:
    """Returns pairs of texts."""
    if not isinstance(field.value, dict) or not all(isinstance(value, str) for value in field.value.values()):
        field.wrong_type('a mapping of texts, such as {"sky": "clear"} (CSV: sky=clear;hour=9)')
    return tuple((str(key), str(value)) for key, value in field.value.items())


# --- file names and patterns -----------------------------------------------------------------------------------------


def found(sources: Sequence[str], scene: Path | None) -> Iterator[Entry]:
    """Yields the photographs that file names and patterns name; those of a pattern in alphabetical order."""
    if scene is None:
        raise ConfigError("no scene given; pass --scene SCENE.yaml, or a manifest that names one per photograph")
    photos = [file for source in sources for file in matching(source)]
    base = common_folder([fixed_part(source) for source in sources], photos)
    for photo in photos:
        yield Entry(derived(photo, base), photo, scene)


def matching(source: str) -> list[Path]:
    """Returns the files that a pattern matches, or the one file that a name without wildcards names."""
    if Path(source).is_dir():
        raise FormatError(f"{source}: is a folder; name its photographs, for example '{source.rstrip('/')}/*.jpg'")
    if not glob.has_magic(source) or Path(source).exists():
        return [Path(source)]
    names = glob.glob(source, recursive=True)  # noqa: PTH207 (Path.glob takes no absolute pattern)
    files = sorted(Path(name) for name in names if not Path(name).is_dir())
    if not files:
        raise FormatError(f"{source}: matches no file; check the folder and the suffix")
    return files


def fixed_part(source: str) -> Path:
    """Returns the folder before a pattern's first wildcard: it stays when photographs are added."""
    parts = Path(source).absolute().parts
    fixed = next((index for index, part in enumerate(parts) if glob.has_magic(part)), len(parts) - 1)
    return Path(*parts[:fixed])


# --- names -----------------------------------------------------------------------------------------------------------


def common_folder(bases: Sequence[Path], photos: Sequence[Path]) -> Path:
    """Returns the folder that photographs' names are relative to: what the bases share, if all lie in it."""
    places = [Path(os.path.abspath(place)) for place in (*bases, *photos)]  # noqa: PTH100 (links are not followed)
    folder = places[0]
    while not all(place.is_relative_to(folder) for place in places) and folder != folder.parent:
        folder = folder.parent
    return folder


def derived(photo: Path, base: Path) -> str:
    """Returns a photograph's name: its path within a folder, without suffix, safe as a folder's name."""
    inside = Path(os.path.relpath(photo, base)).with_suffix("")
    return checked_name("/".join(tidy(part) for part in inside.parts))


def tidy(part: str) -> str:
    """Returns a part of a path without what no folder's name may hold; one that is too long ends in its digest."""
    plain = "".join(letter if letter.isprintable() and letter not in "\\:" else "_" for letter in part)
    plain = "_" + plain.lstrip(".") if plain.startswith(".") else plain
    if len(plain.encode()) <= MAX_NAME:
        return plain
    short = plain.encode()[: MAX_NAME - 20].decode(errors="ignore")
    return f"{short}~{hashlib.sha256(part.encode(errors='surrogateescape')).hexdigest()[:12]}"


def checked_name(name: str) -> str:
    """Returns a name that is safe as a folder inside the output.

    Raises:
        ConfigError: it is absolute, leads outside, is hidden, too long, or holds characters that no folder may have.
    """
    if len(name.encode(errors="replace")) > MAX_NAMES:
        raise ConfigError(f"'{one_line(name, 80)}' is longer than {MAX_NAMES} bytes; give the photograph a 'name'")
    parts = name.split("/")
    if any(part in ("", "..") or part.startswith(".") for part in parts):
        raise ConfigError(f"'{one_line(name, 80)}' would not lie inside the output; use plain folder names")
    if not name.isprintable() or "\\" in name or ":" in name or any(len(part.encode()) > MAX_NAME for part in parts):
        raise ConfigError(
            f"'{one_line(name, 80)}' cannot name a folder (control characters, \\, :, or more than {MAX_NAME} "
            "bytes); give the photograph a 'name'"
        )
    return name
