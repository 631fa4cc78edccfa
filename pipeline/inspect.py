"""What files hold, as a run understands them: its own first stages look, in a folder that goes."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from rich.console import Console

from spinpipe.pipeline.atomic import scratch_folder
from spinpipe.pipeline.config import RunConfig, scene_config
from spinpipe.pipeline.context import RunReader, thread_count
from spinpipe.pipeline.engine import open_engine
from spinpipe.pipeline.plan import make_plan
from spinpipe.pipeline.run_folder import RunFolder
from spinpipe.pipeline.runner import Runner
from spinpipe.schemas import CAMERAS, PLANE, SAMPLING, SCENE, TILES
from spinpipe.stages import STAGES
from spinpipe.stages.ground.ground import format_vector
from spinpipe.stages.ingest.ingest import Ingest
from spinpipe.stages.ingest.object_model import ModelConfig, object_model, read_model
from spinpipe.stages.ingest.readers.file_kind import file_kind
from spinpipe.stages.ingest.readers.mesh import MESHES
from spinpipe.stages.ingest.readers.open_scene import open_scene
from spinpipe.stages.ingest.readers.ply import read_header
from spinpipe.stages.ingest.readers.ply_faces import face_table
from spinpipe.stages.ingest.sanity import believable, odd_shape, refuse_degrees, scale_of
from spinpipe.stages.stage import StageError

LOOKING = ("ingest", "model", "ground")
"""Stages that understand what is given."""
_SAMPLES = 1000
"""Points drawn from a model that is only looked at."""


@dataclass(frozen=True)
class Look:
    """What the first stages of a run found out, up to the one that refused."""

    read: RunReader
    notes: dict[str, list[str]] = field(default_factory=dict[str, list[str]])
    """Lines of each stage."""
    refused: StageError | None = None


def look(config: RunConfig, folder: Path, console: Console) -> Look:
    """Run those of the stages that understand the inputs that the config has a section for.

    Parameters
    ----------
    config : of a run, or of a scene alone.
    folder : to work in; what is there already and follows from the same is not done again.
    console : shows progress.
    """
    searched = is_searched(config)
    config = _in_units(config)
    stages = [stage for stage in STAGES if stage.name in LOOKING and stage.name in config.stages]
    work = RunFolder(folder)
    found = Look(RunReader(work))
    here = config.execution.model_copy(update={"engine": "local"})
    try:
        steps = make_plan(config, work, stages=stages)
        with open_engine(here, thread_count(here.threads)) as engine:
            runner = Runner(config, work, engine, console, tell=False)
            for step in steps:
                (report,) = runner.run([step])
                found.notes[report.stage] = report.notes
                if searched and step.stage is STAGES[0]:
                    _refuse_degrees(found.read, config)
    except StageError as error:
        return Look(found.read, found.notes, error)
    return found


def is_searched(config: RunConfig) -> bool:
    """Whether the scale is to be searched before anything can run."""
    section = config.stages["ingest"]
    return isinstance(section, Ingest.Config) and section.scale == "search"


def _in_units(config: RunConfig) -> RunConfig:
    """A config whose scale is yet to be searched, in units of the scene and without models."""
    if not is_searched(config):
        return config
    section = config.stages["ingest"]
    stages = {name: other for name, other in config.stages.items() if name != "model"}
    return replace(config, stages=stages | {"ingest": section.model_copy(update={"scale": 1.0})})


def _refuse_degrees(read: RunReader, config: RunConfig) -> None:
    """No scale makes metres of degrees: what a run refuses where the scale is not stated."""
    section = config.stages["ingest"]
    assert isinstance(section, Ingest.Config)
    frame, tiles = read(SCENE)[0], read(TILES)[0]
    low, high = tiles.low.min(axis=0) + frame.origin, tiles.high.max(axis=0) + frame.origin
    told = open_scene(section.scene, section.topic).about.coordinates
    scale_of(None, believable(told, low, high)[0], section.scene)
    refuse_degrees(low, high, section.scene)


def look_again(config: RunConfig, folder: RunFolder, console: Console) -> list[str]:
    """What ``look`` finds for a config, from a run's files where they are there: lines.

    Raises
    ------
    StageError
        What a run would refuse.
    """
    with scratch_folder() as work:
        for name in LOOKING:
            if folder.mcap(name).exists():
                RunFolder(work).mcap(name).symlink_to(folder.mcap(name).resolve())
        found = look(config, work, console)
        if found.refused:
            raise found.refused
        return [note for notes in found.notes.values() for note in notes]


def inspect_file(path: Path, role: Literal["", "scene", "model"], console: Console) -> Facts:
    """Facts of a scene or a model; without a role a mesh is a model, all else a scene.

    Raises
    ------
    StageError
        When the file cannot be read.
    """
    if role == "model" or (not role and _is_mesh(path)):
        return model_facts(path)
    return scene_facts(path, console)


def _is_mesh(path: Path) -> bool:
    kind = "" if path.is_dir() else file_kind(path)
    if kind == "obj":
        with path.open("rb") as file:
            return any(line.startswith((b"f ", b"f\t")) for line in file)
    return face_table(read_header(path)) is not None if kind == "ply" else kind in MESHES


Facts = dict[str, Any]
"""Of one file, ready for JSON; ``refused`` is why a run would not take it, if so."""


def scene_facts(path: Path, console: Console) -> Facts:
    """What the stages ingest and ground find out about a scene."""
    config = scene_config(path)
    with scratch_folder() as work:
        found = look(config, work, console)
        if not found.notes:
            raise found.refused or StageError(f"{path}: nothing was found out")
        frame, tiles = found.read(SCENE)[0], found.read(TILES)[0]
        facts: Facts = {
            "path": str(path),
            "role": "scene",
            "format": frame.kind,
            "points": frame.points,
            "strays": frame.strays,
            "duplicates": frame.duplicates,
            "not_finite": frame.dropped,
            "extent_m": _rounded(tiles.high.max(axis=0) - tiles.low.min(axis=0)),
            "origin": list(frame.origin),
            "metres_a_unit": list(frame.scale),
            "unit_source": frame.unit_source,
            "crs": frame.crs,
            "step_m": frame.step_m,
            "fields": list(frame.fields),
            "coloured": frame.coloured,
            "cameras": sum(len(cameras.positions) for cameras in found.read(CAMERAS)),
            "spacing_m": _rounded(frame.spacing_m),
            "notes": found.notes["ingest"][1:],  # the first is all of this in one line
            "refused": str(found.refused or ""),
        }
        for plane in found.read(PLANE):
            facts["up"] = {
                "direction": _rounded(plane.normal),
                "from": plane.up_source if plane.up_source != "file" else frame.up_reason,
                "evidence": {e.name: round(e.value, 2) for e in plane.evidence},
            }
            facts["ground"] = {
                "share": round(plane.inliers / plane.points, 3),
                "levels": [
                    {"height_m": round(v.height_m, 2), "share": round(v.share, 3)}
                    for v in plane.levels
                ],
            }
        for sampling in found.read(SAMPLING):
            facts["spacing_m"] = _rounded(sampling.spacing_m)
            facts["blur_m"] = _rounded(sampling.blur_m)
            facts["errors"] = [
                {"side_m": _rounded(e.side_m), "error_m": _rounded(e.error_m)}
                for e in sampling.errors
            ]
        return facts


def model_facts(path: Path) -> Facts:
    """What the stage model finds out about a file."""
    name = re.sub(r"[^A-Za-z0-9_.-]", "_", path.stem)
    config = ModelConfig(name=name, path=path, samples=_SAMPLES)
    try:
        file = read_model(config)
        model = object_model(config, file, np.random.default_rng(0))
    except StageError as error:
        raise StageError(str(error).removeprefix(f"[[model]] '{name}': ")) from None
    return {
        "path": str(path),
        "role": "model",
        "format": file.kind,
        "size_m": _rounded(model.size),
        "points" if file.faces is None else "vertices": len(file.corners),
        "faces": 0 if file.faces is None else len(file.faces),
        "closed": file.closed,
        "up": {"axis": file.up, "why": file.reason},
        "forward": file.forward,
        "metres_a_unit": file.metres or 1.0,
        "unit_source": file.coordinates.source if file.metres else "",
        "notes": [note for note in (file.doubt, odd_shape(model)) if note],
        "refused": "",
    }


def _rounded(values: Any) -> Any:
    """Numbers with four significant digits."""
    if isinstance(values, float | np.floating):
        return float(f"{values:.4g}")
    return [float(f"{value:.4g}") for value in values]


def fact_rows(facts: Facts) -> Sequence[tuple[str, str]]:
    """Names and texts of the rows of a table."""
    rows = _scene_rows(facts) if facts["role"] == "scene" else _model_rows(facts)
    rows += [("note", note) for note in facts["notes"]]
    return rows + ([("refused", facts["refused"])] if facts["refused"] else [])


def _scene_rows(facts: Facts) -> list[tuple[str, str]]:
    left_out = [
        f"{facts[key]:,} {what}"
        for key, what in (("strays", "far from all others"), ("duplicates", "copies"),
                          ("not_finite", "not finite"))
        if facts[key]
    ]  # fmt: skip
    scale = " x ".join(f"{v:.7g}" for v in dict.fromkeys(facts["metres_a_unit"]))
    crs = re.search(r'"([^"]*)"', facts["crs"])  # the name of one in WKT
    fields = ["colour"] * facts["coloured"] + facts["fields"]
    rows = [
        ("format", facts["format"]),
        (
            "points",
            f"{facts['points']:,}" + (f"; left out: {', '.join(left_out)}" * bool(left_out)),
        ),
        ("extent", f"{' x '.join(f'{v:.4g}' for v in facts['extent_m'])} m"),
        ("spacing", f"{facts['spacing_m']:.3g} m"),
    ]
    if facts.get("errors"):
        text = ", ".join(f"{e['error_m']:.2g} m over {e['side_m']:.2g} m" for e in facts["errors"])
        rows.append(("error", text))
    if facts.get("blur_m"):
        rows.append(("skin", f"steps are blurred by {facts['blur_m']:.2g} m: drawings are draped"))
    if "up" in facts:
        up, ground = facts["up"], facts["ground"]
        rows.append(("up", f"{format_vector(np.array(up['direction']))}, from {up['from']}"))
        if up["evidence"]:
            rows.append(("", ", ".join(f"{k} {v:+.2f}" for k, v in up["evidence"].items())))
        levels = ", ".join(f"{v['height_m']:.1f} m ({v['share']:.0%})" for v in ground["levels"])
        rows.append(("ground", f"{ground['share']:.0%} of the surface; levels: {levels or 'none'}"))
    return [
        *rows,
        ("steps", f"{facts['step_m']:.2g} m" if facts["step_m"] else "none seen"),
        ("unit", f"{scale} m, {facts['unit_source'] or 'assumed: nothing says it'}"),
        ("CRS", crs[1] if crs else facts["crs"] or "not said"),
        ("fields", ", ".join(fields) or "none but the coordinates"),
        ("cameras", f"{facts['cameras'] or 'none'}"),
    ]


def _model_rows(facts: Facts) -> list[tuple[str, str]]:
    faces = f"{facts['faces']:,}, {'' if facts['closed'] else 'not '}closed"
    size = " x ".join(f"{v:.3g}" for v in facts["size_m"])
    return [
        ("format", facts["format"]),
        ("size", f"{size} m (length, width, height)"),
        (
            "unit",
            f"{facts['metres_a_unit']:.7g} m, {facts['unit_source'] or 'assumed: nothing says it'}",
        ),
        ("faces", faces if facts["faces"] else f"none, a cloud of {facts['points']:,} points"),
        ("up", f"{facts['up']['axis']}, {facts['up']['why']}"),
        ("forward", facts["forward"]),
    ]
