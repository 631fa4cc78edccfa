"""``ingest.scale = "search"``: the metres a unit at which the scene shows the objects.

The objects are the yardstick. The scene, thinned and upright, is searched at factors a constant
ratio apart by models that may stretch, so that the true factor cannot fall between two. How much
the instances stretch corrects the best factor, again and again until it stays.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich.console import Console

from spinpipe.pipeline.atomic import scratch_folder
from spinpipe.pipeline.config import RunConfig
from spinpipe.pipeline.context import RunReader
from spinpipe.pipeline.engine import Engine, open_engine
from spinpipe.pipeline.inspect import LOOKING, is_searched, look
from spinpipe.pipeline.keys import code_digest, stage_key
from spinpipe.pipeline.outputs import Outputs
from spinpipe.pipeline.plan import make_plan
from spinpipe.pipeline.progress import stage_progress
from spinpipe.pipeline.run_folder import RunFolder
from spinpipe.pipeline.runner import Runner
from spinpipe.pipeline.scale_peak import ScaleFound, Trial, apart, peak, trial_of
from spinpipe.pipeline.scenes.write_ply import cloud_rows, write_ply
from spinpipe.schemas import CLOUD, DETECTIONS, MODELS, SAMPLING, TILES, UPRIGHT
from spinpipe.stages import STAGES
from spinpipe.stages.geometry.frames import to_world
from spinpipe.stages.ingest.ingest import Ingest
from spinpipe.stages.ingest.model import Model
from spinpipe.stages.ingest.object_model import object_model, read_model
from spinpipe.stages.stage import Section, StageError

LOWEST, HIGHEST = 0.2, 5.0
"""Metres a unit: COLMAP without GPS ends up anywhere near 1."""
RATIO = 1.2
"""From one factor to the next."""
STRETCH = 0.15
"""Of models while searching: more than half of the ratio."""
POINTS = 300_000
"""Most points that are searched: a scene of more is thinned."""
POINTS_ALONG = 10
"""Fewer along the model show no shape: any few points that stand fit it."""
ROUNDS = 5
"""Of correction: a fit follows all but a fifth of what it should stretch by."""
SETTLED = 0.003
_CODE = tuple(Path(__file__).with_name(name) for name in ("scale_search.py", "scale_peak.py"))
_QUIET = Console(quiet=True, force_terminal=False)


def remembered(config: RunConfig, folder: RunFolder, outputs: Outputs) -> ScaleFound | None:
    """What an earlier search of the same found, if it is there."""
    if not outputs.current(folder.scale, _key(config)):
        return None
    document = json.loads(folder.scale.read_text(encoding="utf-8"))
    return ScaleFound(document["scale"], document["note"])


def with_scale(config: RunConfig, found: ScaleFound) -> RunConfig:
    """The config with the scale stated that was found."""
    section = config.stages["ingest"].model_copy(update={"scale": found.scale})
    return replace(config, stages={**config.stages, "ingest": section})


def resolve_scale(
    config: RunConfig, folder: RunFolder, outputs: Outputs, console: Console, threads: int
) -> tuple[RunConfig, list[str]]:
    """The config with a searched scale in place, and what to note; others stay as they are.

    What was found is kept in the run's folder: the same scene, objects and code are searched once.

    Raises
    ------
    StageError
        If no factor stands out.
    """
    if not is_searched(config):
        return config, []
    found = remembered(config, folder, outputs)
    if found is None:
        key = _key(config)
        found, trials = _search(config, folder, console, threads)
        document = {**asdict(found), "trials": [asdict(t) for t in trials if t.instances]}
        text = json.dumps(document, indent=1) + "\n"
        outputs.write(folder.scale, key, lambda file: file.write_text(text, encoding="utf-8"))
    console.print(found.note, highlight=False, markup=False, soft_wrap=True)
    return with_scale(config, found), [found.note]


def _searchable(
    config: RunConfig,
    rows: Sequence[int] | None = None,
    ingest: Section | None = None,
    **ground: object,
) -> RunConfig:
    """The config that is searched with, for models in ``rows``: what the user tunes waits."""
    models = _models(config)
    chosen = [m for i, m in enumerate(models.models) if rows is None or i in rows]
    stretched = [m.model_copy(update={"stretch": max(m.stretch, STRETCH)}) for m in chosen]
    sections = {stage.name: stage.Config() for stage in STAGES if stage.name not in LOOKING}
    sections |= {
        "ingest": ingest or config.stages["ingest"],
        "model": models.model_copy(update={"models": tuple(stretched)}),
        "ground": config.stages["ground"].model_copy(update=ground),
    }
    return replace(config, stages=sections)


def _models(config: RunConfig) -> Model.Config:
    section = config.stages["model"]
    assert isinstance(section, Model.Config)
    return section


def _key(config: RunConfig) -> str:
    """Of what a search depends on: all that its last stage would, and how it goes about it."""
    last = make_plan(_searchable(config), RunFolder(Path()))[-1]
    return stage_key({"stages": last.key, "code of scale search": code_digest(*_CODE)})


def _search(
    config: RunConfig, folder: RunFolder, console: Console, threads: int
) -> tuple[ScaleFound, list[Trial]]:
    """Try all factors, follow the best; all trials in the order they were made."""
    console.print(
        f"[bold]run  [/] scale    searched first, from {LOWEST:g} to {HIGHEST:g} m a unit",
        highlight=False,
    )
    with (
        scratch_folder(folder.path) as place,
        stage_progress(console, "scale") as progress,
        open_engine(config.execution.model_copy(update={"engine": "local"}), threads) as engine,
    ):
        thinned = _thinned(config, place)
        steps = round(math.log(HIGHEST / LOWEST) / math.log(RATIO))
        factors = np.geomspace(LOWEST, HIGHEST, steps + 1).tolist()
        factors = [factor for factor in factors if thinned.models(factor)]
        if not factors:
            raise StageError(
                f"scale search: at no factor from {LOWEST:g} to {HIGHEST:g} is a model smaller "
                f"than the scene and {POINTS_ALONG} times as long as its points are apart"
            )
        counter = progress.start("factors", len(factors) + ROUNDS)
        trials: list[Trial] = []
        for factor in factors:
            trials.append(_tried(config, thinned, factor, engine))
            counter.advance()
        best = max(trials, key=lambda trial: trial.evidence)
        for _ in range(ROUNDS):
            settled = not best.instances or apart(best.estimate, best.factor) < SETTLED
            if settled or not thinned.models(best.estimate):
                break
            best = _tried(config, thinned, best.estimate, engine)
            trials.append(best)
            counter.advance()
    return peak(trials, best), trials


class _Thinned(NamedTuple):
    """The scene that is searched, in its unit, and the objects."""

    path: Path
    extent: float
    spacing: float
    lengths_m: list[float]
    """Longest side of each model."""

    def models(self, factor: float) -> list[int]:
        """Rows of the models that fit into the scene and are sampled well enough to be told."""
        sizes = enumerate(self.lengths_m)
        few = POINTS_ALONG * self.spacing * factor
        return [i for i, length in sizes if few <= length <= self.extent * factor]


def _thinned(config: RunConfig, place: Path) -> _Thinned:
    """Write the scene upright, as the stages ingest and ground understand it."""
    rng = np.random.default_rng(config.run.seed)
    models = [object_model(m, read_model(m), rng) for m in _models(config).models]
    (place / "look").mkdir()
    found = look(config, place / "look", _QUIET)
    if found.refused:
        raise found.refused
    upright = found.read(UPRIGHT)[0]
    share = POINTS / int(found.read(TILES)[0].counts.sum())
    kept = [tile.xyz[rng.random(len(tile.xyz)) < share] for tile in found.read(CLOUD)]
    xyz = to_world(upright, np.concatenate(kept))
    write_ply(place / "scene.ply", cloud_rows(xyz))
    spacing = found.read(SAMPLING)[0].spacing_m / math.sqrt(min(share, 1.0))
    lengths_m = [float(model.size[:2].max()) for model in models]
    return _Thinned(place / "scene.ply", float(np.ptp(xyz, axis=0).max()), spacing, lengths_m)


def _tried(config: RunConfig, thinned: _Thinned, factor: float, engine: Engine) -> Trial:
    """Look for the objects at one scale."""
    section = Ingest.Config(scene=thinned.path, scale=factor)
    here = _searchable(config, thinned.models(factor), section, up=(0.0, 0.0, 1.0))
    folder = RunFolder(thinned.path.with_name("run"))
    folder.path.mkdir(exist_ok=True)
    Runner(here, folder, engine, _QUIET, tell=False).run(make_plan(here, folder))
    read = RunReader(folder)
    sizes = {model.name: model.size for model in read(MODELS)}
    accepted = [d for d in read(DETECTIONS) if d.fate == "accepted"]
    fitted = np.array([d.size_m for d in accepted]).reshape(-1, 3)
    stated = np.array([sizes[d.model] for d in accepted], np.float64).reshape(-1, 3)
    return trial_of(factor, fitted / stated, stated, np.array([d.log_odds for d in accepted]))
