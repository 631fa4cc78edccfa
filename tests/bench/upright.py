"""How well up is found: real scenes as they are, and turned at random, against their known up.

    uv run python tests/bench/upright.py                    # every scene, three turns each
    uv run python tests/bench/upright.py --scenes photo-west artificial --turns 100

A scene's right up is its z (NOTES.md of the data), or the direction given in ``SCENES``. Turned
scenes come without what their format says of up, as a PLY would.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from spinpipe.pipeline.scenes.artificial import make_scene
from spinpipe.schemas import CAMERAS, CLOUD, PLANE, SCENE, TILES, TRAJECTORY, UPRIGHT
from spinpipe.schemas.poses import Cameras
from spinpipe.schemas.records import CloudTile, Plane, SceneFrame, TileIndex
from spinpipe.stages.ground.ground import Ground
from spinpipe.stages.ingest.readers.open_scene import open_scene
from spinpipe.stages.stage import StageError

F64 = NDArray[np.float64]

SHARED = Path(__file__).parents[3] / "shared"
Z, Y = (0.0, 0.0, 1.0), (0.0, 1.0, 0.0)
SCENES: dict[str, tuple[str, tuple[float, float, float]]] = {
    "photo-west": ("data/photo-west/scene.ply", Z),
    "lot-north": ("data/lot-north/scene.ply", Z),
    "bus-yard": ("data/bus-yard/scene.ply", Z),
    "prisms-north": ("data/prisms-north/scene.laz", Z),
    "lapaz-street": ("data/lapaz-street/scene.laz", Z),
    "deck-west": ("data/deck-west/scene.ply", Z),
    "brighton, COLMAP": ("data/brighton/colmap_sparse", Z),
    "brighton, PMVS": ("data/brighton/pmvs/scene_binary.ply", Z),
    "brighton, ODM": ("data/brighton/odm_model.laz", Z),
    "autzen": ("data/formats/laspy_las/autzen_trim.laz", Z),
    "simple": ("data/formats/laspy_las/simple.las", Z),
    "LAS, one scan line": ("cases/real-las-up-sideways/simple1_3.las", Z),
    "LAS, sparse": ("cases/real-las-upside-down/append-bug.laz", Z),
    "half twice": ("cases/half-the-points-twice/scene.ply", Z),
    "noise below": ("cases/noise-below-ground/scene.ply", Z),
    "room": ("cases/indoor-room-y-up/scene.ply", Y),
    "milk, Kinect": ("data/milk/milk_cartoon_all_small_clorox.pcd", (0.006, 0.823, 0.568)),
    "table, Kinect": ("data/mosd/test0.pcd", (-0.048, -0.726, -0.686)),
}
WRONG_DEG = 20.0


class _FoundError(Exception):
    """Up is written: what the stage measures afterwards is not of interest here."""


class _Scene:
    """A scene in memory as the ground stage's context; stops the stage at its transform."""

    threads, memory_bytes = 1, 2**30

    def __init__(self, xyz: F64, cameras: Cameras | None, declared: tuple[float, ...]) -> None:
        self.config, self.rng = Ground.Config(), np.random.default_rng(0)
        local = xyz.astype(np.float32)
        tiles = np.array_split(local, max(1, len(xyz) // 200_000))
        low, high = (np.array([f(tile, axis=0) for tile in tiles]) for f in (np.min, np.max))
        frame = SceneFrame((0, 0, 0), (1, 1, 1), len(xyz), 0, False, "", up=declared)
        self.messages: dict[Any, list[Any]] = {
            CLOUD: [CloudTile(tile, np.full(tile.shape, 255, np.uint8)) for tile in tiles],
            TILES: [TileIndex(low, high, np.array([len(tile) for tile in tiles]))],
            SCENE: [frame],
            CAMERAS: [] if cameras is None else [cameras],
            TRAJECTORY: [],
        }
        self.plane: Plane | None = None

    def read(self, topic: Any) -> list[Any]:
        return self.messages[topic]

    def read_one(self, topic: Any) -> Any:
        return self.messages[topic][0]

    def write(self, topic: Any, message: Any) -> None:
        if topic is PLANE:
            self.plane = message
        if topic is UPRIGHT:
            raise _FoundError

    def progress(self, label: str, total: int) -> _Scene:
        return self

    def advance(self, steps: int = 1) -> None: ...

    def log(self, text: str) -> None: ...

    def up(self) -> F64 | None:
        """What the stage finds, None if it stops."""
        try:
            Ground().run(self)
        except _FoundError:
            pass
        except StageError:
            return None
        return None if self.plane is None else np.array(self.plane.normal)


def read(name: str) -> tuple[F64, Cameras | None, tuple[float, ...], F64]:
    """Points, cameras, what the format says of up, and the right up."""
    if name == "artificial":
        return make_scene().xyz, None, (), np.array(Z)
    path, up = SCENES[name]
    source = open_scene(SHARED / path)
    xyz = np.concatenate([chunk for chunk, _ in source.chunks(1_000_000)])
    xyz = np.unique(xyz[np.isfinite(xyz).all(axis=1)], axis=0)  # as ingest leaves it
    return xyz, source.about.cameras, source.about.up or (), np.array(up) / np.linalg.norm(up)


def error_deg(found: F64, right: F64) -> float:
    """Angle between two directions."""
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(found, right)), found @ right)))


def main() -> None:
    """Print one row a scene."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", nargs="*", default=["artificial", *SCENES])
    parser.add_argument("--turns", type=int, default=3)
    arguments = parser.parse_args()
    print("| scene | points | as it is | turned: median | largest | stopped | wrong | seconds |")
    print("|---|---:|---:|---:|---:|---:|---:|---:|", flush=True)
    for name in arguments.scenes:
        xyz, cameras, declared, right = read(name)
        origin = np.round(np.median(xyz, axis=0))
        xyz = xyz - origin
        if cameras is not None:
            cameras = replace(cameras, positions=cameras.positions - origin)
        found = _Scene(xyz, cameras, declared).up()
        plain = "stopped" if found is None else f"{error_deg(found, right):.2f}"
        errors: list[float] = []
        start = time.perf_counter()
        for turn in Rotation.random(arguments.turns, random_state=1):
            found = _Scene(turn.apply(xyz), None, ()).up()
            if found is not None:
                errors.append(error_deg(found, turn.apply(right)))
        seconds = (time.perf_counter() - start) / max(arguments.turns, 1)
        median, largest = (f"{f(errors):.2f}" if errors else "" for f in (np.median, np.max))
        stopped = arguments.turns - len(errors)
        wrong = sum(error > WRONG_DEG for error in errors)
        print(
            f"| {name} | {len(xyz):,} | {plain} | {median} | {largest} | {stopped} | {wrong} |"
            f" {seconds:.1f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
