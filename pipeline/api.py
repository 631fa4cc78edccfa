"""spinpipe in Python: look into runs, and find objects in arrays.

    from spinpipe.pipeline import api as spinpipe

    run = spinpipe.open("recordings/lot")
    run.accepted[0].position_scene
    run.table()["score"]

    found = spinpipe.find(points, {"saloon": "saloon"}, scan={"bin_m": 0.2})

Records (``Detection``, ``ObjectModel``, ...) are those of ``spinpipe.schemas.records``.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

import numpy as np
import tomli_w
from numpy.typing import NDArray
from rich.console import Console

from spinpipe import schemas
from spinpipe.pipeline.atomic import scratch_folder
from spinpipe.pipeline.config import RunConfig, load_config
from spinpipe.pipeline.context import RunReader
from spinpipe.pipeline.engine import open_engine
from spinpipe.pipeline.memory import fitting_threads
from spinpipe.pipeline.outputs import locked
from spinpipe.pipeline.plan import make_plan
from spinpipe.pipeline.results.complete import open_run_folder
from spinpipe.pipeline.results.instances import ROW_COLUMNS, row
from spinpipe.pipeline.run_folder import RunFolder
from spinpipe.pipeline.runner import Runner
from spinpipe.pipeline.scale_search import resolve_scale
from spinpipe.pipeline.scenes.write_ply import cloud_rows, write_ply
from spinpipe.schemas.arrays import F64, U8
from spinpipe.schemas.records import Detection, ObjectModel
from spinpipe.schemas.topics import Topic, topic_named
from spinpipe.stages.geometry.frames import inverse, to_world, transform, world_from_scene
from spinpipe.stages.stage import StageError

T = TypeVar("T")

ModelSource: TypeAlias = str | Path | NDArray[Any] | Mapping[str, Any]
"""A file, the name of a shape that ships, points (N, 3) in metres, or the keys of ``[[model]]``."""


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points of a scene."""

    xyz: F64
    """(N, 3), in the frame that was asked for."""
    rgb: U8
    """(N, 3); white where the source has no colours."""


@dataclass(frozen=True, eq=False)
class Found:
    """What was found: by ``find``, or in a run."""

    detections: Sequence[Detection]
    """Every candidate with its fate and the reason for it."""
    models: Mapping[str, ObjectModel]
    notes: Mapping[str, Sequence[str]] = field(default_factory=dict[str, Sequence[str]])
    """What each stage had to say."""

    @property
    def accepted(self) -> list[Detection]:
        """Those that are taken for instances, best first."""
        return sorted((d for d in self.detections if d.fate == "accepted"), key=lambda d: -d.score)

    def table(self, fates: Sequence[str] = ("accepted",)) -> dict[str, NDArray[Any]]:
        """Detections as columns: ``id``, ``x_scene``, ``heading_scene_deg``, ``score``, ...

        ``pandas.DataFrame(run.table())`` takes them as they are.
        """
        rows = [row(d, self.models) for d in self.detections if d.fate in fates]
        return {name: np.array([values[name] for values in rows]) for name in ROW_COLUMNS}


class Run:
    """A run's folder: what was found, and everything that it was found from.

    Files are read when they are asked for. See ``open``.
    """

    def __init__(self, folder: RunFolder, config: RunConfig) -> None:
        self.folder = folder.path
        self.config = config
        self._read = RunReader(folder)
        self._report = folder.report

    def __repr__(self) -> str:
        return f"Run({str(self.folder)!r}: {len(self.accepted)} of {len(self.detections)} accepted)"

    def topic(self, topic: str | Topic[T]) -> Sequence[Any]:
        """Records of a topic by its name (``"/scan/hits"``) or itself, decoded as asked for.

        Raises
        ------
        StageError
            If there is no topic of that name.
        """
        if isinstance(topic, str):
            try:
                topic = topic_named(topic)
            except KeyError:
                names = sorted(t.name for t in vars(schemas).values() if isinstance(t, Topic))
                raise StageError(f"no topic {topic}; topics are {', '.join(names)}") from None
        return self._read(topic)

    @cached_property
    def found(self) -> Found:
        """What the run found."""
        models = {model.name: model for model in self._read(schemas.MODELS)}
        notes: dict[str, Sequence[str]] = {}
        if self._report.exists():
            report = json.loads(self._report.read_text(encoding="utf-8"))
            notes = {stage["stage"]: stage["notes"] for stage in report["stages"]}
        return Found(list(self._read(schemas.DETECTIONS)), models, notes)

    @property
    def detections(self) -> Sequence[Detection]:
        """Every candidate with its fate."""
        return self.found.detections

    @property
    def accepted(self) -> list[Detection]:
        """Those that are taken for instances, best first."""
        return self.found.accepted

    def table(self, fates: Sequence[str] = ("accepted",)) -> dict[str, NDArray[Any]]:
        """See ``Found.table``."""
        return self.found.table(fates)

    @cached_property
    def T_world_scene(self) -> F64:
        """(4, 4) similarity from scene coordinates to the upright world in metres."""
        return world_from_scene(self._read(schemas.SCENE)[0], self._read(schemas.UPRIGHT)[0])

    def cloud(self, frame: str = "scene") -> Cloud:
        """All points of the scene at once, in ``"scene"`` or ``"world"`` coordinates."""
        if frame not in ("scene", "world"):
            raise ValueError(f"frame is {frame!r}; it must be 'scene' or 'world'")
        upright, tiles = self._read(schemas.UPRIGHT)[0], self._read(schemas.CLOUD)
        T = np.eye(4) if frame == "world" else inverse(self.T_world_scene)
        xyz = [transform(T, to_world(upright, tile.xyz)) for tile in tiles]
        rgb = [tile.rgb for tile in tiles]
        return Cloud(
            np.concatenate([np.empty((0, 3)), *xyz]),
            np.concatenate([np.empty((0, 3), np.uint8), *rgb]),
        )


