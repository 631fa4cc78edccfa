"""Readers of others in a process of their own, which may hang, grow or die: ours goes on.

The child is a fork, so that it costs milliseconds. The kernel ends it when it has computed for
long without a result, or asks for more memory than a file of that size can need.
"""

from __future__ import annotations

import os
import pickle
import resource
import select
import signal
import struct
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from io import FileIO
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

from spinpipe.stages.stage import StageError

T = TypeVar("T")
_LENGTH = struct.Struct("<q")

MOST_POINTS = 1 << 18
"""To be read at once: with 300 bytes a point they take a fourth of the memory below."""
STEP_S, BYTES_A_S = 10.0, 10e6
"""Processor time for one result: a million points take half a second, a mesh of 80 MB two; and as
much more as the slowest reader takes for the whole file."""
STILL_S, WATCH_S = 60.0, 0.5
"""A reader that sleeps for so long waits for what will not come; how often it is looked at."""
MEMORY_TIMES, MEMORY_BYTES = 16, 300_000_000
"""What a reader may ask for beside what it has: so many times the file's size, and a constant. STL
of 82 MB takes 760 MB (``tests/unit/ingest/test_formats.py``)."""


def guarded(function: Callable[..., Iterator[T]], path: Path, *arguments: Any) -> Generator[T]:
    """What ``function(path, *arguments)`` yields in a child process.

    Parameters
    ----------
    function : a generator function; what it yields is pickled.
    path : of the file that it reads.

    Raises
    ------
    StageError
        What it raises itself, or if its process ends in another way.
    """
    reader, writer = os.pipe()
    child = os.fork()
    if not child:
        _serve(writer, function, path, arguments)
    os.close(writer)
    try:
        with os.fdopen(reader, "rb", buffering=0) as stream:
            while True:
                try:
                    kind, value = pickle.loads(_received(stream, child))
                except (EOFError, pickle.UnpicklingError):
                    raise StageError(f"{path}: {_end(child)}; copy or export it again") from None
                except TimeoutError as error:
                    raise StageError(f"{path}: {error}; copy or export it again") from None
                if kind == "end":
                    return
                if kind == "error":
                    raise value
                yield value
    finally:
        _kill(child)


COPY_AGAIN = "it may be cut short, copy or export it again"


@contextmanager
def readable(path: Path, kind: str, mend: str = COPY_AGAIN) -> Generator[None]:
    """Say in a sentence that a library could not read a file; they raise errors of many kinds."""
    try:
        yield
    except (MemoryError, StageError):
        raise
    except Exception as error:
        what = " ".join(str(error).split()) or f"it ends too early: {type(error).__name__}"
        raise StageError(f"{path}: cannot read the {kind} ({what}); {mend}") from error


def _serve(
    writer: int, function: Callable[..., Iterator[Any]], path: Path, arguments: tuple[Any, ...]
) -> None:
    """Body of the child: never returns."""
    try:
        signal.signal(signal.SIGPROF, signal.SIG_DFL)
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # what it says as it dies is not for users
        size = path.stat().st_size
        limit_s = STEP_S + size / BYTES_A_S
        most = _memory() + MEMORY_TIMES * size + MEMORY_BYTES
        resource.setrlimit(resource.RLIMIT_DATA, (most, resource.RLIM_INFINITY))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        with os.fdopen(writer, "wb") as stream:
            try:
                signal.setitimer(signal.ITIMER_PROF, limit_s)
                for value in function(path, *arguments):
                    signal.setitimer(signal.ITIMER_PROF, 0)
                    _send(stream, "value", value)
                    signal.setitimer(signal.ITIMER_PROF, limit_s)
                _send(stream, "end", None)
            except StageError as error:
                # its text alone: some libraries pickle causes too, and not all causes can be
                _send(stream, "error", StageError(str(error)))
            except MemoryError:
                text = f"{path}: asks for more memory than its size explains; export it again"
                _send(stream, "error", StageError(text))
    finally:
        os._exit(0)


def _send(stream: BinaryIO, kind: str, value: object) -> None:
    data = pickle.dumps((kind, value), protocol=5)
    stream.write(_LENGTH.pack(len(data)))
    stream.write(data)
    stream.flush()


def _received(stream: FileIO, child: int) -> bytearray:
    """What was sent next.

    Raises
    ------
    EOFError
        When the child has ended.
    TimeoutError
        When it sleeps on: a lock that no thread of its own holds, say.
    """
    (length,) = _LENGTH.unpack(_bytes(stream, child, _LENGTH.size))
    return _bytes(stream, child, length)


def _bytes(stream: FileIO, child: int, count: int) -> bytearray:
    data = bytearray(count)
    view = memoryview(data)
    awake, at = _awake(child), time.monotonic()
    while len(view):
        if select.select([stream], [], [], WATCH_S)[0]:
            read = stream.readinto(view)
            if not read:
                raise EOFError
            view = view[read:]
            at = time.monotonic()
        elif (now := _awake(child)) != awake:
            awake, at = now, time.monotonic()
        elif time.monotonic() - at > STILL_S:
            raise TimeoutError(f"its reader stood still for {STILL_S:.0f} s")
    return data


def _awake(pid: int) -> tuple[bytes, ...]:
    """What changes while a process computes: processor time; and whether it sleeps."""
    state, *fields = Path(f"/proc/{pid}/stat").read_bytes().rpartition(b")")[2].split()
    return (*fields[10:12], b"" if state == b"S" else str(time.monotonic()).encode())


def _memory() -> int:
    """What can be written to, which the limit counts; not what is only mapped or reserved."""
    pages = int(Path("/proc/self/statm").read_text().split()[5])
    return pages * resource.getpagesize()


def _end(child: int) -> str:
    """Say how the child ended."""
    _, status = os.waitpid(child, 0)
    code = os.waitstatus_to_exitcode(status)
    if code == -signal.SIGPROF:
        return f"its reader found nothing in {STEP_S:.0f} s or more"
    return f"its reader broke down ({signal.Signals(-code).name if code < 0 else 'no result'})"


def _kill(child: int) -> None:
    try:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
    except (ProcessLookupError, ChildProcessError):
        pass
