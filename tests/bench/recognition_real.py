"""Real car parks under changes that nothing was tuned on: thinned, noisy, mirrored, turned, cut."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from recognition_judge import Trial, judge

from spinpipe.pipeline.atomic import write_atomically
from spinpipe.pipeline.config import load_config
from spinpipe.pipeline.evaluation.truth import TruthObject
from spinpipe.pipeline.scenes.write_ply import cloud_rows, write_ply
from spinpipe.schemas.arrays import F64, U8
from spinpipe.schemas.records import Detection
from spinpipe.stages.geometry.frames import yaw_matrix
from spinpipe.stages.ingest.readers.open_scene import open_scene

CONFIG = Path(__file__).parents[2] / "recordings" / "carpark.toml"
MATCH_M = 1.5
"""Labels are good to 0.3 m, and a car is 1.8 m wide."""
CAR_M = 2.27
"""Geometric mean of a saloon's extents."""
WIDTH_M = 1.8
CUT_M = 2.5
"""A car whose middle is nearer than this to a border may be cut by it."""
GROUND_REACH_M = 3.0
FOOT_M = 0.3048
LARGE = 400_000
"""Points from which the changes are tried on a half."""


@dataclass(frozen=True)
class Park:
    """A labelled cloud."""

    xyz: F64
    rgb: U8
    labels: F64
    """(L, 4): x, y, direction of the long axis in degrees, 1 where it is to be ignored."""
    scale: float = 1.0
    """Metres per unit."""

    def cut(self, axis: int, border: float, upper: bool) -> Park:
        """One side of a border, labels that it may cut to be ignored."""
        sign = 1.0 if upper else -1.0
        inside = sign * (self.labels[:, axis] - border)
        labels = self.labels[inside > -CUT_M].copy()
        labels[np.abs(labels[:, axis] - border) < CUT_M, 3] = 1.0
        keep = sign * (self.xyz[:, axis] - border) > 0
        return replace(self, xyz=self.xyz[keep], rgb=self.rgb[keep], labels=labels)

    def thinned(self, share: float, rng: np.random.Generator) -> Park:
        """A random share of the points."""
        keep = rng.random(len(self.xyz)) < share
        return replace(self, xyz=self.xyz[keep], rgb=self.rgb[keep])

    def noisy(self, noise_m: float, rng: np.random.Generator) -> Park:
        """Gaussian noise on every coordinate."""
        return replace(self, xyz=self.xyz + noise_m * rng.standard_normal(self.xyz.shape))

    def mirrored(self) -> Park:
        """Seen in a mirror: x is turned round."""
        labels = self.labels * [-1, 1, -1, 1]
        labels[:, 2] %= 180
        return replace(self, xyz=self.xyz * [-1, 1, 1], labels=labels)

    def turned(self, heading_deg: float, tilt_deg: float) -> Park:
        """Turned about the vertical, then tilted about x."""
        cos, sin = math.cos(math.radians(tilt_deg)), math.sin(math.radians(tilt_deg))
        tilt = np.array([[1, 0, 0], [0, cos, -sin], [0, sin, cos]])
        R = tilt @ yaw_matrix(heading_deg)[:3, :3]
        centre = self.xyz.mean(axis=0)
        base = np.array([[x, y, self._ground(x, y)] for x, y in self.labels[:, :2]])
        labels = self.labels.copy()
        labels[:, :2] = ((base - centre) @ R.T + centre)[:, :2]
        axis = np.radians(self.labels[:, 2])
        along = np.column_stack([np.cos(axis), np.sin(axis), np.zeros(len(axis))]) @ R.T
        labels[:, 2] = np.degrees(np.arctan2(along[:, 1], along[:, 0])) % 180
        return replace(self, xyz=(self.xyz - centre) @ R.T + centre, labels=labels)

    def in_feet(self) -> Park:
        """The same in feet."""
        labels = self.labels / [FOOT_M, FOOT_M, 1, 1]
        return replace(self, xyz=self.xyz / FOOT_M, labels=labels, scale=FOOT_M)

    def _ground(self, x: float, y: float) -> float:
        near = np.abs(self.xyz[:, :2] - [x, y]).max(axis=1) < GROUND_REACH_M
        return float(np.percentile(self.xyz[near, 2], 5)) if near.any() else 0.0


