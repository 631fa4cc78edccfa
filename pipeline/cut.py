"""``spinpipe model cut``: a model from the user's own scene."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from pydantic import ValidationError
from rich.console import Console

from spinpipe.pipeline.config import ConfigError
from spinpipe.pipeline.context import RunReader
from spinpipe.pipeline.outputs import require_new, write_new
from spinpipe.pipeline.run_folder import RunFolder
from spinpipe.pipeline.scenes.cutting import around_box, cut_instance
from spinpipe.pipeline.scenes.write_ply import cloud_rows, write_ply
from spinpipe.schemas import CLOUD, SCENE, TILES, UPRIGHT
from spinpipe.schemas.arrays import F64, U8
from spinpipe.stages.geometry.frames import inverse, transform, world_from_scene
from spinpipe.stages.geometry.world_cloud import WorldCloud
from spinpipe.stages.ingest.object_model import ModelConfig
from spinpipe.stages.stage import StageError

MIN_POINTS = 100
"""Fewer points say little about a shape."""


def cut_command(
    path: Path, at: str, size: str, heading_deg: float, name: str, out: Path, force: bool
) -> None:
    """``spinpipe model cut``."""
    try:
        ModelConfig(name=name, path=out)
    except ValidationError as error:
        reason = error.errors()[0]["msg"].removeprefix("Value error, ")
        raise ConfigError(f"--name: {reason}") from None
    place = _numbers(at, "--at", (2, 3), "x,y or x,y,z in scene coordinates")
    extent = _numbers(size, "--size", (3,), "length,width,height in metres")
    if min(extent) <= 0:
        raise ConfigError(f"--size {size}: lengths must be above 0")
    if out.suffix.lower() != ".ply":
        raise ConfigError(f"--out {out}: name a .ply file")
    require_new(out, force=force)
    xyz, rgb = cut_model(RunFolder(path), place, np.array(extent), heading_deg)
    _write(out, name, xyz, rgb, force)
    console = Console()
    size_text = " x ".join(f"{v:.2f}" for v in np.ptp(xyz, axis=0))
    console.print(f"{name}: {len(xyz)} points, {size_text} m; wrote {out}", highlight=False)
    section = f'[[model]]\nname = "{name}"\npath = "{out.as_posix()}"'
    console.print(section, highlight=False, markup=False)


def cut_model(
    folder: RunFolder, at: list[float], size: F64, heading_deg: float = 0.0
) -> tuple[F64, U8]:
    """Points (N, 3) of one instance in its object frame, metres, and their colours (N, 3).

    Parameters
    ----------
    folder : a run that is complete up to its ground stage.
    at : x, y and perhaps z of the instance's base centre in scene coordinates.
    size : (3,) length, width, height of the box around it, metres.
    heading_deg : direction of its length, counter-clockwise from the scene's +x.

    Raises
    ------
    StageError
        If the run lacks its first stages, or too few points are there.
    """
    for stage in ("ingest", "ground"):
        if not folder.mcap(stage).exists():
            raise StageError(f"{folder.path}: no {stage} stage here; run a config up to it first")
    read = RunReader(folder)
    upright = read(UPRIGHT)[0]
    T = world_from_scene(read(SCENE)[0], upright)
    centre, base_z = _place(at, T)
    along = T[:3, :3] @ [
        math.cos(math.radians(heading_deg)),
        math.sin(math.radians(heading_deg)),
        0,
    ]
    heading_world = math.degrees(math.atan2(along[1], along[0]))
    low, high = around_box(centre, size)
    cloud = WorldCloud.of(read(CLOUD), read(TILES)[0], upright)
    xyz, rgb = _inside(cloud, low, high)
    rows = np.empty(0, np.int64)
    if len(xyz):
        rows, pose = cut_instance(xyz, centre, size, heading_world, base_z)
        xyz = transform(inverse(pose), xyz[rows])
    if len(rows) < MIN_POINTS:
        where = ",".join(f"{v:g}" for v in at)
        raise StageError(
            f"--at {where}: {len(rows)} points stand there above the ground, {MIN_POINTS} needed; "
            "correct the place or the size (scene coordinates, metres)"
        )
    return xyz, rgb[rows]


def _place(at: list[float], T_world_scene: F64) -> tuple[F64, float | None]:
    """World x and y, and the base height where one was given."""
    if len(at) == 3:
        world = T_world_scene[:3, :3] @ at + T_world_scene[:3, 3]
        return world[:2], float(world[2])
    down = T_world_scene[2, :3]
    if down[2] <= 0.5 * np.linalg.norm(down):
        raise StageError("--at: the scene's z axis is not up; give x,y,z")
    z = -(down[0] * at[0] + down[1] * at[1] + T_world_scene[2, 3]) / down[2]
    return (T_world_scene[:3, :3] @ [*at, z] + T_world_scene[:3, 3])[:2], None


def _inside(cloud: WorldCloud, low: F64, high: F64) -> tuple[F64, U8]:
    """Points and colours over a rectangle."""
    found, colours = [np.empty((0, 3))], [np.empty((0, 3), np.uint8)]
    near = (cloud.low[:, :2] <= high) & (cloud.high[:, :2] >= low)
    for tile in np.flatnonzero(np.all(near, axis=1)).tolist():
        xyz = cloud.points(tile)
        rows = np.all((xyz[:, :2] >= low) & (xyz[:, :2] <= high), axis=1)
        found.append(xyz[rows].astype(np.float64))
        colours.append(cloud.tiles[tile].rgb[rows])
    return np.concatenate(found), np.concatenate(colours)


def _write(path: Path, name: str, xyz: F64, rgb: U8, force: bool) -> None:
    comment = f"{name}: cut from a scene, object frame, metres, z up, front at +x"
    rows = cloud_rows(xyz, rgb)
    write_new(path, lambda partial: write_ply(partial, rows, comment=comment), force=force)


def _numbers(text: str, option: str, counts: tuple[int, ...], form: str) -> list[float]:
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) not in counts or not all(map(math.isfinite, values)):
        raise ConfigError(f"{option} {text}: write {form}")
    return values
