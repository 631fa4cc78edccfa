"""``spinpipe why``: the life of one candidate on the terminal."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from PIL import Image
from rich.console import Console, Group
from rich.table import Table
from rich.text import Text

from spinpipe.pipeline.context import RunReader
from spinpipe.pipeline.drawing.closeup import closeups
from spinpipe.pipeline.drawing.texts import LOW, against
from spinpipe.pipeline.outputs import write_new
from spinpipe.pipeline.results.candidate_pictures import POINTS, VIEWS, strips
from spinpipe.pipeline.results.complete import open_complete
from spinpipe.pipeline.results.life import Life, deciding_part, find_detection, life_of
from spinpipe.schemas import DETECTIONS
from spinpipe.schemas.records import Detection
from spinpipe.stages.stage import StageError

BAR = 20
"""Characters of a full bar."""


def why_command(
    path: Path, numbers: Sequence[int], picture: Path | None = None, force: bool = False
) -> None:
    """``spinpipe why``."""
    folder, config = open_complete(path)
    read = RunReader(folder)
    known = read(DETECTIONS)
    detections = [find_detection(known, number) for number in numbers]
    if picture is not None:
        kind = Image.registered_extensions().get(picture.suffix.lower())
        if kind not in ("PNG", "JPEG", "WEBP"):
            raise StageError(f"--picture {picture}: name a .png, .jpg or .webp file")
        image = strips(closeups(read, detections, POINTS))
        write_new(picture, lambda partial: image.save(partial, format=kind), force=force)
    console = Console()
    for k, detection in enumerate(detections):
        if k:
            console.rule()
        console.print(life_table(life_of(detection, read, config), path), highlight=False)
    if picture is not None:
        text = f"wrote {picture}, a row a candidate: {'; '.join(VIEWS)}"
        console.print(text, highlight=False, soft_wrap=True)


def life_table(life: Life, folder: Path) -> Group:
    """The life of a candidate as tables."""
    d = life.detection
    x, y, z = d.position_scene
    lines = [
        Text(f"candidate {d.id}: {d.model}, {d.fate}", style="bold"),
        Text(d.reason),
        Text(f"at x_scene {x:z.2f}  y_scene {y:z.2f}  z_scene {z:z.2f}\n"),
        _tests(life),
    ]
    if d.parts:
        lines += [Text(), _parts(d)]
    if against(d.parts):
        lines += [Text("\nwhat speaks against it, the loudest first", style="bold"), _against(d)]
    lines += [Text()] + [Text(f"- {line}") for line in life.remedies]
    lines.append(Text(f"see it: spinpipe view {folder} --candidate {d.id}"))
    lines.append(Text(f"or: spinpipe why {folder} {d.id} --picture {d.id}.png"))
    return Group(*lines)


def _tests(life: Life) -> Table:
    table = Table(box=None, pad_edge=False, header_style="bold")
    for name in ("stage", "test", "value", "limit", ""):
        table.add_column(name, no_wrap=name == "limit")
    before = ""
    for test in life.tests:
        mark = {True: "ok", False: "no", None: ""}[test.passed]
        style = "red" if test.passed is False else ""
        stage = "" if test.stage == before else test.stage
        # the key of a limit below it: together they are wider than a terminal
        cells = (stage, test.what, test.value, test.limit.replace(" (", "\n("), mark)
        table.add_row(*(Text(cell, style=style) for cell in cells))
        before = test.stage
    return table


def _parts(d: Detection) -> Table:
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("part")
    table.add_column("value", justify="right")
    table.add_column("if right", justify="right")
    table.add_column("")
    table.add_column("log odds", justify="right")
    worst = deciding_part(d)
    for part in d.parts:
        style = "red" if part == worst and d.fate != "accepted" else ""
        filled = round(BAR * min(max(part.value / part.reference, 0.0), 1.0))
        bar = "█" * filled + "░" * (BAR - filled)
        cells = (part.name, f"{part.value:.2f}", f"{part.reference:.2f}", bar, f"{part.merit:+.2f}")
        table.add_row(*(Text(cell, style=style) for cell in cells))
    return table


def _against(d: Detection) -> Table:
    """What each part that is low says, in words."""
    table = Table(box=None, pad_edge=False, show_header=False)
    for part in against(d.parts):
        table.add_row(f"{part.name} {part.merit:+.1f}", LOW.get(part.name, ""))
    return table
