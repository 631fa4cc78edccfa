"""Files that are either there in full or not at all."""

from __future__ import annotations

import os
from collections.abc import Callable, Generator
from contextlib import contextmanager
from pathlib import Path

unfinished: set[Path] = set()
"""What is being written just now and is worth nothing half: a signal removes it."""


def write_atomically(path: Path, write: Callable[[Path], object]) -> None:
    """Let ``write`` fill a file beside ``path``, flush it to disk, then rename it."""
    with partial_file(path) as partial:
        write(partial)
        commit(partial, path)


@contextmanager
def partial_file(path: Path) -> Generator[Path]:
    """Name a file beside ``path`` to write to; what is left of it at the end is removed.

    An error of the disk names ``path``.
    """
    partial = path.with_name(path.name + ".partial")
    unfinished.add(partial)
    try:
        with naming(path):
            yield partial
    finally:
        partial.unlink(missing_ok=True)
        unfinished.discard(partial)


@contextmanager
def naming(path: Path) -> Generator[None]:
    """Let errors of reading and writing name a file: a full disk does not say by itself which."""
    try:
        yield
    except OSError as error:
        if error.filename is None:
            error.filename = str(path)
        raise


def commit(partial: Path, path: Path) -> None:
    """Flush a finished file to disk and give it its final name."""
    with partial.open("rb") as stream:
        os.fsync(stream.fileno())
    partial.replace(path)
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)
