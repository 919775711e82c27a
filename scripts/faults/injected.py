"""Faults put into a batch of twelve photographs, one by one, and what became of them.

Each function returns an `Outcome`. It is good where every photograph that the fault concerns is in the journal with a
reason, where all others end as in a run without the fault, byte for byte, and where nothing partial is left.
"""

from __future__ import annotations

import os
import re
import resource
import shutil
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path

from faults.kills import children_of, complete
from faults.small_batch import Case, fingerprints, journal_lines, leftovers, made, reasons

COUNT = 12
FILE_LIMIT = 6_000  # bytes; the journal of twelve photographs is smaller, their folders' files are not
CLOCK = """import random, time
_time, _random = time.time, random.Random(1)
time.time = lambda: _time() + _random.choice((-1e9, 0.0, 1e9))
"""
FAR = 4_000_000_000  # seconds since the epoch: the year 2096


@dataclass(frozen=True)
class Outcome:
    """What became of a fault.

    Attributes:
        fault: what it was.
        happened: in a few words, with the first reason of the journal.
        good: it ended as it should.
    """

    fault: str
    happened: str
    good: bool


@cache
def undisturbed(folder: Path) -> tuple[Case, Path]:
    """Returns a batch without any fault, and its output; made once."""
    case = made(folder / "whole", "texels", COUNT)
    said = case.run(folder / "whole" / "out", "--workers", "1")
    if said.returncode != 0:
        raise SystemExit(said.stderr)
    return case, folder / "whole" / "out"


def fresh(folder: Path) -> Case:
    """Returns a copy of the batch without a fault, at the same depth, for a fault of its own."""
    case, _ = undisturbed(folder.parent)
    shutil.copytree(case.photos, folder / "photos")
    shutil.copy(case.scene, folder)
    return Case(folder, case.method)


def same_but(folder: Path, out: Path, without: Iterable[str]) -> bool:
    """Returns whether photographs other than some ended as without the fault; names of files are left out."""
    names = [f"p{index:03d}" for index in range(COUNT) if f"p{index:03d}" not in set(without)]
    now, expected = fingerprints(out, names), fingerprints(undisturbed(folder.parent)[1], names)
    texts = {file for file in expected if file.endswith(".json")}  # they name the photograph's place
    alike = all(now.get(file) == digest for file, digest in expected.items() if file not in texts)
    return alike and now.keys() == expected.keys() and not leftovers(out)


def ended(
    fault: str, folder: Path, out: Path, failed: Iterable[str], said: subprocess.CompletedProcess[str]
) -> Outcome:
    """Returns the outcome of a fault that should cost some photographs and no others."""
    found, expected = reasons(out), sorted(failed)
    lines = len(journal_lines(out))
    first = re.sub(r"\S*/", "", found[min(found)])[:90] if found else ""
    good = sorted(found) == expected and all(found.values()) and same_but(folder, out, expected) and lines == COUNT
    good = good and said.returncode == (1 if expected else 0) and "Traceback" not in said.stderr + said.stdout
    return Outcome(fault, f"exit {said.returncode}, {len(found)} failed" + (f": {first}" if first else ""), good)


def wrong_photograph(fault: str, spoil: Callable[[Path], object], folder: Path) -> Outcome:
    """One photograph that cannot be read."""
    case = fresh(folder)
    spoil(case.photos / "p003.png")
    return ended(fault, folder, folder / "out", ["p003"], case.run(folder / "out", "--workers", "1"))


