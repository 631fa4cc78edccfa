"""The scene's points as LAS, each with the id of the detection that it belongs to."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from spinpipe.pipeline.results.instances import ReadTopic
from spinpipe.schemas import CLOUD, SCENE, TILES, UPRIGHT
from spinpipe.schemas.arrays import F32, I64
from spinpipe.schemas.records import Detection
from spinpipe.stages.geometry.frames import inverse, to_world, transform, world_from_scene

NO_OBJECT = -1
FIRST_USER_CLASS = 64
"""ASPRS LAS 1.4: classes 64..255 are the user's own."""
STEP_M = 1e-4
"""Of the coordinates: a reconstruction is not exact to a tenth of a millimetre."""
BASE_SHARE = 0.05
"""What is lower than this part of an object's height is the ground that it stands on."""


def write_las(read: ReadTopic, detections: Sequence[Detection], path: Path) -> None:
    """Write LAS 1.4 (LAZ if the path ends so) in scene coordinates, tile by tile.

    ``object_id`` (an extra dimension, int32) is the detection whose box holds the point, -1 if
    none; ``classification`` is 64 plus the number of its model, 1 ("unclassified") if none.
    """
    import laspy

    scene, upright = read(SCENE)[0], read(UPRIGHT)[0]
    models = sorted({d.model for d in detections})
    T_scene_world = inverse(world_from_scene(scene, upright))
    header = laspy.LasHeader(point_format=7, version="1.4")
    header.add_extra_dim(laspy.ExtraBytesParams("object_id", "int32", "detection, -1: none"))
    tiles = read(TILES)[0]
    reach_m = float(np.abs([tiles.low, tiles.high]).max())
    header.scales = max(STEP_M, reach_m / 2**30) / np.array(scene.scale)  # 32-bit numbers of steps
    header.offsets = np.floor(scene.origin)
    if scene.crs:
        from pyproj import CRS

        header.add_crs(CRS.from_user_input(scene.crs))
    with path.open("wb") as file, laspy.open(
        file, "w", header=header, do_compress=path.name.removesuffix(".partial").endswith(".laz"),
        closefd=False,
    ) as writer:  # fmt: skip
        for tile in read(CLOUD):
            xyz = to_world(upright, tile.xyz)
            owner = _owners(xyz, detections)
            points = laspy.ScaleAwarePointRecord.zeros(len(xyz), header=header)
            points.x, points.y, points.z = transform(T_scene_world, xyz).T
            for channel, values in zip(("red", "green", "blue"), tile.rgb.T, strict=True):
                points[channel] = values.astype(np.uint16) * 257
            points["object_id"] = [detections[i].id if i >= 0 else NO_OBJECT for i in owner]
            points["classification"] = [
                FIRST_USER_CLASS + models.index(detections[i].model) if i >= 0 else 1 for i in owner
            ]
            writer.write_points(points)


def _owners(xyz: F32, detections: Sequence[Detection]) -> I64:
    """Row of the detection whose box holds each point (N, 3) of the world, -1 if none."""
    owner = np.full(len(xyz), -1, np.int64)
    if not len(xyz):
        return owner
    low, high = xyz.min(axis=0), xyz.max(axis=0)
    for i, d in enumerate(detections):
        size, place = np.asarray(d.size_m), np.asarray(d.position_world)
        reach = float(np.hypot(size[0], size[1])) / 2
        if np.any(place[:2] + reach < low[:2]) or np.any(place[:2] - reach > high[:2]):
            continue
        angle = np.radians(d.heading_deg)
        x, y = (xyz[:, :2] - place[:2]).T
        along, across = (
            x * np.cos(angle) + y * np.sin(angle),
            y * np.cos(angle) - x * np.sin(angle),
        )
        above = xyz[:, 2] - place[2]
        inside = (abs(along) <= size[0] / 2) & (abs(across) <= size[1] / 2)
        owner[inside & (above > BASE_SHARE * size[2]) & (above <= size[2])] = i
    return owner
