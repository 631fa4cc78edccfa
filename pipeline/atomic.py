"""Files that are either there in full or not at all."""

from __future__ import annotations

import fcntl
import os
import shutil
import tempfile
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager, suppress
from pathlib import Path

unfinished: set[Path] = set()
"""Files being written, worth nothing half, and folders of work: a signal removes them."""

PARTIAL, SCRATCH = ".partial", ".scratch-"
_ABANDONED_S = 60.0
"""A folder of work that nobody has held for so long is left over: it is held milliseconds after it
was made."""


@contextmanager
def scratch_folder(parent: Path | None = None) -> Generator[Path]:
    """A folder for work, below the system's for such, or ``parent``; it is gone in the end.

    Those that killed processes left beside it go too.
    """
    place = parent or Path(tempfile.gettempdir())
    prefix = f"{SCRATCH}spinpipe-"
    for left in place.glob(f"{prefix}*"):
        if _abandoned(left):
            remove(left)
    with tempfile.TemporaryDirectory(prefix=prefix, dir=place) as name:
        unfinished.add(Path(name))
        held = os.open(name, os.O_RDONLY)
        try:
            with suppress(OSError):  # a file system without locks
                fcntl.flock(held, fcntl.LOCK_EX)
            yield Path(name)
        finally:
            os.close(held)
            unfinished.discard(Path(name))


def remove(path: Path) -> None:
    """Remove a file, or a folder with all below it."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


def _abandoned(folder: Path) -> bool:
    """Whether no process holds a folder of work any more."""
    try:
        held = os.open(folder, os.O_RDONLY | os.O_NOFOLLOW)
    except OSError:
        return False
    try:
        about = os.fstat(held)
        fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return about.st_uid == os.getuid() and time.time() - about.st_mtime > _ABANDONED_S
    except OSError:
        return False
    finally:
        os.close(held)


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
    partial = path.with_name(path.name + PARTIAL)
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
