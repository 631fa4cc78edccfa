"""What a file is, by its content: suffixes lie, and one suffix stands for many formats."""

from __future__ import annotations

import re
from pathlib import Path

from spinpipe.stages.stage import StageError

_HEAD = 1 << 16
_NUMBER = rb"[-+]?(\d+([.,]\d*)?|[.,]\d+)([ed][-+]?\d+)?|nan|inf"
_ROW = re.compile(
    rb"([^\s,;]+[\s,;]+){0,2}(%s)([\s,;]+(%s)){2,}([\s,;].*)?" % (_NUMBER, _NUMBER), re.I
)
_GROUPED = re.compile(rb"[-+]?\d{1,3}((\.\d{3})+,\d+|(,\d{3})+\.\d+)")
"""A number with thousands separators."""
_PTX = re.compile(
    rb"\d+\s*\n\d+\s*\n" + rb"(\S+[ \t]+){2}\S+\s*\n" * 4 + rb"(\S+[ \t]+){3}\S+\s*\n" * 4
)
"""Columns, rows, the scanner's place and axes, and its transform: points follow in its frame."""

_BEGINNINGS: tuple[tuple[str, str], ...] = (
    ("ply", r"ply[ \t]*[\r\n]"),
    ("las", "LASF"),
    ("mcap", r"\x89MCAP"),
    ("e57", "ASTM-E57"),
    ("glb", "glTF"),
    ("pcd", r"(#[^\n]*\n|\s)*(VERSION|FIELDS|COLUMNS)\s"),
    ("bundler", r"# Bundle file"),
    ("patch", r"\s*PATCHES\s"),
    ("off", r"\s*(#[^\n]*\n\s*)*(ST)?C?N?4?n?OFF\s"),
    ("dae", r"\s*(<\?xml[^>]*>|<!--.*?-->|\s)*<COLLADA"),
    ("gltf", r"\s*\{(?=.*\"asset\"\s*:)"),
    ("opensfm", r"\s*\[?\s*\{(?=.*\"(cameras|shots)\"\s*:)"),
    ("obj", r"([^\n]*\n)*?\s*(v[ \t]+[-\d.]|mtllib[ \t]|vn[ \t]+[-\d.])"),
    ("stl", r"\s*(?i:solid)\b(?=.*\b(?i:facet)\b)"),
)
_KINDS = tuple((kind, re.compile(text.encode(), re.S)) for kind, text in _BEGINNINGS)

_OTHERS: tuple[tuple[bytes, str], ...] = (
    (b"version https://git-lfs", "a Git LFS pointer; fetch the file itself with 'git lfs pull'"),
    (b"PK\x03\x04", "a zip archive; unpack it first (3MF: export as OBJ; NPZ: as text)"),
    (b"\x1f\x8b", "a gzip archive; unpack it first"),
    (b"7z\xbc\xaf", "a 7z archive; unpack it first"),
    (b"BZh", "a bzip2 archive; unpack it first"),
    (b"\xfd7zXZ", "an xz archive; unpack it first"),
    (b"MVSI", "an OpenMVS project; give the PLY that OpenMVS writes beside it"),
    (b"#ROSBAG", "a ROS 1 bag; convert it with 'mcap convert'"),
    (b"SQLite format 3", "a database, perhaps a ROS 2 bag; convert it with 'mcap convert'"),
    (b"\x89HDF", "an HDF5 file; export the cloud as PLY or LAS"),
    (b"Kaydara FBX", "an FBX file; export it as OBJ or GLB"),
    (b"BLENDER", "a Blender project; export it as OBJ or GLB"),
    (b"ISO-10303-21", "a STEP or IFC file; export it as OBJ or STL"),
    (b"#usda", "a USD file; export it as GLB or OBJ"),
    (b"PXR-USDC", "a USD file; export it as GLB or OBJ"),
    (b"# vtk", "a VTK file; export it as PLY"),
    (b"DRACO", "a Draco file; unpack it with 'draco_decoder'"),
    (b"\x93NUMPY", "an array of numpy; write it as text with numpy.savetxt"),
    (b"II*\0", "a TIFF, a picture or a height model; give the cloud, or its cells as XYZ"),
    (b"MM\0*", "a TIFF, a picture or a height model; give the cloud, or its cells as XYZ"),
    (b"ncols ", "a raster of heights; give the cloud, or its cells as XYZ (gdal2xyz)"),
    (b"\xff\xfe", "text in UTF-16; save it as UTF-8"),
    (b"\xfe\xff", "text in UTF-16; save it as UTF-8"),
    (b"\x89PNG", "a picture; give the reconstruction made from it"),
    (b"\xff\xd8\xff", "a picture; give the reconstruction made from it"),
    (b"AC10", "a DWG drawing; export the points as XYZ or LAS, a mesh as OBJ or STL"),
    (b"AutoCAD Binary DXF", "a DXF drawing; export points as XYZ or LAS, a mesh as OBJ or STL"),
    (b"ADRC", "a ReCap scan; export it as E57 or PTS"),
    (b"#VRML", "a VRML scene; export it as OBJ, PLY or GLB"),
    (b"\x80\x04\x95", "a Python pickle; write the points as PLY or with numpy.savetxt"),
    (b"%PDF", "a PDF"),
    (b"<!doctype html", "a web page; download the file itself"),
    (b"<html", "a web page; download the file itself"),
)


