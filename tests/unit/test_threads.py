"""Maps on threads: order, nesting, errors, and how many threads run at a time."""

from __future__ import annotations

import threading
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from spinpipe.stages.threads import map_threads


@pytest.mark.parametrize("threads", [1, 2, 3, 7])
def test_nested_maps_run_no_more_threads_than_given(threads: int) -> None:
    lock, running, most = threading.Lock(), 0, 0

    def inner(value: int) -> int:
        nonlocal running, most
        with lock:
            running += 1
            most = max(most, running)
        time.sleep(0.002)
        with lock:
            running -= 1
        return value * value

    def outer(value: int) -> int:
        return sum(map_threads(inner, range(value), threads))

    expected = [sum(v * v for v in range(n)) for n in range(12)]
    assert list(map_threads(outer, range(12), threads)) == expected
    assert most <= threads


def test_a_map_that_is_given_up_or_fails_leaves_all_threads_to_the_next() -> None:
    def fail(value: int) -> int:
        if value == 5:
            raise ValueError("five")
        return value

    for _ in range(20):
        results = map_threads(fail, range(100), 3)
        assert next(results) == 0
        results.close()  # pyright: ignore[reportAttributeAccessIssue]
        with pytest.raises(ValueError, match="five"):
            list(map_threads(fail, range(100), 3))

    def meet(barrier: threading.Barrier) -> int:
        return barrier.wait(timeout=10)

    barrier = threading.Barrier(2)  # two run beside the one that asks for results
    with ThreadPoolExecutor(1) as pool:
        done = pool.submit(lambda: list(map_threads(meet, [barrier] * 2, 3)))
        assert sorted(done.result(timeout=20)) == [0, 1]
