"""The files beside a ``.gltf`` that hold its geometry."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from spinpipe.stages.stage import StageError


def external_buffers(path: Path) -> Iterator[bytes]:
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
