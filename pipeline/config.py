"""A run's config: sections, overrides, errors that name file, key and the nearest valid key."""

from __future__ import annotations

import difflib
import re
import tomllib
from collections.abc import Iterable, Mapping
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, cast

import tomli_w
from pydantic import Field, ValidationError, field_validator
from pydantic.fields import FieldInfo

from spinpipe.stages import STAGES
from spinpipe.stages.ingest.object_model import ModelConfig
from spinpipe.stages.stage import Section


class ConfigError(Exception):
    """A config that cannot be used; the message names file, section, key and the mend."""


class RunSection(Section):
    """The run as a whole."""

    name: str = Field("", description="folder below recordings/; the config's file name if empty")
    seed: int = Field(0, ge=0, lt=2**32, description="of every random number of the run")

    @field_validator("name")
    @classmethod
    def _one_folder(cls, name: str) -> str:
        if re.search(r"[/\\\x00-\x1f]", name) or name in (".", "..") or len(name) > 100:
            raise ValueError("must be the name of one folder: no '/', no '..', at most 100 letters")
        return name


class ExecutionSection(Section):
    """How the work is done; none of it changes a result."""

    engine: Literal["local", "dask"] = Field("local", description="where tiles are computed")
    scheduler: str = Field("", description="address of the Dask scheduler, tcp://host:port")
    threads: int = Field(0, ge=0, le=1024, description="0: all cores")
    memory_gb: float = Field(
        4.0, ge=0.25, le=4096, description="the run's process stays below it, or is refused"
    )


class RecordSection(Section):
    """What goes into the Rerun recording."""

    preview_points: int = Field(
        1_000_000, ge=1, le=50_000_000, description="points of the cloud that are shown"
    )


def own_keys(section: type[Section]) -> dict[str, FieldInfo]:
    """The keys of a section without the sections below it."""
    fields = section.model_fields.items()
    return {key: field for key, field in fields if not _section_of(field)}


def _section_of(field: FieldInfo) -> type[Section] | None:
    kind = field.annotation
    return kind if isinstance(kind, type) and issubclass(kind, Section) else None


def _sections(name: str, section: type[Section]) -> dict[str, type[Section]]:
    """A section and those below it, by the name in its brackets."""
    found = {name: section}
    for key, field in section.model_fields.items():
        if below := _section_of(field):
            found |= _sections(f"{name}.{key}", below)
    return found


_WHOLE: dict[str, type[Section]] = {
    "run": RunSection,
    **{stage.name: stage.Config for stage in STAGES},
    "execution": ExecutionSection,
    "record": RecordSection,
}
MODEL = "model"
"""The one section of which there may be several: ``[[model]]``."""
SECTIONS = {n: s for name, whole in _WHOLE.items() for n, s in _sections(name, whole).items()} | {
    MODEL: ModelConfig
}
"""What a config file may hold, by the name that stands in brackets."""


def brackets(name: str) -> str:
    """How a section is headed in a config file."""
    return f"[[{name}]]" if name == MODEL else f"[{name}]"


@dataclass(frozen=True)
class RunConfig:
    """All sections of a run, every default filled in."""

    run: RunSection
    execution: ExecutionSection
    record: RecordSection
    stages: Mapping[str, Section]
    """By stage name."""

    def to_toml(self) -> str:
        """The config as a file that gives the same run from any folder."""
        sections = {"run": self.run, **self.stages}
        sections |= {"execution": self.execution, "record": self.record}
        document = {name: _plain(section) for name, section in sections.items()}
        document[MODEL] = document[MODEL]["models"]
        return tomli_w.dumps(document)


def load_config(path: Path, overrides: Iterable[str] = ()) -> RunConfig:
    """Read a config file and apply ``section.key=value`` overrides.

    Paths in the file are relative to the file, paths in overrides to the current folder.

    Raises
    ------
    ConfigError
        In one line: file, section, key, what is wrong and what would be right.
    """
    try:
        raw = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such file; 'spinpipe init' writes one") from None
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        hint = _toml_hint(path, error)
        raise ConfigError(f"{path}: not valid TOML: {error}{hint}") from None
    return config_of(raw, path, overrides)


