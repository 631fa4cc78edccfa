"""Files that a run reads: which they are, what is in them, and whether they stayed as they were."""

from __future__ import annotations

import difflib
import hashlib
import json
import os
import re
import stat
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from spinpipe.pipeline.outputs import MARK
from spinpipe.stages.stage import StageError

_CLOCK_S = 0.02
"""A file system counts time in steps of up to so long: a change within one would go unseen."""

_PHOTOS = (".jpg", ".jpeg")
_PHOTO_HEAD = 1 << 17
"""EXIF is one segment near the beginning, of at most 64 KiB [CIPA DC-008, 4.7.2]."""

_LINK = re.compile(r"(^|/)(https?|ftp|s3|file):")


def _missing_hint(path: Path) -> str:
    """What a path that leads nowhere was meant to be, where that shows."""
    text = str(path)
    if not text.isprintable():
        return "; escapes like \\t stand in it: write paths with / or in single quotes"
    if _LINK.search(text):
        return "; links are not followed: download it and give its path"
    if "$" in text or "%" in text:
        return "; variables are not replaced: write the whole path"
    if "\\" in text:
        return "; folders are parted by / here"
    try:
        there = {other.name.lower(): other.name for other in path.parent.iterdir()}
    except OSError:
        return f"; the folder {path.parent} is not there either"
    near = difflib.get_close_matches(path.name.strip(" '\"").lower(), there, n=1, cutoff=0.6)
    return f"; did you mean '{there[near[0]]}'?" if near else ""


Identity = tuple[tuple[str | int, ...], ...]


def hash_path(path: Path, key: str) -> str:
    """Hash of a file's content, or of all files below a folder with their relative names.

    Of photos in a folder, the size and the head count: stages read what their EXIF says.
    The content of a glTF file includes the buffers that it refers to. A run's folder below an
    input is no part of it.

    Raises
    ------
    StageError
        If it is missing, cannot be read, or is neither file nor folder: a pipe has no end.
    """
    digest = hashlib.sha256()
    try:
        for file in _files(path, key):
            if path.is_dir():
                digest.update(str(file.relative_to(path)).encode() + b"\0")
            with file.open("rb") as stream:
                if path.is_dir() and file.suffix.lower() in _PHOTOS:
                    head = stream.read(_PHOTO_HEAD)
                    digest.update(b"%d" % file.stat().st_size + hashlib.sha256(head).digest())
                else:
                    digest.update(hashlib.file_digest(stream, "sha256").digest())
        if path.suffix.lower() == ".gltf":
            for content in _gltf_buffers(path):
                digest.update(hashlib.sha256(content).digest())
    except OSError as error:
        raise StageError(f"{key}: cannot read {path}: {error.strerror}") from None
    return f"sha256 {digest.hexdigest()}{path.suffix}"


def identity(path: Path, key: str) -> Identity:
    """What changes when an input is written to or replaced: places, sizes and times.

    Taken before it is hashed and compared after it was read, it tells that what was read is what
    was hashed. Waits until its newest time is past, so that no later change can bear the same.
    """
    try:
        found = [(str(f), f.lstat(), f.stat()) for f in _files(path, key)]
    except OSError as error:
        raise StageError(f"{key}: cannot read {path}: {error.strerror}") from None
    newest = max((s.st_ctime for _, *stats in found for s in stats), default=0.0)
    while 0 <= time.time() - newest < _CLOCK_S:
        time.sleep(_CLOCK_S)
    return tuple(
        (name, *(n for s in stats for n in (s.st_dev, s.st_ino, s.st_size, s.st_ctime_ns)))
        for name, *stats in found
    )


def _files(path: Path, key: str) -> Iterator[Path]:
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        raise StageError(f"{key}: {path} does not exist{_missing_hint(path)}") from None
    if stat.S_ISREG(mode):
        yield path
        return
    if not stat.S_ISDIR(mode):
        raise StageError(f"{key}: {path} is neither a file nor a folder; give a file")
    for folder, below, names in os.walk(path):
        below[:] = sorted(name for name in below if not Path(folder, name, MARK).exists())
        for file in (Path(folder, name) for name in sorted(names)):
            if file.is_file():
                yield file


def _gltf_buffers(path: Path) -> Iterator[bytes]:
    """Content of the buffers that a glTF file refers to, found as the reader of meshes finds them.

    Buffers within the file, and images, are left out [Khronos glTF 2.0, section 3.6.1].

    Raises
    ------
    StageError
        If the file is no glTF or a buffer cannot be read.
    """
    from trimesh.resolvers import FilePathResolver  # heavy: only where needed

    resolver = FilePathResolver(str(path))
    try:
        document: dict[str, Any] = json.loads(path.read_bytes())
        uris = [buffer.get("uri", "data:") for buffer in document.get("buffers", [])]
    except (ValueError, AttributeError, TypeError) as error:
        raise StageError(f"{path}: not a glTF file ({error}); export it again") from None
    for uri in uris:
        if uri.startswith("data:"):
            continue
        try:
            yield resolver.get(uri)
        except (OSError, ValueError) as error:
            raise StageError(f"{path}: cannot read its buffer '{uri}'; put it beside") from error
