"""Work on all processors, results in order. Embree and torch release the interpreter lock, so threads are enough."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from itertools import chain, islice
from threading import Thread
from typing import TypeVar

import torch

Item = TypeVar("Item")
Result = TypeVar("Result")


def thread_count() -> int:
    """Returns the number of threads to use: torch's (OMP_NUM_THREADS), at most the processors this process may use."""
    processors = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(processors, torch.get_num_threads())


@contextmanager
def single_threaded() -> Iterator[None]:
    """Lets every call of torch work on one thread: its sums then come out the same, bit by bit, on any machine.

    Several threads of `ordered_map` may each make such calls; they still work side by side.
    """
    count = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(count)


def ordered_map(task: Callable[[Item], Result], items: Iterable[Item], count: int | None = None) -> Iterator[Result]:
    """Yields task(item) for each item, in the items' order, computed on several threads: `thread_count` of them.

    At most two items per thread are in flight, whatever their number; an error or Ctrl-C cancels the rest. A single
    item, or a single thread, needs no other thread and starts none.
    """
    count = thread_count() if count is None else count
    remaining = iter(items)
    some = list(islice(remaining, 2))
    remaining = chain(some, remaining)
    if count == 1 or len(some) < 2:
        yield from map(task, remaining)
        return
    with workers(count) as pool:
        try:
            waiting: deque[Future[Result]] = deque(pool.submit(task, item) for item in islice(remaining, 2 * count))
            while waiting:
                result = waiting.popleft().result()
                waiting.extend(pool.submit(task, item) for item in islice(remaining, 1))
                yield result
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def workers(count: int) -> ThreadPoolExecutor:
    """Returns that many threads, each of whose calls of torch works on as many threads as the caller's do."""
    return ThreadPoolExecutor(count, initializer=torch.set_num_threads, initargs=(torch.get_num_threads(),))


@contextmanager
def aside(task: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[list[Callable[[], Result]]]:
    """Has task(item) done for one item after another by a thread beside the caller's; gives what waits for each result.

    Where one thread is to do all, a task is done when its result is asked for. At the end no task is left at work.
    """
    if thread_count() == 1:
        yield [partial(task, item) for item in items]
        return
    pool = workers(1)
    try:
        yield [pool.submit(task, item).result for item in items]
    finally:
        pool.shutdown(cancel_futures=True)


def begin_beside(task: Callable[[], object]) -> None:
    """Begins a task on a thread of its own, whose calls of torch work on it alone; the process ends after it."""
    torch.get_num_threads()  # or this thread, should it ask later, would find the number that the other one has set

    def alone() -> None:
        with single_threaded():
            task()

    Thread(target=alone).start()


def single_threaded_map(task: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
    """Yields `ordered_map` of tasks whose own calls of torch work on one thread each.

    Their number of threads is taken before that: within `single_threaded`, `thread_count` is 1.
    """
    count = thread_count()
    with single_threaded():
        yield from ordered_map(task, items, count)
