"""``spinpipe why``: the life of one candidate on the terminal."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console, Group
from rich.table import Table
from rich.text import Text

from spinpipe.pipeline.context import RunReader
from spinpipe.pipeline.results.complete import open_complete
from spinpipe.pipeline.results.life import Life, deciding_part, find_detection, life_of
from spinpipe.schemas import DETECTIONS

BAR = 20
"""Characters of a full bar."""


def why_command(path: Path, number: int) -> None:
    """``spinpipe why``."""
    folder, config = open_complete(path)
    read = RunReader(folder)
    detection = find_detection(read(DETECTIONS), number)
    Console().print(life_table(life_of(detection, read, config), path), highlight=False)


def life_table(life: Life, folder: Path) -> Group:
    """The life of a candidate as tables."""
    d = life.detection
    x, y, z = d.position_scene
    lines = [
        Text(f"candidate {d.id}: {d.model}, {d.fate}", style="bold"),
        Text(d.reason),
        Text(f"at x_scene {x:.2f}  y_scene {y:.2f}  z_scene {z:.2f}\n"),
        _tests(life),
    ]
    if life.parts:
        lines += [Text(), _parts(life)]
    lines += [Text()] + [Text(f"- {line}") for line in life.remedies]
    lines.append(Text(f"see it: spinpipe view {folder} --candidate {d.id}"))
    return Group(*lines)


def _tests(life: Life) -> Table:
    table = Table(box=None, pad_edge=False, header_style="bold")
    for name in ("stage", "test", "value", "limit", ""):
        table.add_column(name)
    before = ""
    for test in life.tests:
        mark = {True: "ok", False: "no", None: ""}[test.passed]
        style = "red" if test.passed is False else ""
        stage = "" if test.stage == before else test.stage
        cells = (stage, test.what, test.value, test.limit, mark)
        table.add_row(*(Text(cell, style=style) for cell in cells))
        before = test.stage
    return table


def _parts(life: Life) -> Table:
    parts = life.parts
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("part")
    table.add_column("value", justify="right")
    known = any(part.reference is not None for part in parts)
    costly = any(part.merit is not None for part in parts)
    if known:
        table.add_column("if right", justify="right")
    table.add_column("")
    if costly:
        table.add_column("log odds", justify="right")
    worst = deciding_part(life.detection)
    for part in parts:
        style = "red" if part == worst and life.detection.fate != "accepted" else ""
        cells = [part.name, f"{part.value:.2f}"]
        if known:
            cells.append("" if part.reference is None else f"{part.reference:.2f}")
        share = part.value / (part.reference or 1.0)
        filled = round(BAR * min(max(share, 0.0), 1.0))
        cells.append("█" * filled + "░" * (BAR - filled))
        if costly:
            cells.append("" if part.merit is None else f"{part.merit:+.2f}")
        table.add_row(*(Text(cell, style=style) for cell in cells))
    return table
