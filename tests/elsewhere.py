"""A device that is not there: its tensors compute on the CPU, say they lie elsewhere, and note what a GPU waits for.

What code for a GPU must not do can thus be proved where there is none. An operation on tensors of two devices raises,
as CUDA's do; `.numpy()` raises; and whatever makes the host wait for an answer is counted: values that are fetched
(`.cpu()`, `.item()`, `bool()`, `torch.equal`) and results whose size depends on values (`nonzero`, masks as indices,
`unique`). What it cannot tell is what a GPU rounds differently, and how fast one is.

It takes the place that torch keeps for devices of other makers (PrivateUse1).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

import torch
from torch._library.custom_ops import OPDEFS
from torch.utils import _pytree as pytree
from torch.utils import backend_registration

NAME = "elsewhere"
FETCHES = ("_local_scalar_dense", "equal", "is_nonzero")
SIZED_BY_VALUES = ("nonzero", "masked_select", "_unique2", "unique_dim", "unique_consecutive", "repeat_interleave")
INDEXING = ("index", "index_put", "index_put_", "_index_put_impl_", "_unsafe_index")
FACTORIES = ("empty.memory_format", "empty_strided", "eye", "eye.m", "arange", "arange.start", "arange.start_step",
             "linspace", "full", "zeros", "ones")  # fmt: skip
waits: Counter[str] = Counter()


class Elsewhere(torch.Tensor):
    """A tensor on the device that is not there."""

    held: torch.Tensor
    __torch_function__: Any = torch._C._disabled_torch_function_impl

    @staticmethod
    def __new__(cls, held: torch.Tensor) -> Elsewhere:
        kind: dict[str, Any] = {"dtype": held.dtype, "layout": held.layout, "device": torch.device(NAME, 0)}
        if held.layout is torch.strided:
            kind |= {"strides": held.stride(), "storage_offset": held.storage_offset()}
        made = torch.Tensor._make_wrapper_subclass(cls, held.shape, **kind)
        made.held = held
        return made

    def tolist(self) -> Any:
        waits["tolist"] += 1
        return self.held.tolist()

    def __repr__(self, *, tensor_contents: Any = None) -> str:
        return f"elsewhere({self.held!r})"

    @classmethod
    def __torch_dispatch__(cls, operation: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        return performed(operation, args, kwargs or {})


def performed(operation: Any, args: Any, kwargs: Any) -> Any:
    """Returns what an operation does, on the CPU; its results lie where those of a device's operation would."""
    if operation.namespace != "aten":  # a custom operator: what it is made of is what counts
        return OPDEFS[operation._schema.name]._init_fn(*args, **kwargs)
    whole = operation.decompose(*args, **kwargs)
    if whole is not NotImplemented:
        return whole
    name = operation.overloadpacket.__name__
    device = kwargs.get("device")
    note(name, args, device)
    if name != "copy_":
        check_one_device(name, (args, kwargs))
    if device is not None:
        kwargs = {**kwargs, "device": torch.device("cpu")}
    result = operation(*held(args), **held(kwargs))
    if operation._schema.is_mutable and result is not None:
        given = [part for part in pytree.tree_leaves((args, kwargs)) if isinstance(part, Elsewhere)]
        known = {id(part.held): part for part in given}
        return pytree.tree_map(lambda part: known.get(id(part), part), result)
    if device is not None and torch.device(device).type != NAME:
        return result
    return pytree.tree_map(lambda part: Elsewhere(part) if isinstance(part, torch.Tensor) else part, result)


def note(name: str, args: Any, device: Any) -> None:
    """Counts an operation that the host must wait for."""
    leaves_it = name == "_to_copy" and device is not None and torch.device(device).type != NAME
    fetched = name == "copy_" and not isinstance(args[0], Elsewhere)
    masks = name in INDEXING and any(part is not None and part.dtype == torch.bool for part in args[1])
    if leaves_it or fetched or masks or name in FETCHES or name in SIZED_BY_VALUES:
        waits[name] += 1


def check_one_device(name: str, parts: Any) -> None:
    """Raises RuntimeError where tensors of two devices meet; a single number of the CPU may meet any."""
    tensors = [part for part in pytree.tree_leaves(parts) if isinstance(part, torch.Tensor)]
    strange = [part for part in tensors if not isinstance(part, Elsewhere) and part.dim() > 0]
    if strange and name not in INDEXING:
        raise RuntimeError(f"{name}: expected all tensors to be on the same device, but found two")


def held(parts: Any) -> Any:
    """Returns the arguments as tensors of the CPU."""
    return pytree.tree_map(lambda part: part.held if isinstance(part, Elsewhere) else part, parts)


@contextmanager
def counting() -> Iterator[Counter[str]]:
    """Gives the number of times that the host waited for the device within the block, by operation."""
    before, here = waits.copy(), Counter[str]()
    yield here
    here.update(waits - before)


def register() -> torch.device:
    """Returns the device, known to torch from now on."""
    if torch._C._get_privateuse1_backend_name() != NAME:
        backend_registration._setup_privateuseone_for_python_backend(NAME)
        for name in FACTORIES:
            KERNELS.impl(name, partial(made, name), "PrivateUse1")
        KERNELS.impl("copy_", lambda into, source, wait=True: copied(into, source), "PrivateUse1")
        KERNELS.impl("_copy_from", lambda source, into, wait=True: copied(into, source), "PrivateUse1")
    return torch.device(NAME, 0)


KERNELS = torch.library.Library("aten", "IMPL")


def made(name: str, *args: Any, device: Any = None, **kwargs: Any) -> Elsewhere:
    """Returns a new tensor on the device."""
    packet, _, overload = name.partition(".")
    operation = getattr(getattr(torch.ops.aten, packet), overload or "default")
    return Elsewhere(operation(*args, device=torch.device("cpu"), **kwargs))


def copied(into: torch.Tensor, source: torch.Tensor) -> torch.Tensor:
    """Returns a tensor with the values of another."""
    return performed(torch.ops.aten.copy_.default, (into, source), {})
