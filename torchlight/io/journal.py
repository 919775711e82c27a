"""Journals: one line of JSON per photograph that ended, appended and forced to the disk before the next.

{"name": "day1/IMG_0412", "entry": "9f2c...", "state": "failed", "reason": "IMG_0412.jpg: truncated ..."}

A photograph without a line is pending. A line cut off by a crash is no line. Time plays no part in it: clocks jump.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import BinaryIO, Literal

from filelock import FileLock, Timeout

from torchlight.errors import FormatError
from torchlight.io.atomic import make_folder
from torchlight.io.files import MAX_BYTES, read_bytes, reason

State = Literal["done", "failed"]
SUFFIX, LOCK = ".jsonl", ".lock"


@dataclass(frozen=True)
class Record:
    """How one photograph ended.

    Attributes:
        name: of its folder.
        entry: digest of what was asked (`Entry.digest`).
        state: done, or failed.
        reason: of a failure, one line; else empty.
    """

    name: str
    entry: str
    state: State
    reason: str = ""


class Journal:
    """A shard's journal, open for appending; `opened` makes it."""

    def __init__(self, path: Path, file: BinaryIO) -> None:
        self._path, self._file = path, file

    def append(self, record: Record) -> None:
        """Appends a record; when this returns, it is on the disk.

        Raises:
            FormatError: the disk is full, or the file cannot be written.
        """
        line = json.dumps(asdict(record), ensure_ascii=True) + "\n"
        try:
            self._file.write(line.encode())  # unbuffered and appending: one write, whole lines beside each other
            os.fsync(self._file.fileno())
        except OSError as error:
            raise FormatError(
                f"{self._path}: the journal cannot be written: {reason(error)}; "
                "free some space and run the same command again: nothing that is complete is lost"
            ) from error


@contextmanager
def opened(folder: Path, shard: str) -> Iterator[Journal]:
    """Yields the journal of a shard, which no other process has meanwhile.

    Raises:
        FormatError: another process works on the shard, or the folder cannot be written.
    """
    make_folder(folder)
    path = folder / f"{shard}{SUFFIX}"
    lock = FileLock(folder / f"{shard}{LOCK}")
    try:
        lock.acquire(timeout=0)
    except Timeout:
        raise FormatError(f"{folder}: {shard} is being worked on by another process; wait for it, or stop it") from None
    except OSError as error:
        raise FormatError(f"{folder}: cannot be locked: {reason(error)}; choose another --out") from error
    try:
        with appending(path) as file:
            yield Journal(path, file)
    finally:
        lock.release()


@contextmanager
def appending(path: Path) -> Iterator[BinaryIO]:
    """Yields a file open for appending, at the start of a line even where the last one was cut off."""
    try:
        file = path.open("ab+", buffering=0)
    except OSError as error:
        raise FormatError(f"{path}: cannot be written: {reason(error)}; choose another --out") from error
    with file:
        if file.seek(0, os.SEEK_END) > 0:
            file.seek(-1, os.SEEK_END)
            if file.read(1) != b"\n":
                file.write(b"\n")
        yield file


def records(folder: Path) -> dict[str, Record]:
    """Returns the record of every photograph in a folder's journals, of whatever shards: done, else the last failure.

    Lines that are no record are left out: their photographs are pending, or complete on the disk.
    """
    found: dict[str, Record] = {}
    for path in sorted(folder.glob(f"*{SUFFIX}")):
        if path.stat().st_size == 0:
            continue
        for line in read_bytes(path, MAX_BYTES).splitlines():
            record = parsed(line)
            if record is not None and not (record.name in found and found[record.name].state == "done"):
                found[record.name] = record
    return found


def parsed(line: bytes) -> Record | None:
    """Returns the record of a line, None where it holds none."""
    try:
        record = Record(**json.loads(line))
    except (ValueError, TypeError, RecursionError):
        return None
    texts = (record.name, record.entry, record.reason)
    whole = record.state in ("done", "failed") and all(isinstance(text, str) for text in texts)
    return record if whole else None
