"""Files that we write into a folder: which are ours, what each was made from, whether it is whole.

A folder that we write into is marked by a file that lists what we wrote, with the key of what it
was made from and the digest of its content. A file that is not listed is somebody else's: it is
neither replaced nor removed without ``--force``. If the list itself is damaged, all names that we
use in a marked folder are taken for ours: a damage must not block a run for good.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
from collections.abc import Callable, Generator
from contextlib import contextmanager
from pathlib import Path

from spinpipe.pipeline.atomic import PARTIAL, SCRATCH, remove, write_atomically
from spinpipe.stages.stage import StageError

MARK, LOCK = ".spinpipe", ".lock"
_Entry = dict[str, str]


class Outputs:
    """The files of ours in one folder.

    Parameters
    ----------
    folder : Path
        Made if it is not there.
    force : bool
        Whether files of others may be replaced.
    """

    def __init__(self, folder: Path, *, force: bool = False) -> None:
        self._mark = folder / MARK
        self._listed = _read(self._mark)
        self._trusting = force or (self._listed is None and self.marked)

    @property
    def marked(self) -> bool:
        """Whether the folder is one that we write into."""
        return self._mark.exists()

    def claim(self, *paths: Path) -> None:
        """Say what is about to be written, before anything is computed.

        Raises
        ------
        StageError
            If one of the files is there and not ours.
        """
        listed = self._listed or {}
        foreign = [path for path in paths if path.name not in listed and os.path.lexists(path)]
        if foreign and not self._trusting:
            raise StageError(
                f"{foreign[0]}: is there already and was not written by spinpipe; "
                "move it, choose another folder, or replace it with --force"
            )
        listed = {path.name: self._entry(path) for path in paths}
        if not listed.keys() <= (self._listed or {}).keys():
            self._save({**(self._listed or {}), **listed})

    def current(self, path: Path, key: str) -> bool:
        """Whether a file is what we wrote, and was made from what ``key`` stands for."""
        entry = self._entry(path)
        return entry.get("key") == key and bool(key) and entry.get("sha256") == digest(path)

    def edited(self, path: Path) -> bool:
        """Whether somebody changed a file that we wrote."""
        return path.exists() and self._entry(path)["sha256"] not in ("", digest(path))

    def require_whole(self, path: Path) -> None:
        """Refuse a file that is not what we wrote.

        Raises
        ------
        StageError
            If so.
        """
        if self._listed is None or self._entry(path)["sha256"] != digest(path):
            raise StageError(f"{path}: is not as the run wrote it; run its config again")

    def write(self, path: Path, key: str, fill: Callable[[Path], object]) -> None:
        """Write a claimed file, whole or not at all, unless it is current.

        Parameters
        ----------
        path : below the folder.
        key : of what it is made from; without one it is written always.
        fill : writes the content to the path it is given.
        """
        if not self.current(path, key):
            write_atomically(path, fill)
            self.written(path, key)

    def written(self, path: Path, key: str) -> None:
        """Note that a claimed file was written."""
        self._save({**(self._listed or {}), path.name: {"key": key, "sha256": digest(path)}})

    def discard(self, *paths: Path) -> None:
        """Remove those of the files that are ours."""
        for path in paths:
            if path.name in (self._listed or {}):
                path.unlink(missing_ok=True)

    def leftovers(self) -> list[Path]:
        """What killed processes left: half a file of ours, folders of work.

        Half the file of a stage is none: the next run goes on from it.
        """
        if not self.marked:
            return []
        halves = [f"{name}{PARTIAL}" for name in (MARK, *(self._listed or {}))]
        folder = self._mark.parent
        files = [folder / name for name in halves if not name.endswith(f".mcap{PARTIAL}")]
        return sorted((*(f for f in files if f.is_file()), *folder.glob(f"{SCRATCH}*")))

    def _entry(self, path: Path) -> _Entry:
        return (self._listed or {}).get(path.name, {"key": "", "sha256": ""})

    def _save(self, listed: dict[str, _Entry]) -> None:
        self._listed = listed
        text = json.dumps({"files": listed, "check": _check(listed)}, indent=1) + "\n"
        write_atomically(self._mark, lambda file: file.write_text(text, encoding="utf-8"))


def _read(mark: Path) -> dict[str, _Entry] | None:
    """What a mark lists; None if there is none or it is damaged."""
    try:
        document = json.loads(mark.read_bytes())
        listed: dict[str, _Entry] = document["files"]
        return listed if document["check"] == _check(listed) else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _check(listed: dict[str, _Entry]) -> str:
    return hashlib.sha256(json.dumps(listed, sort_keys=True).encode()).hexdigest()[:16]


def digest(path: Path) -> str:
    """SHA-256 of a file's content; empty if it is not there."""
    try:
        with path.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError:
        return ""


@contextmanager
def locked(folder: Path, *, force: bool = False) -> Generator[Outputs]:
    """Hold a folder for this process and give its files; what a killed one left half goes.

    Raises
    ------
    StageError
        If another process works in it.
    """
    made = [path for path in (folder, *folder.parents) if not path.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / LOCK).open("a") as stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise StageError(
                f"{folder}: another spinpipe works in this folder; "
                "wait for it or choose another with --output"
            ) from None
        try:
            outputs = Outputs(folder, force=force)
            for path in outputs.leftovers():
                remove(path)
            yield outputs
        except BaseException:
            _remove_if_nothing_came_of_it(folder, made)
            raise


def _remove_if_nothing_came_of_it(folder: Path, made: list[Path]) -> None:
    """Leave no folder behind that holds only our own marks, nor parents made for it."""
    if made and {path.name for path in folder.iterdir()} <= {LOCK, MARK}:
        for path in folder.iterdir():
            path.unlink()
        for path in made:
            path.rmdir()


def write_new(path: Path, fill: Callable[[Path], object], *, force: bool = False) -> None:
    """Write a file that the user named, whole or not at all; one that is there stays.

    Raises
    ------
    StageError
        If it is there and may not be replaced.
    """
    require_new(path, force=force)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, fill)


def require_new(path: Path, *, force: bool = False) -> None:
    """Refuse to replace a file, best before the work for it is done.

    Raises
    ------
    StageError
        If it is there and may not be replaced.
    """
    if os.path.lexists(path) and not force:
        raise StageError(f"{path}: is there already; name another, or replace it with --force")
