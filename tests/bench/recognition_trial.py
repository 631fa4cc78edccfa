"""Recognition benchmark: a run on an artificial scene."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from recognition_judge import Trial, judge
from recognition_objects import Sought
from recognition_scenes import Condition, Scene, make_scene

from spinpipe.pipeline.config import load_config
from spinpipe.pipeline.evaluation.truth import TruthObject
from spinpipe.schemas.records import Detection

CONFIG = """\
[ingest]
scene = '{scene}'
[[model]]
name = '{name}'
path = '{model}'
{extra}
"""


def artificial_trial(
    sought: Sought, condition: Condition, seed: int, threads: int, extra: str, keep: Path | None
) -> Trial:
    """Make a scene, run the pipeline with its defaults and judge it."""
    size = np.ptp(sought.mesh().vertices, axis=0)
    trial = Trial(
        "artificial",
        sought.name,
        condition.name,
        condition.view,
        condition.spacings_across,
        condition.noise,
        float(np.cbrt(size.prod())),
    )
    with tempfile.TemporaryDirectory() as temporary:
        folder = keep / f"{sought.name}_{condition.name}_{seed}" if keep else Path(temporary)
        scene = make_scene(sought, condition, seed, folder)
        trial.points = scene.points
        config = folder / "config.toml"
        text = CONFIG.format(scene=scene.cloud, name=sought.name, model=scene.model, extra=extra)
        config.write_text(text)

        def name_of(truth: TruthObject) -> str:
            return _nearest(scene, truth.given, instances=True)

        def stands_on(detection: Detection) -> str:
            x, y, _ = detection.position_scene
            return _nearest(scene, (x, y), instances=False)

        radius_m = float(min(size[:2])) / 2
        run = load_config(config, [f"execution.threads={threads}"])
        judge(trial, run, folder, scene.truth, radius_m, sought.symmetry, name_of, stands_on)
    return trial


def _nearest(scene: Scene, place: tuple[float, float], instances: bool) -> str:
    """Kind of the nearest instance, or name of the nearest thing and how far away it is."""
    things = [t for t in scene.things if t.sought or not instances]
    far = [float(np.hypot(t.position[0] - place[0], t.position[1] - place[1])) for t in things]
    nearest = int(np.argmin(far))
    thing = things[nearest]
    return thing.kind if instances else f"{thing.kind} {thing.name}, {far[nearest]:.2f} m"
