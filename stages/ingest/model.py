"""Model: the objects to look for, upright, in metres, sampled where they can be seen."""

from __future__ import annotations

from pydantic import Field, field_validator

from spinpipe.schemas import MODELS, SCENE, TILES
from spinpipe.stages.ingest.object_model import ModelConfig, object_model, read_model
from spinpipe.stages.ingest.sanity import (
    model_line,
    odd_sampling,
    odd_shape,
    require_possible,
)
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
        progress = ctx.progress("models", len(ctx.config.models))
        for config in ctx.config.models:
            file = read_model(config)
            model = object_model(config, file, ctx.rng)
            ctx.log(model_line(model, file))
            require_possible(scene, scene_m, model)
            for note in (file.doubt, odd_sampling(scene, model), odd_shape(model)):
                if note:
                    ctx.log(f"odd: {note}")
            ctx.write(MODELS, model)
            progress.advance()
