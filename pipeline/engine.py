"""Where work on tiles is done: in this process, or on the workers of a Dask cluster."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Protocol, TypeVar

from spinpipe.pipeline.config import ExecutionSection

T = TypeVar("T")
R = TypeVar("R")


class Engine(Protocol):
    """Maps a function over items, in order."""

    @property
    def threads(self) -> int:
        """Threads that compiled kernels may use."""
        ...

    def map(self, function: Callable[[T], R], items: Iterable[T]) -> Iterator[R]:
        """``function`` of every item, in order."""
        ...


@dataclass(frozen=True)
class LocalEngine:
    """One item after the other in this process; the kernels use the threads."""

    threads: int

    def map(self, function: Callable[[T], R], items: Iterable[T]) -> Iterator[R]:
        """``function`` of every item, in order."""
        return map(function, items)


@contextmanager
def open_engine(config: ExecutionSection, threads: int) -> Iterator[Engine]:
    """The engine that a config asks for, closed at the end."""
    yield LocalEngine(threads)
