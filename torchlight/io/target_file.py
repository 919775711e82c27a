"""The sheet's description as a YAML file: what a photograph's markers mean in millimetres."""

from __future__ import annotations

from pathlib import Path

from torchlight.errors import CalibrationError, ConfigError
from torchlight.io import fields
from torchlight.io.atomic import write_atomically
from torchlight.io.fields import Field
from torchlight.io.files import one_line
from torchlight.io.yaml_file import read_yaml
from torchlight.photo.boards import named_dictionary
from torchlight.photo.target import RULER_LENGTH, Prop, Sheet, check_ruler

_KEYS = ("paper", "origin", "inside", "dictionary", "marker_size", "markers", "ruler", "occluders")
_RULER_KEYS = ("printed", "measured")


def read_target(path: str | Path) -> Sheet:
    """Returns the sheet that a file of `write_target` describes; its `occluders` are for scene files to copy.

    Raises:
        FormatError: missing or not YAML.
        ConfigError: unknown or missing keys, wrong types.
        CalibrationError: the ruler does not measure what it should, or the markers cannot be.
    """
    path = Path(path)
    document, _ = read_yaml(path)
    root = Field(document, path, "", CalibrationError)
    known = fields.mapping(root, _KEYS)
    paper = fields.numbers(fields.required(known, "paper", root, "paper: [210, 297]"), 2)
    origin = fields.numbers(fields.required(known, "origin", root, "origin: [105, 153.5]"), 2)
    inside = fields.numbers(fields.required(known, "inside", root, "inside: [144, 221]"), 2)
    named = fields.required(known, "dictionary", root, "dictionary: DICT_4X4_50")
    dictionary = fields.text(named)
    try:
        named_dictionary(dictionary)
    except ConfigError as error:
        raise ConfigError(named.describe(one_line(str(error).removeprefix("dictionary: ")))) from error
    size = fields.positive(fields.required(known, "marker_size", root, "marker_size: 20"))
    listed = fields.items(fields.required(known, "markers", root, "markers: [[-87, -125.5]]"), "a list of x, y")
    centers = [fields.numbers(item, 2) for item in listed]
    if len(centers) < 4:
        known["markers"].fail(f"{len(centers)} markers, at least 4 are needed")
    if "ruler" in known:
        _check_ruler(known["ruler"])
    return Sheet(
        (paper[0], paper[1]),
        dictionary,
        size,
        tuple((center[0], center[1]) for center in centers),
        (inside[0], inside[1]),
        (origin[0], origin[1]),
    )


def _check_ruler(field: Field) -> None:
    known = fields.mapping(field, _RULER_KEYS)
    printed = fields.positive(fields.required(known, "printed", field, "printed: 100"))
    measured = fields.positive(fields.required(known, "measured", field, "measured: 100"))
    try:
        check_ruler(printed, measured)
    except CalibrationError as error:
        field.fail(str(error).removeprefix("ruler: "))


def write_target(path: str | Path, sheet: Sheet, prop: Prop) -> None:
    """Writes the sheet, with the object as a scene file's `occluders` say it."""
    markers = "\n".join(f"  - {_numbers(center)} # {identity}" for identity, center in enumerate(sheet.markers))
    text = f"""# A printed sheet, as torchlight target made it. Millimetres; x to the right and y up the page.
paper: {_numbers(sheet.paper)}
origin: {_numbers(sheet.origin)} # of x, y, counted from the page's lower left corner
inside: {_numbers(sheet.inside)} # clean white around the origin
dictionary: {sheet.dictionary}
marker_size: {sheet.marker_size:g}
markers: # middle of each marker, in the order of their ids
{markers}
ruler: # lay a ruler along the printed line and write down what it measures
  printed: {RULER_LENGTH:g}
  measured: {RULER_LENGTH:g}
occluders:
  - {_solid(prop)}
    rotation_degrees: [0, 0, {prop.turn_degrees:g}]
    translation: {_numbers((*prop.position, 0.0))}
"""
    write_atomically(path, text.encode())


def _solid(prop: Prop) -> str:
    if prop.shape == "box":
        return f"box: {_numbers(prop.size)}"
    return f"{prop.shape}: {{radius: {prop.size[0]:g}, height: {prop.size[1]:g}}}"


def _numbers(values: tuple[float, ...]) -> str:
    return f"[{', '.join(f'{value:.10g}' for value in values)}]"
