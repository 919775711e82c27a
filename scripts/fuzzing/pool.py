"""A process that reads inputs, with an end to its memory and to its patience; a new one follows one that died."""

from __future__ import annotations

import os
import resource
import sys
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from types import TracebackType

SECONDS = 10.0  # an input that takes longer hangs
MEMORY = 3 * 2**30  # bytes of address space beyond those of a process that has read nothing
SPOKEN = "spoken.txt"
VALID = "valid"  # folder of the inputs before they were made wrong
BEGIN = 120.0  # seconds for a process to start


class Reader:
    """Reads inputs one by one in another process."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder  # holds the files that inputs name
        self._context = get_context("spawn")
        self._start()

    def __enter__(self) -> Reader:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop()

    def read(self, name: str, data: bytes) -> str:
        """Returns "read", "refused", or what is wrong with how an input was read."""
        self._pipe.send((name, data))
        try:
            if self._pipe.poll(SECONDS):
                return self._pipe.recv()
            said = f"hangs: more than {SECONDS:g} s"
        except (EOFError, ConnectionError):
            self._process.join()
            spoken = (self._folder / SPOKEN).read_text(errors="replace").strip()[-200:]
            said = f"crashes: the process ended with {self._process.exitcode}: {spoken}"
        self._stop()
        self._start()
        return said

    def _start(self) -> None:
        self._pipe, other = self._context.Pipe()
        self._process = self._context.Process(target=serve, args=(other, str(self._folder)), daemon=True)
        self._process.start()
        other.close()
        if not self._pipe.poll(BEGIN):
            raise SystemExit("the reading process does not start")
        self._pipe.recv()

    def _stop(self) -> None:
        self._process.kill()
        self._process.join()


def serve(pipe: Connection, folder: str) -> None:
    """Reads inputs until the pipe is closed."""
    import torch

    from fuzzing.trial import outcome

    torch.set_num_threads(1)
    spoken = os.open(Path(folder) / SPOKEN, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    for stream in (sys.stdout, sys.stderr):  # libraries of pictures speak there
        os.dup2(spoken, stream.fileno())
    status = Path("/proc/self/status").read_text().splitlines()
    used = next(int(line.split()[1]) * 1024 for line in status if line.startswith("VmSize"))
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, used + MEMORY))
    valid = {file.name: file.read_bytes() for file in (Path(folder) / VALID).iterdir()}
    for name, data in valid.items():
        (Path(folder) / name).write_bytes(data)
    pipe.send("ready")
    while True:
        try:
            name, data = pipe.recv()
        except EOFError:
            return
        pipe.send(outcome(Path(folder), name, data))
        if name in valid:
            (Path(folder) / name).write_bytes(valid[name])
