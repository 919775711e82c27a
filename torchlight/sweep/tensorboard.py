"""Figures of trials as TensorBoard shows them (extra `tensorboard`): a run per trial, with its settings as text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from torchlight.errors import ConfigError
from torchlight.io.atomic import partial_folder
from torchlight.sweep.trial import Trial

FOLDER = "tensorboard"


def writer_class() -> Any:
    """Returns torch's writer of TensorBoard's files.

    Raises:
        ConfigError: TensorBoard is not installed.
    """
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError:
        raise ConfigError("--tensorboard: not installed; pip install 'torchlight[tensorboard]'") from None
    return SummaryWriter


def write_scalars(out: Path, trials: Sequence[Trial], rows: Sequence[Mapping[str, Any]]) -> None:
    """Writes the run of every trial that is done and has none yet."""
    make = writer_class()
    for trial, row in zip(trials, rows, strict=True):
        folder = out / FOLDER / trial.name
        if row["state"] != "done" or folder.exists():
            continue
        with partial_folder(folder) as partial, make(str(partial)) as writer:
            for key, value in row.items():
                if isinstance(value, int | float) and key not in trial.values:
                    writer.add_scalar(key, value)
            settings = "\n".join(f"    {key}: {value}" for key, value in trial.values.items())
            writer.add_text("settings", settings)
