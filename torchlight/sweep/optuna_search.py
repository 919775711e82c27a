"""Points proposed by Optuna (extra `sweep`), which remembers them in a database: SQLite, or any that it can reach.

Points are proposed in groups of a fixed size, by a sampler that is seeded by the sweep's seed and the point's number,
and answers are told in the order of the questions. So neither the number of workers nor an interruption changes them.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from torchlight.errors import ConfigError
from torchlight.io.files import one_line
from torchlight.io.sweep_file import Axis, Choices, Sweep
from torchlight.sweep.search import Points

DATABASE = "optuna.db"
FOLDER = "folder"  # attribute of the points that belong to one output folder: others may share the study
HERE = "this"  # where the study lies in the folder itself, which may be moved


def by_optuna(sweep: Sweep, out: Path) -> Points:
    """Yields groups of points until the folder has `search.trials` of them; expects the figure of each, None = failed.

    Raises:
        ConfigError: Optuna is not installed, or its storage cannot be used.
    """
    optuna = imported()
    study = opened(optuna, sweep, out)
    owner = HERE if sweep.search.storage is None else str(out.resolve())
    trials, together = sweep.search.trials, sweep.search.together
    while True:
        asked = own(study, owner)
        if all(one.state.is_finished() for one in asked):
            if len(asked) >= trials:
                return
            wanted = len(asked) + together
        else:
            wanted = -(-len(asked) // together) * together  # the rest of a group that was cut short
        for number in range(len(asked), min(wanted, trials)):
            ask(optuna, study, sweep, number, owner)
        group = [one for one in own(study, owner) if not one.state.is_finished()]
        answers = yield [{key: one.params[key] for key in sweep.axes} for one in group]
        for one, figure in zip(group, answers, strict=True):
            tell(optuna, study, one.number, figure)


def own(study: Any, owner: str) -> Sequence[Any]:
    """Returns the points that were proposed for one output folder, in order."""
    return [one for one in study.get_trials() if one.user_attrs.get(FOLDER) == owner]


def imported() -> Any:
    """Returns Optuna, which speaks only of what is wrong."""
    try:
        import optuna  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise ConfigError("search.kind: optuna is not installed; pip install 'torchlight[sweep]'") from None
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    return optuna


def opened(optuna: Any, sweep: Sweep, out: Path) -> Any:
    """Returns the study that the sweep goes on with, made where there is none."""
    storage = sweep.search.storage
    url = f"sqlite:///{(out / DATABASE).resolve()}" if storage is None else storage
    try:
        return optuna.create_study(storage=url, study_name=sweep.source.stem, direction="minimize", load_if_exists=True)
    except Exception as error:  # an own kind of error per database
        raise ConfigError(f"{sweep.source}: search.storage: {url}: {one_line(str(error))}") from error


def ask(optuna: Any, study: Any, sweep: Sweep, number: int, owner: str) -> None:
    """Has a point proposed and stored."""
    study.sampler = optuna.samplers.TPESampler(seed=zlib.crc32(f"{sweep.seed} {number}".encode()))
    trial = study.ask()
    for key, axis in sweep.axes.items():
        suggest(trial, key, axis)
    trial.set_user_attr(FOLDER, owner)  # last: what a crash left half proposed belongs to nobody


def suggest(trial: Any, key: str, axis: Axis) -> None:
    """Has a value of one axis proposed."""
    if isinstance(axis, Choices):
        trial.suggest_categorical(key, axis.values)
    elif axis.whole:
        trial.suggest_int(key, int(axis.low), int(axis.high), log=axis.log)
    else:
        trial.suggest_float(key, axis.low, axis.high, log=axis.log)


def tell(optuna: Any, study: Any, number: int, figure: float | None) -> None:
    """Tells what came of a point; None = it failed."""
    if figure is None:
        study.tell(number, state=optuna.trial.TrialState.FAIL)
    else:
        study.tell(number, figure)
