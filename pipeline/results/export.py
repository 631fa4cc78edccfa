"""``spinpipe export``: a run's detections in another tool's format."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from spinpipe.pipeline.config import ConfigError
from spinpipe.pipeline.context import RunReader
from spinpipe.pipeline.outputs import locked, write_new
from spinpipe.pipeline.results.complete import open_complete
from spinpipe.pipeline.results.formats import FORMATS, SUFFIX, Export
from spinpipe.schemas import DETECTIONS, MODELS


def export_command(
    path: Path, name: str, fates: Sequence[str], output: Path | None, force: bool
) -> None:
    """``spinpipe export``."""
    folder, config = open_complete(path)
    read = RunReader(folder)
    detections = list(read(DETECTIONS))
    known = {d.fate for d in detections} | {"accepted", "ambiguous", "rejected", "duplicate"}
    for fate in fates:
        if fate not in known:
            raise ConfigError(f"--fate {fate}: no such fate; fates are {', '.join(sorted(known))}")
    chosen = [d for d in detections if d.fate in fates]
    models = {model.name: model for model in read(MODELS)}
    target = output or folder.path / f"export.{SUFFIX.get(name, name)}"
    export = Export(config.run.name, chosen, models, read)

    def fill(partial: Path) -> None:
        FORMATS[name](export, partial)

    if output is None:
        with locked(folder.path, force=force) as outputs:
            outputs.claim(target)
            outputs.write(target, "", fill)
    else:
        write_new(target, fill, force=force)
    text = f"wrote {target}: {len(chosen)} of {len(detections)} candidates ({', '.join(fates)})"
    Console().print(text, highlight=False, soft_wrap=True)
