"""What the trials of a sweep are measured on: photographs of one's own, or a block's photographs with known light."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from torchlight.errors import ConfigError
from torchlight.geometry.analytic_shadow import Block
from torchlight.io import fields
from torchlight.io.fields import Field, shown
from torchlight.io.files import read_bytes, sha256_of

SUN_AND_WINDOW = "sun_and_window"
DATA_KEYS = ("synthetic", "photographs")
PHOTOGRAPHS_KEYS = ("scene", "photos")
SYNTHETIC_KEYS = ("lights", "block", "plane", "seen", "held_out", "samples", "noise", "seed")
POSE_KEYS = ("block", "rotation_degrees", "translation")
AXES_OF_SYNTHETIC = ("data.noise", "data.samples", "data.seed")
MAX_SAMPLES = 1024
EXAMPLE = "data: {synthetic: {lights: [sun_and_window], seen: {rotation_degrees: 20}, held_out: [...]}}"


@dataclass(frozen=True)
class Source:
    """A file, and what was in it.

    Attributes:
        path: the file; None = made from formulas (`sun_and_window`).
        name: in tables.
        sha256: of the file.
    """

    path: Path | None
    name: str
    sha256: str = ""


@dataclass(frozen=True)
class Synthetic:
    """A block under known lights: 8-bit photographs of one pose, scored on poses never shown.

    Attributes:
        lights: what lights the block, one photograph each.
        seen: the block as photographed.
        held_out: the blocks whose shadows are to be predicted.
        plane: extents of the receiver.
        samples: of the receiver along each side.
        noise: standard deviation of Gaussian noise, as a share of the brightest sample; added before rounding.
        seed: of the noise.
    """

    lights: tuple[Source, ...]
    seen: Block
    held_out: tuple[Block, ...]
    plane: tuple[float, float] = (4.0, 4.0)
    samples: int = 64
    noise: float = 0.0
    seed: int = 0


@dataclass(frozen=True)
class Photographs:
    """Photographs of one scene: nothing is held out, the score is the fit.

    Attributes:
        scene: the scene file.
        photos: the photographs.
    """

    scene: Source
    photos: tuple[Source, ...]


Data = Synthetic | Photographs


def identity(data: Data) -> dict[str, Any]:
    """Returns what data are, wherever their files lie: names, contents and settings."""
    found = asdict(data)
    for key in ("lights", "photos", "scene"):
        if key in found:
            several = found[key] if isinstance(found[key], tuple | list) else [found[key]]
            found[key] = [{name: one[name] for name in ("name", "sha256")} for one in several]
    return found


def with_data(data: Data, values: Mapping[str, object], source: Path) -> Data:
    """Returns data with settings given by name, such as {"data.noise": 0.01}.

    Raises:
        ConfigError: a value of a wrong type or out of range, or photographs, which have no such settings.
    """
    for key, value in values.items():
        field = Field(value, source, key)
        if not isinstance(data, Synthetic):
            field.fail("photographs are as they are; only synthetic data have this setting")
        name = key.removeprefix("data.")
        data = replace(data, **{name: READERS[name](field)})
    return data


def read_data(field: Field, seed: int, root: Path | None) -> Data:
    """Returns what the section `data` describes.

    Args:
        field: the section.
        seed: of the sweep; that of the noise where the section states none.
        root: folder that lights' names are relative to; None = that of the file.

    Raises:
        FormatError: a file is missing.
        ConfigError: an unknown or missing key, a wrong type, or a pattern that no file matches.
    """
    known = fields.mapping(field, DATA_KEYS)
    if len(known) != 1:
        field.fail(f"expected one of {' and '.join(DATA_KEYS)}; for example '{EXAMPLE}'")
    if "photographs" in known:
        return read_photographs(known["photographs"])
    return read_synthetic(known["synthetic"], seed, root)


def read_photographs(field: Field) -> Photographs:
    """Returns photographs; paths and patterns are relative to the file."""
    known = fields.mapping(field, PHOTOGRAPHS_KEYS)
    folder = field.file.parent
    scene = fields.text(fields.required(known, "scene", field, "scene: scene.yaml"))
    photos = fields.required(known, "photos", field, "photos: [photo.jpg]")
    return Photographs(
        source_of(folder / scene),
        tuple(one for item in fields.items(photos, "a list of photographs") for one in matching(item, folder)),
    )


def read_synthetic(field: Field, seed: int, root: Path | None) -> Synthetic:
    """Returns synthetic data."""
    known = fields.mapping(field, SYNTHETIC_KEYS)
    listed = fields.required(known, "lights", field, f"lights: [{SUN_AND_WINDOW}, probes/kitchen.hdr]")
    folder = field.file.parent if root is None else root
    lights = [one for item in fields.items(listed, "a list of lights") for one in light_sources(item, folder)]
    if not lights:
        listed.fail(f"expected at least one light, such as {SUN_AND_WINDOW}")
    names = [light.name for light in lights]
    for name in names:
        if names.count(name) > 1:
            listed.fail(f"{name} is listed twice; a light counts once")
    block = fields.numbers(known["block"], 3) if "block" in known else (1.0, 0.6, 1.2)
    size = (block[0], block[1], block[2])
    seen = fields.required(known, "seen", field, "seen: {rotation_degrees: 20}")
    held_out = fields.required(known, "held_out", field, "held_out: [{rotation_degrees: 69, translation: [0.3, 0.2]}]")
    poses = tuple(pose(item, size) for item in fields.items(held_out, "a list of poses"))
    if not poses:
        held_out.fail("expected at least one pose that is not photographed")
    data = Synthetic(tuple(lights), pose(seen, size), poses, seed=seed)
    if data.seen in poses:
        held_out.fail("holds the pose that is photographed; leave it away")
    changes = {name: READERS[name](known[name]) for name in READERS if name in known}
    return replace(data, **changes)


def light_sources(field: Field, folder: Path) -> list[Source]:
    """Returns the lights that a name or a pattern stands for."""
    if field.value == SUN_AND_WINDOW:
        return [Source(None, SUN_AND_WINDOW)]
    try:
        return matching(field, folder)
    except ConfigError as error:
        raise ConfigError(f"{error}; --data DIR names the folder of the lights") from None


def matching(field: Field, folder: Path) -> list[Source]:
    """Returns the files that a path or a pattern stands for, sorted.

    Raises:
        ConfigError: there are none.
    """
    text = fields.text(field)
    if Path(text).is_absolute():
        found = [Path(text)] if Path(text).is_file() else []
    else:
        found = sorted(path for path in folder.glob(text) if path.is_file())
    if not found:
        field.fail(f"no file matches {shown(text)} in {folder}")
    return [source_of(path) for path in found]


def source_of(path: Path) -> Source:
    """Returns a file with its digest; raises FormatError where it cannot be read."""
    return Source(path, path.stem, sha256_of(read_bytes(path)))


def pose(field: Field, size: tuple[float, float, float]) -> Block:
    """Returns a block where a mapping says it stands; `size` where it states none."""
    known = fields.mapping(field, POSE_KEYS)
    own = fields.numbers(known["block"], 3) if "block" in known else size
    if min(own) <= 0:
        field.fail("expected a block of extents above 0")
    turn = fields.number(known["rotation_degrees"]) if "rotation_degrees" in known else 0.0
    place = fields.numbers(known["translation"], 2) if "translation" in known else (0.0, 0.0)
    return Block((own[0], own[1], own[2]), turn, (place[0], place[1]))


def plane(field: Field) -> tuple[float, float]:
    """Returns two extents above 0."""
    size = fields.numbers(field, 2)
    if min(size) <= 0:
        field.fail("expected extents above 0")
    return size[0], size[1]


def samples(field: Field) -> int:
    """Returns a number of samples along a side."""
    count = whole(field)
    if not 2 <= count <= MAX_SAMPLES:
        field.fail(f"expected 2 to {MAX_SAMPLES} samples along a side, got {count}")
    return count


def noise(field: Field) -> float:
    """Returns a share of the brightest sample."""
    share = fields.number(field)
    if not 0 <= share < 1:
        field.fail(f"expected a share of the brightest sample in [0, 1), got {share:g}")
    return share


def whole(field: Field) -> int:
    """Returns an integer of at least 0."""
    if isinstance(field.value, bool) or not isinstance(field.value, int) or field.value < 0:
        field.wrong_type("an integer of at least 0")
    return field.value


READERS = {"plane": plane, "samples": samples, "noise": noise, "seed": whole}
