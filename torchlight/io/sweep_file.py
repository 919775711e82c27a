"""Sweep files: which settings are tried, how they are searched, and what they are measured on.

seed: 0
search: {kind: grid}
base: {light: {method: adaptive}}
axes: {light.resolution: [8, 16, 32], data.noise: [0.0, 0.01]}
data: {synthetic: {lights: [sun_and_window], seen: {rotation_degrees: 20}, held_out: [{rotation_degrees: 69}]}}
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from torchlight.config import Config, leaves
from torchlight.io import fields
from torchlight.io.config_file import parsed, with_values
from torchlight.io.fields import Field
from torchlight.io.sweep_data import AXES_OF_SYNTHETIC, EXAMPLE, Data, Synthetic, read_data, whole, with_data
from torchlight.io.yaml_file import read_yaml

SWEEP_KEYS = ("seed", "search", "base", "axes", "data")
INTERVAL_KEYS = ("low", "high", "log")
KEYS_OF_SEARCH = {
    "grid": ("kind",),
    "random": ("kind", "trials"),
    "optuna": ("kind", "trials", "storage", "minimize", "together"),
}
METRICS_OF_SYNTHETIC = ("held_out_rms_255", "worst_rms_255", "fit_rms_255", "functions")
METRICS_OF_PHOTOGRAPHS = ("fit_rms_255", "worst_fit_rms_255", "functions")
TOGETHER = 4


@dataclass(frozen=True)
class Choices:
    """An axis of listed values."""

    values: tuple[Any, ...]


@dataclass(frozen=True)
class Interval:
    """An axis of all numbers between two, both included; integers where both are.

    Attributes:
        low: the smallest.
        high: the largest.
        log: equal ratios are equally likely, not equal differences.
    """

    low: int | float
    high: int | float
    log: bool = False

    @property
    def whole(self) -> bool:
        """Whether the axis holds integers."""
        return isinstance(self.low, int) and isinstance(self.high, int)


Axis = Choices | Interval


@dataclass(frozen=True)
class Search:
    """How points are chosen.

    Attributes:
        kind: grid, random or optuna.
        trials: how many; 0 = all, of a grid.
        storage: URL of Optuna's storage; None = SQLite in the output folder.
        minimize: the figure that Optuna makes small.
        together: points that Optuna proposes before it learns what came of any.
    """

    kind: str
    trials: int = 0
    storage: str | None = None
    minimize: str = METRICS_OF_SYNTHETIC[0]
    together: int = TOGETHER


@dataclass(frozen=True)
class Sweep:
    """What is asked.

    Attributes:
        source: the file.
        seed: of the search, and of the noise.
        search: how points are chosen.
        base: settings that are no axis.
        axes: from settings to values.
        data: what every trial is measured on.
    """

    source: Path
    seed: int
    search: Search
    base: Config
    axes: Mapping[str, Axis]
    data: Data

    def at(self, values: Mapping[str, Any]) -> tuple[Config, Data]:
        """Returns configuration and data of a point."""
        data = {key: value for key, value in values.items() if key in AXES_OF_SYNTHETIC}
        settings = {key: value for key, value in values.items() if key not in data}
        return with_values(self.base, settings, self.source), with_data(self.data, data, self.source)


def metrics_of(data: Data) -> tuple[str, ...]:
    """Returns the figures that a trial can be judged by, the usual one first."""
    return METRICS_OF_SYNTHETIC if isinstance(data, Synthetic) else METRICS_OF_PHOTOGRAPHS


def read_sweep(path: str | Path, root: Path | None = None) -> Sweep:
    """Returns what a sweep file asks.

    Args:
        path: the file.
        root: folder that the lights' names are relative to; None = that of the file.

    Raises:
        FormatError: a file is missing, or not YAML.
        ConfigError: an unknown key (with a suggestion), a wrong type, or an axis that a setting cannot take.
    """
    path = Path(path)
    document, _ = read_yaml(path)
    top = Field(document, path, "")
    known = fields.mapping(top, SWEEP_KEYS)
    seed = whole(known["seed"]) if "seed" in known else 0
    base = parsed(Config(), known["base"]) if "base" in known else Config()
    data = read_data(fields.required(known, "data", top, EXAMPLE), seed, root)
    search = read_search(fields.required(known, "search", top, "search: {kind: grid}"), data)
    axes = read_axes(fields.required(known, "axes", top, "axes: {light.resolution: [8, 16, 32]}"), search)
    sweep = Sweep(path, seed, search, base, axes, data)
    for key, axis in axes.items():
        for value in ends(axis):
            sweep.at({key: value})  # says what the setting cannot take
    return sweep


def read_search(field: Field, data: Data) -> Search:
    """Returns how points are chosen."""
    every = tuple(dict.fromkeys(key for keys in KEYS_OF_SEARCH.values() for key in keys))
    known = fields.mapping(field, every)
    kind = fields.choice(fields.required(known, "kind", field, "kind: grid"), tuple(KEYS_OF_SEARCH))
    known = fields.mapping(field, KEYS_OF_SEARCH[kind])
    if kind == "grid":
        return Search(kind)
    trials = counted(fields.required(known, "trials", field, "trials: 40"))
    if kind == "random":
        return Search(kind, trials)
    metrics = metrics_of(data)
    return Search(
        kind,
        trials,
        fields.text(known["storage"]) if "storage" in known else None,
        fields.choice(known["minimize"], metrics) if "minimize" in known else metrics[0],
        counted(known["together"]) if "together" in known else TOGETHER,
    )


def read_axes(field: Field, search: Search) -> dict[str, Axis]:
    """Returns the axes, in the file's order."""
    known = [path for path, _ in leaves(Config())]
    axes = {key: read_axis(one) for key, one in fields.mapping(field, (*known, *AXES_OF_SYNTHETIC)).items()}
    if not axes:
        field.fail("expected at least one axis; for example 'light.resolution: [8, 16, 32]'")
    for key, axis in axes.items():
        if search.kind == "grid" and isinstance(axis, Interval):
            field.fail(f"{key}: a grid takes listed values, such as [8, 16, 32]; an interval wants random or optuna")
    return axes


