"""A run's config: sections, overrides, errors that name file, key and the nearest valid key."""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, cast

import tomli_w
from pydantic import Field, ValidationError
from pydantic.fields import FieldInfo

from spinpipe.stages import STAGES
from spinpipe.stages.ingest.ingest import ModelConfig
from spinpipe.stages.stage import Section


class ConfigError(Exception):
    """A config that cannot be used; the message names file, section, key and the mend."""


class RunSection(Section):
    """The run as a whole."""

    name: str = Field("", description="folder below recordings/; the config's file name if empty")
    seed: int = Field(0, ge=0, lt=2**32, description="of every random number of the run")


class ExecutionSection(Section):
    """How the work is done; none of it changes a result."""

    engine: Literal["local", "dask"] = Field("local", description="where tiles are computed")
    scheduler: str = Field("", description="address of the Dask scheduler, tcp://host:port")
    threads: int = Field(0, ge=0, le=1024, description="0: all cores")
    memory_gb: float = Field(4.0, ge=0.25, le=4096, description="upper bound on memory")


class RecordSection(Section):
    """What goes into the Rerun recording."""

    preview_points: int = Field(
        1_000_000, ge=1, le=50_000_000, description="points of the cloud that are shown"
    )


SECTIONS: dict[str, type[Section]] = {
    "run": RunSection,
    **{stage.name: stage.Config for stage in STAGES},
    "execution": ExecutionSection,
    "record": RecordSection,
}


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
        document = {"run": _plain(self.run)}
        ingest = _plain(self.stages["ingest"])
        models = ingest.pop("models")
        document |= {"ingest": ingest, "model": models}
        document |= {n: _plain(s) for n, s in self.stages.items() if n != "ingest"}
        document |= {"execution": _plain(self.execution), "record": _plain(self.record)}
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
        raise ConfigError(f"{path}: not valid TOML: {error}") from None
    _require_sections(raw, path)
    for override in overrides:
        _override(raw, override)
    return _validate(raw, path)


def _require_sections(raw: dict[str, Any], path: Path) -> None:
    """The file holds known sections and a list of models; nothing is said of their keys."""
    for name, value in raw.items():
        if name not in _SECTION_NAMES:
            raise ConfigError(f"{path.name}: no section [{name}]. {_nearest(name, _SECTION_NAMES)}")
        if name != "model" and not isinstance(value, dict):
            raise ConfigError(f"{path.name}: [{name}] must be a section, not a value")
    if "models" in raw.get("ingest", {}):
        raise ConfigError(f"{path.name}: [ingest] has no key 'models'. Write [[model]] sections")
    models = raw.get("model")
    if models is None:
        raise ConfigError(f"{path.name}: no [[model]] section: say what to look for")
    if not isinstance(models, list) or not all(
        isinstance(m, dict) for m in cast(list[Any], models)
    ):
        raise ConfigError(
            f"{path.name}: write [[model]] with double brackets: there can be several"
        )


def _validate(raw: dict[str, Any], path: Path) -> RunConfig:
    raw = dict(raw)
    raw["ingest"] = {**raw.get("ingest", {}), "models": raw.pop("model")}
    context = {"base": path.resolve().parent}
    sections: dict[str, Section] = {}
    for name, section in SECTIONS.items():
        try:
            sections[name] = section.model_validate(raw.get(name, {}), context=context)
        except ValidationError as error:
            raise ConfigError(f"{path.name}: {_explain(error, name)}") from None
    run = cast(RunSection, sections["run"])
    return RunConfig(
        run=run if run.name else run.model_copy(update={"name": path.stem}),
        execution=cast(ExecutionSection, sections["execution"]),
        record=cast(RecordSection, sections["record"]),
        stages={stage.name: sections[stage.name] for stage in STAGES},
    )


_SECTION_NAMES = (*SECTIONS, "model")


def _override(raw: dict[str, Any], override: str) -> None:
    key, equals, text = override.partition("=")
    parts = key.strip().split(".")
    section: type[Section] | None
    target: Any
    if parts[0] == "model" and len(parts) == 3:
        section, field = ModelConfig, parts[2]
        target = _model(raw, parts[1])
    elif len(parts) == 2:
        section, field = SECTIONS.get(parts[0]), parts[1]
        target = raw.setdefault(parts[0], {})
    else:
        section, field, target = None, "", None
    if section is None or not equals:
        raise ConfigError(
            f"--set {override}: write section.key=value (or model.NAME.key=value); "
            f"sections are {', '.join(SECTIONS)}"
        )
    if field not in section.model_fields:
        place = key.strip().rpartition(".")[0]
        raise ConfigError(f"--set {override}: {_unknown_key(place, field, section)}")
    try:
        value = tomllib.loads(f"v = {text}")["v"]
    except tomllib.TOMLDecodeError:
        value = text  # a bare word: no quotes needed on the command line
    if _is_path(section.model_fields[field]) and isinstance(value, str):
        value = str(Path.cwd() / Path(value).expanduser())
    target[field] = value


def _model(raw: dict[str, Any], name: str) -> dict[str, Any]:
    models = raw.get("model", [])
    for i, model in enumerate(models):
        if name in (str(i), model.get("name")):
            return model
    names = [str(m.get("name")) for m in models]
    raise ConfigError(f"--set model.{name}: no such model. {_nearest(name, names)}")


def _is_path(field: FieldInfo) -> bool:
    return "Path" in str(field.annotation)


def _explain(error: ValidationError, section: str) -> str:
    """The first error in one line."""
    first = error.errors(include_url=False)[0]
    where = [str(part) for part in first["loc"]]
    model: type[Section] = SECTIONS[section]
    place = f"[{section}]"
    if section == "ingest" and where[:1] == ["models"]:
        model, place = ModelConfig, "[[model]]"
        if len(where) > 1:
            place += f" number {int(where[1]) + 1}"
        where = where[2:]
    key = where[0] if where else ""
    if first["type"] == "extra_forbidden":
        return _unknown_key(place, key, model)
    description = model.model_fields[key].description if key in model.model_fields else None
    help_text = f" ({description})" if description else ""
    if first["type"] == "missing":
        return f"{place} needs '{key}'{help_text}"
    message = first["msg"].removeprefix("Value error, ")
    message = message[0].lower() + message[1:]
    if not key:
        return f"{place}: {message}"
    return f"{place} {key} = {first['input']!r}: {message}{help_text}"


def _unknown_key(place: str, key: str, section: type[Section]) -> str:
    keys = [name for name in section.model_fields if name != "models"]
    return f"{place} has no key '{key}'. {_nearest(key, keys)}"


def _nearest(word: str, choices: Iterable[str]) -> str:
    choices = list(choices)
    close = difflib.get_close_matches(word, choices, n=1, cutoff=0.5)
    return f"Did you mean '{close[0]}'?" if close else f"There are: {', '.join(choices)}"


def _plain(section: Section) -> dict[str, Any]:
    return section.model_dump(mode="json", exclude_none=True)
