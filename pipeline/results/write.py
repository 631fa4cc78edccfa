"""The result files that every run writes into its folder."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from spinpipe.pipeline.config import RunConfig
from spinpipe.pipeline.keys import content_digest, content_hash
from spinpipe.pipeline.outputs import Outputs
from spinpipe.pipeline.results import formats
from spinpipe.pipeline.results.instances import ReadTopic
from spinpipe.pipeline.run_folder import RunFolder
from spinpipe.schemas import DETECTIONS, MODELS, SCENE
from spinpipe.schemas.records import Detection


def results_key(config: RunConfig, keys: Mapping[str, str]) -> str:
    """What results are made from and how: keys of all stages by name, the code that writes them."""
    code = [content_digest(folder) for folder in ("results", "drawing")]
    text = json.dumps([dict(keys), config.run.name, code])
    return content_hash(text.encode())


def write_results(
    config: RunConfig,
    read: ReadTopic,
    folder: RunFolder,
    report: dict[str, Any],
    outputs: Outputs,
    key: str,
) -> list[Detection]:
    """Write the result files of a complete run and return all its detections.

    Parameters
    ----------
    config, read, folder : of the run.
    report : content of report.json.
    outputs, key : of the folder, and of the results: files that are current are left as they are.
    """
    detections = list(read(DETECTIONS))
    models = {model.name: model for model in read(MODELS)}

    name = config.run.name
    every = formats.Export(name, detections, models, read)
    accepted = formats.Export(name, [d for d in detections if d.fate == "accepted"], models, read)
    write = outputs.write
    write(folder.detections_json, key, lambda path: formats.write_json(every, path))
    write(folder.detections_csv, key, lambda path: formats.write_csv(accepted, path))
    write(folder.detections_ply, key, lambda path: formats.write_meshes(accepted, path))
    if read(SCENE)[0].crs:
        write(folder.detections_geojson, key, lambda path: formats.write_geojson(accepted, path))
    if not all(outputs.current(p, key) for p in (folder.detections_png, folder.report_html)):
        _write_pictures(config, read, folder, report, every, outputs, key)
    return detections


def _write_pictures(
    config: RunConfig,
    read: ReadTopic,
    folder: RunFolder,
    report: dict[str, Any],
    every: formats.Export,
    outputs: Outputs,
    key: str,
) -> None:
    from spinpipe.pipeline.results.report import write_report
    from spinpipe.pipeline.results.scene_map import scene_view, write_scene_map

    view = scene_view(read, every.detections)
    outputs.write(
        folder.detections_png, key, lambda path: write_scene_map(view, every.detections, path)
    )
    outputs.write(
        folder.report_html,
        key,
        lambda path: write_report(read, config, every.detections, every.models, view, report, path),
    )
