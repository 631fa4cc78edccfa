"""The files of a run and their names."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from spinpipe.pipeline.outputs import LOCK
from spinpipe.stages import STAGES


@dataclass(frozen=True)
class RunFolder:
    """The folder of one run: one MCAP a stage, the recording, the results."""

    path: Path

    def mcap(self, stage: str) -> Path:
        """Complete output of a stage, for instance ``04_scan.mcap``."""
        number = next(i for i, s in enumerate(STAGES, 1) if s.name == stage)
        return self.path / f"{number:02d}_{stage}.mcap"

    def partial(self, stage: str) -> Path:
        """Output of a stage that is still being written."""
        return self.mcap(stage).with_suffix(".mcap.partial")

    def interrupted(self, stage: str) -> Path:
        """What an interrupted run left behind, while the next one takes it over."""
        return self.mcap(stage).with_suffix(".mcap.interrupted")

    def begun(self, stage: str) -> list[Path]:
        """Those of the two that are there."""
        return [path for path in (self.partial(stage), self.interrupted(stage)) if path.exists()]

    @property
    def lock(self) -> Path:
        """Held by the process that works in this folder."""
        return self.path / LOCK

    @property
    def recording(self) -> Path:
        """The Rerun recording."""
        return self.path / "run.rrd"

    @property
    def config(self) -> Path:
        """The config with every default filled in."""
        return self.path / "config.resolved.toml"

    @property
    def report(self) -> Path:
        """What ran, why, how long, with which versions."""
        return self.path / "report.json"

    @property
    def scale(self) -> Path:
        """What a search for the scale found, with its trials."""
        return self.path / "scale.json"

    @property
    def detections_json(self) -> Path:
        """Every candidate with its fate."""
        return self.path / "detections.json"

    @property
    def detections_csv(self) -> Path:
        """The accepted ones."""
        return self.path / "detections.csv"

    @property
    def detections_ply(self) -> Path:
        """The accepted models in scene coordinates."""
        return self.path / "detections.ply"

    @property
    def detections_geojson(self) -> Path:
        """Footprints of the accepted in longitude and latitude, if the scene knows where it is."""
        return self.path / "detections.geojson"

    @property
    def detections_png(self) -> Path:
        """The scene from above with the fates of all candidates."""
        return self.path / "detections.png"

    @property
    def report_html(self) -> Path:
        """Everything on one page."""
        return self.path / "report.html"

    @property
    def results(self) -> tuple[Path, ...]:
        """What is made from the last stage."""
        tables = (self.detections_json, self.detections_csv, self.detections_ply)
        return (*tables, self.detections_geojson, self.detections_png, self.report_html)

    @property
    def files(self) -> tuple[Path, ...]:
        """Everything that a run writes."""
        stages = tuple(self.mcap(stage.name) for stage in STAGES)
        return (*stages, *self.results, self.recording, self.config, self.report, self.scale)