def open(folder: str | Path) -> Run:  # noqa: A001 - as in api.open(...)
    """Open a run's folder.

    Raises
    ------
    ConfigError
        If there is no run in it.
    """
    return Run(*open_run_folder(Path(folder)))


def find(
    points: NDArray[Any],
    models: Mapping[str, ModelSource],
    *,
    colors: NDArray[Any] | None = None,
    **config: Mapping[str, Any],
) -> Found:
    """Find every instance of models in a cloud that is held in memory; leaves no files behind.

    Parameters
    ----------
    points : (N, 3) coordinates, metres unless ``ingest={"scale": ...}`` says otherwise.
    models : by name: a file, a shape that ships (``"saloon"``), points (M, 3) in metres, or a
        mapping of the keys of ``[[model]]``, ``{"path": "car.obj", "stretch": 0.1}``.
    colors : (N, 3) 0..255, only to look at.
    config : sections as in a config file, ``ground={"up": [0, 0, 1]}, scan={"bin_m": 0.1}``.

    Raises
    ------
    ConfigError, StageError
        As on the command line: one sentence that says what to do.
    """
    with scratch_folder() as place:
        rgb = None if colors is None else np.asarray(colors, np.uint8)
        write_ply(place / "scene.ply", cloud_rows(np.asarray(points, np.float64), rgb, "<f8"))
        document: dict[str, Any] = {key: dict(section) for key, section in config.items()}
        document["ingest"] = {**document.get("ingest", {}), "scene": "scene.ply"}
        document["model"] = [_model(key, model, place) for key, model in models.items()]
        (place / "find.toml").write_text(tomli_w.dumps(document), encoding="utf-8")
        run = load_config(place / "find.toml")
        return _compute(run, RunFolder(place / "run"))


def _model(name: str, source: ModelSource, place: Path) -> dict[str, Any]:
    """A ``[[model]]`` section."""
    if isinstance(source, Mapping):
        return {"name": name, **source}
    if isinstance(source, np.ndarray):
        path = place / f"{name}.ply"
        write_ply(path, cloud_rows(source.astype(np.float64), None, "<f8"))
        return {"name": name, "path": str(path)}
    if isinstance(source, str) and not Path(source).suffix:
        return {"name": name, "shape": source}
    return {"name": name, "path": str(Path(source).resolve())}


def _compute(config: RunConfig, folder: RunFolder) -> Found:
    threads = fitting_threads(config, recording=False)
    quiet = Console(quiet=True)
    with locked(folder.path) as outputs, open_engine(config.execution, threads) as engine:
        outputs.claim(folder.scale)
        config, searched = resolve_scale(config, folder, outputs, quiet, threads)
        reports = Runner(config, folder, engine, quiet).run(make_plan(config, folder))
        read = RunReader(folder)
        models = {model.name: model for model in read(schemas.MODELS)}
        notes = {report.stage: report.notes for report in reports}
        notes["ingest"] = searched + notes["ingest"]
        return Found(list(read(schemas.DETECTIONS)), models, notes)


__all__: Sequence[str] = ("Cloud", "Found", "Run", "find", "open")