def truncated(photo: Path) -> None:
    """Keeps the first half."""
    data = photo.read_bytes()
    photo.write_bytes(data[: len(data) // 2])


def replaced(make: Callable[[Path], object], photo: Path) -> None:
    """Puts something else in a photograph's place."""
    photo.unlink()
    make(photo)


def flipped(file: Path) -> None:
    """Flips one bit in the middle."""
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 1
    file.write_bytes(data)


def folder_in_place(folder: Path) -> Outcome:
    """A folder where a photograph is listed: a manifest names it, since patterns leave folders out."""
    case = fresh(folder)
    replaced(Path.mkdir, case.photos / "p003.png")
    listed = folder / "list.csv"
    listed.write_text("photo,name\n" + "".join(f"photos/p{i:03d}.png,p{i:03d}\n" for i in range(COUNT)))
    said = case.run(folder / "out", "--workers", "1", source=str(listed))
    return ended("a folder in a photograph's place", folder, folder / "out", ["p003"], said)


def place_taken(folder: Path) -> Outcome:
    """A file of somebody else's where a result belongs."""
    case = fresh(folder)
    (folder / "out" / "journal").mkdir(parents=True)
    (folder / "out" / "photos").mkdir()
    (folder / "out" / "photos" / "p003").write_text("not a folder")
    said = case.run(folder / "out", "--workers", "1")
    (folder / "out" / "photos" / "p003").unlink()
    return ended("a file in a result's place", folder, folder / "out", ["p003"], said)


def full_for_results(folder: Path) -> Outcome:
    """No file may grow: every result fails, with the reason; with room again --retry-failed does them all."""
    case, out = fresh(folder), folder / "out"
    said = case.run(out, "--workers", "1", before=partial(limit_files, FILE_LIMIT))
    found = reasons(out)
    good = len(found) == COUNT and all("cannot be written" in text for text in found.values()) and not leftovers(out)
    again = case.run(out, "--workers", "1", "--retry-failed")
    good = good and again.returncode == 0 and same_but(folder, out, ()) and "Traceback" not in said.stderr
    first = re.sub(r"\S*/", "", next(iter(found.values()), ""))[:70]
    return Outcome(
        "no room for results, then room", f"exit {said.returncode}, {len(found)} failed: {first}; retried", good
    )


def limit_files(size: int) -> None:
    """Ends the growth of the files of a process and its children."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))


def full_for_journal(folder: Path) -> Outcome:
    """The journal lies on a full disk: the batch stops in one line; with room again it goes on."""
    case, out = fresh(folder), folder / "out"
    (out / "journal").mkdir(parents=True)
    (out / "journal" / "shard-1-of-1.jsonl").symlink_to("/dev/full")
    said = case.run(out, "--workers", "1")
    (out / "journal" / "shard-1-of-1.jsonl").unlink()
    again = case.run(out, "--workers", "1")
    good = "No space left on device" in said.stderr and "Traceback" not in said.stderr and said.returncode not in (0, 1)
    good = good and again.returncode == 0 and same_but(folder, out, ()) and len(journal_lines(out)) == COUNT
    return Outcome(
        "no room for the journal, then room", f"exit {said.returncode}: {said.stderr.strip()[-80:]}; resumed", good
    )


def worker_killed(folder: Path) -> Outcome:
    """A worker killed while it writes: its photographs are done again, and what it had begun is removed."""
    case, out = fresh(folder), folder / "out"
    struck: list[int] = []
    with subprocess.Popen(
        case.command(out, "--workers", "2"), env=case.environment(), stdout=subprocess.PIPE, stderr=subprocess.STDOUT
    ) as run:
        while run.poll() is None and not (complete(out) and leftovers(out)):  # until one is just being written
            time.sleep(0.001)
        for child in children_of(run.pid)[-1:]:
            os.kill(child, signal.SIGKILL)
            struck.append(child)
        text = run.communicate()[0].decode()
    said = subprocess.CompletedProcess([], run.returncode, text, "")
    one = ended("a worker killed at work", folder, out, [], said)
    return Outcome(one.fault, f"{one.happened}; {len(struck)} killed", one.good and len(struck) == 1)


def cache_flipped(folder: Path) -> Outcome:
    """A bit of the cached transport flipped: it is noticed, said and computed again."""
    case, out = fresh(folder), folder / "out"
    case.run(folder / "before", "--workers", "1")
    files = list((folder / "cache").glob("*.safetensors"))
    for file in files:
        flipped(file)
    one = ended("a bit of the cache flipped", folder, out, [], said := case.run(out, "--workers", "1"))
    warned = "ignored and computed again" in said.stderr
    return Outcome(one.fault, f"{one.happened}, " + ("said and computed again" if warned else "nothing said"),
                   one.good and bool(files) and warned)  # fmt: skip


def clock_jumps(folder: Path) -> Outcome:
    """Clocks that jump by thirty years, and files from the future, over a batch that is killed and resumed."""
    case, out = fresh(folder), folder / "out"
    (folder / "clock").mkdir()
    (folder / "clock" / "sitecustomize.py").write_text(CLOCK)
    variables = {"PYTHONPATH": str(folder / "clock")}
    case.run(folder / "before", "--workers", "1", variables=variables)
    for file in [*case.photos.iterdir(), case.scene, *(folder / "cache").iterdir()]:
        os.utime(file, (FAR, FAR))
    with subprocess.Popen(case.command(out, "--workers", "1"), env=case.environment(**variables)) as run:
        killer = threading.Timer(60, run.kill)
        killer.start()
        while run.poll() is None and not complete(out):
            time.sleep(0.002)
        run.kill()
        killer.cancel()
    time.sleep(1)
    for file in out.rglob("*"):
        os.utime(file, (FAR, FAR), follow_symlinks=False)
    said = case.run(out, "--workers", "1", variables=variables)
    return ended("clocks that jump, files from the future", folder, out, [], said)


FAULTS: tuple[Callable[[Path], Outcome], ...] = (
    partial(wrong_photograph, "a truncated photograph", truncated),
    partial(wrong_photograph, "an empty photograph", lambda photo: photo.write_bytes(b"")),
    partial(wrong_photograph, "a bit of a photograph flipped", flipped),
    partial(wrong_photograph, "a link that leads nowhere", partial(replaced, lambda photo: photo.symlink_to("gone"))),
    partial(wrong_photograph, "a link that leads to itself", partial(replaced, lambda photo: photo.symlink_to(photo))),
    partial(wrong_photograph, "a pipe in a photograph's place", partial(replaced, os.mkfifo)),
    folder_in_place,
    place_taken,
    full_for_results,
    full_for_journal,
    worker_killed,
    cache_flipped,
    clock_jumps,
)
