"""Work on threads: results come in order, and their number never changes them.

Maps may be nested: tiles on threads, blocks of a tile on threads. However many there are, no more
than the given number of threads run at a time: whoever works holds one of so many permits, and
lends it while waiting for results.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cache
from threading import Semaphore
from typing import TypeVar

T = TypeVar("T")
R = TypeVar("R")


def map_threads(function: Callable[[T], R], items: Iterable[T], threads: int) -> Iterator[R]:
    """Yield ``function`` of every item, in order, by threads; few items wait at a time.

    Whoever stops early, by Ctrl-C say, waits only for the items under way.
    """
    if threads <= 1:
        yield from map(function, items)
        return
    permits = _permits(threads)

    def work(item: T) -> R:
        with permits:
            return function(item)

    def result() -> R:
        permits.release()
        try:
            return waiting.popleft().result()
        finally:
            permits.acquire()

    pool = ThreadPoolExecutor(threads)
    waiting: deque[Future[R]] = deque()
    try:
        for item in items:
            waiting.append(pool.submit(work, item))
            if len(waiting) > 4 * threads:
                yield result()
        while waiting:
            yield result()
    finally:
        permits.release()
        pool.shutdown(cancel_futures=True)
        permits.acquire()


@cache
def _permits(threads: int) -> Semaphore:
    """What allows so many threads to work; who asks first is working and holds the first."""
    return Semaphore(threads - 1)
