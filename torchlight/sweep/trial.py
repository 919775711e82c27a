"""One point of a sweep: its settings, its name, its place."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from torchlight.config import Config, leaves
from torchlight.io.files import sha256_of
from torchlight.io.journal import Record
from torchlight.io.sweep_data import Data, identity
from torchlight.io.sweep_file import Sweep

TRIALS, TRIAL = "trials", "trial.json"
NAME_DIGITS = 12


@dataclass(frozen=True, eq=False)
class Trial:
    """Settings and what they are measured on.

    Attributes:
        values: of the axes.
        config: all settings.
        data: with the axes' values.
    """

    values: Mapping[str, Any]
    config: Config
    data: Data

    @cached_property
    def digest(self) -> str:
        """Of everything that the figures follow from, in hexadecimal: the same point has the same in every sweep."""
        settings = {"configuration": dict(leaves(self.config)), "data": identity(self.data)}
        return sha256_of(json.dumps(settings, sort_keys=True).encode())

    @property
    def name(self) -> str:
        """Of the trial's folder."""
        return self.digest[:NAME_DIGITS]

    def parts(self) -> Sequence[Trial]:
        """Returns the trial: it is done as a whole."""
        return [self]

    def lost(self, why: str) -> tuple[Record, ...]:
        """Returns its failure."""
        return (Record(self.name, self.digest, "failed", why),)


def trial_at(sweep: Sweep, values: Mapping[str, Any]) -> Trial:
    """Returns the trial at a point of the axes."""
    config, data = sweep.at(values)
    return Trial(dict(values), config, data)


def folder_of(out: Path, name: str) -> Path:
    """Returns the folder of a trial."""
    return out / TRIALS / name


def complete(out: Path, name: str) -> bool:
    """Returns whether a trial's folder is there: folders appear whole."""
    return (folder_of(out, name) / TRIAL).is_file()
