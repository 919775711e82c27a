"""A line per trial: the axes' values, how it ended, its figures, and last the seconds."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from torchlight.io.batch_folder import JOURNAL, read_object, write_lines, write_table
from torchlight.io.journal import records
from torchlight.sweep.trial import TRIAL, Trial, complete, folder_of

SCORES = ("held_out_rms_255", "fit_rms_255")  # the first that there is


def write_tables(out: Path, trials: Sequence[Trial]) -> list[dict[str, Any]]:
    """Writes results.jsonl and results.csv, and returns their rows, in the order of the search."""
    rows = list(table(out, trials))
    write_lines(out / "results.jsonl", rows)
    write_table(out / "results.csv", rows)
    return rows


def table(out: Path, trials: Sequence[Trial]) -> Iterator[dict[str, Any]]:
    """Yields the row of every trial: done, failed (with the reason) or pending.

    A row holds the name, the axes' values, state and reason; of what is done also the figures, a column
    "held_out_rms_255.<light>" or "fit_rms_255.<photograph>" each, and seconds by stage.
    """
    ended = records(out / JOURNAL)
    for trial in trials:
        row: dict[str, Any] = {"name": trial.name, **trial.values}
        record = ended.get(trial.name)
        if complete(out, trial.name):
            yield {**row, "state": "done", "reason": "", **figures(out, trial.name)}
        elif record is not None and record.state == "failed":
            yield {**row, "state": "failed", "reason": record.reason}
        else:
            yield {**row, "state": "pending", "reason": ""}


def figures(out: Path, name: str) -> dict[str, Any]:
    """Returns the figures and seconds of a finished trial."""
    found = read_object(folder_of(out, name) / TRIAL)
    score = next(key for key in SCORES if key in found["figures"])
    each = {f"{score}.{one}": row[score] for one, row in found["each"].items()}
    return {**found["figures"], **each, **{f"seconds.{key}": value for key, value in found["seconds"].items()}}
