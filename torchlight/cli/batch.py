"""`torchlight batch`: many photographs; each ends as a folder or a reason, and a restart goes on where it stopped."""

from __future__ import annotations

import functools
import os
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tqdm import tqdm

from torchlight.batch.blocks import named_shard
from torchlight.batch.local import on_processes
from torchlight.batch.run import Batch, Engine, Progress, finished, in_this_process, merge, run_batch
from torchlight.batch.table import PARQUET, counts, reasons, write_typed_table
from torchlight.cli import NOTHING_STARTED, arguments, fail
from torchlight.errors import ConfigError
from torchlight.io import parquet
from torchlight.io.manifest import Entry, read_entries
from torchlight.io.scene_file import load_scene

SOME_FAILED = 1
REASONS_SHOWN = 5
SECONDS_BETWEEN_LINES = 60.0
BAR = "{desc} {percentage:3.0f}% |{bar:30}| {n_fmt}/{total_fmt}, {rate_fmt}, {remaining} left{postfix}"


def run(command: arguments.Batch) -> int:
    """Returns 0 when every photograph is done, 1 when some failed or are pending, 2 when nothing could start.

    Raises:
        TorchlightError: nothing could start.
    """
    if command.merge is not None:
        return summarize(tables(command.merge, wants_parquet(command, command.merge)))
    if command.out is None:
        raise ConfigError("--out is missing; usage: torchlight batch MANIFEST|PATTERN --scene SCENE --out DIR")
    typed = wants_parquet(command, command.out)
    entries = read_entries(command.sources, command.scene)
    check_only_scene(entries)
    batch = Batch(tuple(entries), command.out, command.settings, named_shard(command.shard), command.retry_failed)
    last = followed(batch, engine_of(command))
    if not finished(command.out):
        print(
            f"{command.out}: {batch.shard.name} has ended; others are pending: torchlight batch --merge {command.out}"
        )
        return SOME_FAILED if last is not None and last.failed else 0
    code = summarize(tables(command.out, typed))
    if last is not None:
        print(cost(last))
    return code


def tables(out: Path, typed: bool) -> list[dict[str, Any]]:
    """Writes the tables of a batch, results.parquet among them where it is wanted, and returns their rows."""
    rows = merge(out)
    if typed:
        write_typed_table(out, rows)
    return rows


def wants_parquet(command: arguments.Batch, out: Path) -> bool:
    """Returns whether results.parquet is asked for, or there already: an old one would not agree with the others.

    Raises:
        ConfigError: it is wanted, and pyarrow is not installed.
    """
    wanted = command.parquet or (out / PARQUET).is_file()
    if wanted:
        parquet.installed()  # said before anything is written
    return wanted


def engine_of(command: arguments.Batch) -> Engine:
    """Returns what blocks are worked on with.

    Raises:
        ConfigError: a number of workers below 0, or an option of another engine.
    """
    if command.engine == "ray":
        from torchlight.batch.cluster import installed, on_ray

        installed()  # said before anything is written
        return functools.partial(on_ray, address=command.address, workers=command.workers)
    if command.address is not None:
        raise ConfigError("--address is for --engine ray; leave it away")
    workers = processors() if command.workers is None else command.workers
    if workers < 0:
        raise ConfigError(f"--workers: expected 0 (in this process) or more, got {workers}")
    return in_this_process if workers == 0 else functools.partial(on_processes, workers=workers)


def processors() -> int:
    """Returns the number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def check_only_scene(entries: Sequence[Entry]) -> None:
    """Raises what is wrong with the scene where all photographs are of one: they would all fail of it."""
    scenes = {entry.scene for entry in entries}
    if len(scenes) == 1:
        load_scene(scenes.pop())


def followed(batch: Batch, engine: Engine) -> Progress | None:
    """Does the batch and returns where it stood last; failures are one line each as they happen."""
    last: Progress | None = None
    steps = run_batch(batch, engine)
    first = next(steps, None)
    if first is None:
        return None
    with shown(first.total) as advance:
        for last in _chained(first, steps):
            if last.record.state == "failed":
                with tqdm.external_write_mode(file=sys.stderr):
                    fail(f"{last.record.name}: {last.record.reason}")
            advance(last)
    return last


def _chained(first: Progress, rest: Iterator[Progress]) -> Iterator[Progress]:
    yield first
    yield from rest


@contextmanager
def shown(total: int) -> Iterator[Any]:
    """Yields a function that shows where the batch stands: a bar on a terminal, elsewhere a line a minute."""
    terminal = sys.stderr.isatty()
    start = spoke = time.monotonic()
    with tqdm(total=total, desc="photographs", unit="photo", disable=not terminal, bar_format=BAR) as bar:

        def advance(now: Progress) -> None:
            nonlocal spoke
            bar.set_postfix_str(f"{now.failed} failed" if now.failed else "", refresh=False)
            bar.update(1)
            if not terminal and time.monotonic() - spoke > SECONDS_BETWEEN_LINES:
                spoke = time.monotonic()
                ended = now.done + now.failed
                left = (spoke - start) / ended * (total - ended)
                fail(f"{ended} of {total} photographs, {now.failed} failed, about {tqdm.format_interval(left)} left")

        yield advance


def summarize(rows: Sequence[Mapping[str, Any]]) -> int:
    """Prints how a batch ended, with the commonest reasons of failures, and returns the exit code."""
    count = counts(rows)
    pending = f", {count['pending']} pending" if count["pending"] else ""
    print(f"{count['done']} of {len(rows)} photographs done, {count['failed']} failed{pending}")
    found = reasons(rows)
    for reason, number in found[:REASONS_SHOWN]:
        print(f"  {number} x {reason}")
    if len(found) > REASONS_SHOWN:
        print(f"  and {len(found) - REASONS_SHOWN} other reasons; see the column 'reason' of results.csv")
    if count["failed"] == len(rows):
        return NOTHING_STARTED
    return SOME_FAILED if count["failed"] or count["pending"] else 0


def cost(last: Progress) -> str:
    """Returns where the time of all processes went, and the most memory that one held."""
    total = sum(last.seconds.values()) or 1.0
    parts = sorted(last.seconds.items(), key=lambda item: -item[1])
    shares = ", ".join(f"{stage} {seconds / total:.0%}" for stage, seconds in parts)
    return f"{total:.0f} s of work ({shares}); {last.peak_bytes / 2**20:,.0f} MiB at most in a process"
