"""Blocks on a Ray cluster (extra `cluster`): Ray starts, feeds and restarts the workers; nothing is added to it.

A scene's transport is made once, by a task, and lies in the object store: every worker of a machine reads the same
memory. Photographs and the output folder must be reachable under the same names on all machines.
"""

from __future__ import annotations

import warnings
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from torchlight.batch.blocks import Block
from torchlight.batch.local import DIED, Whole, Work
from torchlight.batch.work import Report, Task, keeps, work
from torchlight.config import Config
from torchlight.errors import ConfigError
from torchlight.io.scene_file import load_scene
from torchlight.method import named_method
from torchlight.precomputation import dense_resolution, precompute
from torchlight.transfer import Transfer

RETRIES = 3  # of a block whose worker died; then photograph by photograph
SCENES_KEPT = 8  # transports in the object store at a time


@dataclass(frozen=True, eq=False)
class Remote:
    """A cluster.

    Attributes:
        ray: the module.
        task: from a function to what Ray runs of it, on one processor.
        room: blocks in flight at a time.
    """

    ray: Any
    task: Callable[[Callable[..., Any]], Any]
    room: int


def on_ray(
    todo: Iterable[Block], task: Task, address: str | None = None, workers: int | None = None
) -> Iterator[Report]:
    """Yields a report per block, or per photograph, as they come: an engine.

    Args:
        todo: the blocks.
        task: what they have in common.
        address: of a running cluster; None = one of this machine, for the time of the call.
        workers: of this machine's cluster; None = as many as processors.

    Raises:
        ConfigError: Ray is not installed, or there is no cluster at the address.
    """
    with connected(address, workers) as remote:
        make, do = remote.task(transport_of), remote.task(block_of)
        transports = dict[Path, Any]()

        def begin(block: Block) -> Any:
            return do.remote(task, block, transport_for(block, task, transports, make))

        yield from answers(todo, begin, remote)


def pieces_on_ray(
    todo: Iterable[Whole], work: Work[Whole], address: str | None = None, workers: int | None = None
) -> Iterator[Report]:
    """Yields a report per piece of work that shares nothing with the others; the rest is as for `on_ray`."""

    def on_one_thread(piece: Whole) -> Report:
        torch.set_num_threads(1)
        return work(piece)

    with connected(address, workers) as remote:
        yield from answers(todo, remote.task(on_one_thread).remote, remote)


def installed() -> Any:
    """Returns the module; raises ConfigError where Ray is not installed."""
    try:
        import ray  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise ConfigError("--engine ray: Ray is not installed; pip install 'torchlight[cluster]'") from None
    return ray


@contextmanager
def connected(address: str | None, workers: int | None) -> Iterator[Remote]:
    """Yields a cluster, and leaves it at the end."""
    ray = installed()
    try:
        quiet = {"log_to_driver": False, "logging_level": "ERROR"}
        if address is None:
            ray.init(address="local", num_cpus=workers, include_dashboard=False, **quiet)
        else:
            ray.init(address=address, **quiet)
    except (ConnectionError, RuntimeError, ValueError) as error:
        raise ConfigError(f"--address: no Ray cluster at {address}: {str(error).splitlines()[0]}") from error
    room = 2 * max(1, int(ray.cluster_resources().get("CPU", 1)))
    try:
        yield Remote(ray, ray.remote(num_cpus=1, max_retries=RETRIES), room)
    finally:
        ray.shutdown()


def answers(todo: Iterable[Whole], begin: Callable[[Whole], Any], remote: Remote) -> Iterator[Report]:
    """Yields a report per block, or per part of it where its workers died.

    Args:
        todo: the blocks.
        begin: from a block to Ray's promise of its report.
        remote: the cluster.
    """
    waiting, flying = deque(todo), dict[Any, Whole]()
    while waiting or flying:
        while waiting and len(flying) < remote.room:
            block = waiting.popleft()
            flying[begin(block)] = block
        ready, _ = remote.ray.wait(list(flying), num_returns=1)
        block = flying.pop(ready[0])
        try:
            yield remote.ray.get(ready[0])
        except remote.ray.exceptions.RayError:
            parts = block.parts()
            if len(parts) == 1:
                yield Report(block.lost(DIED), {}, 0)
            else:
                waiting.extendleft(parts)


def transport_for(block: Block, task: Task, transports: dict[Path, Any], make: Any) -> Any:
    """Returns the transport of a block's scene in the object store; None where the batch has no use for it again."""
    if not block.shared:
        return None
    scene = block.entries[0].scene
    if scene not in transports:
        transports[scene] = make.remote(scene, task.config, keeps(task, block))
        if len(transports) > SCENES_KEPT:
            del transports[next(iter(transports))]  # Ray frees it when the last block that reads it has ended
    return transports[scene]


def transport_of(scene: Path, config: Config, use_cache: bool) -> tuple[np.ndarray, int] | None:
    """Returns a scene's dense transport and its resolution; None where there is none: each photograph will say why."""
    torch.set_num_threads(1)
    try:
        resolution = dense_resolution(*named_method(config))
        return precompute(load_scene(scene), resolution, use_cache=use_cache).transport.numpy(), resolution
    except Exception:  # noqa: BLE001
        return None


def block_of(task: Task, block: Block, dense: tuple[np.ndarray, int] | None) -> Report:
    """Returns what came of a block, with a transport that lies in shared memory."""
    torch.set_num_threads(1)
    if dense is None:
        return work(task, block)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # "not writable": nothing writes to a transport
        transport = torch.from_numpy(dense[0])
    return work(task, block, Transfer(transport, dense[1]))
