"""How a command's modules are loaded: all that takes long to import is imported here, in an order that saves time."""

from __future__ import annotations

import ctypes
import gc
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from threading import Thread
from types import ModuleType, SimpleNamespace

from torchlight.cli import arguments

SOLVING = ("estimate", "batch", "joint", "demo", "sweep")
# tyro checks the defaults of options by it, which is for tests to do: a twentieth of a second to import
TYPEGUARD = SimpleNamespace(check_type=lambda value, kind: value, TypeCheckError=TypeError)
DRAWING = "torchlight.drawing.elsewhere"
# what torch does to tensors without values ("meta"), for its compilers: a third of its import
UNASKED = "torch._meta_registrations"
# of malloc.h: how much of the heap's end is kept, from which size on a tensor gets pages of its own (no more is
# allowed), and how many heaps there are for threads to share
MALLOPT = {"M_TRIM_THRESHOLD": (-1, 2**29), "M_MMAP_THRESHOLD": (-3, 2**25), "M_ARENA_MAX": (-8, 2)}


def loaded(command: arguments.Command) -> ModuleType:
    """Returns the module of a command with all that it needs.

    What importing makes stays to the end: the garbage collector need not look through it, neither meanwhile nor later.
    Commands that solve first import Numba, which does without torch, whose library is loaded meanwhile (`begin`).
    """
    gc.disable()
    name = type(command).__name__.lower()
    if name == "estimate":
        keep_freed_memory()
    if name in SOLVING:
        # Numba would import it for the sake of np.dot, which no kernel calls
        with hidden("scipy.linalg"), suppress(ImportError):
            import_module("numba.np.arraymath")
    if asks_little(command):
        with postponed(UNASKED):
            import_module("torch")
    module = import_module(f"torchlight.cli.{name}")
    gc.freeze()
    gc.enable()
    return module


def asks_little(command: arguments.Command) -> bool:
    """Returns whether a command is an estimate whose work is done by compiled code, so that torch need not be whole.

    All else is given all of torch: its random generators, its transforms and its own operators do not work without.
    """
    if not isinstance(command, arguments.Estimate):
        return False
    return command.settings.light.method == "adaptive" and command.settings.compute.device in ("auto", "cpu")


def begin(words: Sequence[str]) -> None:
    """Begins what the command of a process will need: torch's library, on a thread, and a process that draws."""
    if words and words[0] in SOLVING and not {"-h", "--help"} & set(words):
        Thread(target=load_library_of_torch, daemon=True).start()
        if words[0] == "estimate" and "--skip-pictures" not in words:
            import_module(DRAWING).begin()


def end() -> None:
    """Ends what `begin` began; pictures that were asked for have come."""
    if DRAWING in sys.modules:
        sys.modules[DRAWING].end()


def load_library_of_torch() -> None:
    """Loads the largest library of torch, a fifth of its import; no other thread is held up meanwhile."""
    found = find_spec("torch")
    for folder in (found.submodule_search_locations if found else None) or []:
        for library in (Path(folder) / "lib").glob("libtorch_cpu.*"):
            with suppress(OSError):  # the import itself says what is wrong
                ctypes.CDLL(str(library))


def keep_freed_memory() -> None:
    """Has the C library keep what tensors free for those that come: new pages must be cleared first.

    That is a fifth of a second of an estimate. For a process that ends soon.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None) if sys.platform == "linux" else None  # musl has none
    if mallopt is not None:
        for parameter, value in MALLOPT.values():
            mallopt(parameter, value)


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


@contextmanager
def postponed(module: str, instead: object = None) -> Iterator[None]:
    """Gives who imports a module meanwhile an empty one, or what is to stand in for it; who asks later gets it whole.

    Args:
        module: its full name.
        instead: what stands in.
    """
    if module in sys.modules:
        yield
        return
    instead = ModuleType(module) if instead is None else instead
    sys.modules[module] = instead  # pyright: ignore[reportArgumentType]  (any object will do)
    try:
        yield
    finally:
        package, _, name = module.rpartition(".")
        if sys.modules.get(module) is instead:
            del sys.modules[module]
        if getattr(sys.modules.get(package), name, None) is instead:
            delattr(sys.modules[package], name)
