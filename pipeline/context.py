"""The context that the pipeline hands to a stage."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Container, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np

from spinpipe.pipeline.engine import Engine
from spinpipe.pipeline.mcap_file import (
    DamagedFileError,
    Messages,
    StageFileWriter,
    read_metadata,
    recover,
)
from spinpipe.pipeline.progress import StageProgress
from spinpipe.pipeline.run_folder import RunFolder
from spinpipe.pipeline.views import StageViews
from spinpipe.schemas.topics import Topic
from spinpipe.stages import STAGES
from spinpipe.stages.stage import Progress, Section, Stage

T = TypeVar("T")
R = TypeVar("R")
C = TypeVar("C", bound=Section)


class RunReader:
    """The one door to what a run has written: only whole files that follow from each other.

    Parameters
    ----------
    folder : of the run.
    ready : stages that may be read; by default all that are there. A run that is under way names
        those that it has finished, so that what an earlier one left is never looked at.
    """

    def __init__(self, folder: RunFolder, ready: Container[str] | None = None) -> None:
        self.folder = folder
        self._ready = ready

    def __call__(self, topic: Topic[T]) -> Sequence[T]:
        """Records of a topic, decoded as they are asked for; none if its stage is not complete.

        Raises
        ------
        DamagedFileError
            If a file is damaged, or was made from another than the one that stands beside it.
        """
        producer = next(stage for stage in STAGES if topic in stage.outputs)
        path = self.folder.mcap(producer.name)
        if not path.exists() or (self._ready is not None and producer.name not in self._ready):
            return ()
        require_origin(self.folder, producer.name)
        return Messages(path, topic)


def require_origin(folder: RunFolder, stage: str) -> None:
    """Refuse a stage's file that was made from other files than those beside it.

    Raises
    ------
    DamagedFileError
        If so, or if one of the files is damaged.
    """
    made_from = json.loads(read_metadata(folder.mcap(stage), "stage").get("parts", "{}"))
    for name in (s.name for s in STAGES):
        expected, path = made_from.get(f"stage {name}"), folder.mcap(name)
        if expected is None or not path.exists():
            continue
        if read_metadata(path, "stage").get("key") != expected:
            raise DamagedFileError(
                f"{folder.mcap(stage)} was not made from {path.name} beside it; "
                "run its config again"
            )
        require_origin(folder, name)


class RunContext(Generic[C]):
    """Implements ``spinpipe.stages.stage.Context`` over the files of a run."""

    def __init__(
        self,
        *,
        stage: Stage,
        config: C,
        seed: int,
        key: str,
        folder: RunFolder,
        writer: StageFileWriter,
        engine: Engine,
        memory_bytes: int,
        scratch: Path,
        progress: StageProgress,
    ) -> None:
        self.config = config
        self.rng = np.random.default_rng([seed, _number(stage.name)])
        self.threads = engine.threads
        self.memory_bytes = memory_bytes
        self.scratch = scratch
        self.notes: list[str] = []
        self.views = StageViews(stage.name, folder)
        """What viewers get beside the records; to be written when the stage has ended."""
        self._stage = stage
        self._key = key
        self._folder = folder
        self._writer = writer
        self._engine = engine
        self._progress = progress
        self._read = RunReader(folder)

    def read(self, topic: Topic[T]) -> Sequence[T]:
        """Messages of an input topic."""
        self._require(topic, self._stage.inputs, "inputs")
        return self._read(topic)

    def read_one(self, topic: Topic[T]) -> T:
        """The only message of an input topic."""
        return self.read(topic)[0]

    def write(self, topic: Topic[T], message: T) -> None:
        """Append to an output topic."""
        self._require(topic, self._stage.outputs, "outputs")
        self._writer.write(topic, message)
        self.views.see(topic, message)

    def recovered(self, topic: Topic[T]) -> Iterator[T]:
        """Messages that an interrupted run had written; they go into the new file as they come."""
        self._require(topic, self._stage.outputs, "outputs")
        for data in recover(self._folder.interrupted(self._stage.name), self._key, topic):
            self._writer.write_bytes(topic, data)
            record = topic.decode(data)
            self.views.see(topic, record)
            yield record

    def progress(self, label: str, total: int) -> Progress:
        """Start a counter."""
        return self._progress.start(label, total)

    def map(self, function: Callable[[T], R], items: Iterable[T]) -> Iterator[R]:
        """``function`` of every item, in order, on the run's engine."""
        return self._engine.map(function, items)

    def log(self, text: str) -> None:
        """Note one line for the report."""
        self.notes.append(text)

    def _require(self, topic: Topic[T], declared: tuple[Topic[T], ...], kind: str) -> None:
        if topic not in declared:
            raise ValueError(f"{self._stage.name} does not declare {topic.name} in its {kind}")


def thread_count(configured: int) -> int:
    """The number of threads to use: as configured, or all cores that this process may use."""
    return configured or len(os.sched_getaffinity(0))


def _number(name: str) -> int:
    return int.from_bytes(hashlib.sha256(name.encode()).digest()[:4], "little")
