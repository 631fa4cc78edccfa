"""``spinpipe status``: what of a run is there, and whether it is being worked on."""

from __future__ import annotations

import fcntl
import json
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from rich.console import Console
from rich.table import Table
from rich.text import Text

from spinpipe.pipeline.context import RunReader
from spinpipe.pipeline.mcap_file import DamagedFileError, read_metadata
from spinpipe.pipeline.outputs import Outputs
from spinpipe.pipeline.results.complete import open_run_folder
from spinpipe.pipeline.run_folder import RunFolder
from spinpipe.schemas import DETECTIONS
from spinpipe.stages import STAGES

RESULTS = (
    *("detections.json", "detections.csv", "detections.ply", "detections.geojson"),
    *("detections.png", "report.html", "run.rrd"),
)


def status_command(path: Path) -> None:
    """``spinpipe status``."""
    outputs, folder = Outputs(path), RunFolder(path)
    name = ""
    if folder.config.exists() or not outputs.marked:
        folder, config = open_run_folder(path)
        name = f" {config.run.name}"
    console = Console()
    busy = _locked(folder)
    state = "being worked on" if busy else "nobody works on it"
    console.print(f"run{name} in {path}: {state}", highlight=False, soft_wrap=True)
    console.print(_stages(folder), highlight=False)
    console.print(_results(folder), highlight=False, soft_wrap=True)
    for line in () if busy else _left(folder, outputs):
        console.print(line, highlight=False, soft_wrap=True)
    if folder.mcap("verify").exists():
        fates = Counter(d.fate for d in RunReader(folder)(DETECTIONS))
        found = ", ".join(f"{n} {fate}" for fate, n in sorted(fates.items())) or "no candidates"
        console.print(found, highlight=False)
    else:
        config = folder.config if folder.config.exists() else "CONFIG"
        console.print(f"go on: spinpipe run {config} -o {path}", highlight=False, soft_wrap=True)


def _stages(folder: RunFolder) -> Table:
    table = Table(box=None, pad_edge=False, header_style="bold")
    for name, justify in (("stage", "left"), ("state", "left"), ("s", "right"), ("MB", "right")):
        table.add_column(name, justify="right" if justify == "right" else "left")
    table.add_column("notes")
    for stage in STAGES:
        state, seconds, notes, path = "missing", "", "", folder.mcap(stage.name)
        if path.exists():
            try:
                result = read_metadata(path, "result")
                state = "complete"
                seconds = f"{float(result.get('seconds', 0)):.1f}"
                notes = "; ".join(json.loads(result.get("notes", "[]"))[-2:])
            except DamagedFileError:
                state = "damaged"
        else:
            for left in folder.begun(stage.name):
                state, path = "begun", left
        size = f"{path.stat().st_size / 1e6:.1f}" if path.exists() else ""
        table.add_row(*(Text(cell) for cell in (stage.name, state, seconds, size, notes)))
    return table


def _results(folder: RunFolder) -> str:
    there = [name for name in RESULTS if (folder.path / name).exists()]
    return "results: " + (", ".join(there) or "none yet")


def _left(folder: RunFolder, outputs: Outputs) -> Iterator[str]:
    """What killed processes left."""
    if begun := [path.name for stage in STAGES for path in folder.begun(stage.name)]:
        yield f"interrupted, the next run goes on from it: {', '.join(begun)}"
    if left := [path.name for path in outputs.leftovers()]:
        yield f"left by a killed process, to be removed by the next run: {', '.join(left)}"


def _locked(folder: RunFolder) -> bool:
    if not folder.lock.exists():
        return False
    with folder.lock.open() as stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False
