"""The work on one trial, in whatever process it happens: measure, write; a trial ends as a folder or as a reason."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from torchlight.batch.ending import failure
from torchlight.batch.work import Report, peak_bytes
from torchlight.config import leaves
from torchlight.io.atomic import partial_folder
from torchlight.io.journal import Record
from torchlight.io.sweep_data import Synthetic, identity
from torchlight.results import versions
from torchlight.sweep.photographs import measure_photographs
from torchlight.sweep.provenance import git_commit
from torchlight.sweep.synthetic import Measured, measure_synthetic
from torchlight.sweep.trial import TRIAL, Trial, complete, folder_of
from torchlight.sweep.truth import TRUTH


def work(out: Path, trial: Trial) -> Report:
    """Returns what came of a trial, its folder on the disk; whatever stops it is its reason, and no other's."""
    try:
        found = measured(trial, out / TRUTH)
        write(out, trial, found)
    except Exception as error:  # noqa: BLE001 (a sweep outlives whatever one trial does)
        if not complete(out, trial.name):
            return Report((Record(trial.name, trial.digest, "failed", failure(error)),), {}, peak_bytes())
        found = Measured({}, {}, {})  # written by a process that was given up too early
    return Report((Record(trial.name, trial.digest, "done"),), found.seconds, peak_bytes())


def measured(trial: Trial, truth: Path) -> Measured:
    """Returns the figures of a trial."""
    if isinstance(trial.data, Synthetic):
        return measure_synthetic(trial.config, trial.data, truth)
    return measure_photographs(trial.config, trial.data)


def write(out: Path, trial: Trial, found: Measured) -> None:
    """Writes a trial's folder, whole or not at all; raises FormatError where that is not possible."""
    with partial_folder(folder_of(out, trial.name)) as folder:
        (folder / TRIAL).write_text(json.dumps(content(trial, found), indent=2, allow_nan=False) + "\n")


def content(trial: Trial, found: Measured) -> dict[str, Any]:
    """Returns what trial.json holds: everything that the figures follow from, the figures, and last the seconds."""
    return {
        "name": trial.name,
        "digest": trial.digest,
        "values": dict(trial.values),
        "configuration": dict(leaves(trial.config)),
        "data": identity(trial.data),
        "versions": versions(),
        "git_commit": git_commit(),
        "figures": found.figures,
        "each": found.each,
        "seconds": found.seconds,
    }
