"""Where work on tiles is done: in this process, or on the workers of a Dask cluster."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol, TypeVar, cast

from threadpoolctl import threadpool_limits

from spinpipe.pipeline.config import ConfigError, ExecutionSection
from spinpipe.stages.stage import StageError
from spinpipe.stages.threads import map_threads

if TYPE_CHECKING:
    from distributed import Client, Future

T = TypeVar("T")
R = TypeVar("R")

CONNECT_TIMEOUT_S = 10
RETRIES = 3


class Engine(Protocol):
    """Maps a function over items, in order."""

    @property
    def threads(self) -> int:
        """Threads that compiled kernels may use for one item."""
        ...

    def map(self, function: Callable[[T], R], items: Iterable[T]) -> Iterator[R]:
        """``function`` of every item, in order."""
        ...


@dataclass(frozen=True)
class LocalEngine:
    """Items in threads of this process; within an item the kernels use the threads too."""

    threads: int

    def map(self, function: Callable[[T], R], items: Iterable[T]) -> Iterator[R]:
        """``function`` of every item, in order."""
        return map_threads(function, items, self.threads)


class DaskEngine:
    """Items on the workers of a Dask cluster, which must see the run's folder.

    A worker that dies loses nothing: the scheduler gives its items to others. Only a few results
    a worker are under way at any time, so memory stays bounded here too.
    """

    def __init__(self, client: Client, threads: int) -> None:
        self._client = client
        self.threads = threads

    def map(self, function: Callable[[T], R], items: Iterable[T]) -> Iterator[R]:
        """``function`` of every item, in order."""
        waiting: deque[Future[Any]] = deque()
        try:
            for item in items:
                waiting.append(self._client.submit(function, item, pure=False, retries=RETRIES))
                if len(waiting) > 2 * max(1, self._slots()):
                    yield _result(waiting.popleft())
            while waiting:
                yield _result(waiting.popleft())
        finally:
            for future in waiting:
                future.cancel()

    def _slots(self) -> int:
        """Threads of all workers there are now: they come and go."""
        return sum(cast("dict[str, int]", self._client.nthreads()).values())


def _result(future: Future[Any]) -> Any:
    from distributed.scheduler import KilledWorker

    try:
        return future.result()
    except KilledWorker as error:
        raise StageError(f"dask: {' '.join(str(error).split())}") from None
    finally:
        future.release()


@contextmanager
def _native_threads(threads: int) -> Generator[None]:
    """Pools of libraries: no more than one thread beside each of ours, in Rust as many as ours.

    Sums of a linear algebra library come in another order with every number of threads, too.
    """
    before = os.environ.get("RAYON_NUM_THREADS")
    os.environ["RAYON_NUM_THREADS"] = str(threads)
    try:
        with threadpool_limits(1):
            yield
    finally:
        if before is None:
            del os.environ["RAYON_NUM_THREADS"]
        else:
            os.environ["RAYON_NUM_THREADS"] = before


@contextmanager
def open_engine(config: ExecutionSection, cores: int) -> Generator[Engine]:
    """The engine that a config asks for, closed at the end.

    Parameters
    ----------
    config : the ``[execution]`` section.
    cores : threads that this process may use.

    Raises
    ------
    ConfigError
        If Dask is asked for but not installed, or no scheduler is named.
    StageError
        If the scheduler does not answer or has no workers.
    """
    if config.engine == "local":
        with _native_threads(cores):
            yield LocalEngine(cores)
        return
    try:
        from distributed import Client
    except ModuleNotFoundError:
        raise ConfigError(
            "execution.engine = 'dask' needs an extra package: pip install 'spinpipe[dask]'"
        ) from None
    if not config.scheduler:
        raise ConfigError("execution.engine = 'dask' needs execution.scheduler = 'tcp://host:port'")
    try:
        client = Client(config.scheduler, timeout=CONNECT_TIMEOUT_S, set_as_default=False)
    except (OSError, ValueError):
        raise StageError(
            f"no Dask scheduler answers at {config.scheduler}: start one with 'dask scheduler'"
        ) from None
    with client:
        if not client.nthreads():
            raise StageError(
                f"the Dask scheduler at {config.scheduler} has no workers: "
                f"start some with 'dask worker {config.scheduler}'"
            )
        # Each thread of a worker takes an item of its own, so one item needs no more than one.
        yield DaskEngine(client, config.threads or 1)
