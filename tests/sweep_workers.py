"""Work for the processes of a pool, one trial each."""

from __future__ import annotations

import os
import signal

from torchlight.batch.work import Report
from torchlight.io.journal import Record
from torchlight.sweep.trial import Trial


def dies_of_noise(trial: Trial) -> Report:
    """Kills its process where a trial has the noise 0.01, as one that exhausts the memory does."""
    if trial.values["data.noise"] == 0.01:
        os.kill(os.getpid(), signal.SIGKILL)
    return Report((Record(trial.name, trial.digest, "done"),), {}, 0)
