"""`torchlight sweep`: settings tried one after the other; each ends as a folder or a reason, a restart goes on."""

from __future__ import annotations

import functools
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from tqdm import tqdm

from torchlight.batch.local import Work, answers
from torchlight.batch.work import Report
from torchlight.cli import NOTHING_STARTED, arguments, fail
from torchlight.cli.batch import SOME_FAILED, processors
from torchlight.errors import ConfigError
from torchlight.io.sweep_file import Sweep, read_sweep
from torchlight.sweep.plots import score_of, write_plots
from torchlight.sweep.run import Engine, planned, run_sweep
from torchlight.sweep.table import write_tables
from torchlight.sweep.tensorboard import write_scalars, writer_class
from torchlight.sweep.trial import Trial


def run(command: arguments.Sweep) -> int:
    """Returns 0 when every trial is done, 1 when some failed, 2 when nothing could start or all failed.

    Raises:
        TorchlightError: nothing could start.
    """
    sweep = read_sweep(command.sweep, command.data)
    engine = engine_of(command)
    if command.tensorboard:
        writer_class()
    trials = followed(sweep, command, engine)
    rows = write_tables(command.out, trials)
    if command.tensorboard:
        write_scalars(command.out, trials, rows)
    for path in (command.out / "results.csv", *write_plots(command.out, sweep, rows)):
        print(path)
    return summarize(sweep, rows)


def engine_of(command: arguments.Sweep) -> Engine:
    """Returns what trials are worked on with.

    Raises:
        ConfigError: a number of workers below 0, or an option of another engine.
    """
    if command.engine == "ray":
        from torchlight.batch.cluster import pieces_on_ray

        return functools.partial(pieces_on_ray, address=command.address, workers=command.workers)
    if command.address is not None:
        raise ConfigError("--address is for --engine ray")
    workers = processors() if command.workers is None else command.workers
    if workers < 0:
        raise ConfigError(f"--workers: expected 0 (in this process) or more, got {workers}")
    return in_this_process if workers == 0 else functools.partial(answers, workers=workers)


def in_this_process(trials: Iterable[Trial], work: Work[Trial]) -> Iterator[Report]:
    """Yields a report per trial, worked on here."""
    return map(work, trials)


def followed(sweep: Sweep, command: arguments.Sweep, engine: Engine) -> tuple[Trial, ...]:
    """Does the sweep and returns its trials; failures are one line each as they happen."""
    total = sweep.search.trials or len(planned(sweep, command.out))
    steps = run_sweep(sweep, command.out, engine, command.retry_failed)
    with tqdm(total=total, desc="trials", unit="trial", disable=not sys.stderr.isatty()) as bar:
        while True:
            try:
                step = next(steps)
            except StopIteration as end:
                return end.value
            if step.record.state == "failed":
                with tqdm.external_write_mode(file=sys.stderr):
                    fail(f"{step.record.name}: {step.record.reason}")
            bar.update(step.ended - bar.n)


def summarize(sweep: Sweep, rows: Sequence[Mapping[str, Any]]) -> int:
    """Prints how a sweep ended and its best trial, and returns the exit code."""
    done = [row for row in rows if row["state"] == "done"]
    print(f"{len(done)} of {len(rows)} trials done, {len(rows) - len(done)} failed")
    if not done:
        return NOTHING_STARTED
    score = score_of(done)
    best = min(done, key=lambda row: row[score])
    settings = ", ".join(f"{key} = {best[key]}" for key in sweep.axes)
    print(f"least {score}: {best[score]:.2f} at {settings} ({best['functions']:g} functions, trial {best['name']})")
    return SOME_FAILED if len(done) < len(rows) else 0
