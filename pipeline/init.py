"""The commented config that ``spinpipe init`` writes: every key with its default and meaning."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator

import tomli_w
from pydantic.fields import FieldInfo

from spinpipe.pipeline.config import SECTIONS
from spinpipe.pipeline.tables import default_text
from spinpipe.stages.ingest.ingest import ModelConfig

HEADER = """\
# A run of spinpipe: spinpipe run {file}
# Paths are relative to this file. Keys that stand behind a # keep their default.
"""


def commented_config(file: str, scene: str, model: str) -> str:
    """A config for one scene and one model with all keys explained."""
    lines = [HEADER.format(file=file)]
    for name, section in SECTIONS.items():
        lines += _section(f"[{name}]", section.__doc__, section.model_fields, {"scene": scene})
        if name == "ingest":
            given = {"name": _name(model), "path": model}
            lines += _section("[[model]]", ModelConfig.__doc__, ModelConfig.model_fields, given)
    return "\n".join(lines) + "\n"


def _section(
    title: str, doc: str | None, fields: dict[str, FieldInfo], given: dict[str, str]
) -> Iterator[str]:
    yield f"# {(doc or '').strip().partition(chr(10))[0]}"
    yield title
    for key, field in fields.items():
        if key == "models":
            continue
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
