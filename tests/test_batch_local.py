"""Processes of this machine: one that dies costs at most the photograph that killed it."""

from __future__ import annotations

import functools
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from batch_case import QUICK, fingerprints, write_photos, write_scene
from batch_workers import answer, dies_of, dies_once

from torchlight.batch.blocks import WHOLE, Block, blocks
from torchlight.batch.local import DIED, Work, answers
from torchlight.batch.run import Batch, in_this_process, merge, run_batch
from torchlight.io.manifest import Entry, read_entries


def some_blocks(count: int) -> list[Block]:
    entries = [Entry(f"{i}", Path(f"{i}.jpg"), Path("s.yaml")) for i in range(count)]
    return blocks(entries, WHOLE, frozenset(entry.name for entry in entries))


def states(work: Work, count: int, workers: int = 2) -> dict[str, str]:
    reports = answers(some_blocks(count), work, workers)
    return {record.name: record.reason for report in reports for record in report.records}


def test_every_block_is_answered_once() -> None:
    reports = list(answers(some_blocks(40), answer, 2))
    names = [record.name for report in reports for record in report.records]
    assert sorted(names) == sorted(str(i) for i in range(40))


def test_a_process_that_is_killed_costs_nothing(tmp_path: Path) -> None:
    found = states(functools.partial(dies_once, tmp_path / "flag", "9"), 40)
    assert found == {str(i): "" for i in range(40)}


def test_a_photograph_that_kills_its_process_costs_itself() -> None:
    found = states(functools.partial(dies_of, "9"), 10)
    assert found.pop("9") == f"9.jpg: {DIED}"
    assert found == {str(i): "" for i in range(10) if i != 9}


BATCH = """
import sys
from pathlib import Path
sys.path.insert(0, {tests!r})
from batch_case import QUICK
from torchlight.batch.local import on_processes
from torchlight.batch.run import Batch, run_batch
from torchlight.io.manifest import read_entries
import functools
if __name__ == "__main__":
    entries = read_entries([{photos!r}], Path({scene!r}))
    for step in run_batch(Batch(tuple(entries), Path({out!r}), QUICK), functools.partial(on_processes, workers=2)):
        print(step.record.name, flush=True)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="kills with a signal")
def test_a_batch_whose_parent_is_killed_goes_on_and_ends_like_another(tmp_path: Path) -> None:
    scene = write_scene(tmp_path / "scene.yaml")
    write_photos(tmp_path / "photos", scene, 24)
    pattern, out = str(tmp_path / "photos" / "*.png"), tmp_path / "out"
    entries = tuple(read_entries([pattern], scene))
    for _ in run_batch(Batch(entries, tmp_path / "whole", QUICK), in_this_process):
        pass
    code = BATCH.format(tests=str(Path(__file__).parent), photos=pattern, scene=str(scene), out=str(out))
    (tmp_path / "batch.py").write_text(code)
    call = [sys.executable, str(tmp_path / "batch.py")]
    with subprocess.Popen(call, stdout=subprocess.PIPE, text=True, start_new_session=True) as process:
        assert process.stdout is not None
        first = process.stdout.readline().strip()
        process.send_signal(signal.SIGKILL)
    assert first
    wait_for_end_of_group(process.pid)
    rest = [step.record.name for step in run_batch(Batch(entries, out, QUICK), in_this_process)]
    assert first not in rest
    merge(out)
    merge(tmp_path / "whole")
    assert fingerprints(out) == fingerprints(tmp_path / "whole")
    assert (out / "results.csv").read_bytes() == (tmp_path / "whole/results.csv").read_bytes()


def wait_for_end_of_group(leader: int) -> None:
    """Returns when no process of a group is left: children end with their parent; fails after ten seconds."""
    for _ in range(100):
        try:
            os.killpg(leader, 0)
        except ProcessLookupError:
            return
        time.sleep(0.1)
    raise AssertionError("the workers outlived their parent")
