"""What every benchmark states alike: the machine, its threads, seconds, peak memory; as a Markdown table and as CSV.

A row is a dictionary. One that was measured beside a peer has these columns, which scripts/draw_performance.py reads
from every file: "case" (what was done), "peer" (by whom as well), "ratio" (the peer's seconds over ours) and, where a
ratio is aimed at, "asked".
"""

from __future__ import annotations

import csv
import os
import platform
import resource
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

Result = TypeVar("Result")
Row = Mapping[str, object]
OUT = Path("out/bench")


@dataclass(frozen=True)
class Cost:
    """What something took.

    Attributes:
        wall: seconds that one waits for it.
        processor: seconds of processor time, summed over threads: what it takes on a machine busy with other things.
    """

    wall: float
    processor: float


def clocked(task: Callable[[], Result]) -> tuple[Result, Cost]:
    """Returns what a task returns, and its cost."""
    wall, processor = time.perf_counter(), time.process_time()
    result = task()
    return result, Cost(time.perf_counter() - wall, time.process_time() - processor)


def best(task: Callable[[], Result], runs: int) -> tuple[Result, Cost]:
    """Returns what a task returns, and the least wall and the least processor time of some runs."""
    result, cost = clocked(task)
    for _ in range(runs - 1):
        result, again = clocked(task)
        cost = Cost(min(cost.wall, again.wall), min(cost.processor, again.processor))
    return result, cost


def peak_gib() -> float:
    """Returns the largest resident memory that this process, or any one of its children, has had so far, in GiB."""
    kibibytes = max(resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return kibibytes / 2**20


def processor_name() -> str:
    """Returns what the processor calls itself."""
    about = Path("/proc/cpuinfo")
    lines = about.read_text().splitlines() if about.is_file() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def machine(threads: int) -> str:
    """Returns the machine in one line."""
    return f"{processor_name()}, {os.cpu_count()} processors, {threads} threads"


def markdown(rows: Sequence[Row]) -> str:
    """Returns rows as a table; a column that a row does not have stays empty."""
    names = columns(rows)
    lines = [names, ["---"] * len(names), *([cell(row.get(name)) for name in names] for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def cell(value: object) -> str:
    """Returns a value as a table shows it."""
    if isinstance(value, float):
        return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.3g}"
    if isinstance(value, int) and not isinstance(value, bool):
        return f"{value:,}"
    return "" if value is None else str(value)


def columns(rows: Sequence[Row]) -> list[str]:
    """Returns the names of all columns, in the order of their first appearance."""
    return list(dict.fromkeys(name for row in rows for name in row))


def save(name: str, rows: Sequence[Row], threads: int, out: Path = OUT) -> Path:
    """Prints the machine and the peak memory, writes OUT/name.csv and returns its path.

    Every row of the file also has the machine, the threads and the peak memory.
    """
    where = machine(threads)
    stated = {"machine": where, "threads": threads, "peak memory of the run, GiB": round(peak_gib(), 3)}
    full = [{**row, **stated} for row in rows]
    out.mkdir(parents=True, exist_ok=True)
    path = out / f"{name}.csv"
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, fieldnames=columns(full))
        writer.writeheader()
        writer.writerows(full)
    print(f"\n{where}; peak memory of the run {peak_gib():.2f} GiB; {path}")
    return path