def config_of(raw: dict[str, Any], path: Path, overrides: Iterable[str] = ()) -> RunConfig:
    """The config that a document is, as if it stood in a file; overrides are put into it.

    Raises
    ------
    ConfigError
        As ``load_config``.
    """
    _require_sections(deepcopy(raw), path)
    for override in overrides:
        _override(raw, override)
    return _validate(raw, path)


def scene_config(scene: Path) -> RunConfig:
    """The sections that a scene needs by itself: nothing is looked for in it."""
    given: dict[str, dict[str, Any]] = {"ingest": {"scene": scene}}
    wanted = {name: section for name, section in _WHOLE.items() if name != MODEL}
    try:
        sections = {name: s.model_validate(given.get(name, {})) for name, s in wanted.items()}
    except ValidationError as error:
        raise ConfigError(f"{scene}: {_message(error.errors()[0]['msg'])}") from None
    return RunConfig(
        run=cast(RunSection, sections["run"]),
        execution=cast(ExecutionSection, sections["execution"]),
        record=cast(RecordSection, sections["record"]),
        stages={stage.name: sections[stage.name] for stage in STAGES if stage.name in sections},
    )


_MISTAKES = (
    (r'"[^"]*\\[^"]*"', "write paths with / or in single quotes: scene = 'C:\\data\\scene.ply'"),
    (r"=\s*\d+,\d", "decimals have a point: scale = 0.3048"),
    (r"=\s*[\u2018-\u201f]", "its quotes are typographic: write scene = 'scene.ply'"),
    (r"=\s*[A-Za-z/~.]", "text stands in quotes: scene = 'scene.ply'"),
)
"""What lines that are not TOML look like, and what was meant."""


def _toml_hint(path: Path, error: Exception) -> str:
    """What is wrong with the line that TOML stumbles over, where that shows."""
    line = re.search(r"\(at line (\d+)", str(error))
    text = path.read_text(encoding="utf-8-sig", errors="replace").splitlines()
    if not line or not text:
        return ""
    row = text[min(int(line[1]), len(text)) - 1]
    if "overwrite" in str(error) or "twice" in str(error):
        return f"; '{row.strip()}' is there twice"
    return next((f"; {hint}" for pattern, hint in _MISTAKES if re.search(pattern, row)), "")


def _require_sections(raw: dict[str, Any], path: Path) -> None:
    """The file holds known sections and a list of models; nothing is said of their keys."""
    for name in raw:
        if name not in SECTIONS:
            raise ConfigError(f"{path.name}: no section [{name}]. {_nearest(name, SECTIONS)}")
    for name in SECTIONS:
        if name != MODEL and not isinstance(_at(raw, name), dict):
            raise ConfigError(f"{path.name}: [{name}] must be a section, not a value")
    models = raw.get(MODEL)
    if models is None:
        raise ConfigError(f"{path.name}: no [[model]] section: say what to look for")
    if not isinstance(models, list) or not all(
        isinstance(m, dict) for m in cast(list[Any], models)
    ):
        raise ConfigError(
            f"{path.name}: write [[model]] with double brackets: there can be several"
        )


def _validate(raw: dict[str, Any], path: Path) -> RunConfig:
    raw = raw | {MODEL: {"models": raw[MODEL]}}
    context = {"base": path.resolve().parent}
    sections: dict[str, Section] = {}
    for name, section in _WHOLE.items():
        try:
            sections[name] = section.model_validate(raw.get(name, {}), context=context)
        except ValidationError as error:
            raise ConfigError(f"{path.name}: {_explain(error, name, raw)}") from None
    run = cast(RunSection, sections["run"])
    return RunConfig(
        run=run if run.name else run.model_copy(update={"name": path.stem}),
        execution=cast(ExecutionSection, sections["execution"]),
        record=cast(RecordSection, sections["record"]),
        stages={stage.name: sections[stage.name] for stage in STAGES},
    )


