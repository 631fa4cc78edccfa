"""Our PLY header and writer against an independent implementation."""

# plyfile has no types
# pyright: reportMissingTypeStubs=false, reportUnknownMemberType=false

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plyfile import PlyData, PlyElement, PlyListProperty

from spinpipe.pipeline.scenes.write_ply import cloud_rows, write_ply
from spinpipe.stages.ingest.readers.ply_header import CODES, parse_header

NUMBERS = st.sampled_from(sorted(CODES.values()))
FIELDS = st.lists(
    st.tuples(st.from_regex(r"[a-z_]{1,8}", fullmatch=True), NUMBERS, st.booleans()),
    min_size=1,
    max_size=6,
    unique_by=lambda field: field[0],
)


@given(
    tables=st.dictionaries(st.sampled_from(["vertex", "face", "edge"]), FIELDS, min_size=1),
    order=st.sampled_from(["ascii", "<", ">"]),
    count=st.integers(0, 3),
)
def test_headers_mean_the_same_to_both(tables: dict[str, Any], order: str, count: int) -> None:
    elements = []
    for name, fields in tables.items():
        dtype = [(f, "O" if is_list else code) for f, code, is_list in fields]
        rows = np.zeros(count, dtype)
        for field, code, is_list in fields:
            if is_list:
                rows[field] = [np.zeros(2, code) for _ in range(count)]
        types = {field: code for field, code, _ in fields}
        elements.append(PlyElement.describe(rows, name, val_types=types))
    text = order == "ascii"
    theirs = PlyData(elements, text=text, byte_order="=" if text else order, comments=["a b"])
    stream = io.BytesIO()
    theirs.write(stream)

    ours = parse_header(stream.getvalue())

    assert ours.text == text
    assert ours.data_offset == len(theirs.header) + 1
    assert ours.comments == ("a b",)
    assert [e.name for e in ours.elements] == list(tables)
    native = "=" if text else order
    for element, expected in zip(ours.elements, elements, strict=True):
        assert element.count == count
        for prop, other in zip(element.properties, expected.properties, strict=True):
            assert prop.name == other.name
            if isinstance(other, PlyListProperty):
                assert (prop.count_dtype, prop.dtype) == other.list_dtype(native)
            else:
                assert (prop.count_dtype, prop.dtype) == (None, other.dtype(native))
        if element.has_lists:
            with pytest.raises(ValueError, match="no common type"):
                _ = element.dtype
        else:
            assert element.dtype == expected.dtype(native)


def test_type_names_with_sizes_mean_the_same() -> None:
    for name, code in CODES.items():
        for alias in (name, np.dtype(code).name):
            head = f"ply\nformat ascii 1.0\nelement a 1\nproperty {alias} x\nend_header\n"
            assert parse_header(head.encode()).elements[0].dtype["x"] == np.dtype(code)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("element vertex", "line 5 'element vertex': not 'element'"),
        ("element vertex -1", "line 5 .*not 'element'"),
        ("element face 2", "line 5 .*a second 'face'"),
        ("property float", "line 5 .*not a 'property'"),
        ("property half x", "line 5 .*no type 'half' in PLY; types are char"),
        ("property list float int x", "'float' cannot count"),
        ("property float n", "line 5 .*a second 'n'"),
        ("format ascii 1.0", "line 5 .*not a 'property'"),
        ("nonsense", "line 5 'nonsense'"),
    ],
)
def test_a_broken_line_is_named(line: str, message: str) -> None:
    head = f"ply\nformat ascii 1.0\nelement face 1\nproperty int n\n{line}\nend_header\n"
    with pytest.raises(ValueError, match=message):
        parse_header(head.encode())


@pytest.mark.parametrize(
    ("head", "message"),
    [
        ("ply\nend_header\n", "no 'format' line"),
        ("ply\ncomment format ascii 1.0\nend_header\n", "no 'format' line"),
        ("ply\nformat binary 1.0\nend_header\n", "line 2 .*one of ascii, binary_little_endian"),
        ("ply\nformat ascii 2.0\nend_header\n", "line 2"),
        ("ply\nelement vertex 1\nend_header\n", "line 2 .*not 'format'"),
        ("ply\nformat ascii 1.0\nproperty int n\nend_header\n", "belongs to no element"),
        ("ply\nformat ascii 1.0\n", "no 'end_header'"),
        ("ply", "not a PLY file"),
    ],
)
def test_a_broken_header_is_named(head: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        parse_header(head.encode())


@pytest.mark.parametrize("faces", [None, 0, 7])
@pytest.mark.parametrize("count", [0, 50])
def test_the_writer_writes_what_the_other_one_writes(
    tmp_path: Path, count: int, faces: int | None
) -> None:
    rng = np.random.default_rng(1)
    # Gaps, the other byte order and only every second row: the file has none of it
    dtype = np.dtype([(f"field_{code}", f">{code}") for code in CODES.values()], align=True)
    rows = np.zeros(2 * count, dtype)[::2]
    for name in dtype.names or ():
        rows[name] = rng.integers(0, 100, count)
    triangles = None if faces is None else rng.integers(0, 50, (faces, 3)).astype(np.int32)

    write_ply(tmp_path / "ours.ply", rows, triangles, comment="made by hand")

    packed = rows.astype([(name, dtype[name]) for name in dtype.names or ()])
    elements = [PlyElement.describe(packed, "vertex")]
    if triangles is not None:
        face = np.zeros(len(triangles), [("vertex_indices", "i4", (3,))])
        face["vertex_indices"] = triangles
        elements.append(PlyElement.describe(face, "face"))
    theirs = PlyData(elements, byte_order="<", comments=["made by hand"])
    theirs.write(str(tmp_path / "theirs.ply"))
    assert (tmp_path / "ours.ply").read_bytes() == (tmp_path / "theirs.ply").read_bytes()


def test_rows_of_a_cloud() -> None:
    xyz = np.arange(6.0).reshape(2, 3)
    assert cloud_rows(xyz).tolist() == [(0, 1, 2), (3, 4, 5)]
    assert cloud_rows(xyz).dtype == [(axis, "<f4") for axis in "xyz"]
    rows = cloud_rows(xyz, np.array([7, 8, 9], np.uint8), "<f8")
    assert rows.tolist() == [(0, 1, 2, 7, 8, 9), (3, 4, 5, 7, 8, 9)]
    assert rows.dtype["z"] == np.float64


def test_what_ply_cannot_hold_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "cloud.ply"
    with pytest.raises(ValueError, match="'x': PLY has no type for int64"):
        write_ply(path, np.zeros(1, [("x", "i8")]))
    with pytest.raises(ValueError, match="'x': PLY has no type"):
        write_ply(path, np.zeros(1, [("x", "f4", 3)]))
    with pytest.raises(ValueError, match="without blanks"):
        write_ply(path, np.zeros(1, [("x y", "f4")]))
    with pytest.raises(ValueError, match="one printable line"):
        write_ply(path, cloud_rows(np.zeros((1, 3))), comment="a\nend_header")
    assert not path.exists()
