"""The shape that every stage shares, and what a stage sees of the pipeline around it.

A stage is a plain class with ``name``, ``version``, ``inputs``, ``outputs``, a frozen ``Config``
section and ``run(ctx)``. It reads and writes typed topics through the context and knows nothing
of files, recordings or the terminal.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, Protocol, TypeVar

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationInfo

from spinpipe.schemas.topics import Topic

T = TypeVar("T")
R = TypeVar("R")
C = TypeVar("C", covariant=True)


class StageError(Exception):
    """Something that the user can mend; the message says what, where and what to do."""


class Section(BaseModel):
    """Base of every config section: frozen, no unknown keys, no infinite numbers."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


def _resolve(path: Path, info: ValidationInfo) -> Path:
    base: Path = (info.context or {}).get("base", Path())
    try:
        resolved = (base / path.expanduser()).resolve()
        str(resolved).encode()
    except UnicodeEncodeError:
        raise ValueError("its name is not UTF-8; rename it") from None
    except (RuntimeError, OSError):
        raise ValueError("it is a link that leads to itself, or below no home; name it") from None
    except ValueError:
        raise ValueError("a name cannot hold a zero byte") from None
    return resolved


InputPath = Annotated[Path, AfterValidator(_resolve)]
"""A file or folder that a stage reads: relative to the config file. The key of a stage holds its
content, not its name."""


Scale = Annotated[float, Field(ge=1e-9, le=1e9)]
"""Metres a unit: from nanometres to more than the Earth is wide."""


class Progress(Protocol):
    """A counter shown to the user while a stage works."""

    def advance(self, steps: int = 1) -> None:
        """Count ``steps`` more as done."""
        ...


class Context(Protocol[C]):
    """What a stage sees of the run: its section, its topics, its random numbers, its limits."""

    @property
    def config(self) -> C:
        """The stage's own section of the config."""
        ...

    @property
    def rng(self) -> np.random.Generator:
        """A generator seeded from ``(run.seed, stage name)``: the same at every run."""
        ...

    @property
    def threads(self) -> int:
        """How many threads compiled kernels may use, at least 1."""
        ...

    @property
    def memory_bytes(self) -> int:
        """How much memory the stage may use; work is cut into pieces that fit."""
        ...

    @property
    def scratch(self) -> Path:
        """A folder for temporary files, which have no name so that none can stay behind."""
        ...

    def read(self, topic: Topic[T]) -> Sequence[T]:
        """Messages of a topic that an earlier stage wrote, decoded as they are asked for.

        The sequence can be pickled and indexed, so a worker reads only what it needs.
        """
        ...

    def read_one(self, topic: Topic[T]) -> T:
        """The only message of a topic."""
        ...

    def write(self, topic: Topic[T], message: T) -> None:
        """Append a message to one of the stage's own output topics."""
        ...

    def recovered(self, topic: Topic[T]) -> Iterator[T]:
        """What an interrupted run of this very stage and key had already written to ``topic``.

        Each message that comes is part of the output already and must not be written again.
        """
        ...

    def progress(self, label: str, total: int) -> Progress:
        """Start a counter with ``total`` steps."""
        ...

    def map(self, function: Callable[[T], R], items: Iterable[T]) -> Iterator[R]:
        """``function`` of every item, in order, computed by the run's engine.

        The function and its items must be picklable: the engine may run on other machines.
        """
        ...

    def log(self, text: str) -> None:
        """Note one line for the run's report."""
        ...


class Stage(Protocol):
    """One step of the pipeline: a name, its topics, its section and ``run``.

    The members are plain class attributes: ``name = "scan"``, ``class Config(Section)``.
    """

    @property
    def name(self) -> str:
        """Config section, stem of the MCAP file and root of the Rerun entities."""
        ...

    @property
    def version(self) -> int:
        """Raised to force the stage to run again; a change to its code does so by itself."""
        ...

    @property
    def inputs(self) -> tuple[Topic[Any], ...]:
        """Topics of earlier stages that this one reads."""
        ...

    @property
    def outputs(self) -> tuple[Topic[Any], ...]:
        """Topics that this stage writes."""
        ...

    @property
    def Config(self) -> type[Section]:
        """The stage's section of the config."""
        ...

    def run(self, ctx: Context[Any]) -> None:
        """Read the inputs, compute, write the outputs; raise ``StageError`` on bad input."""
        ...
