"""What is looked for: a model, and what is known of its instances."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from spinpipe.stages.verify.model.field import ModelField

LOOSE = 0.1
"""Stretch from which a model is a family of shapes rather than one that is known."""


@dataclass(frozen=True, eq=False)
class KnownObject:
    """A model to look for, and what is known of its instances."""

    name: str
    field: ModelField
    stretch: float = 0.0
    visible_from: Literal["all", "above"] = "all"

    @property
    def rigid(self) -> bool:
        """Whether its shape is known, rather than that of a family."""
        return self.stretch < LOOSE / 2
