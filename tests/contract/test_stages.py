"""One suite for every stage: what all stages promise, whatever they compute."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

import numpy as np
import pytest
import rerun as rr
from pydantic.fields import FieldInfo

from spinpipe.pipeline.config import SECTIONS, RunConfig, load_config, own_keys
from spinpipe.pipeline.context import RunContext, RunReader
from spinpipe.pipeline.drawing.draw import DRAW
from spinpipe.pipeline.engine import LocalEngine
from spinpipe.pipeline.mcap_file import StageFileWriter
from spinpipe.pipeline.run_folder import RunFolder
from spinpipe.schemas import (
    CAMERAS,
    CLOUD,
    CLUSTERS,
    DETECTIONS,
    HITS,
    SCENE,
    TILES,
    TRAJECTORY,
    UPRIGHT,
)
from spinpipe.schemas.records import CloudTile, Cluster, Hits, SceneFrame, TileIndex, Upright
from spinpipe.schemas.topics import Topic
from spinpipe.stages import STAGES
from spinpipe.stages.stage import Section, Stage, StageError

if TYPE_CHECKING:
    from tests.conftest import Yard, YardRun

TOPICS: tuple[Topic[Any], ...] = tuple(topic for stage in STAGES for topic in stage.outputs)

NAMED = {stage.name: stage for stage in STAGES}
Messages = dict[Topic[Any], list[Any]]

every_stage = pytest.mark.parametrize("stage", STAGES, ids=lambda stage: stage.name)


class MemoryContext:
    """A context over messages in memory; records which topics were asked for."""

    memory_bytes = 1 << 30

    def __init__(
        self, stage: Stage, config: Section, inputs: Messages, scratch: Path, threads: int = 1
    ) -> None:
        self.stage = stage
        self.config = config
        self.rng = np.random.default_rng(0)
        self.threads = threads
        self.scratch = scratch
        self.inputs = inputs
        self.asked: set[Topic[Any]] = set()
        self.outputs: Messages = {topic: [] for topic in stage.outputs}
        self.encoded: list[tuple[str, bytes]] = []

    def read(self, topic: Topic[Any]) -> Sequence[Any]:
        assert topic in self.stage.inputs, topic.name
        self.asked.add(topic)
        return self.inputs[topic]

    def read_one(self, topic: Topic[Any]) -> Any:
        return self.read(topic)[0]

    def write(self, topic: Topic[Any], message: Any) -> None:
        data = topic.encode(message).SerializeToString(deterministic=True)
        self.encoded.append((topic.name, data))
        self.outputs[topic].append(topic.decode(data))

    def recovered(self, topic: Topic[Any]) -> Iterator[Any]:
        assert topic in self.stage.outputs, topic.name
        return iter(())

    def progress(self, label: str, total: int) -> MemoryContext:
        return self

    def advance(self, steps: int = 1) -> None:
        assert steps >= 0

    def map(self, function: Callable[[Any], Any], items: Iterable[Any]) -> Iterator[Any]:
        return map(function, items)

    def log(self, text: str) -> None:
        assert "\n" not in text


def run(
    stage: Stage, config: Section, inputs: Messages, scratch: Path, threads: int = 1
) -> MemoryContext:
    """Run one stage with every warning an error."""
    context = MemoryContext(stage, config, inputs, scratch, threads)
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        stage.run(context)
    return context


@pytest.fixture(scope="module")
def config(finished_yard: YardRun) -> RunConfig:
    return load_config(finished_yard.config)


@pytest.fixture(scope="module")
def messages(finished_yard: YardRun) -> Messages:
    """All messages of a complete run."""
    read = RunReader(RunFolder(finished_yard.output))
    return {topic: list(read(topic)) for topic in TOPICS}


def degenerate_clouds() -> dict[str, np.ndarray]:
    """Clouds in which nothing can be found, about 40 m wide where they have a width."""
    rng = np.random.default_rng(0)
    along = np.linspace(-20, 20, 500)
    return {
        "empty": np.empty((0, 3)),
        "one point": np.array([[1.0, 2.0, 3.0]]),
        "two points": np.array([[-20.0, 0, 0], [20.0, 0, 0]]),
        "equal points": np.tile([[1.0, 2.0, 3.0]], (500, 1)),
        "collinear": np.column_stack([along, 0.5 * along, 0 * along]),
        "vertical line": np.column_stack([0 * along, 0 * along, along]),
        "plane": rng.uniform(-20, 20, (2000, 3)) * [1, 1, 0],
        "grid": np.stack(np.meshgrid(*[np.arange(-20.0, 21, 4)] * 3), axis=-1).reshape(-1, 3),
        "far": rng.uniform(-20, 20, (500, 3)) + [1e6, -1e6, 1e5],
    }


def as_messages(xyz: np.ndarray) -> Messages:
    """What ingest and ground would write for a cloud that stands upright."""
    points = xyz.astype(np.float32)
    tile = CloudTile(points, np.full((len(points), 3), 255, np.uint8))
    low, high = (
        (points.min(axis=0)[None], points.max(axis=0)[None])
        if len(points)
        else (np.empty((0, 3), np.float32),) * 2
    )
    counts = np.array([len(points)] if len(points) else [], np.int64)
    return {
        CLOUD: [tile] if len(points) else [],
        TILES: [TileIndex(low, high, counts)],
        SCENE: [SceneFrame((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), len(points), 0, False, "scene.ply")],
        CAMERAS: [],
        TRAJECTORY: [],
        UPRIGHT: [Upright((0.0, 0.0, 0.0, 1.0), (0.0, 0.0, 0.0))],
    }


def choices(section: str, key: str) -> tuple[str, ...]:
    """All values of a key that offers a choice."""
    return get_args(SECTIONS[section].model_fields[key].annotation)


clouds = pytest.mark.parametrize("cloud", degenerate_clouds().values(), ids=degenerate_clouds())


@every_stage
def test_a_stage_has_the_shape_of_a_stage(stage: Stage) -> None:
    assert stage.name.isidentifier()
    assert stage.version >= 1
    assert issubclass(stage.Config, Section)
    assert (type(stage).__doc__ or "").strip()
    assert len(set(stage.outputs)) == len(stage.outputs) > 0
    assert all(topic.name.startswith(f"/{stage.name}/") for topic in stage.outputs)


def test_inputs_come_from_earlier_stages_and_names_are_unique() -> None:
    names = [topic.name for topic in TOPICS]
    assert len(set(names)) == len(names)
    for i, stage in enumerate(STAGES):
        earlier = {topic for other in STAGES[:i] for topic in other.outputs}
        assert set(stage.inputs) <= earlier


@every_stage
def test_undeclared_topics_are_refused(
    stage: Stage, finished_yard: YardRun, config: RunConfig, tmp_path: Path
) -> None:
    context: RunContext[Any] = RunContext(
        stage=stage,
        config=config.stages[stage.name],
        seed=0,
        key="",
        folder=RunFolder(finished_yard.output),
        writer=StageFileWriter(tmp_path / "a.mcap", {}),
        engine=LocalEngine(1),
        memory_bytes=1 << 30,
        scratch=tmp_path,
        progress=None,
    )
    for topic in TOPICS:
        if topic not in stage.inputs:
            with pytest.raises(ValueError, match=f"{stage.name} does not declare {topic.name}"):
                context.read(topic)
        if topic not in stage.outputs:
            with pytest.raises(ValueError, match=f"{stage.name} does not declare {topic.name}"):
                context.write(topic, None)
            with pytest.raises(ValueError, match=f"{stage.name} does not declare {topic.name}"):
                list(context.recovered(topic))


@every_stage
def test_the_same_seed_gives_the_same_bytes_with_any_number_of_threads(
    stage: Stage, config: RunConfig, messages: Messages, tmp_path: Path
) -> None:
    """And every declared input is read by one of its methods: it would cost re-runs for nothing."""
    section = config.stages[stage.name]
    first, second = (run(stage, section, messages, tmp_path, threads) for threads in (1, 2))
    assert {name for name, _ in first.encoded} <= {topic.name for topic in stage.outputs}
    assert second.encoded == first.encoded
    asked = first.asked
    if "method" in type(section).model_fields:
        for method in choices(stage.name, "method")[1:]:
            asked |= run(
                stage, section.model_copy(update={"method": method}), messages, tmp_path
            ).asked
    assert asked == set(stage.inputs)


@clouds
def test_ground_decides_on_degenerate_clouds(
    cloud: np.ndarray, config: RunConfig, tmp_path: Path
) -> None:
    stage = NAMED["ground"]
    for overrides in ({}, {"up": (0.0, 0.0, 1.0)}, {"min_margin": 4.0}):
        section = config.stages["ground"].model_copy(update=overrides)
        try:
            outputs = run(stage, section, as_messages(cloud), tmp_path).outputs
        except StageError:
            continue
        assert np.isfinite(outputs[UPRIGHT][0].T_world_local).all()


@clouds
@pytest.mark.parametrize("origins", choices("scan", "origins"))
def test_scan_finds_nothing_in_degenerate_clouds(
    cloud: np.ndarray, origins: str, config: RunConfig, messages: Messages, tmp_path: Path
) -> None:
    section = config.stages["scan"].model_copy(update={"origins": origins})
    outputs = run(NAMED["scan"], section, messages | as_messages(cloud), tmp_path).outputs
    assert [len(hits.points) for hits in outputs[HITS]] == [0]


@pytest.mark.parametrize("method", choices("cluster", "method"))
@pytest.mark.parametrize("hits", degenerate_clouds().values(), ids=degenerate_clouds())
def test_cluster_takes_any_hits(
    method: str, hits: np.ndarray, config: RunConfig, messages: Messages, tmp_path: Path
) -> None:
    section = config.stages["cluster"].model_copy(update={"method": method, "min_hits": 1})
    points = hits.astype(np.float32)
    correlation = np.linspace(0.6, 0.9, len(points), dtype=np.float32)
    given = messages | {HITS: [Hits("saloon", points, correlation)]}
    found: list[Cluster] = run(NAMED["cluster"], section, given, tmp_path).outputs[CLUSTERS]
    assert [cluster.id for cluster in found] == list(range(len(found)))
    assert sum(cluster.hits for cluster in found) == len(points)
    assert np.isfinite([cluster.position for cluster in found]).all()


@clouds
@pytest.mark.parametrize("method", choices("verify", "method"))
def test_verify_decides_on_candidates_in_degenerate_clouds(
    cloud: np.ndarray, method: str, config: RunConfig, messages: Messages, tmp_path: Path
) -> None:
    section = config.stages["verify"].model_copy(update={"method": method})
    places = [(1.0, 2.0, 4.0), (0.0, 0.0, 1.4), (500.0, 0.0, 1.4)]
    candidates = [Cluster(i, "saloon", p, 3, 0.7, "delaunay") for i, p in enumerate(places)]
    given = messages | as_messages(cloud) | {CLUSTERS: candidates}
    outputs = run(NAMED["verify"], section, given, tmp_path).outputs
    assert [d.id for d in outputs[DETECTIONS]] == [0, 1, 2]
    for detection in outputs[DETECTIONS]:
        assert detection.fate == "rejected"
        assert detection.reason
        assert np.isfinite(detection.T_scene_model).all()


def test_verify_without_candidates_has_no_detections(
    config: RunConfig, messages: Messages, tmp_path: Path
) -> None:
    outputs = run(
        NAMED["verify"], config.stages["verify"], messages | {CLUSTERS: []}, tmp_path
    ).outputs
    assert outputs[DETECTIONS] == []


NOT_FINITE = {
    "all NaN": np.full((100, 3), np.nan),
    "one axis NaN": np.column_stack([np.full((100, 2), 1.0), np.full(100, np.nan)]),
    "infinite": np.full((100, 3), np.inf),
    "beyond float32": np.full((100, 3), 1e300),
    "some NaN": np.concatenate(
        [np.full((5, 3), np.nan), np.random.default_rng(0).normal(0, 9, (99, 3))]
    ),
}


@pytest.mark.parametrize("name", [*degenerate_clouds(), *NOT_FINITE])
def test_ingest_decides_on_degenerate_files(
    name: str, yard: Yard, config: RunConfig, tmp_path: Path
) -> None:
    xyz = (degenerate_clouds() | NOT_FINITE)[name]
    yard.write(tmp_path, xyz)
    section = config.stages["ingest"].model_copy(update={"scene": tmp_path / "scene.ply"})
    hopeless = {"empty", *NOT_FINITE} - {"some NaN"}
    if name in hopeless:
        with pytest.raises(StageError, match=r"^[^\n]+$"):
            run(NAMED["ingest"], section, {}, tmp_path)
        return
    outputs = run(NAMED["ingest"], section, {}, tmp_path).outputs
    finite = np.isfinite(xyz).all(axis=1).sum()
    (scene,) = outputs[SCENE]
    assert scene.points == sum(outputs[TILES][0].counts)
    assert scene.points + scene.duplicates + scene.strays == finite
    assert scene.dropped == len(xyz) - finite


@every_stage
def test_drawing_works_on_what_a_stage_writes(stage: Stage, messages: Messages) -> None:
    draw(stage, messages)


def test_drawing_works_where_nothing_was_found(
    config: RunConfig, messages: Messages, tmp_path: Path
) -> None:
    given = dict(messages)
    section = config.stages["scan"].model_copy(update={"min_correlation": 0.999})
    for stage in STAGES[STAGES.index(NAMED["scan"]) :]:
        chosen = section if stage.name == "scan" else config.stages[stage.name]
        given |= run(stage, chosen, given, tmp_path).outputs
    assert given[DETECTIONS] == []
    for stage in STAGES:
        draw(stage, given)


def test_drawing_works_on_a_candidate_that_could_not_be_fitted(
    config: RunConfig, messages: Messages, tmp_path: Path
) -> None:
    far = replace(messages[CLUSTERS][0], position=(500.0, 0.0, 1.4))
    given = messages | {CLUSTERS: [far]}
    given |= run(NAMED["verify"], config.stages["verify"], given, tmp_path).outputs
    draw(NAMED["verify"], given)


def draw(stage: Stage, messages: Messages) -> None:
    strict = rr.strict_mode()
    rr.set_strict_mode(True)
    try:
        recording = rr.RecordingStream("spinpipe_test")
        memory = recording.memory_recording()
        DRAW[stage.name](lambda topic, /: messages[topic], recording, 1000)
        assert memory.num_msgs() > 0
    finally:
        rr.set_strict_mode(strict)


FIELDS: dict[str, FieldInfo] = {
    f"{name}.{key}": field
    for name, section in SECTIONS.items()
    for key, field in own_keys(section).items()
}


@pytest.mark.parametrize("key", FIELDS)
def test_every_key_is_described_and_every_number_bounded(key: str) -> None:
    field = FIELDS[key]
    assert field.description
    kinds = {field.annotation, *get_args(field.annotation)}
    if kinds & {int, float}:
        bounds = {type(bound).__name__ for bound in field.metadata}
        assert bounds & {"Gt", "Ge"}, "no lower bound"
        assert bounds & {"Lt", "Le"}, "no upper bound"
