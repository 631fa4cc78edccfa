"""Model: the objects to look for, upright, in metres, sampled where they can be seen."""

from __future__ import annotations

import numpy as np
from pydantic import Field, field_validator

from spinpipe.schemas import MODELS, SCENE, TILES
from spinpipe.schemas.records import ObjectModel, SceneFrame, TileIndex
from spinpipe.stages.ingest.object_model import ModelConfig, load_model
from spinpipe.stages.stage import Context, Section, StageError


class Model:
    """Read the objects to look for: a stage of its own, so that another one costs no import."""

    name = "model"
    version = 1
    inputs = (TILES, SCENE)
    outputs = (MODELS,)

    class Config(Section):
        """The ``[[model]]`` sections."""

        models: tuple[ModelConfig, ...] = Field(min_length=1, description="objects to look for")

        @field_validator("models")
        @classmethod
        def _unique(cls, models: tuple[ModelConfig, ...]) -> tuple[ModelConfig, ...]:
            names = [model.name for model in models]
            twice = next((name for name in names if names.count(name) > 1), None)
            if twice is not None:
                raise ValueError(f"two models have the name '{twice}'; rename one")
            return models

    def run(self, ctx: Context[Config]) -> None:
        """Write every model that has room in the scene."""
        tiles, scene = ctx.read_one(TILES), ctx.read_one(SCENE)
        for config in ctx.config.models:
            model = load_model(config, ctx.rng, ctx.log)
            _require_room(model, tiles, scene)
            ctx.write(MODELS, model)


def _require_room(model: ObjectModel, tiles: TileIndex, scene: SceneFrame) -> None:
    """Refuse a model that is wider than the whole scene: one of the scales must be wrong."""
    scene_m = float((tiles.high.max(axis=0) - tiles.low.min(axis=0)).max())
    surface = model.vertices if len(model.vertices) else model.points
    model_m = float(np.ptp(surface[:, :2], axis=0).max())
    if model_m > scene_m:
        raise StageError(
            f"model '{model.name}' is {model_m:.3g} m wide, the whole scene {scene_m:.3g} m; "
            f"correct [ingest] scale (now {scene.scale[0]:g}) or the scale of that [[model]]"
        )
