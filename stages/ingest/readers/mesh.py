"""Triangle meshes: OBJ, STL, GLB, glTF, OFF and DAE through trimesh, PLY by itself.

A mesh offered as a scene is sampled evenly over its faces.
"""

# trimesh's types are incomplete
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false

from __future__ import annotations

import json
import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any, Literal

import numpy as np

from spinpipe.schemas.arrays import F64, I64, U8
from spinpipe.schemas.records import Vector
from spinpipe.stages.geometry.shapes import draw_on_faces, face_areas_and_normals
from spinpipe.stages.ingest.readers.coordinates import Coordinates, beside, from_text
from spinpipe.stages.ingest.readers.guarded import guarded, readable
from spinpipe.stages.ingest.readers.ply import read_header
from spinpipe.stages.ingest.readers.ply_faces import read_ply_mesh
from spinpipe.stages.ingest.readers.scene_source import About, MemorySource
from spinpipe.stages.stage import StageError

MESHES = ("obj", "stl", "glb", "gltf", "off", "dae", "ply")
SAMPLES = 1_000_000
"""Points drawn from a mesh that is offered as a scene; as many as it has vertices if more."""
_MESH_SHARE = 0.5
"""A cloud may carry some faces; where they use this share of the vertices they are the scene."""
_ASSET = 1 << 16
"""Bytes at the beginning of a DAE file that hold what it says of itself."""
_STL_TITLE = 80
"""Bytes before the number of faces of a binary STL; text files begin with a line instead."""
_SEED = 20100502
"""Of that sample, which belongs to the file and not to the run: 3DOR 2010, 2 May."""


@dataclass(frozen=True)
class FileMesh:
    """All faces of a file, in its own coordinates."""

    vertices: F64
    """(V, 3), each used by a face."""
    faces: I64
    """(F, 3)."""
    rgb: U8 | None = None
    """(V, 3), or None where there are no colours."""
    up: Vector | None = None
    """Up by the format's specification."""
    coordinates: Coordinates = field(default_factory=Coordinates)
    """Unit as far as the file tells."""
    kind: str = ""
    used: float = 1.0
    """Share of the file's vertices that a face uses."""


def read_mesh(path: Path, kind: str) -> FileMesh | None:
    """Read all faces of a file; None where it has none, as a cloud.

    Raises
    ------
    StageError
        When it cannot be read, or a face refers to a vertex that is not there.
    """
    if kind == "ply":
        found = read_ply_mesh(path)
        if found is None:
            return None
        vertices, faces, rgb = found
        up, told = None, from_text(read_header(path).comments, "a comment in the PLY header")
    else:
        if kind in ("glb", "gltf"):
            with readable(path, "mesh", "export it again"):
                _require_readable(path, kind)
        # imported here once, not in each child
        import trimesh  # noqa: F401  # pyright: ignore[reportUnusedImport]

        vertices, faces, rgb = next(iter(guarded(_by_trimesh, path, kind)))
        # glTF: +y is up [Khronos glTF 2.0, section 3.4]
        up = (0.0, 1.0, 0.0) if kind in ("glb", "gltf") else None
        told = collada_asset(path)[0] if kind == "dae" else _said_in_comments(path, kind)
    if not len(faces):
        return None
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise StageError(
            f"{path}: a face refers to vertex {int(np.abs(faces).max()):,} of {len(vertices):,}; "
            "export it again"
        )
    used = np.zeros(len(vertices), np.bool_)
    used[faces] = True
    compact = np.cumsum(used) - 1
    name = {"gltf": "glTF"}.get(kind, kind.upper())
    colours = None if rgb is None else rgb[used]
    share = float(used.mean())
    told = told or beside(path) or Coordinates()
    return FileMesh(vertices[used], compact[faces], colours, up, told, f"{name} mesh", share)


def sampled_mesh(path: Path, kind: str) -> MemorySource | None:
    """A mesh as a scene: points evenly over its faces; None where it has none."""
    mesh = read_mesh(path, kind)
    if mesh is None or mesh.used < _MESH_SHARE:
        return None
    finite = np.isfinite(mesh.vertices[mesh.faces]).all(axis=(1, 2))
    faces = mesh.faces[finite]
    if not face_areas_and_normals(mesh.vertices, faces)[0].sum() > 0:
        raise StageError(f"{path}: its faces have no area; give a cloud or a mesh with a surface")
    count = max(SAMPLES, len(mesh.vertices))
    rng = np.random.default_rng(_SEED)
    draw = draw_on_faces(mesh.vertices, faces, count, rng)
    rgb = None
    if mesh.rgb is not None:
        corners = mesh.rgb[faces[draw.face]].astype(np.float64)
        rgb = np.rint(np.einsum("nk,nkc->nc", draw.weights, corners)).astype(np.uint8)
    about = About(
        kind=f"{mesh.kind} of {len(mesh.faces):,} faces",
        coordinates=mesh.coordinates,
        up=mesh.up,
        up_reason="glTF: y is up" if mesh.up else "",
        notes=(f"a mesh, not a cloud: {count:,} points drawn from its {len(faces):,} faces",),
    )
    return MemorySource(about, draw.points, rgb)