_OTHER_TEXTS: tuple[tuple[re.Pattern[bytes], str], ...] = tuple(
    (re.compile(text, re.S | re.I), what)
    for text, what in (
        (
            rb"(\s*999\r?\n[^\n]*\n)*\s*0\s*\n\s*SECTION\s",
            "a DXF drawing; export points as XYZ or LAS, a mesh as OBJ or STL",
        ),
        (
            rb"\s*(<\?xml[^>]*>\s*)?(<!DOCTYPE[^>]*>\s*)?<X3D",
            "an X3D scene; export it as OBJ or GLB",
        ),
        (rb"; FBX ", "an FBX file; export it as OBJ or GLB"),
        (rb"[^\n]{72}S\s*\d+\s*\n", "an IGES file; export it as OBJ or STL"),
        (rb"\s*(<\?xml[^>]*>\s*)?<kml", "a KML file; give the reconstruction itself"),
        (
            rb"\s*\{(?=.*\"frames\")(?=.*\"transform_matrix\")",
            "a NeRF dataset, cameras without points; give the cloud reconstructed from it",
        ),
        (rb"\s*\{\s*\"type\"\s*:\s*\"Feature", "a GeoJSON file; export the points as XYZ"),
    )
)


def file_kind(path: Path) -> str:
    """Name the format of a file by its first 64 KiB and its size.

    Returns
    -------
    str
        ``ply``, ``las``, ``mcap``, ``e57``, ``glb``, ``gltf``, ``pcd``, ``bundler``, ``patch``,
        ``off``, ``dae``, ``obj``, ``stl``, ``opensfm``, ``colmap`` (a points3D file) or ``text``.

    Raises
    ------
    StageError
        When it cannot be opened, is empty or none of these; the message says what it looks like.
    """
    if not path.exists():
        raise StageError(f"{path}: no such file or folder; correct the path in the config")
    try:
        size = path.stat().st_size
        with path.open("rb") as file:
            head = file.read(_HEAD)
    except OSError as error:
        raise StageError(f"{path}: cannot be read: {error.strerror}") from None
    if not head.strip(b"\0 \t\r\n"):
        raise StageError(f"{path}: the file is empty: {_unknown(path)}")
    if path.name in ("points3D.bin", "points3D.txt"):
        return "colmap"
    for beginning, what in _OTHERS:
        if head[: len(beginning)].lower() == beginning.lower():
            raise StageError(f"{path}: this is {what}")
    head = head.removeprefix(b"\xef\xbb\xbf")
    for pattern, what in _OTHER_TEXTS:
        if pattern.match(head):
            raise StageError(f"{path}: this is {what}")
    kind = next((kind for kind, pattern in _KINDS if pattern.match(head)), None)
    if kind == "obj" and not _is_text(head):
        kind = None
    if kind is not None:
        return kind
    if size >= 84 and size == 84 + 50 * int.from_bytes(head[80:84], "little"):
        return "stl"
    if _is_text(head):
        lines = head.splitlines()[: -1 if size > _HEAD else None]
        if _PTX.match(head):
            raise StageError(f"{path}: this is a PTX file; export it as PTS, E57 or LAS")
        if lines and all(map(_is_grouped, lines[1:50] or lines)):
            raise StageError(f"{path}: its numbers have thousands separators; export them without")
        rows = [line for line in lines[:50] if _ROW.fullmatch(line.replace(b'"', b"").strip())]
        if len(rows) >= min(len(lines), 2) / 2:
            return "text"
    raise StageError(f"{path}: {_unknown(path)}")


def _is_grouped(line: bytes) -> bool:
    """Whether all words are numbers, some of them with thousands separators."""
    words = re.split(rb"[;\s]+", line.strip(b" ;\t\r\n"))
    grouped = [_GROUPED.fullmatch(word) is not None for word in words]
    plain = re.compile(_NUMBER, re.I)
    return any(grouped) and all(
        g or plain.fullmatch(w) for g, w in zip(grouped, words, strict=True)
    )


def _is_text(head: bytes) -> bool:
    return b"\0" not in head and not re.search(rb"[\x00-\x08\x0e-\x1f]", head)


def _unknown(path: Path) -> str:
    claims = {
        ".ply": "not a PLY file, it does not begin with 'ply'",
        ".las": "not a LAS file, it does not begin with 'LASF'",
        ".laz": "not a LAZ file, it does not begin with 'LASF'",
        ".pcd": "not a PCD file, its header is missing",
        ".glb": "not a GLB file, it does not begin with 'glTF'",
        ".stl": "not an STL file, its size does not fit its number of faces",
        ".e57": "not an E57 file, it does not begin with 'ASTM-E57'",
        ".mcap": "not an MCAP file",
        ".bin": "raw numbers without a header, as of KITTI, or a file of a COLMAP model: give the "
        "model's folder, or write the points as PLY or PCD",
        ".3ds": "a 3DS scene; export it as OBJ or GLB",
    }
    known = "PLY, LAS, LAZ, PCD, E57, XYZ, CSV, PTS, OBJ, STL, GLB, OFF, DAE, MCAP, Bundler, COLMAP"
    claim = claims.get(path.suffix.lower(), f"of no known format (known are {known})")
    return f"{claim}; copy or export the file again"
