"""What a run would do: for every stage its key, whether it runs, and why."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from spinpipe.pipeline.config import ConfigError, RunConfig
from spinpipe.pipeline.input_files import Identity
from spinpipe.pipeline.keys import (
    changed_parts,
    input_identities,
    producers,
    stage_key,
    stage_parts,
)
from spinpipe.pipeline.mcap_file import DamagedFileError, read_metadata
from spinpipe.pipeline.run_folder import RunFolder
from spinpipe.stages import STAGES
from spinpipe.stages.stage import Section, Stage

_SHOWN_CHANGES = 3
_LONG = 28
"""Characters of a value; keys of stages and hashes of files are longer."""


@dataclass(frozen=True)
class Step:
    """One stage of a plan."""

    stage: Stage
    config: Section
    key: str
    parts: Mapping[str, str] = field(repr=False)
    action: str
    """``"run"``, ``"reuse"`` or ``"skip"``."""
    reason: str
    inputs: tuple[Identity, ...] = field(default=(), repr=False)
    """Of the files that it reads, from before they were hashed."""


def make_plan(
    config: RunConfig,
    folder: RunFolder,
    *,
    start: str | None = None,
    until: str | None = None,
    stages: Sequence[Stage] = STAGES,
) -> list[Step]:
    """Decide for every stage whether it runs, from its key and the files that are there.

    Parameters
    ----------
    config : the run's config.
    folder : where the run's files are; need not exist.
    start : stage from which on everything runs, whatever is there.
    until : last stage that runs.
    stages : in their order, those that the others read from among them.

    Raises
    ------
    ConfigError
        If ``start`` or ``until`` is no stage, or ``start`` comes after ``until``.
    StageError
        If an input file is missing.
    """
    first = _index(start, "--from", default=len(stages))
    last = _index(until, "--until", default=len(stages) - 1)
    if start and first > last:
        raise ConfigError(f"--from {start} comes after --until {until}: nothing would run")
    steps: list[Step] = []
    keys: dict[str, str] = {}
    for i, stage in enumerate(stages):
        section = config.stages[stage.name]
        inputs = input_identities(stage, section)
        parts = stage_parts(
            stage, section, config.run.seed, {name: keys[name] for name in producers(stage)}
        )
        keys[stage.name] = key = stage_key(parts)
        if i > last:
            action, reason = "skip", f"--until {until}"
        elif i >= first:
            action, reason = "run", f"--from {start}"
        else:
            action, reason = _decide(folder, stage.name, key, parts)
        steps.append(Step(stage, section, key, parts, action, reason, inputs))
    return steps


def _index(stage: str | None, option: str, default: int) -> int:
    if stage is None:
        return default
    names = [s.name for s in STAGES]
    if stage not in names:
        raise ConfigError(f"{option} {stage}: no such stage; stages are {', '.join(names)}")
    return names.index(stage)


def _decide(folder: RunFolder, stage: str, key: str, parts: Mapping[str, str]) -> tuple[str, str]:
    path = folder.mcap(stage)
    if not path.exists():
        if folder.begun(stage):
            return "run", "was interrupted"
        return "run", "no output yet"
    try:
        written = read_metadata(path, "stage")
        before = dict[str, str](json.loads(written.get("parts", "{}")))
    except DamagedFileError as error:
        return "run", str(error)
    except (ValueError, TypeError):
        return "run", f"{path.name} was not written by spinpipe"
    if written.get("key") == key:
        return "reuse", "nothing it depends on changed"
    return "run", _why(before, parts)


def _why(before: Mapping[str, str], now: Mapping[str, str]) -> str:
    """Name what changed; an upstream stage stands for all that changed above it."""
    changed = changed_parts(before, now)
    own = [name for name in changed if not name.startswith("stage ")]
    names = own or [name.removeprefix("stage ") for name in changed]
    shown = [_change(name, before.get(name), now.get(name)) for name in names[:_SHOWN_CHANGES]]
    more = len(names) - _SHOWN_CHANGES
    return ", ".join(shown) + (f" and {more} more" if more > 0 else "")


def _change(name: str, before: str | None, now: str | None) -> str:
    """A value that fits on a line beside what it was; of files and stages that they changed."""
    values = [value for value in (before, now) if value is not None]
    if len(values) < 2 or any(len(v) > _LONG or v.startswith("sha256") for v in values):
        return f"{name} changed"
    return f"{name} changed from {before} to {now}"
