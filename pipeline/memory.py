"""What memory a run takes at most, told before it starts; fewer threads where that makes it fit.

The figures are peaks of whole processes (``tests/bench/pipeline.py``), with some room: ten million
points take 0.47 GB on the ground, 0.34 with one thread and 0.46 with two in the stages after it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from spinpipe.pipeline.config import ConfigError, RunConfig
from spinpipe.pipeline.context import thread_count

_GB = 1e9
_PROGRAM = 0.2 * _GB
"""Interpreter, libraries, compiled kernels."""
_MODEL_BYTE = 22.0
"""A byte of a model's file: as text, as arrays, sampled, seen from all around."""
_SAMPLE_POINT = 2200.0
"""A point of the ground's sample, with its trees and neighbourhoods."""
_SAMPLING = 0.3 * _GB
"""Two million points that density and noise are measured from."""
_TILES = 0.1 * _GB
_TILE_POINT = 500.0
"""A point of the tile that a thread works on, with what surrounds the tile."""
_RECORDING = 0.15 * _GB
_PREVIEW_POINT = 150.0


def fitting_threads(config: RunConfig, *, recording: bool) -> int:
    """How many threads a run may use, of those it is allowed, so that it stays below its memory.

    Raises
    ------
    ConfigError
        If it does not with a single one; the message says what it needs.
    """
    memory = config.execution.memory_gb * _GB
    sections = {name: section.model_dump() for name, section in config.stages.items()}
    ground = max(_SAMPLE_POINT * sections["ground"]["sample_points"], _SAMPLING)
    a_thread = _TILE_POINT * sections["ingest"]["tile_points"]
    fixed = _PROGRAM + _MODEL_BYTE * max(_file_bytes(sections["model"]["models"]), default=0)
    if recording:
        fixed += _RECORDING + _PREVIEW_POINT * config.record.preview_points
    least = fixed + max(ground, _TILES + a_thread)
    if memory < least:
        mend = "raise it, or lower ground.sample_points, ingest.tile_points"
        if recording:
            mend += ", record.preview_points, or record nothing (--rerun off)"
        raise ConfigError(
            f"execution.memory_gb = {config.execution.memory_gb:g}: this run may take "
            f"{least / _GB:.2f} GB; {mend}"
        )
    return min(thread_count(config.execution.threads), int((memory - fixed - _TILES) / a_thread))


def working_bytes(memory_gb: float) -> int:
    """What of the memory is left for a stage's arrays, beside the program."""
    return max(int(memory_gb * _GB - _PROGRAM), int(_PROGRAM))


def _file_bytes(models: Sequence[dict[str, Any]]) -> Iterator[int]:
    for model in models:
        if model["path"] is not None and model["path"].is_file():
            yield model["path"].stat().st_size