def read_axis(field: Field) -> Axis:
    """Returns an axis: a list of values, or a mapping with low and high."""
    if isinstance(field.value, dict):
        known = fields.mapping(field, INTERVAL_KEYS)
        low = bound(fields.required(known, "low", field, "{low: 20, high: 450, log: true}"))
        high = bound(fields.required(known, "high", field, "{low: 20, high: 450, log: true}"))
        log = known["log"].value if "log" in known else False
        if not isinstance(log, bool):
            known["log"].wrong_type("true or false")
        if low >= high or (log and low <= 0):
            field.fail(f"expected low below high{', both above 0,' if log else ''}, got {low} and {high}")
        return Interval(low, high, log)
    values = [item.value for item in fields.items(field, "a list of values, or {low: 20, high: 450, log: true}")]
    if not values or any(isinstance(value, dict | list) for value in values):
        field.wrong_type("a list of values")
    if len({(type(value), value) for value in values}) < len(values):
        field.fail("lists a value twice; keep one")
    return Choices(tuple(values))


def bound(field: Field) -> int | float:
    """Returns a finite number as it stands: an integer stays one."""
    number = fields.number(field)
    return field.value if isinstance(field.value, int) else number


def counted(field: Field) -> int:
    """Returns an integer of at least 1."""
    if whole(field) == 0:
        field.wrong_type("an integer of at least 1")
    return whole(field)


def ends(axis: Axis) -> tuple[Any, ...]:
    """Returns the values that tell whether a setting can take an axis."""
    return axis.values if isinstance(axis, Choices) else (axis.low, axis.high)
