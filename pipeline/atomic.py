"""Files that are either there in full or not at all."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Generator
from contextlib import contextmanager
from pathlib import Path

unfinished: set[Path] = set()
"""Files being written, worth nothing half, and folders of work: a signal removes them."""


@contextmanager
def scratch_folder() -> Generator[Path]:
    """A folder for work that leaves nothing behind, however it ends."""
    with tempfile.TemporaryDirectory(prefix="spinpipe-") as name:
        unfinished.add(Path(name))
        try:
            yield Path(name)
        finally:
            unfinished.discard(Path(name))


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
