"""Values of a configuration file that know where they stand, so that every error names file and key."""

from __future__ import annotations

import difflib
import math
import reprlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NoReturn

import torch
from jaxtyping import Float
from torch import Tensor

from torchlight.errors import ConfigError, TorchlightError
from torchlight.io.files import one_line

_SHORT = reprlib.Repr()
_SHORT.maxlevel, _SHORT.maxlist, _SHORT.maxdict = 2, 4, 4
_SHORT.maxstring, _SHORT.maxlong, _SHORT.maxother = 60, 40, 60
_MISSING = object()


@dataclass(frozen=True, eq=False)
class Field:
    """One value and its place.

    Attributes:
        value: as read from the file.
        file: the file.
        key: path such as `occluders[1].box`; empty for the whole document.
        error: class of the errors about values out of range; wrong types are always a ConfigError.
    """

    value: object
    file: Path
    key: str
    error: type[TorchlightError] = ConfigError

    def fail(self, message: str) -> NoReturn:
        """Raises this field's error class with file, key and message."""
        raise self.error(self.describe(message))

    def describe(self, message: str) -> str:
        """Returns one line: file, key and message."""
        return f"{self.file}: {self.key}: {message}" if self.key else f"{self.file}: {message}"

    def wrong_type(self, expected: str) -> NoReturn:
        """Raises ConfigError: expected this, got that."""
        raise ConfigError(self.describe(f"expected {expected}, got {shown(self.value)}"))


def shown(value: object) -> str:
    """Returns a value for a message: one line, shortened."""
    return "nothing" if value is None else one_line(_SHORT.repr(value), 120)


def mapping(field: Field, known: Sequence[str]) -> dict[str, Field]:
    """Returns the fields of a mapping; raises ConfigError for anything else and for keys that are not known."""
    if not isinstance(field.value, dict):
        field.wrong_type(f"a mapping with keys among {', '.join(known)}")
    for key in field.value:
        if key not in known:
            near = difflib.get_close_matches(str(key), known, n=1)
            advice = f"did you mean '{near[0]}'?" if near else f"known keys: {', '.join(known)}"
            raise ConfigError(_child(field, str(key)).describe(f"unknown key; {advice}"))
    return {key: replace(_child(field, key), value=value) for key, value in field.value.items()}


def required(fields: dict[str, Field], key: str, parent: Field, example: str) -> Field:
    """Returns a field that must be there; raises ConfigError that shows an example otherwise."""
    if key not in fields:
        raise ConfigError(_child(parent, key).describe(f"missing; for example '{example}'"))
    return fields[key]


def items(field: Field, expected: str) -> list[Field]:
    """Returns the fields of a list."""
    if not isinstance(field.value, list):
        field.wrong_type(expected)
    return [replace(field, value=value, key=f"{field.key}[{index}]") for index, value in enumerate(field.value)]


def text(field: Field) -> str:
    """Returns non-empty text."""
    if not isinstance(field.value, str) or not field.value.strip():
        field.wrong_type("text")
    return field.value


def choice(field: Field, options: Sequence[str]) -> str:
    """Returns one of the options."""
    if field.value not in options:
        field.wrong_type(" or ".join(options))
    return str(field.value)


def number(field: Field) -> float:
    """Returns a finite number."""
    if isinstance(field.value, bool) or not isinstance(field.value, int | float):
        field.wrong_type("a number")
    try:
        value = float(field.value)
    except OverflowError:
        value = math.inf
    if not math.isfinite(value):
        field.fail(f"expected a finite number, got {shown(field.value)}")
    return value


def positive(field: Field) -> float:
    """Returns a finite number above 0."""
    value = number(field)
    if value <= 0:
        field.fail(f"expected a number above 0, got {shown(field.value)}")
    return value


def numbers(field: Field, count: int) -> tuple[float, ...]:
    """Returns a list of exactly `count` finite numbers."""
    return tuple(number(item) for item in _exactly(field, count, "numbers"))


def integers(field: Field, count: int) -> tuple[int, ...]:
    """Returns a list of exactly `count` integers."""
    parts = _exactly(field, count, "integers")
    for part in parts:
        if isinstance(part.value, bool) or not isinstance(part.value, int):
            part.wrong_type("an integer")
    return tuple(int(str(part.value)) for part in parts)


def matrix(field: Field, rows: int, columns: int) -> Float[Tensor, "rows columns"]:
    """Returns a list of `rows` lists of `columns` finite numbers as a float64 matrix."""
    lines = _exactly(field, rows, f"rows of {columns} numbers")
    return torch.tensor([numbers(line, columns) for line in lines], dtype=torch.float64)


def _exactly(field: Field, count: int, what: str) -> list[Field]:
    if not isinstance(field.value, list) or len(field.value) != count:
        field.wrong_type(f"a list of {count} {what}")
    return items(field, what)


def _child(field: Field, key: str) -> Field:
    name = one_line(key, 60)
    return replace(field, value=_MISSING, key=f"{field.key}.{name}" if field.key else name)