def real_trials(folder: Path, threads: int, seed: int, work: Path, quick: bool) -> Iterator[Trial]:
    """Every car park of a folder under every change; large ones by their half with most cars."""
    for scene in sorted(folder.glob("*/scene.ply")):
        truth = scene.with_name("truth.csv")
        if not truth.exists():
            continue
        name = scene.parent.name
        park = read_park(scene, truth)
        for change, changed in _changes(park, np.random.default_rng(seed)):
            if quick and change not in ("whole", "half", "thinned to 25 %"):
                continue
            yield _trial(name, change, changed(), threads, work / f"{name}_{change}")


def read_park(scene: Path, truth: Path) -> Park:
    """Read a cloud and its labels."""
    chunks = list(open_scene(scene).chunks(1 << 20))
    with truth.open(newline="", encoding="utf-8") as stream:
        labels = [
            [float(row[c]) for c in ("x", "y", "axis_deg", "ignore")]
            for row in csv.DictReader(stream)
        ]
    return Park(
        np.concatenate([xyz for xyz, _ in chunks]),
        np.concatenate([rgb for _, rgb in chunks]),
        np.array(labels),
    )


def _changes(park: Park, rng: np.random.Generator) -> Iterator[tuple[str, Callable[[], Park]]]:
    middle = np.median(park.labels[:, :2], axis=0).tolist()
    halves = [
        (f"half {'xy'[axis]}{'-+'[upper]}", park.cut(axis, middle[axis], bool(upper)))
        for axis in (0, 1)
        for upper in (0, 1)
    ]
    whole = park
    if len(park.xyz) > LARGE:
        whole = max((half for _, half in halves), key=lambda h: float((h.labels[:, 3] == 0).sum()))
    yield ("half" if whole is not park else "whole"), lambda: whole
    yield "thinned to 50 %", lambda: whole.thinned(0.5, rng)
    yield "thinned to 25 %", lambda: whole.thinned(0.25, rng)
    yield "noise 2 cm", lambda: whole.noisy(0.02, rng)
    yield "noise 5 cm", lambda: whole.noisy(0.05, rng)
    yield "mirrored", whole.mirrored
    yield "turned, tilted", lambda: whole.turned(37.0, 5.0)
    yield "in feet", whole.in_feet
    for name, half in halves:
        yield name, partial(_same, half)
    for name, half in halves[:2]:
        for upper in (0, 1):
            quarter = half.cut(1, middle[1], bool(upper))
            yield f"quarter {name[5:]} y{'-+'[upper]}", partial(_same, quarter)


def _same(park: Park) -> Park:
    return park


def _trial(name: str, change: str, park: Park, threads: int, folder: Path) -> Trial:
    spacing_m = park.scale * math.sqrt(
        float(np.ptp(park.xyz[:, :2], axis=0).prod() / len(park.xyz))
    )
    trial = Trial("real", name, change, "real", 1.8 / spacing_m, 0.0, CAR_M)
    trial.points = len(park.xyz)
    folder.mkdir(parents=True, exist_ok=True)
    scene, truth = folder / "scene.ply", folder / "truth.csv"
    write_ply(scene, cloud_rows(park.xyz, park.rgb))
    write_atomically(truth, partial(_write_labels, labels=park.labels))
    overrides = [
        f"ingest.scene={scene.resolve()}",
        f"ingest.scale={park.scale}",
        f"execution.threads={threads}",
    ]
    config = load_config(CONFIG, overrides)
    judge(trial, config, folder, truth, MATCH_M, 2, _line, _stretched)
    return trial


def _write_labels(path: Path, labels: F64) -> None:
    with path.open("w", newline="", encoding="utf-8") as stream:
        table = csv.writer(stream)
        table.writerow(["model", "x", "y", "axis_deg", "ignore"])
        table.writerows(["car", *row[:3], int(row[3])] for row in labels.tolist())


def _line(truth: TruthObject) -> str:
    return f"at {truth.given[0]:.1f}, {truth.given[1]:.1f}"


def _stretched(d: Detection) -> str:
    size = " x ".join(f"{v:.2f}" for v in d.size_m)
    return f"{d.model} of {size} m at {d.position_scene[0]:.1f}, {d.position_scene[1]:.1f}"
