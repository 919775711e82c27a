"""Work on all processors, results in order. Embree and torch release the interpreter lock, so threads are enough."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import islice
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")


def thread_count() -> int:
    """Returns the number of processors this process may run on."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def ordered_map(task: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
    """Yields task(item) for each item, in the items' order, computed on one thread per processor.

    At most two items per thread are in flight, whatever their number; an error or Ctrl-C cancels the rest.
    """
    count = thread_count()
    remaining = iter(items)
    with ThreadPoolExecutor(count) as pool:
        try:
            waiting: deque[Future[Result]] = deque(pool.submit(task, item) for item in islice(remaining, 2 * count))
            while waiting:
                result = waiting.popleft().result()
                waiting.extend(pool.submit(task, item) for item in islice(remaining, 1))
                yield result
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
