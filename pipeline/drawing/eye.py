"""From where a viewer first looks: the whole scene fills its view, an object stands in the middle.

A view of the scene is wide (two below each other) where the scene is long, and about square else.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
import rerun.blueprint as rrb

from spinpipe.pipeline.drawing.drawing import Reader
from spinpipe.pipeline.drawing.model import model_bounds
from spinpipe.schemas import CAMERAS, TILES, UPRIGHT
from spinpipe.schemas.arrays import F64, I64
from spinpipe.schemas.records import ObjectModel, TileIndex
from spinpipe.stages.geometry.frames import transform

DOWN_DEG = 60.0
TAN_UP = 0.5
"""Half the view's height at distance 1: Rerun opens 55 degrees upwards."""
LONG = 1.7
"""Ratio of a scene's sides from which on wide views suit it better."""
WIDE, SQUARE = 2.1, 1.06
"""Width of a view by its height, in a window of 1600 x 900."""
LABEL_SHARE = (0.055, 0.035)
"""Room of a label, as shares of the view's height: across and upwards."""


class Eye(NamedTuple):
    """Position and target in the world, metres."""

    position: F64
    target: F64

    def controls(self) -> rrb.EyeControls3D:
        """As a blueprint has it."""
        return rrb.EyeControls3D(
            position=self.position, look_target=self.target, eye_up=(0.0, 0.0, 1.0)
        )


def scene_corners(read: Reader) -> F64:
    """(8 + C, 3) corners of a box around the cloud, then the cameras; world, metres."""
    tiles, upright = read(TILES)[0], read(UPRIGHT)
    T_world_local = upright[0].T_world_local if len(upright) else np.eye(4)
    cameras = [transform(T_world_local, shown.positions) for shown in read(CAMERAS)]
    return np.concatenate([_corners(tiles, T_world_local), *cameras])


def is_long(corners: F64) -> bool:
    """Whether wide views suit the scene."""
    length, width, _ = np.ptp(corners[:8], axis=0)
    return bool(max(length, width) > LONG * max(min(length, width), 1e-9))


def scene_eye(corners: F64) -> Eye:
    """Look down across the longer side, from as near as the box and all cameras are in view.

    ``corners`` are those of ``scene_corners``.
    """
    aspect = WIDE if is_long(corners) else SQUARE
    box = corners[:8]
    centre = (box.min(axis=0) + box.max(axis=0)) / 2
    length, width, height = np.ptp(box, axis=0)
    # what makes the box high is a tree or a pole, seldom in the corner next to the eye
    low = np.concatenate(
        [box - np.where(box[:, 2:] > centre[2], (0, 0, 0.6 * height), 0), corners[8:]]
    )
    right = np.array([1.0, 0.0, 0.0]) if length >= width else np.array([0.0, -1.0, 0.0])
    ahead, down = np.cross([0.0, 0.0, 1.0], right), np.deg2rad(DOWN_DEG)
    forward = ahead * np.cos(down) - [0.0, 0.0, np.sin(down)]
    eyes: list[tuple[float, Eye]] = []
    for shift in np.linspace(0, 0.5, 11) * min(length, width):  # the near side looms larger
        target = centre - shift * ahead
        x, y, depth = ((low - target) @ a for a in (right, np.cross(right, forward), forward))
        back = np.max(np.maximum(abs(x) / (aspect * TAN_UP), abs(y) / TAN_UP) - depth)
        position = target - back * forward
        eyes.append((float((centre - position) @ forward), Eye(position, target)))
    return min(eyes, key=lambda view: view[0])[1]


def label_rows(read: Reader, places: F64) -> I64:
    """Rows of places (N, 3), in order of their worth, whose labels do not hide each other."""
    if not len(places):
        return np.empty(0, np.int64)
    eye = scene_eye(scene_corners(read))
    forward = eye.target - eye.position
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right = right / np.linalg.norm(right)
    x, y, depth = ((places - eye.position) @ a for a in (right, np.cross(right, forward), forward))
    seen = np.column_stack([x, y]) / (2 * TAN_UP * np.maximum(depth, 1e-9))[:, None]
    kept: list[int] = []
    for row in range(len(places)):
        apart = abs(seen[kept] - seen[row]) / LABEL_SHARE
        if not len(kept) or bool((apart.max(axis=1) > 1).all()):
            kept.append(row)
    return np.array(kept, np.int64)


def object_eye(models: Sequence[ObjectModel], places: F64) -> Eye:
    """Look at models that stand at ``places`` along y from ahead, aside and above."""
    size = diagonal(models, float(np.ptp(places)) if len(places) else 0.0)
    return Eye(np.array([0.72, -1.0, 0.84]) * size, np.array([0.0, 0.0, 0.1]) * size)


def diagonal(models: Sequence[ObjectModel], extra: float = 0.0) -> float:
    """Diagonal of a box that holds any of the models, metres; ``extra`` makes it wider."""
    sizes = np.array([np.ptp(model_bounds(model), axis=0) for model in models]).reshape(-1, 3)
    return max(float(np.linalg.norm(sizes.max(axis=0, initial=0) + (0.0, extra, 0.0))), 1e-3)


def _corners(tiles: TileIndex, T_world_local: F64) -> F64:
    low, high = tiles.low.min(axis=0).tolist(), tiles.high.max(axis=0).tolist()
    corners = np.array(list(product(*zip(low, high, strict=True))))
    return corners @ T_world_local[:3, :3].T + T_world_local[:3, 3]
