"""Numba as every kernel uses it, and a word before its first compilation, which takes seconds.

Machine code is kept on disk beside the kernels, or in the user's cache folder where that cannot be written
(NUMBA_CACHE_DIR names another): a machine compiles once per version. Only then, once per process, the logger
"torchlight" gets `ANNOUNCEMENT` as information; the command line prints it.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from contextlib import suppress
from typing import Any, no_type_check
from weakref import WeakSet

from numba import njit, types
from numba.core import event
from numba.core.caching import FunctionCache
from numba.core.runtime import rtsys
from numba.extending import intrinsic

ANNOUNCEMENT = "compiling once for this machine (about half a minute)"

_kernels: WeakSet[Any] = WeakSet()


@no_type_check
def compiled(function: Callable[..., Any]) -> Any:
    """Returns a function in machine code that releases the interpreter lock; compiled when first called.

    Used above `no_type_check`, so that checkers of annotations leave the function alone.
    """
    return _announced(njit(nogil=True, cache=True)(function))


@no_type_check
def compiled_sums(function: Callable[..., Any]) -> Any:
    """Returns a function as `compiled` does, whose sums may be taken in any order and products fused into them.

    Dot products then run at the speed of the processor. The order is fixed when the function is compiled: the same
    numbers in give the same numbers out, whatever the threads, but another processor may round otherwise.
    """
    return _announced(njit(nogil=True, cache=True, fastmath={"reassoc", "nsz", "contract"})(function))


@no_type_check
def _announced(dispatcher: Any) -> Any:
    _kernels.add(dispatcher)
    if type(getattr(dispatcher, "_cache", None)) is FunctionCache:  # not where NUMBA_DISABLE_JIT is set
        dispatcher._cache.__class__ = Stored
    return dispatcher


class Stored(FunctionCache):
    """Machine code on disk, loaded without what only a compiler has to know.

    Numba would first import and register how each function of Python and NumPy is compiled: a sixth of a second. This
    leans on what numba keeps to itself; a numba that has changed it is left to go its own way.
    """

    @no_type_check
    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Returns the machine code for some types; None, and all that a compiler has to know, where there is none."""
        with suppress(AttributeError, TypeError), self._guard_against_spurious_io_errors():
            rtsys.initialize(target_context)
            found = self._load_overload(sig, target_context)
            if found is not None:
                return found
        return super().load_overload(sig, target_context)


@intrinsic
def borrowed(_: Any, array: Any) -> Any:
    """Returns, within compiled code, the same array without an owner; the owner must outlive it.

    Every call that hands on an array counts its owner's references with locked instructions, tens of cycles each. What
    has no owner is not counted, so that small functions cost nothing.
    """

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        result = context.make_array(array)(context, builder, arguments[0])
        result.meminfo = context.get_constant_null(types.MemInfoPointer(types.voidptr))
        result.parent = context.get_constant_null(types.pyobject)
        return result._getvalue()

    return array(array), code


class Announcer(event.Listener):
    """Announces the first kernel that is compiled; what numba loads from its disk cache or compiles for others is not.

    Numba broadcasts the event "numba:compile" where its disk cache holds nothing for a call.
    """

    def __init__(self) -> None:
        self.silent = False

    def on_start(self, event: Any) -> None:
        """Announces a compilation that begins. Numba's compiler lock is held, so no two threads come here at once."""
        if not self.silent and event.data["dispatcher"] in _kernels:
            self.silent = True
            logging.getLogger("torchlight").info(ANNOUNCEMENT)

    def on_end(self, event: Any) -> None:
        """Does nothing."""


event.register("numba:compile", Announcer())
