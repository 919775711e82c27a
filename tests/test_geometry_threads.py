"""Work in parallel, results in order, little in flight, and errors that end it."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from itertools import islice

import pytest

from torchlight.geometry.threads import ordered_map, thread_count


def test_results_come_in_the_items_order() -> None:
    def slow_first(item: int) -> int:
        time.sleep(0.02 if item == 0 else 0)
        return item * item

    assert list(ordered_map(slow_first, range(20))) == [k * k for k in range(20)]
    assert list(ordered_map(slow_first, [])) == []


def test_items_are_taken_as_they_are_needed() -> None:
    taken: list[int] = []

    def items() -> Iterator[int]:
        for k in range(1000):
            taken.append(k)
            yield k

    results = ordered_map(lambda item: item, items())
    for k in range(5):
        assert next(results) == k
        assert len(taken) <= k + 1 + 2 * thread_count()


def test_an_error_reaches_the_caller_and_ends_the_work() -> None:
    started = threading.Semaphore(0)

    def task(item: int) -> int:
        started.release()
        if item == 3:
            raise ValueError("item 3")
        return item

    results = ordered_map(task, range(1000))
    assert list(islice(results, 3)) == [0, 1, 2]
    with pytest.raises(ValueError, match="item 3"):
        next(results)
    count = 0
    while started.acquire(blocking=False):
        count += 1
    assert count <= 4 + 2 * thread_count()
