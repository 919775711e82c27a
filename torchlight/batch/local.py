"""Blocks on processes of this machine. A process that dies costs time, and at most the photograph that killed it.

Which one that was, a broken pool does not tell: whatever was in flight is done again, block by block in a process of
its own; a block that kills that as well is done photograph by photograph.
"""

from __future__ import annotations

import functools
import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import connection, get_context, parent_process
from typing import TypeVar

from torchlight.batch.blocks import Block, Piece
from torchlight.batch.work import Report, Task, peak_bytes, work

DIED = "the process that worked on it ended without an answer: killed, out of memory, or a crash in a library"
Whole = TypeVar("Whole", bound=Piece)
Work = Callable[[Whole], Report]


def on_processes(todo: Iterable[Block], task: Task, workers: int) -> Iterator[Report]:
    """Yields a report per block, worked on in processes of one thread each: an engine."""
    return answers(todo, functools.partial(work, task), workers)


def answers(blocks: Iterable[Whole], work: Work[Whole], workers: int, threads: int = 1) -> Iterator[Report]:
    """Yields a report per block, or per part of it, as they come; memory does not grow with the number of blocks.

    Args:
        blocks: what to do.
        work: done on each, in another process; must be importable there.
        workers: processes.
        threads: of each.
    """
    waiting = deque(blocks)
    while waiting:
        suspects = yield from side_by_side(waiting, work, workers, threads)
        for block in suspects:
            yield from alone(block, work, threads)


def side_by_side(
    waiting: deque[Whole], work: Work[Whole], workers: int, threads: int
) -> Generator[Report, None, list[Whole]]:
    """Yields reports until all blocks are done or a process died; returns what was in flight then."""
    flying: dict[Future[Report], Whole] = {}
    with pool(workers, threads) as processes:
        while waiting or flying:
            try:
                while waiting and len(flying) <= workers:  # one more than there are processes: none ever waits
                    future = processes.submit(work, waiting[0])
                    flying[future] = waiting.popleft()
            except BrokenProcessPool:
                return list(flying.values())
            for future in wait(flying, return_when=FIRST_COMPLETED).done:
                try:
                    report = future.result()
                except BrokenProcessPool:
                    return list(flying.values())
                del flying[future]
                yield report
    return []


def alone(block: Whole, work: Work[Whole], threads: int) -> Iterator[Report]:
    """Yields the reports of a block that has a process to itself; where it kills it, of each part."""
    try:
        with pool(1, threads) as process:
            yield process.submit(work, block).result()
    except BrokenProcessPool:
        parts = block.parts()
        if len(parts) == 1:
            yield Report(block.lost(DIED), {}, peak_bytes())
            return
        for part in parts:
            yield from alone(part, work, threads)


@contextmanager
def pool(workers: int, threads: int) -> Iterator[ProcessPoolExecutor]:
    """Yields processes that start afresh, and ends them at once when the caller stops early."""
    processes = ProcessPoolExecutor(workers, get_context("spawn"), begin, (threads,))
    try:
        yield processes
    except BaseException:
        stop(processes)
        raise
    finally:
        processes.shutdown(cancel_futures=True)


def stop(processes: ProcessPoolExecutor) -> None:
    """Ends the processes of a pool: what they write is complete or absent at any moment."""
    for process in list((processes._processes or {}).values()):  # there is no public way before Python 3.14
        process.terminate()


def begin(threads: int) -> None:
    """Sets a process up: its share of the threads, Ctrl-C left to the parent, and no life after the parent's."""
    import cv2
    import torch

    torch.set_num_threads(threads)
    cv2.setNumThreads(threads)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=end_with_parent, daemon=True).start()


def end_with_parent() -> None:
    """Waits for the parent to end, by whatever means, and ends this process."""
    parent = parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
        os._exit(1)
