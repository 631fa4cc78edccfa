"""The result files that every run writes into its folder."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from spinpipe.pipeline.atomic import write_atomically
from spinpipe.pipeline.config import RunConfig
from spinpipe.pipeline.results import formats
from spinpipe.pipeline.results.geojson import scene_crs
from spinpipe.pipeline.results.instances import ReadTopic
from spinpipe.pipeline.run_folder import RunFolder
from spinpipe.schemas import DETECTIONS, MODELS, SCENE
from spinpipe.schemas.records import Detection


def write_results(
    config: RunConfig,
    read: ReadTopic,
    folder: RunFolder,
    report: dict[str, Any],
    *,
    keep: bool = False,
) -> list[Detection]:
    """Write the result files of a complete run and return all its detections.

    Parameters
    ----------
    config, read, folder : of the run.
    report : content of report.json.
    keep : leave files as they are that are there: nothing has changed since.
    """
    detections = list(read(DETECTIONS))
    models = {model.name: model for model in read(MODELS)}

    def write(path: Path, fill: Callable[[Path], object]) -> None:
        if not (keep and path.exists()):
            write_atomically(path, fill)

    name = config.run.name
    every = formats.Export(name, detections, models, read)
    accepted = formats.Export(name, [d for d in detections if d.fate == "accepted"], models, read)
    write(folder.detections_json, lambda path: formats.write_json(every, path))
    write(folder.detections_csv, lambda path: formats.write_csv(accepted, path))
    write(folder.detections_ply, lambda path: formats.write_meshes(accepted, path))
    if scene_crs(read(SCENE)[0]):
        write(folder.detections_geojson, lambda path: formats.write_geojson(accepted, path))
    if not (keep and folder.detections_png.exists() and folder.report_html.exists()):
        _write_pictures(config, read, folder, report, every)
    return detections


def _write_pictures(
    config: RunConfig,
    read: ReadTopic,
    folder: RunFolder,
    report: dict[str, Any],
    every: formats.Export,
) -> None:
    from spinpipe.pipeline.results.report import write_report
    from spinpipe.pipeline.results.scene_map import scene_view, write_scene_map

    view = scene_view(read, every.detections)
    write_atomically(
        folder.detections_png, lambda path: write_scene_map(view, every.detections, path)
    )
    write_atomically(
        folder.report_html,
        lambda path: write_report(read, config, every.detections, every.models, view, report, path),
    )
