"""The key of a stage: what its output depends on, hashed before it runs.

key = hash(stage name, its code, its config section, content of its input files, seed, keys of the
stages it reads from). Names and places of files do not count, their content does; of code neither
layout nor comments nor docstrings.
"""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from types import CodeType
from typing import Any

from pydantic import BaseModel

from spinpipe import schemas, stages
from spinpipe.pipeline.input_files import Identity, hash_path, identity
from spinpipe.pipeline.mcap_file import FORMAT
from spinpipe.stages import STAGES
from spinpipe.stages.stage import Stage


def stage_parts(
    stage: Stage, section: BaseModel, seed: int, inputs: Mapping[str, str]
) -> dict[str, str]:
    """What the key is made of, by name: kept beside the key so that a run can say what changed.

    Parameters
    ----------
    stage : the stage.
    section : its config section.
    seed : the run's seed.
    inputs : keys of the stages that the stage reads from, by stage name.

    Raises
    ------
    StageError
        If an input file is missing or cannot be read.
    """
    parts = {"version": f"{stage.name} {stage.version}"} | _code(stage) | {"seed": str(seed)}
    parts["format of files"] = FORMAT
    for name, value in _flatten(section, f"[{stage.name}]"):
        parts[name] = hash_path(value, name) if isinstance(value, Path) else json.dumps(value)
    return parts | {f"stage {name}": key for name, key in inputs.items()}


def input_paths(stage: Stage, section: BaseModel) -> list[tuple[str, Path]]:
    """Files and folders that a stage reads, with the keys that name them."""
    values = _flatten(section, f"[{stage.name}]")
    return [(name, value) for name, value in values if isinstance(value, Path)]


def input_identities(stage: Stage, section: BaseModel) -> tuple[Identity, ...]:
    """What changes when a file changes that the stage reads."""
    return tuple(identity(path, name) for name, path in input_paths(stage, section))


def content_hash(content: bytes) -> str:
    """Key of something by its content: 32 hexadecimal digits."""
    return hashlib.sha256(content).hexdigest()[:32]


def stage_key(parts: Mapping[str, str]) -> str:
    """Key of a stage from its parts: 32 hexadecimal digits."""
    return content_hash(json.dumps(parts, sort_keys=True).encode())


def changed_parts(before: Mapping[str, str], now: Mapping[str, str]) -> list[str]:
    """Names of the parts that differ, in the order of ``now``."""
    return [name for name in {**now, **before} if before.get(name) != now.get(name)]


def producers(stage: Stage) -> list[str]:
    """Names of the stages that write what ``stage`` reads, in order."""
    return [s.name for s in STAGES if any(topic in s.outputs for topic in stage.inputs)]


@cache
def code_digest(*files: Path) -> str:
    """Digest of what Python files do: comments, layout and docstrings may change."""
    digest = hashlib.sha256()
    for file in sorted(files):
        # what is left at this level has neither docstrings nor assertions
        code = compile(file.read_bytes(), file.name, "exec", dont_inherit=True, optimize=2)
        for part in (file.name, *_effects(code)):
            digest.update(part.encode() + b"\0")
    return digest.hexdigest()


@cache
def content_digest(folder: str) -> str:
    """Digest of the code in a folder of pipeline/ as it is: for what is quickly made again."""
    digest = hashlib.sha256()
    for file in sorted((Path(__file__).parent / folder).rglob("*")):
        if file.suffix in (".py", ".html"):
            digest.update(file.name.encode() + b"\0" + file.read_bytes())
    return digest.hexdigest()


def _effects(code: CodeType) -> Iterator[str]:
    """What compiled code and the functions within it do, without the lines they stand on."""
    yield repr((code.co_name, code.co_flags, code.co_argcount, code.co_posonlyargcount))
    yield repr((code.co_kwonlyargcount, code.co_names, code.co_varnames, code.co_freevars))
    yield repr((code.co_code, code.co_exceptiontable))
    for constant in code.co_consts:
        match constant:
            case CodeType():
                yield from _effects(constant)
            case frozenset():  # its order is another in each process
                yield repr(sorted(map(repr, constant)))
            case _:
                yield repr(constant)


def _code(stage: Stage) -> dict[str, str]:
    """Digests of the code that a stage may call: its folder, what stages share, the messages."""
    own = Path(sys.modules[type(stage).__module__].__file__ or "").parent
    shared, messages = (Path(package.__path__[0]) for package in (stages, schemas))
    top = [file for file in shared.glob("*.py") if file.name != "__init__.py"]
    return {
        f"code of {own.name}": code_digest(*own.rglob("*.py")),
        "code of geometry": code_digest(*(shared / "geometry").rglob("*.py")),
        "code of stages": code_digest(*top),
        "code of schemas": code_digest(*messages.glob("*.py")),
    }


def _flatten(section: BaseModel, place: str) -> Iterator[tuple[str, Any]]:
    """Every key of a section, named as it stands in a config file: ``[scan] bin_m``."""
    for key in type(section).model_fields:
        value = getattr(section, key)
        if isinstance(value, BaseModel):
            yield from _flatten(value, f"{place[:-1]}.{key}]")
        elif isinstance(value, tuple) and any(isinstance(item, BaseModel) for item in value):
            yield f"[{place}] names", [item.name for item in value]
            for item in value:
                yield from _flatten(item, f"[{place}] '{item.name}'")
        else:
            yield f"{place} {key}", value
