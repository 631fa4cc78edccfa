"""Clouds as lines of numbers, whatever parts and names their columns."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tests.unit.ingest.readers.small_cloud import COLOURED, LINES, RGB, ROWS, ROWS_RGB, XYZ, read

from spinpipe.stages.ingest.readers.open_scene import open_scene
from spinpipe.stages.stage import StageError


@pytest.mark.parametrize(
    ("text", "coloured"),
    [
        (ROWS, False),
        (ROWS.replace(" ", "\t") + "\n\n", False),
        (ROWS.replace(" ", ","), False),
        (ROWS.replace(".", ","), False),
        (ROWS.replace(".", ",").replace(" ", ";"), False),
        ("# a comment\n" + ROWS, False),
        ("4\n" + COLOURED, True),
        ("x;y;z\n" + ROWS.replace(" ", ";"), False),
        ("//X Y Z R G B\n" + COLOURED, True),
        ("Easting,Northing,Elevation,Red,Green,Blue\r\n" + COLOURED.replace(" ", ","), True),
        ("\n".join(f"{i} {row}" for i, row in enumerate(ROWS.split("\n"))), False),
        ("\n".join(f"P{i},{row}".replace(" ", ",") for i, row in enumerate(LINES)), True),
        ("Exported by a Tool 3.1\nProject: yard\n\n" + ROWS, False),
        ('"n","x [m]","y_m","z (m)"\n"7",' + ROWS.replace(" ", ",").replace("\n", '\n"7",'), False),
        (ROWS.replace(" ", ", ").replace("\n", ",\n"), False),
        ("\n".join(["2", *LINES[:2], "2", *LINES[2:]]), True),
        ("\n".join(f"{row} 0.0 0.6 0.8" for row in ROWS.split("\n")), False),
        ("id x y z\n" + "\n".join(f"{i} {row}" for i, row in enumerate(ROWS.split("\n"))), False),
        ("\n".join(" ".join(f"{v:.9E}".replace("E", "D") for v in row) for row in XYZ), False),
        ("\n".join(f"{a} {' '.join(f'{v:.6f}' for v in c / 255)}" for a, c in ROWS_RGB), True),
        (
            "\n".join(f"2026-01-02 12:00:{i}0 {row}" for i, row in enumerate(ROWS.split("\n"))),
            False,
        ),
        ("\n".join(f"{row} # a tree" for row in ROWS.split("\n")), False),
        (ROWS.replace("\n", "\r"), False),
        ("x;y;z;\n" + ROWS.replace(" ", ";").replace("\n", ";\n"), False),
        ("z,y,x\nm,m,m\n" + "\n".join(",".join(r.split()[::-1]) for r in ROWS.split("\n")), False),
    ],
)
def test_text(tmp_path: Path, text: str, coloured: bool) -> None:
    path = tmp_path / "cloud"
    path.write_text(text)
    xyz, rgb = read(path)
    np.testing.assert_allclose(xyz, XYZ, atol=1e-6)
    assert open_scene(path).coloured == coloured
    np.testing.assert_array_equal(rgb, RGB if coloured else np.full_like(RGB, 255))


def test_damaged_text_names_the_place(tmp_path: Path) -> None:
    path = tmp_path / "cloud.xyz"
    path.write_text(ROWS + "\n1 2\n")
    with pytest.raises(StageError, match="cannot read points 3 to 5 of 5"):
        read(path)
    path.write_text("5\n" + ROWS)
    with pytest.raises(StageError, match="cut short, 1 of 5 points are missing"):
        open_scene(path)
    path.write_text("x y z\n1 2 abc\n" + ROWS)
    with pytest.raises(StageError, match=r"line 2 is no point \('1 2 abc'\)"):
        open_scene(path)


@pytest.mark.parametrize("missing", ["1,,3,5", ",2,3,5", "NA,NA,NA,5", "1,null,3,5", ",,,"])
def test_rows_without_numbers_are_points_without_coordinates(tmp_path: Path, missing: str) -> None:
    path = tmp_path / "cloud.csv"
    path.write_text("x,y,z,i\n" + ROWS.replace(" ", ",").replace("\n", ",5\n") + f",5\n{missing}\n")
    xyz, _ = read(path, 10)
    np.testing.assert_allclose(xyz[:4], XYZ, atol=1e-6)
    assert not np.isfinite(xyz[4]).all()


@pytest.mark.parametrize(
    ("names", "unit"),
    [
        ("x [ft],y [ft],z [ft]", 0.3048),
        ("x,y,z\nft,ft,ft", 0.3048),
        ("x_mm,y_mm,z_mm", 1e-3),
        ("x_coord,y_coord,h", None),
    ],
)
def test_units_in_the_names_of_columns(tmp_path: Path, names: str, unit: float | None) -> None:
    path = tmp_path / "cloud.csv"
    path.write_text(f"{names}\n" + ROWS.replace(" ", ","))
    assert open_scene(path).about.coordinates.metres == (unit and (unit, unit, unit))
