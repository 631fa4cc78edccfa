"""The commented config that ``spinpipe init`` writes: every key with its default and meaning."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping

import tomli_w

from spinpipe.pipeline.config import MODEL, SECTIONS, brackets, own_keys
from spinpipe.pipeline.tables import default_text
from spinpipe.stages.stage import Section

HEADER = """\
# A run of spinpipe: spinpipe run {file}
# Paths are relative to this file. Keys that stand behind a # keep their default.
"""


OF_A_MESH: dict[str, str | float] = {"visible_from": "above", "stretch": 0.1}
"""What is assumed of a mesh: a drone sees things from above, and a drawn shape stands for its kind.
A cloud is taken for what instances look like."""


def commented_config(file: str, scene: str, model: str, *, is_mesh: bool) -> str:
    """A config for one scene and one model with all keys explained."""
    lines = [HEADER.format(file=file)]
    for name, section in SECTIONS.items():
        given: dict[str, str | float] = {"scene": scene}
        if name == MODEL:
            given = {"name": _name(model), "path": model} | (OF_A_MESH if is_mesh else {})
        lines += _section(brackets(name), section, given)
    return "\n".join(lines) + "\n"


def _section(title: str, section: type[Section], given: Mapping[str, str | float]) -> Iterator[str]:
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
