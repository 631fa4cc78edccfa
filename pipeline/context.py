"""The context that the pipeline hands to a stage."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np

from spinpipe.pipeline.engine import Engine
from spinpipe.pipeline.mcap_file import Messages, StageFileWriter, recover
from spinpipe.pipeline.progress import StageProgress
from spinpipe.pipeline.run_folder import RunFolder
from spinpipe.schemas.topics import Topic
from spinpipe.stages import STAGES
from spinpipe.stages.stage import Progress, Section, Stage

T = TypeVar("T")
R = TypeVar("R")
C = TypeVar("C", bound=Section)


class RunReader:
    """Reads any topic of a run's complete files."""

    def __init__(self, folder: RunFolder) -> None:
        self.folder = folder

    def __call__(self, topic: Topic[T]) -> Sequence[T]:
        """Records of a topic, decoded as they are asked for; none if its stage is not complete."""
        producer = next(stage for stage in STAGES if topic in stage.outputs)
        path = self.folder.mcap(producer.name)
        return Messages(path, topic) if path.exists() else ()


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

    def recovered(self, topic: Topic[T]) -> Iterator[T]:
        """Messages that an interrupted run had written; they go into the new file as they come."""
        self._require(topic, self._stage.outputs, "outputs")
        for data in recover(self._folder.interrupted(self._stage.name), self._key, topic):
            self._writer.write_bytes(topic, data)
            yield topic.decode(data)

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