def _by_trimesh(path: Path, kind: str) -> Iterator[tuple[F64, I64, U8 | None]]:
    import trimesh  # heavy: only where needed
    from trimesh.resolvers import FilePathResolver

    with readable(path, "mesh", "export it again"):
        with path.open("rb") if kind != "obj" else BytesIO(_plain_obj(path.read_bytes())) as file:
            resolver = FilePathResolver(str(path))
            scene = trimesh.load_scene(
                file, file_type=kind, resolver=resolver, process=False, skip_materials=True
            )
        mesh: Any = scene.to_mesh()
    faces = np.asarray(mesh.faces, np.int64).reshape(-1, 3)
    visual: Any = getattr(mesh, "visual", None)
    rgb = None
    if getattr(visual, "kind", None) == "vertex" and len(faces):
        rgb = np.ascontiguousarray(np.asarray(visual.vertex_colors, np.uint8)[:, :3])
    yield np.asarray(mesh.vertices, np.float64).reshape(-1, 3), faces, rgb


def _plain_obj(data: bytes) -> bytes:
    """OBJ with decimal points, its corners without rows of texture and normals.

    trimesh takes the corners of a face to have the same rows, which files do not keep to.
    """
    if re.search(rb"^v[ \t][^\n]*\d,\d", data, re.M):
        data = data.replace(b",", b".")
    if re.search(rb"^f[ \t][^\n]*/", data, re.M):
        data = re.sub(rb"(?<=\d)/[-\d/]*", b"", data)
    return data


def _said_in_comments(path: Path, kind: str) -> Coordinates | None:
    """A unit or system that OBJ and OFF files name in comments, STL files in their title."""
    if kind not in ("obj", "off", "stl"):
        return None
    with path.open("rb") as file:
        head = file.read(_STL_TITLE if kind == "stl" else _ASSET).decode("utf-8", "replace")
    lines = head.splitlines()
    comments = lines[:1] if kind == "stl" else [line for line in lines if line.startswith("#")]
    return from_text(comments, f"a comment in the {kind.upper()} file")


def collada_asset(path: Path) -> tuple[Coordinates | None, Literal["x", "y", "z"] | None]:
    """Unit and axis that a DAE file says is up, as far as it does [COLLADA 1.4.1, asset]."""
    with path.open("rb") as file:
        head = file.read(_ASSET)
    unit = re.search(rb"<unit\b[^>]*\bmeter\s*=\s*[\"']([0-9.eE+-]+)[\"']", head)
    axis = re.search(rb"<up_axis>\s*([XYZ])_UP\s*</up_axis>", head)
    try:
        metres = float(unit[1]) if unit else 1.0
    except ValueError:
        metres = 1.0
    told = None
    if unit and 0 < metres < np.inf and metres != 1:
        told = Coordinates(
            name=f"{metres:g} m", metres=(metres, metres, metres), source="unit of the DAE file"
        )
    up: dict[bytes, Literal["x", "y", "z"]] = {b"X": "x", b"Y": "y", b"Z": "z"}
    return told, up[axis[1]] if axis else None


def _require_readable(path: Path, kind: str) -> None:
    """Refuse glTF whose geometry trimesh would read wrongly, or not at all.

    [Khronos glTF 2.0, sections 3.6.2.3 and 3.12; KHR_draco_mesh_compression;
    EXT_meshopt_compression]
    """
    document = _gltf_document(path, kind)
    used = [*document.get("extensionsUsed", []), *document.get("extensionsRequired", [])]
    if "KHR_draco_mesh_compression" in used and not _has_draco():
        raise StageError(
            f"{path}: its geometry is compressed with Draco; install DracoPy "
            "(pip install 'spinpipe[draco]'), or export it without compression"
        )
    if any(name.endswith("_meshopt_compression") for name in used):
        raise StageError(
            f"{path}: its geometry is compressed with meshopt; export it without compression"
        )
    for mesh in document.get("meshes", []):
        for primitive in mesh["primitives"]:
            wanted = (primitive["attributes"].get("POSITION"), primitive.get("indices"))
            if any("sparse" in document["accessors"][i] for i in wanted if i is not None):
                raise StageError(
                    f"{path}: its geometry is stored as sparse accessors; export it without them"
                )


def _gltf_document(path: Path, kind: str) -> dict[str, Any]:
    """The JSON of a glTF file."""
    with path.open("rb") as file:
        if kind == "glb":
            (length,) = struct.unpack_from("<I", file.read(20), 12)
            return json.loads(file.read(min(length, path.stat().st_size)))
        return json.load(file)


def _has_draco() -> bool:
    from importlib.util import find_spec

    return find_spec("DracoPy") is not None
