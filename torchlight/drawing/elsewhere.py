"""Pictures drawn by a process of their own, where one was begun; else by the one that asks.

Importing Matplotlib and drawing two pictures takes as long as solving for a light, and holds the interpreter lock all
the while: another thread would gain nothing. The other process imports no torch, and ends when this one does.
"""

from __future__ import annotations

import gc
import os
import pickle
import signal
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # the command line imports this module before it knows whether there is anything to draw
    from torchlight.drawing.content import Content

GONE = (OSError, EOFError, ValueError, pickle.PickleError)  # of a process that has ended, or never came up
_begun: list[Other] = []


class Other:
    """A process that draws, and the thread that speaks to it: one picture after another."""

    def __init__(self) -> None:
        # finds modules where this process does: in the working directory only if this one does
        served = f"import sys; sys.path[:] = {sys.path!r}; from {__name__} import serve; serve()"
        self.process = subprocess.Popen(  # noqa: S603  (this very Python)
            [sys.executable, "-c", served],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
        )
        self.thread = ThreadPoolExecutor(1)

    def picture(self, content: Content) -> bytes:
        """Returns a picture; drawn by this process where the other has gone."""
        try:
            pickle.dump(content, self.process.stdin)  # pyright: ignore[reportArgumentType]  (a pipe, as asked for)
            self.process.stdin.flush()  # pyright: ignore[reportOptionalMemberAccess]
            return pickle.load(self.process.stdout)  # noqa: S301  # pyright: ignore[reportArgumentType]
        except GONE:
            return draw(content)

    def end(self) -> None:
        """Ends the process, whatever it is at; it would end by itself, but a little after this one."""
        self.process.kill()
        self.thread.shutdown(cancel_futures=True)
        for pipe in (self.process.stdin, self.process.stdout):
            with suppress(OSError):  # what was asked for and not read
                pipe.close()  # pyright: ignore[reportOptionalMemberAccess]
        self.process.wait()


def begin() -> None:
    """Begins the process, where there is a processor for it."""
    processors = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if processors > 1 and not _begun:
        with suppress(OSError):
            _begun.append(Other())


def end() -> None:
    """Ends the process, if there is one."""
    while _begun:
        _begun.pop().end()


def begun() -> bool:
    """Returns whether there is such a process."""
    return bool(_begun)


def drawn(content: Content) -> Callable[[], bytes]:
    """Returns what waits for a picture: drawn meanwhile where a process was begun, else when asked for."""
    if _begun:
        return _begun[0].thread.submit(_begun[0].picture, content).result
    return partial(draw, content)


def draw(content: Content) -> bytes:
    """Returns a picture as PNG bytes, drawn here and now."""
    from torchlight.drawing.content import FitContent
    from torchlight.drawing.fates import draw_fates  # with Matplotlib, which nothing else of this module needs
    from torchlight.drawing.fit import draw_fit

    return draw_fit(content) if isinstance(content, FitContent) else draw_fates(content)


def load() -> None:
    """Loads what draws, without the manual that Matplotlib writes for its classes: a quarter of its import.

    For a process in which nobody will read that manual.
    """
    setattr(import_module("matplotlib.artist"), "kwdoc", lambda artist: "")  # noqa: B010  (a module has any attribute)
    import_module("torchlight.drawing.fates")
    import_module("torchlight.drawing.fit")


def serve() -> None:
    """Draws what comes by standard input until it ends, and writes the pictures to standard output.

    Ctrl-C is for the process that began this one, which ends it.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    gc.disable()
    load()
    with suppress(EOFError, OSError):  # whoever asked has gone
        while True:
            pickle.dump(draw(pickle.load(sys.stdin.buffer)), sys.stdout.buffer)  # noqa: S301  (of who began this one)
            sys.stdout.buffer.flush()
