"""A batch killed at random moments and resumed: what an observer sees meanwhile, and what is there in the end."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import threading
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

from faults.small_batch import Case, digest, fingerprints, journal_lines, leftovers

LIGHTS = frozenset({"light.exr", "light.hdr", "light.png", "confidence.exr"})
FILES = LIGHTS | {"estimate.safetensors", "timing.json", "result.json"}
WORKERS_KILLED = 0.25  # share of the kills at which a worker goes first, and the parent a little later
EARLY = 0.3  # share of the kills that come before the call has written anything
PATIENCE = 60.0  # seconds, on a machine busy with other things too, for workers to follow their parent


@dataclass
class Observer:
    """Lists an output while it is written.

    Attributes:
        out: the output.
        seen: digests of the files of every folder, with its inode, as it was when first visible.
        looks: how often it was listed.
        wrong: what was visible and not complete.
    """

    out: Path
    seen: dict[str, tuple[int, dict[str, str]]] = field(default_factory=dict)
    looks: int = 0
    wrong: list[str] = field(default_factory=list)

    def watch(self, stop: threading.Event) -> None:
        """Looks until told to stop."""
        while not stop.is_set():
            self.look()
            time.sleep(0.002)

    def look(self) -> None:
        """Looks once."""
        self.looks += 1
        photos = self.out / "photos"
        names = visible(photos)
        for name in names:
            folder = photos / name
            if name not in self.seen:
                files = {path.name for path in folder.iterdir()}
                self.wrong += [] if files == FILES else [f"{name} holds {sorted(files)}"]
                found = {file: digest(folder / file) for file in files}
                self.seen[name] = folder.stat().st_ino, found
        for file in ("batch.json", "results.jsonl", "manifest.jsonl"):
            self.check_lines(self.out / file, whole=file == "batch.json")

    def check_lines(self, path: Path, whole: bool) -> None:
        """Notes a file that is there and is not JSON."""
        try:
            text = path.read_text()
            for document in [text] if whole else text.splitlines():
                json.loads(document)
        except FileNotFoundError:
            return
        except ValueError:
            self.wrong.append(path.name)

    def changed(self) -> list[str]:
        """Returns photographs whose folder is another one, or holds other bytes, than when it was first visible."""
        return [
            name
            for name, (inode, files) in self.seen.items()
            if (self.out / "photos" / name).stat().st_ino != inode
            or any(digest(self.out / "photos" / name / file) != before for file, before in files.items())
        ]


@dataclass(frozen=True)
class Struck:
    """What came of the kills.

    Attributes:
        parents: killed while there was work left.
        workers: killed before them.
        rounds: calls until the batch was done, the last one undisturbed.
        looks: of the observer.
        partial: what was visible and not complete.
        rewritten: photographs whose folder was written again.
        twice: photographs that the journal says were done more than once.
        left: hidden things that lie in the output when all is done.
        different: files that differ from an undisturbed run's.
        files: that were compared.
    """

    parents: int
    workers: int
    rounds: int
    looks: int
    partial: list[str]
    rewritten: list[str]
    twice: list[str]
    left: list[str]
    different: list[str]
    files: int

    @property
    def good(self) -> bool:
        """Nothing partial, nothing twice, nothing left, nothing different."""
        return not (self.partial or self.rewritten or self.twice or self.left or self.different)


@dataclass(frozen=True)
class Pace:
    """Seconds until an undisturbed run has written its first photograph, and from then to its end."""

    start: float
    work: float


def pace(case: Case, out: Path) -> Pace:
    """Runs a batch that nobody disturbs and returns its pace."""
    begun, first = time.monotonic(), None
    with subprocess.Popen(
        case.command(out, "--workers", "1"), env=case.environment(), stdout=subprocess.DEVNULL
    ) as run:
        while run.poll() is None:
            first = time.monotonic() if first is None and complete(out) else first
            time.sleep(0.01)
    if run.returncode != 0 or first is None:
        raise SystemExit(f"the undisturbed run ended with {run.returncode}")
    return Pace(first - begun, time.monotonic() - first)


def complete(out: Path) -> int:
    """Returns how many photographs are visible in an output."""
    return len(visible(out / "photos"))


def visible(photos: Path) -> list[str]:
    """Returns the names of the folders of photographs that are not hidden."""
    return [path.name for path in photos.iterdir() if not path.name.startswith(".")] if photos.is_dir() else []


def struck(case: Case, out: Path, undisturbed: Path, kills: int, seed: int, usual: Pace) -> Struck:
    """Kills a batch at random moments, lets it end, and returns what that did.

    Moments are uniform: those of `EARLY` within the usual time until the first photograph, the others within a time
    after the call's first new photograph that leaves work for all of them.

    Args:
        case: the batch.
        out: its output.
        undisturbed: the output of a run that nobody disturbed.
        kills: how often the parent is killed.
        seed: of the moments.
        usual: pace of the undisturbed run.
    """
    longest = 1.2 * usual.work / kills
    chance, observer, stop = random.Random(seed), Observer(out), threading.Event()
    watching = threading.Thread(target=observer.watch, args=(stop,), daemon=True)
    watching.start()
    parents = workers = 0
    for number in range(kills):
        early, first = chance.random() < EARLY, chance.random() < WORKERS_KILLED
        moment = Moment(not early, chance.uniform(0.0, usual.start if early else longest), first)
        ended, killed = one_kill(case, out, moment, 1 + number % 2)
        parents, workers = parents + ended, workers + killed
        print(f"  kill {number + 1}: {moment.words}, {complete(out)} photographs complete", flush=True)
    last = case.run(out, "--workers", "2")
    stop.set()
    watching.join()
    observer.look()
    if last.returncode != 0:
        raise SystemExit(f"the last run ended with {last.returncode}: {last.stderr}")
    now, expected = fingerprints(out), fingerprints(undisturbed)
    counted = Counter(line["name"] for line in journal_lines(out))
    return Struck(
        parents,
        workers,
        kills + 1,
        observer.looks,
        observer.wrong,
        observer.changed(),
        [name for name, count in counted.items() if count > 1],
        leftovers(out),
        [name for name in {**now, **expected} if now.get(name) != expected.get(name)],
        len(expected),
    )


@dataclass(frozen=True)
class Moment:
    """When a call is killed: seconds after its start, or after its first new photograph; and whether a worker first."""

    writing: bool
    seconds: float
    worker_first: bool

    @property
    def words(self) -> str:
        """For a line of the log."""
        since = "the first new photograph" if self.writing else "the start"
        return f"{self.seconds:.2f} s after {since}" + (", a worker before" if self.worker_first else "")


def one_kill(case: Case, out: Path, moment: Moment, workers: int) -> tuple[bool, bool]:
    """Starts a batch, kills it, waits until its workers are gone; returns whether parent and worker were alive."""
    quiet, before, killed = subprocess.DEVNULL, complete(out), False
    with subprocess.Popen(
        case.command(out, "--workers", str(workers)),
        env=case.environment(),
        stdout=quiet,
        stderr=quiet,
        start_new_session=True,
    ) as process:
        while moment.writing and process.poll() is None and complete(out) == before:
            time.sleep(0.002)
        time.sleep(moment.seconds / 2)
        if moment.worker_first:
            children = children_of(process.pid)
            killed = bool(children)
            if children:
                os.kill(children[-1], signal.SIGKILL)
        time.sleep(moment.seconds / 2)
        alive = process.poll() is None
        process.kill()
    wait_for_group(process.pid)
    return alive, killed


def children_of(parent: int) -> list[int]:
    """Returns the processes that a process has started, but the one that only counts its semaphores."""
    try:
        listed = Path(f"/proc/{parent}/task/{parent}/children").read_text().split()
    except OSError:
        return []
    return [int(child) for child in listed if b"spawn_main" in command_line(int(child))]


def command_line(process: int) -> bytes:
    """Returns the command line of a process, empty where it is gone."""
    try:
        return Path(f"/proc/{process}/cmdline").read_bytes()
    except OSError:
        return b""


def wait_for_group(leader: int) -> None:
    """Returns when no process of a group is left."""
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        try:
            os.killpg(leader, 0)
        except ProcessLookupError:
            return
        time.sleep(0.05)
    raise SystemExit("the workers outlived their parent")
