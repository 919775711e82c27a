"""Work in parallel, results in order, little in flight, and errors that end it."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from itertools import islice

import pytest
import torch

from torchlight import threads
from torchlight.threads import aside, ordered_map, single_threaded, thread_count


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


def test_as_many_threads_as_torch_may_use_and_processors_there_are(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.sched_getaffinity", lambda process: set(range(6)), raising=False)
    for allowed, expected in ((1, 1), (4, 4), (64, 6)):
        monkeypatch.setattr(torch, "get_num_threads", lambda allowed=allowed: allowed)
        assert thread_count() == expected


@pytest.mark.parametrize("count", [1, 3])
def test_no_more_threads_at_once_than_asked_for(count: int) -> None:
    running, most, lock = 0, 0, threading.Lock()

    def task(item: int) -> None:
        nonlocal running, most
        with lock:
            running += 1
            most = max(most, running)
        time.sleep(0.002)
        with lock:
            running -= 1

    assert len(list(ordered_map(task, range(20), count))) == 20
    assert most == count


def test_torch_works_on_one_thread_within_and_as_before_afterwards() -> None:
    before = torch.get_num_threads()
    try:
        torch.set_num_threads(2)
        with single_threaded():
            assert torch.get_num_threads() == 1
            assert list(ordered_map(lambda item: torch.get_num_threads(), range(3), 2)) == [1, 1, 1]
        assert torch.get_num_threads() == 2
        with pytest.raises(ValueError, match="inside"), single_threaded():
            raise ValueError("inside")
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(before)


def test_tasks_of_one_thread_each_work_side_by_side(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threads, "thread_count", lambda: 2 if torch.get_num_threads() == before else 1)
    before = torch.get_num_threads() + 1
    torch.set_num_threads(before)
    meeting = threading.Barrier(2, timeout=30)
    try:
        found = list(threads.single_threaded_map(lambda item: (meeting.wait() >= 0, torch.get_num_threads()), range(4)))
        assert found == [(True, 1)] * 4
        assert torch.get_num_threads() == before
    finally:
        torch.set_num_threads(before - 1)


@pytest.mark.parametrize("count", [1, 2])
def test_results_of_a_thread_beside_come_in_any_order_asked(count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threads, "thread_count", lambda: count)
    with aside(lambda item: 10 // item, [1, 0, 5]) as (first, second, third):
        assert third() == 2
        with pytest.raises(ZeroDivisionError):
            second()
        assert first() == 10
