"""Opening the folder of a run that is complete."""

from __future__ import annotations

from pathlib import Path

from spinpipe.pipeline.config import ConfigError, RunConfig, load_config
from spinpipe.pipeline.outputs import Outputs
from spinpipe.pipeline.run_folder import RunFolder
from spinpipe.stages.stage import StageError


def open_run_folder(path: Path) -> tuple[RunFolder, RunConfig]:
    """The folder of a run, complete or not, and the run's config.

    Raises
    ------
    ConfigError
        If there is no run.
    """
    folder = RunFolder(path)
    if not folder.config.exists():
        raise ConfigError(f"{path}: no run here: {folder.config.name} is missing")
    Outputs(path).require_whole(folder.config)
    return folder, load_config(folder.config)


def open_complete(path: Path) -> tuple[RunFolder, RunConfig]:
    """The folder of a run whose last stage is there, and the run's config.

    Raises
    ------
    ConfigError, StageError
        If there is no run, or if it is not complete.
    """
    folder, config = open_run_folder(path)
    if not folder.mcap("verify").exists():
        raise StageError(f"{path}: the run is not complete; run its config to the end")
    return folder, config
