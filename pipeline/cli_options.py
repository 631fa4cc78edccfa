"""Arguments and options that commands have in common, and the words that they take."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer


class RerunMode(StrEnum):
    """Where the recording goes."""

    save = "save"
    spawn = "spawn"
    connect = "connect"
    off = "off"


class ExportFormat(StrEnum):
    """What ``export`` writes."""

    csv = "csv"
    json = "json"
    geojson = "geojson"
    ply = "ply"
    obj = "obj"
    kitti = "kitti"
    las = "las"
    mcap = "mcap"


class Role(StrEnum):
    """What a file is looked at as."""

    scene = "scene"
    model = "model"


class Frame(StrEnum):
    """Coordinates of labels."""

    scene = "scene"
    world = "world"


ConfigArgument = Annotated[Path, typer.Argument(metavar="CONFIG", help="The run's TOML file.")]
OutputOption = Annotated[
    Path | None,
    typer.Option("--output", "-o", metavar="DIR", help="The run's folder (recordings/<name>)."),
]
SetOption = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="SECTION.KEY=VALUE", help="Override one key; repeatable."),
]
FromOption = Annotated[
    str | None, typer.Option("--from", metavar="STAGE", help="Run this stage and all after it.")
]
UntilOption = Annotated[
    str | None, typer.Option("--until", metavar="STAGE", help="Stop after this stage.")
]
RerunOption = Annotated[
    RerunMode,
    typer.Option(
        "--rerun",
        help="save: run.rrd in the run's folder; spawn: a viewer; connect: a running viewer.",
    ),
]
RunArgument = Annotated[Path, typer.Argument(metavar="RUN", help="A run's folder.")]
ForceOption = Annotated[
    bool, typer.Option("--force", help="Replace files that are not from spinpipe.")
]
