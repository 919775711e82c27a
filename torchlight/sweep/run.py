"""A sweep from its file to its table: the story.

points  = search(sweep)                      all of a grid, some at random, or group by group from Optuna
trials  = settings at the points             named by what their figures follow from
pending = trials - complete - failed before  nothing is done twice
reports = engine(pending, work)              each trial's folder appears whole
journal += report.records                    done, or failed with the reason
answers = figures of the trials              what Optuna learns from
tables, plots
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from shutil import rmtree
from typing import Any

from torchlight.batch.local import Work
from torchlight.batch.work import Report
from torchlight.config import leaves
from torchlight.errors import ConfigError, FormatError
from torchlight.io.atomic import PARTIAL, check_writable, make_folder
from torchlight.io.batch_folder import JOURNAL, read_object, write_object
from torchlight.io.journal import Journal, Record, opened, records
from torchlight.io.sweep_data import identity
from torchlight.io.sweep_file import Sweep
from torchlight.results import versions
from torchlight.sweep.optuna_search import by_optuna
from torchlight.sweep.provenance import git_commit
from torchlight.sweep.search import Points, at_random, grid
from torchlight.sweep.trial import TRIAL, TRIALS, Trial, complete, folder_of, trial_at
from torchlight.sweep.work import work

SWEEP, SHARD = "sweep.json", "sweep"
Engine = Callable[[Iterable[Trial], Work[Trial]], Iterator[Report]]


@dataclass(frozen=True)
class Progress:
    """Where a sweep stands.

    Attributes:
        total: trials that are known so far.
        ended: of these, done or failed.
        record: of the trial that ended last.
    """

    total: int
    ended: int
    record: Record


def run_sweep(
    sweep: Sweep, out: Path, engine: Engine, retry: bool = False
) -> Generator[Progress, None, tuple[Trial, ...]]:
    """Yields where the sweep stands, trial by trial, and returns all trials; stop listening and it stops.

    Args:
        sweep: what is asked.
        out: folder of the results.
        engine: what trials are worked on with.
        retry: do what failed before again.

    Raises:
        ConfigError: the folder holds another sweep, or the search cannot begin.
        FormatError: the folder cannot be written, or another process works on it.
    """
    check_place(out)
    with opened(out / JOURNAL, SHARD) as journal:
        check_settings(sweep, out)
        remove_partial(out)
        known: dict[str, Trial] = {}
        points = search(sweep, out)
        answers: Sequence[float | None] | None = None
        while True:
            try:
                asked = next(points) if answers is None else points.send(answers)
            except StopIteration:
                return tuple(known.values())
            group = [trial_at(sweep, values) for values in asked]
            before = set(known)
            known |= {trial.name: trial for trial in group if trial.name not in known}
            fresh = [trial for name, trial in known.items() if name not in before]
            yield from do(fresh, len(known), journal, out, engine, retry)
            answers = [figure_of(out, trial.name, sweep.search.minimize) for trial in group]


def search(sweep: Sweep, out: Path) -> Points:
    """Returns the points that a sweep tries."""
    if sweep.search.kind == "optuna":
        return by_optuna(sweep, out)
    return grid(sweep) if sweep.search.kind == "grid" else at_random(sweep)


def do(
    trials: Sequence[Trial], total: int, journal: Journal, out: Path, engine: Engine, retry: bool
) -> Iterator[Progress]:
    """Does what is pending of some trials, and yields where the sweep stands."""
    ended = records(out / JOURNAL)
    for trial in trials:
        if complete(out, trial.name) and ended.get(trial.name, LOST).state != "done":
            journal.append(Record(trial.name, trial.digest, "done"))
    todo = [trial for trial in trials if pending(trial, out, ended, retry)]
    done = total - len(todo)
    for report in engine(todo, functools.partial(work, out)) if todo else ():
        for record in report.records:
            journal.append(record)
            done += 1
            yield Progress(total, done, record)


LOST = Record("", "", "failed")


def pending(trial: Trial, out: Path, ended: Mapping[str, Record], retry: bool) -> bool:
    """Returns whether a trial is to be done now."""
    if complete(out, trial.name):
        return False
    record = ended.get(trial.name)
    return record is None or record.state == "done" or retry  # done, but its folder was removed: again


def figure_of(out: Path, name: str, figure: str) -> float | None:
    """Returns a figure of a trial; None where it failed."""
    if not complete(out, name):
        return None
    return read_object(folder_of(out, name) / TRIAL)["figures"].get(figure)


def planned(sweep: Sweep, out: Path) -> list[Trial]:
    """Returns the trials of a grid or a random sweep; raises what is wrong with any of them."""
    return [] if sweep.search.kind == "optuna" else [trial_at(sweep, values) for values in next(search(sweep, out))]


# --- checks ----------------------------------------------------------------------------------------------------------


def check_place(out: Path) -> None:
    """Raises FormatError where results could not be written, or would lie among other things."""
    check_writable(out)
    if out.is_dir() and any(out.iterdir()) and not (out / SWEEP).is_file() and not (out / JOURNAL).is_dir():
        raise FormatError(f"{out}: is not empty and holds no sweep; choose another --out")
    make_folder(out)


def check_settings(sweep: Sweep, out: Path) -> None:
    """Writes sweep.json, or raises ConfigError where it holds another sweep; only `trials` may change."""
    path, asked = out / SWEEP, description(sweep)
    if path.is_file():
        before = read_object(path).get("asked")
        if not isinstance(before, dict):
            raise FormatError(f"{path}: holds no sweep; choose another --out")
        for key in asked | before:
            if key != "trials" and asked.get(key) != before.get(key):
                raise ConfigError(f"{out}: was begun with another '{key}'; use the same sweep, or another --out")
        if asked == before:
            return
    write_object(path, {"asked": asked, "versions": versions(), "git_commit": git_commit()})


def description(sweep: Sweep) -> dict[str, Any]:
    """Returns what a sweep asks, as JSON keeps it."""
    chosen = asdict(sweep.search)
    trials = chosen.pop("trials")
    axes = {key: {name: listed(value) for name, value in asdict(axis).items()} for key, axis in sweep.axes.items()}  # pyright: ignore[reportArgumentType]
    return {
        "trials": trials,
        "seed": sweep.seed,
        "search": chosen,
        "axes": axes,
        "base": dict(leaves(sweep.base)),
        "data": plain(identity(sweep.data)),
    }


def listed(value: Any) -> Any:
    """Returns a tuple as the list that JSON makes of it."""
    return list(value) if isinstance(value, tuple) else value


def plain(value: Any) -> Any:
    """Returns nested tuples as lists."""
    if isinstance(value, dict):
        return {key: plain(one) for key, one in value.items()}
    return [plain(one) for one in value] if isinstance(value, tuple | list) else value


def remove_partial(out: Path) -> None:
    """Removes what a killed process left half written."""
    with suppress(OSError):
        for left in (out / TRIALS).glob(f".*{PARTIAL}*"):
            rmtree(left, ignore_errors=True)
