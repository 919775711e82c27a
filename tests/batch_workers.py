"""Work for the processes of a pool: what it answers, and what it dies of."""

from __future__ import annotations

import os
import signal
from pathlib import Path

from torchlight.batch.blocks import Block
from torchlight.batch.work import Report
from torchlight.io.journal import Record


def answer(block: Block) -> Report:
    """Returns that everything is done."""
    return Report(tuple(Record(entry.name, entry.digest, "done") for entry in block.pending), {"solve": 1.0}, 1)


def dies_once(flag: Path, name: str, block: Block) -> Report:
    """Kills its process when it first meets a photograph, as an administrator may."""
    if any(entry.name == name for entry in block.pending) and not flag.exists():
        flag.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return answer(block)


def dies_of(name: str, block: Block) -> Report:
    """Kills its process whenever it meets a photograph, as one that exhausts the memory does."""
    if any(entry.name == name for entry in block.pending):
        os.kill(os.getpid(), signal.SIGKILL)
    return answer(block)
