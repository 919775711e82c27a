"""A batch from its manifest to its tables: the story of many photographs.

entries  = read_entries(manifest)               what is asked
check    = batch.json                           the same settings as before, or a clear refusal
pending  = entries - complete - failed before   nothing is done twice
blocks   = of one scene, always the same        solved together
reports  = engine(blocks, work)                 each photograph's folder appears whole
journal += report.records                       done, or failed with the reason
tables   = results.jsonl, results.csv, report.html
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from shutil import rmtree
from typing import Any

from torchlight.batch.blocks import WHOLE, Block, Shard, blocks
from torchlight.batch.report import write_report
from torchlight.batch.table import record_of_complete, write_tables
from torchlight.batch.work import Report, Task, complete, folder_of, work
from torchlight.config import Config, leaves
from torchlight.errors import ConfigError, FormatError
from torchlight.io.atomic import PARTIAL, check_writable, make_folder
from torchlight.io.batch_folder import BATCH, JOURNAL, MANIFEST, PHOTOS, read_object, write_lines, write_object
from torchlight.io.journal import Journal, Record, opened, records
from torchlight.io.manifest import Entry, as_row, read_entries
from torchlight.results import versions

UNUSED = "; it holds no result and may be removed"
Engine = Callable[[Iterable[Block], Task], Iterator[Report]]


@dataclass(frozen=True)
class Batch:
    """What is asked.

    Attributes:
        entries: the photographs.
        out: folder of the results.
        config: the settings.
        shard: the part that is done here.
        retry: do what failed before again.
    """

    entries: tuple[Entry, ...]
    out: Path
    config: Config
    shard: Shard = WHOLE
    retry: bool = False


@dataclass(frozen=True)
class Progress:
    """Where a batch stands.

    Attributes:
        total: photographs of this shard that were to be done now.
        done: of these, so far.
        failed: likewise.
        record: of the photograph that ended last.
        seconds: of all processes, by stage.
        peak_bytes: most memory that a process has held.
    """

    total: int
    done: int
    failed: int
    record: Record
    seconds: Mapping[str, float]
    peak_bytes: int


def run_batch(batch: Batch, engine: Engine) -> Generator[Progress, None, None]:
    """Yields where the batch stands, photograph by photograph; stop listening and it stops, complete so far.

    Raises:
        ConfigError: the folder holds a batch with other settings, or a photograph of another file.
        FormatError: the folder cannot be written, or another process works on the shard.
    """
    check_place(batch.out)
    with opened(batch.out / JOURNAL, batch.shard.name) as journal:
        todo = begun(batch, journal)
        total = sum(len(block.pending) for block in todo)
        done, failed, seconds, peak = 0, 0, dict[str, float](), 0
        for report in engine(todo, Task(batch.out, batch.config)):
            peak = max(peak, report.peak_bytes)
            seconds = added(seconds, report.seconds)
            for record in report.records:
                journal.append(record)
                done, failed = done + (record.state == "done"), failed + (record.state == "failed")
                yield Progress(total, done, failed, record, seconds, peak)
        remove_partial(batch)  # of workers that were killed while they wrote


def begun(batch: Batch, journal: Journal) -> list[Block]:
    """Returns the blocks that are to be done now; checks what was done before, and tidies up what was killed."""
    check_settings(batch)
    write_lines(batch.out / MANIFEST, map(as_row, batch.entries))
    ended = records(batch.out / JOURNAL)
    check_names(batch.entries, ended)
    for entry in batch.entries:
        if entry.name not in ended and complete(batch.out, entry.name):
            journal.append(record_of_complete(entry))
    remove_partial(batch)
    wanted = frozenset(entry.name for entry in batch.entries if pending(batch, entry, ended))
    return blocks(batch.entries, batch.shard, wanted)


def added(one: Mapping[str, float], other: Mapping[str, float]) -> dict[str, float]:
    """Returns the sum of seconds by stage."""
    return {key: one.get(key, 0.0) + other.get(key, 0.0) for key in {**one, **other}}


def pending(batch: Batch, entry: Entry, ended: Mapping[str, Record]) -> bool:
    """Returns whether a photograph is to be done now."""
    if complete(batch.out, entry.name):
        return False
    record = ended.get(entry.name)
    return record is None or record.state == "done" or batch.retry  # done, but its folder was removed: again


def merge(out: Path) -> list[dict[str, Any]]:
    """Writes the tables of a batch, and its report, from its folder alone and returns their rows.

    Raises:
        FormatError: the folder holds no batch.
    """
    if not (out / BATCH).is_file():
        raise FormatError(f"{out}: holds no batch (no {BATCH}); name the --out of torchlight batch")
    rows = write_tables(out, read_entries([str(out / MANIFEST)], None))
    write_report(out, rows)
    return rows


def finished(out: Path) -> bool:
    """Returns whether a batch has no pending photograph left, of any shard."""
    entries = read_entries([str(out / MANIFEST)], None)
    ended = records(out / JOURNAL)
    return all(entry.name in ended or complete(out, entry.name) for entry in entries)


# --- checks ----------------------------------------------------------------------------------------------------------


def check_place(out: Path) -> None:
    """Raises FormatError where results could not be written, or would lie among other things."""
    check_writable(out)
    if out.is_dir() and any(out.iterdir()) and not (out / BATCH).is_file() and not (out / JOURNAL).is_dir():
        raise FormatError(f"{out}: is not empty and holds no batch; choose another --out")
    make_folder(out)


def check_settings(batch: Batch) -> None:
    """Writes batch.json, or raises ConfigError where it holds other settings than these."""
    asked = dict(leaves(batch.config))
    path = batch.out / BATCH
    if not path.is_file():
        write_object(path, {"configuration": asked, "versions": versions()})
        return
    before = read_object(path).get("configuration")
    if not isinstance(before, dict):
        raise FormatError(f"{path}: holds no configuration; choose another --out")
    for key in asked | before:
        if asked.get(key) != before.get(key):
            raise ConfigError(
                f"{batch.out}: was begun with {key} = {before.get(key)}, not {asked.get(key)}; "
                f"use the same settings, or another --out{'' if (batch.out / PHOTOS).exists() else UNUSED}"
            )


def check_names(entries: Sequence[Entry], ended: Mapping[str, Record]) -> None:
    """Raises ConfigError where a name stood for another photograph before."""
    for entry in entries:
        record = ended.get(entry.name)
        if record is not None and record.entry != entry.digest:
            raise ConfigError(
                f"{entry.name}: was another photograph, scene, mask or exposure when this batch began; "
                "choose another --out, or give it another 'name'"
            )


def remove_partial(batch: Batch) -> None:
    """Removes what killed processes left of the shard's photographs."""
    everything = blocks(batch.entries, batch.shard, frozenset(entry.name for entry in batch.entries))
    folders = {folder_of(batch.out, entry.name) for block in everything for entry in block.entries}
    for parent in {folder.parent for folder in folders}:
        with suppress(OSError):
            for left in parent.glob(f".*{PARTIAL}*"):
                if parent / left.name[1:].rpartition(PARTIAL)[0] in folders:
                    rmtree(left, ignore_errors=True)


def in_this_process(todo: Iterable[Block], task: Task) -> Iterator[Report]:
    """Yields a report per block, worked on here: the simplest engine."""
    return map(functools.partial(work, task), todo)