def _at(raw: dict[str, Any], name: str) -> Any:
    """What the file holds of a section; an empty one is put in where it holds none."""
    for part in name.split("."):
        raw = raw.setdefault(part, {})
    return raw


def _override(raw: dict[str, Any], override: str) -> None:
    key, equals, text = override.partition("=")
    place, _, field = key.strip().rpartition(".")
    of_model, _, model = place.partition(".")
    name = MODEL if of_model == MODEL and model else place
    if name not in SECTIONS or place == MODEL or not equals:
        raise ConfigError(
            f"--set {override}: write section.key=value (or model.NAME.key=value); "
            f"sections are {', '.join(SECTIONS)}"
        )
    section = SECTIONS[name]
    target = _model(raw, model) if name == MODEL else _at(raw, name)
    if field not in own_keys(section):
        raise ConfigError(f"--set {override}: {_unknown_key(place, field, name)}")
    try:
        value = tomllib.loads(f"v = {text}")["v"]
    except tomllib.TOMLDecodeError:
        value = text  # a bare word: no quotes needed on the command line
    if _is_path(section.model_fields[field]) and isinstance(value, str):
        value = str(Path.cwd() / Path(value).expanduser())
    target[field] = value


def _model(raw: dict[str, Any], name: str) -> dict[str, Any]:
    models = raw[MODEL]
    for i, model in enumerate(models):
        if name in (str(i), model.get("name")):
            return model
    names = [str(m.get("name")) for m in models]
    raise ConfigError(f"--set model.{name}: no such model. {_nearest(name, names)}")


def _is_path(field: FieldInfo) -> bool:
    return "Path" in str(field.annotation)


def _explain(error: ValidationError, section: str, raw: dict[str, Any]) -> str:
    """The first error in one line."""
    first = error.errors(include_url=False)[0]
    where = [str(part) for part in first["loc"]]
    place = brackets(section)
    if section == MODEL:
        if len(where) > 1:
            number = int(where[1])
            name = raw[MODEL]["models"][number].get("name")
            place += f" '{name}'" if name else f" number {number + 1}"
        where = where[2:]
    while where and f"{section}.{where[0]}" in SECTIONS:
        section = f"{section}.{where.pop(0)}"
        place = brackets(section)
    key = where[0] if where else ""
    if first["type"] == "extra_forbidden":
        return _unknown_key(place, key, section)
    fields = SECTIONS[section].model_fields
    description = fields[key].description if key in fields else None
    help_text = f" ({description})" if description else ""
    if first["type"] == "missing":
        return f"{place} needs '{key}'{help_text}"
    message = _message(first["msg"])
    if not key:
        return f"{place}: {message}"
    return f"{place} {key} = {first['input']!r}: {message}{help_text}"


def _message(text: str) -> str:
    text = text.removeprefix("Value error, ")
    return text[0].lower() + text[1:]


def _unknown_key(place: str, key: str, section: str) -> str:
    for name, below in SECTIONS.items():  # where a key of the past may have moved to
        if name.startswith(f"{section}.") and key in own_keys(below):
            return f"{place} has no key '{key}' any more: it stands in [{name}]"
    return f"{place} has no key '{key}'. {_nearest(key, own_keys(SECTIONS[section]))}"


def _nearest(word: str, choices: Iterable[str]) -> str:
    choices = list(choices)
    close = difflib.get_close_matches(word, choices, n=1, cutoff=0.5)
    return f"Did you mean '{close[0]}'?" if close else f"There are: {', '.join(choices)}"


def _plain(section: Section) -> dict[str, Any]:
    return section.model_dump(mode="json", exclude_none=True)
