"""What a run's folder holds just now, whatever the config of the moment asks for."""

from __future__ import annotations

from collections.abc import Container, Iterable, Sequence
from dataclasses import replace

from pydantic import ValidationError

from spinpipe.pipeline.config import ConfigError, RunConfig
from spinpipe.pipeline.keys import content_hash, input_paths
from spinpipe.pipeline.mcap_file import DamagedFileError, read_metadata
from spinpipe.pipeline.outputs import MARK, Outputs
from spinpipe.pipeline.plan import Step
from spinpipe.pipeline.run_folder import RunFolder
from spinpipe.stages import STAGES


def keys_in(folder: RunFolder, steps: Sequence[Step] = ()) -> dict[str, str]:
    """Keys of the stages whose files are there, or will be after ``steps``."""
    planned = {step.stage.name: step.key for step in steps if step.action != "skip"}
    keys: dict[str, str] = {}
    for stage in STAGES:
        key = planned.get(stage.name) or _about(folder, stage.name).get("key")
        if key:
            keys[stage.name] = key
    return keys


def write_config(
    config: RunConfig,
    folder: RunFolder,
    steps: Iterable[Step],
    done: Container[str],
    outputs: Outputs,
) -> None:
    """Write the sections that the files in the folder were made with.

    That is another section than the run's where a stage was not reached, or left out.
    """
    sections = dict(config.stages)
    for step in steps:
        about = _about(folder, step.stage.name)
        if step.stage.name not in done and about.get("key", step.key) != step.key:
            try:
                made_with = type(step.config).model_validate_json(about.get("section", ""))
            except ValidationError:
                continue  # of a version with other keys: the file is not reused either
            sections[step.stage.name] = made_with
    text = replace(config, stages=sections).to_toml()
    key = content_hash(text.encode())
    outputs.write(folder.config, key, lambda file: file.write_text(text, encoding="utf-8"))


def require_inputs_apart(config: RunConfig, folder: RunFolder) -> None:
    """Refuse a run whose files would replace what it reads.

    Raises
    ------
    ConfigError
        If an input is one of the run's files, or the run's folder itself.
    """
    files = (*folder.files, folder.path / MARK, folder.path)
    ours = {file.resolve() for file in files}
    for stage in STAGES:
        for key, path in input_paths(stage, config.stages[stage.name]):
            if path.resolve() in ours:
                raise ConfigError(
                    f"{key}: {path} is where the run would write; "
                    "choose another folder with --output"
                )


def _about(folder: RunFolder, stage: str) -> dict[str, str]:
    try:
        return read_metadata(folder.mcap(stage), "stage")
    except (DamagedFileError, FileNotFoundError):
        return {}
