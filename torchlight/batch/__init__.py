"""Thousands of photographs: in a program of your own, on this machine's processors, or on a cluster.

`estimate` yields what came of each photograph; `Observations` feeds a DataLoader; `run` is `torchlight batch`.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from torchlight.batch.dataset import Observations as Observations
    from torchlight.batch.iterate import Found as Found
    from torchlight.batch.iterate import estimate as estimate

# imported at first use: one photograph on the command line needs no DataLoader, which takes half a second
_HOME = {"Found": "iterate", "Observations": "dataset", "estimate": "iterate"}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'torchlight.batch' has no attribute '{name}'")
    return getattr(import_module(f"torchlight.batch.{_HOME[name]}"), name)
