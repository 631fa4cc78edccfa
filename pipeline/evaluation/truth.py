"""Ground truth from a CSV file, brought to the world frame of a run."""

from __future__ import annotations

import csv
import difflib
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from spinpipe.schemas.arrays import F64
from spinpipe.schemas.records import SceneFrame, Upright
from spinpipe.stages.geometry.frames import world_from_scene
from spinpipe.stages.stage import StageError

COLUMNS = ("model", "x", "y", "z", "heading_deg", "axis_deg", "ignore")
LEAST_UPRIGHT = 0.5
"""Smallest cosine between the scene's z axis and up with which x and y alone say a place."""


@dataclass(frozen=True)
class TruthObject:
    """One labelled object, in the world frame."""

    row: int
    """Line of the file."""
    given: tuple[float, float]
    """x and y as the file has them."""
    model: str
    """Empty if the file does not say."""
    position: tuple[float, float, float]
    """Base centre in metres; z is NaN if the file has none."""
    heading_deg: float | None
    """Of the object's +x axis, [0, 360)."""
    axis_deg: float | None
    """Of the object's long axis, [0, 180): known too where the heading is."""
    ignore: bool
    """Counts neither as found nor as missed, and what is found there is not false."""


def read_truth(
    path: Path, frame: SceneFrame, upright: Upright, coordinates: Literal["scene", "world"]
) -> list[TruthObject]:
    """Read a file with the columns ``x,y`` and optionally ``model,z,heading_deg,axis_deg,ignore``.

    Parameters
    ----------
    path : CSV file with a header; columns of other names are left alone.
    frame, upright : of the run.
    coordinates
        Frame of the file. ``scene``: as the imported cloud; headings are counter-clockwise from
        its +x. ``world``: as ``position_world`` and ``heading_deg`` of detections.json.

    Raises
    ------
    StageError
        If a column or number is missing or wrong, with file and line.
    """
    T = world_from_scene(frame, upright) if coordinates == "scene" else np.eye(4)
    rotation = T[:3, :3] / np.cbrt(np.linalg.det(T[:3, :3]))
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            table = csv.DictReader(stream, skipinitialspace=True)
            header = [name.strip() for name in table.fieldnames or ()]
            table.fieldnames = header
            _check_header(header, path)
            return [_object(row, table.line_num, T, rotation, path) for row in table]
    except (UnicodeDecodeError, csv.Error) as error:
        raise StageError(f"{path}: not a CSV file: {error}") from None


def _check_header(header: list[str], path: Path) -> None:
    """Refuse a header without places, or with a name that is nearly one of ours."""
    for name in ("x", "y"):
        if name not in header:
            raise StageError(
                f"{path}: no column '{name}'; the header must name x and y, "
                "and may name model, z, heading_deg, axis_deg, ignore"
            )
    for name in header:
        missing = [column for column in COLUMNS if column not in header]
        meant = difflib.get_close_matches(name, missing, n=1, cutoff=0.65)
        if name not in COLUMNS and meant:
            raise StageError(f"{path}: unknown column '{name}'; rename it: '{meant[0]}' is known")


def _object(
    row: dict[str, str | None], line: int, T: F64, rotation: F64, path: Path
) -> TruthObject:
    def number(column: str) -> float | None:
        text = (row.get(column) or "").strip()
        if not text:
            return None
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise StageError(f"{path}: line {line}: {column} = '{text}' is no number; correct it")
        return value

    x, y, z = number("x"), number("y"), number("z")
    if x is None or y is None:
        raise StageError(f"{path}: line {line}: x or y is empty; fill it in or remove the line")
    where = f"{path}: line {line}"
    heading, axis = number("heading_deg"), number("axis_deg")
    if heading is not None:
        heading = _turned(heading, rotation, where)
    axis = heading if axis is None else _turned(axis, rotation, where)
    return TruthObject(
        row=line,
        given=(x, y),
        model=(row.get("model") or "").strip(),
        position=_position(x, y, z, T, where),
        heading_deg=heading,
        axis_deg=None if axis is None else axis % 180.0,
        ignore=bool(number("ignore")),
    )


def _position(
    x: float, y: float, z: float | None, T: F64, where: str
) -> tuple[float, float, float]:
    """World position; without z that of the place on the ground below or above."""
    if z is not None:
        u, v, w = (T[:3, :3] @ [x, y, z] + T[:3, 3]).tolist()
        return u, v, w
    _require_upright(T[2, 2] / np.linalg.norm(T[2, :3]), where)
    ground_z = -(T[2, 0] * x + T[2, 1] * y + T[2, 3]) / T[2, 2]
    u, v, _ = (T[:3, :3] @ [x, y, ground_z] + T[:3, 3]).tolist()
    return u, v, math.nan


def _turned(angle_deg: float, rotation: F64, where: str) -> float:
    """Heading in the world of a horizontal direction of the file's frame."""
    _require_upright(rotation[2, 2], where)
    angle = math.radians(angle_deg)
    direction = rotation @ [math.cos(angle), math.sin(angle), 0.0]
    return math.degrees(math.atan2(direction[1], direction[0])) % 360.0


def _require_upright(cosine: float, where: str) -> None:
    if cosine < LEAST_UPRIGHT:
        raise StageError(
            f"{where}: the scene's z axis is not up, so x, y and an angle say no place in it; "
            "give the truth in world coordinates with --frame world"
        )
