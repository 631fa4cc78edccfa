"""What ``spinpipe init`` writes: a config with every key explained, filled in by looking."""

from __future__ import annotations

import os
import re
import textwrap
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w
from rich.console import Console
from scipy.spatial.transform import Rotation

from spinpipe.pipeline.atomic import scratch_folder
from spinpipe.pipeline.config import MODEL, SECTIONS, ConfigError, brackets, config_of, own_keys
from spinpipe.pipeline.inspect import Look, look
from spinpipe.pipeline.tables import default_text
from spinpipe.schemas import CAMERAS, SCENE, UPRIGHT
from spinpipe.stages.ingest.object_model import ModelConfig, read_model
from spinpipe.stages.stage import Section, StageError

HEADER = """\
# A run of spinpipe: spinpipe run {file}
# Paths are relative to this file. Keys that stand behind a # keep their default.
"""
OF_A_MESH: dict[str, str | float] = {"visible_from": "above", "stretch": 0.1}
"""What is assumed of a mesh: a drone sees things from above, and a drawn shape stands for its kind.
A cloud is taken for what instances look like."""
STEEP_DEG = 45.0
"""Cameras that look down by more than this see things from above."""


def filled_in(
    path: Path, scene: str, models: Sequence[str], shapes: Sequence[str], overrides: Sequence[str]
) -> tuple[dict[str, Any], list[str]]:
    """The document of a config for a scene, after a look at it and the models; what was found.

    Parameters
    ----------
    path : of the config; paths in it are relative to its folder.
    scene, models : as typed in the current folder.
    shapes : names of shapes that ship.
    overrides : ``section.key=value``, put into the document.

    Raises
    ------
    ConfigError, StageError
        What a run would refuse.
    """
    sections = [_of_file(model, path.parent) for model in models]
    sections += [{"name": shape, "shape": shape, **OF_A_MESH} for shape in shapes]
    for i, section in enumerate(sections):
        if section["name"] in {other["name"] for other in sections[:i]}:
            section["name"] += f"_{i + 1}"
    document: dict[str, Any] = {"ingest": {"scene": _beside(scene, path.parent)}, MODEL: sections}
    notes = _looked_at(document, path, overrides)
    return document, notes


def _looked_at(document: dict[str, Any], path: Path, overrides: Sequence[str]) -> list[str]:
    """Check a document as a run would, and state in it what the files tell."""
    config = config_of(document, path, overrides)
    with scratch_folder() as work:
        found = look(config, work, Console(stderr=True))
        if found.refused:
            raise StageError(f"{found.refused}; init takes it as --set SECTION.KEY=VALUE")
        frame = found.read(SCENE)[0]
        if frame.unit_source and set(frame.scale) != {1.0}:
            one = len(set(frame.scale)) == 1
            document["ingest"]["scale"] = frame.scale[0] if one else list(frame.scale)
        if not _seen_from_above(found):
            for section in document[MODEL]:
                if section.get("visible_from") == "above":
                    section["visible_from"] = "all"
        return [note for notes in found.notes.values() for note in notes]


def _seen_from_above(found: Look) -> bool:
    """Whether most of the cameras look steeply down; so does a drone, if there are none."""
    for cameras in found.read(CAMERAS):
        if len(cameras.positions):
            up = found.read(UPRIGHT)[0].T_world_local[2, :3]
            ahead = Rotation.from_quat(cameras.quaternions_xyzw).apply([0.0, 0.0, 1.0])
            return bool(np.median(ahead @ up) < -np.sin(np.radians(STEEP_DEG)))
    return True


def _of_file(model: str, folder: Path) -> dict[str, Any]:
    """A ``[[model]]`` for a file; the axis that it takes for up is stated where two compete."""
    section: dict[str, Any] = {"name": _name(model), "path": _beside(model, folder)}
    file = read_model(ModelConfig(name=section["name"], path=Path(model)))
    if file.faces is not None:
        section |= OF_A_MESH
    return section | ({"up": file.up} if file.doubt else {})


def _beside(path: str, folder: Path) -> str:
    """A path typed in the current folder, as it stands in a config in ``folder``."""
    given = Path(path).expanduser()
    return str(given) if given.is_absolute() else os.path.relpath(given, folder)


def preset_config(
    preset: str, path: Path, scene: str, overrides: Sequence[str]
) -> tuple[str, list[str]]:
    """The text of a config that ships, with a scene put in and looked at if one is given.

    Raises
    ------
    ConfigError
        If there is no such preset.
    StageError
        What a run would refuse.
    """
    folder = resources.files("spinpipe.recordings")
    names = sorted(f.name[:-5] for f in folder.iterdir() if f.name.endswith(".toml"))
    if preset not in names:
        raise ConfigError(f"init --preset {preset}: no such preset; there are {', '.join(names)}")
    text = (folder / f"{preset}.toml").read_text(encoding="utf-8")
    text = "[ingest]" + text.partition("[ingest]")[2]
    if not scene:
        return HEADER.format(file=path.name) + text, []
    line = tomli_w.dumps({"scene": _beside(scene, path.parent)}).strip()
    text = re.sub(r"^scene = .*$", lambda _: line, text, count=1, flags=re.MULTILINE)
    document = tomllib.loads(text)
    before = tomli_w.dumps(document)
    notes = _looked_at(document, path, overrides)
    if tomli_w.dumps(document) != before:
        text = tomli_w.dumps(document)
    return HEADER.format(file=path.name) + text, notes


def commented_config(file: str, document: Mapping[str, Any]) -> str:
    """A config with all keys explained, those of ``document`` set."""
    lines = [HEADER.format(file=file)]
    for name, section in SECTIONS.items():
        if name != MODEL:
            given: Any = document
            for part in name.split("."):
                given = given.get(part, {})
            lines += _section(brackets(name), section, given)
            continue
        first, *others = document[MODEL]
        lines += _section(brackets(name), section, first)
        for other in others:
            lines += [brackets(name), tomli_w.dumps(other)]
    return "\n".join(lines) + "\n"


def _section(title: str, section: type[Section], given: Mapping[str, Any]) -> Iterator[str]:
    yield f"# {(section.__doc__ or '').strip().partition(chr(10))[0]}"
    yield title
    for key, field in own_keys(section).items():
        yield from textwrap.wrap(
            field.description or "", 96, initial_indent="# ", subsequent_indent="# "
        )
        if key in given:
            yield tomli_w.dumps({key: given[key]}).strip()
        else:
            default = default_text(field)
            yield f"# {key} = {'...' if default in ('none', 'needed') else default}"
    yield ""


def _name(model: str) -> str:
    """A model's file name as its name."""
    stem = model.replace("\\", "/").rsplit("/", 1)[-1].partition(".")[0]
    return "".join(c if c.isalnum() or c in "_-." else "_" for c in stem) or "model"
