"""Model: the objects to look for, upright, in metres, sampled where they can be seen."""

from __future__ import annotations

from pydantic import Field, field_validator

from spinpipe.schemas import MODELS, SCENE, TILES
from spinpipe.stages.ingest.object_model import ModelConfig, load_model
from spinpipe.stages.ingest.sanity import model_line, oddities, require_possible
from spinpipe.stages.stage import Context, Section


class Model:
    """Read the objects to look for: a stage of its own, so that another one costs no import."""

    name = "model"
    version = 2
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
        """Write every model that the scene can show."""
        tiles, scene = ctx.read_one(TILES), ctx.read_one(SCENE)
        scene_m = float((tiles.high.max(axis=0) - tiles.low.min(axis=0)).max())
        for config in ctx.config.models:
            model = load_model(config, ctx.rng, ctx.log)
            ctx.log(model_line(model))
            require_possible(scene, scene_m, model)
            for note in oddities(scene, model):
                ctx.log(f"odd: {note}")
            ctx.write(MODELS, model)
