"""How a command's modules are loaded: all that takes long to import is imported here, in an order that saves time."""

from __future__ import annotations

import ctypes
import gc
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from threading import Thread
from types import ModuleType

SOLVING = ("estimate", "batch", "joint", "demo", "sweep")
M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3  # of malloc.h
KEPT = 2**30  # bytes


def loaded(name: str) -> ModuleType:
    """Returns a command's module with all that it needs.

    What importing makes stays to the end: the garbage collector need not look through it, neither meanwhile nor later.
    Commands that solve first import Numba, which does without torch; another thread loads torch's library meanwhile.
    """
    gc.disable()
    if name in SOLVING:
        keep_freed_memory()
        loading = Thread(target=load_library_of_torch)
        loading.start()
        # Numba would import it for the sake of np.dot, which no kernel calls
        with hidden("scipy.linalg"), suppress(ImportError):
            import_module("numba.np.arraymath")
        loading.join()
    module = import_module(f"torchlight.cli.{name}")
    gc.freeze()
    gc.enable()
    return module


def load_drawing() -> None:
    """Loads what draws pictures, without the manual that Matplotlib writes for its classes: a quarter of its import."""
    import_module("matplotlib.artist").kwdoc = lambda artist: ""
    import_module("torchlight.fates")


def load_library_of_torch() -> None:
    """Loads the largest library of torch, a fifth of its import; no other thread is held up meanwhile."""
    found = find_spec("torch")
    for folder in (found.submodule_search_locations if found else None) or []:
        for library in (Path(folder) / "lib").glob("libtorch_cpu.*"):
            with suppress(OSError):  # the import itself says what is wrong
                ctypes.CDLL(str(library))


def keep_freed_memory() -> None:
    """Has the C library keep up to 1 GiB of freed memory: else every large tensor gets new pages, which are cleared."""
    if sys.platform == "linux":
        mallopt = getattr(ctypes.CDLL(None), "mallopt", None)  # musl has none
        if mallopt is not None:
            mallopt(M_MMAP_THRESHOLD, KEPT)
            mallopt(M_TRIM_THRESHOLD, KEPT)


@contextmanager
def hidden(module: str) -> Iterator[None]:
    """Lets a module be missing while others are imported that ask for it."""
    if module in sys.modules:
        yield
        return
    sys.modules[module] = None  # pyright: ignore[reportArgumentType]  (what the import system documents for this)
    try:
        yield
    finally:
        del sys.modules[module]
