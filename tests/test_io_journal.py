"""Journals: what is written stays, what was cut off is nothing, and one process writes at a time."""

from __future__ import annotations

from pathlib import Path

import pytest

from torchlight.errors import FormatError
from torchlight.io.journal import Record, opened, records

DONE = Record("a", "1", "done")
FAILED = Record("b", "2", "failed", "b.jpg: truncated")


def test_what_is_appended_is_read(tmp_path: Path) -> None:
    with opened(tmp_path, "shard-1-of-1") as journal:
        journal.append(DONE)
        assert records(tmp_path) == {"a": DONE}
        journal.append(FAILED)
    assert records(tmp_path) == {"a": DONE, "b": FAILED}


def test_every_way_of_being_cut_off_leaves_the_lines_before(tmp_path: Path) -> None:
    with opened(tmp_path, "s") as journal:
        journal.append(DONE)
        journal.append(FAILED)
    path = tmp_path / "s.jsonl"
    whole = path.read_bytes()
    first = whole.index(b"\n") + 1
    for length in range(first, len(whole)):
        path.write_bytes(whole[:length])
        expected = {"a": DONE} if length < len(whole) - 1 else {"a": DONE, "b": FAILED}
        assert records(tmp_path) == expected
        with opened(tmp_path, "s") as journal:
            journal.append(FAILED)
        assert records(tmp_path) == {"a": DONE, "b": FAILED}


@pytest.mark.parametrize(
    "line", [b"{}", b"[]", b"nonsense", b"\xff\x00", b'{"name": "a", "entry": "1", "state": "odd"}']
)
def test_a_line_that_is_no_record_is_passed_over(tmp_path: Path, line: bytes) -> None:
    with opened(tmp_path, "s") as journal:
        journal.append(DONE)
    with (tmp_path / "s.jsonl").open("ab") as file:
        file.write(line + b"\n")
    assert records(tmp_path) == {"a": DONE}


def test_done_stays_done_whatever_other_shards_say(tmp_path: Path) -> None:
    for shard, record in (("s1", DONE), ("s2", Record("a", "1", "failed", "x"))):
        with opened(tmp_path, shard) as journal:
            journal.append(record)
    assert records(tmp_path) == {"a": DONE}


def test_a_failure_may_be_done_later(tmp_path: Path) -> None:
    with opened(tmp_path, "s") as journal:
        journal.append(FAILED)
        journal.append(Record("b", "2", "done"))
    assert records(tmp_path)["b"].state == "done"


def test_two_processes_do_not_share_a_shard(tmp_path: Path) -> None:
    with (
        opened(tmp_path, "shard-1-of-2"),
        pytest.raises(FormatError, match="shard-1-of-2 is being worked on by another process"),
        opened(tmp_path, "shard-1-of-2"),
    ):
        pass
    with opened(tmp_path, "shard-1-of-2"), opened(tmp_path, "shard-2-of-2"):
        pass


def test_a_full_disk_is_said(tmp_path: Path) -> None:
    Path(tmp_path / "s.jsonl").symlink_to("/dev/full")
    with opened(tmp_path, "s") as journal, pytest.raises(FormatError, match="No space left on device"):
        journal.append(DONE)
