"""Sweeps of a lidar become one cloud: each is registered to those before it.

The odometry is KISS-ICP [Vizzo et al., RA-L 2023] as its authors distribute it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import product
from typing import TYPE_CHECKING, Literal

import numpy as np
from pydantic import Field
from scipy.spatial.transform import Rotation

from spinpipe.schemas.arrays import F64, I64
from spinpipe.schemas.poses import Trajectory
from spinpipe.stages.ingest.readers.mcap import McapSource, Sweep
from spinpipe.stages.ingest.readers.scene_source import MemorySource
from spinpipe.stages.stage import Section, StageError

if TYPE_CHECKING:
    from kiss_icp.kiss_icp import KissICP

_REACH_PERCENT = 99
"""Points of the first sweep that are no farther than what it sees: the rest may be reflections."""
_FEWEST_POINTS = 100
"""A sweep with fewer is none: a driver's first message is often empty."""
_LEAST_OVERLAP = 0.2
"""Share of a sweep that must lie where the map has points. Sweeps that follow each other share most
of what they see; where they do not, KISS-ICP returns its guess without a word."""


class Odometry(Section):
    """How the sweeps of a log become one scene."""

    method: Literal["auto", "kiss-icp", "none"] = Field(
        default="auto",
        description="kiss-icp: register each sweep to those before it; none: the sweeps lie in one "
        "frame already; auto: none where the messages name a fixed frame (map, odom, world, earth)",
    )
    max_range_m: float = Field(
        default=100.0, ge=0.1, le=1e5, description="farther points are not used"
    )
    min_range_m: float = Field(
        default=0.0,
        ge=0,
        le=1e5,
        description="nearer points are not used: the sensor's own vehicle",
    )
    deskew: bool = Field(
        default=True, description="undo the motion during a sweep where its points have times"
    )
    voxel_m: float | None = Field(
        default=None,
        ge=0.001,
        le=1000,
        description="cell of the map that sweeps are registered to; none: a hundredth of how far "
        "the first sweep sees",
    )
    map_voxel_m: float = Field(
        default=0.05,
        ge=0.0001,
        le=1000,
        description="of all points in such a cell of the scene one is kept",
    )


def registered(log: McapSource, rules: Odometry, advance: Callable[[int], None]) -> MemorySource:
    """The scene that the sweeps of a log make, in the sensor frame of the first.

    Parameters
    ----------
    log : a log of several sweeps.
    rules : ranges and cells.
    advance : is told how many more points have been read.

    Raises
    ------
    StageError
        When no sweep has points within the ranges, or a sweep does not meet those before it.
    """
    from kiss_icp.mapping import VoxelHashMap

    kiss = None
    voxel = 0.0
    scene = VoxelHashMap(rules.map_voxel_m, max_distance=np.inf, max_points_per_voxel=1)
    poses: list[F64] = []
    times: list[int] = []
    skipped = timed = 0
    for number, sweep in enumerate(log.messages()):
        advance(len(sweep.xyz))
        points, point_times = _usable(sweep, rules)
        if len(points) < _FEWEST_POINTS:
            skipped += 1
            continue
        timed += len(point_times) > 0
        if kiss is None:
            reach = float(np.percentile(np.linalg.norm(points, axis=1), _REACH_PERCENT))
            voxel = rules.voxel_m or reach / 100  # as KISS-ICP has it of the largest range
            kiss = _kiss(rules, voxel)
        known = kiss.local_map.point_cloud()
        frame, source = kiss.register_frame(points, point_times)
        pose: F64 = kiss.last_pose
        _require_overlap(source, pose, known, voxel, f"{log.path}: sweep {number + 1:,}")
        scene.add_points(frame @ pose[:3, :3].T + pose[:3, 3])
        poses.append(pose)
        times.append(sweep.time_ns)
    if not poses:
        raise StageError(
            f"{log.path}: no sweep has {_FEWEST_POINTS} points between [ingest.odometry] "
            f"min_range_m = {rules.min_range_m:g} and max_range_m = {rules.max_range_m:g}"
        )
    T = np.array(poses)
    path_m = float(np.linalg.norm(np.diff(T[:, :3, 3], axis=0), axis=1).sum())
    notes = [
        f"{len(T):,} sweeps registered by KISS-ICP ({timed:,} deskewed), {path_m:.1f} m of path; "
        f"one point kept in each cell of {rules.map_voxel_m:g} m"
    ]
    if skipped:
        notes.append(f"{skipped:,} sweeps left out: fewer than {_FEWEST_POINTS} points in range")
    trajectory = Trajectory(
        T[:, :3, 3],
        Rotation.from_matrix(T[:, :3, :3]).as_quat(),
        np.array(times, np.int64),
    )
    about = replace(log.about, trajectory=trajectory, notes=(*log.about.notes, *notes))
    return MemorySource(about, np.array(scene.point_cloud()))


def _kiss(rules: Odometry, voxel: float) -> KissICP:
    from kiss_icp.config import KISSConfig
    from kiss_icp.config.config import DataConfig, MappingConfig, RegistrationConfig
    from kiss_icp.kiss_icp import KissICP

    return KissICP(
        KISSConfig(
            data=DataConfig(
                max_range=rules.max_range_m, min_range=rules.min_range_m, deskew=rules.deskew
            ),
            mapping=MappingConfig(voxel_size=voxel),
            # sums of several threads come in another order at every run
            registration=RegistrationConfig(max_num_threads=1),
        )
    )


def _usable(sweep: Sweep, rules: Odometry) -> tuple[F64, F64]:
    """Points within the ranges, and their times: (N,), or (0,) where they tell nothing."""
    with np.errstate(over="ignore"):
        ranges = np.linalg.norm(sweep.xyz, axis=1)
    good = (ranges > rules.min_range_m) & (ranges < rules.max_range_m)  # neither holds for NaN
    times = np.empty(0) if sweep.times is None else sweep.times[good]
    if not (len(times) and np.isfinite(times).all() and np.ptp(times) > 0 and rules.deskew):
        times = np.empty(0)
    return np.ascontiguousarray(sweep.xyz[good]), times


def _require_overlap(source: F64, pose: F64, known: F64, voxel: float, sweep: str) -> None:
    """Stop where a sweep was not registered to anything."""
    if not len(known):
        return
    placed = source @ pose[:3, :3].T + pose[:3, 3]
    occupied = np.unique(_cells(known, voxel))
    near = np.zeros(len(placed), np.bool_)
    for step in product((-voxel, 0.0, voxel), repeat=3):  # where KISS-ICP looks for a neighbour
        cells = _cells(placed + step, voxel)
        near |= occupied[np.searchsorted(occupied[:-1], cells)] == cells
    share = float(near.mean())
    if not np.isfinite(pose).all() or share < _LEAST_OVERLAP:
        raise StageError(
            f"{sweep}: the odometry lost its way, {share:.0%} of the points lie where those of "
            "earlier sweeps are; try another [ingest.odometry] max_range_m or voxel_m, or cut the "
            "log ('mcap filter')"
        )


def _cells(points: F64, voxel: float) -> I64:
    """A number for the cell of each point (N, 3): 21 bits an axis."""
    x, y, z = (np.floor(points / voxel).astype(np.int64) + (1 << 20)).T
    return (x << 42) + (y << 21) + z
