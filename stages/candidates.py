"""What every way of verification works on: candidates, models and the cloud around them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

from spinpipe.schemas.records import F64, Cluster, ObjectModel, Vector
from spinpipe.stages.neighbourhood import WorldCloud


@dataclass(frozen=True)
class Candidates:
    """Candidates of a scene and what is needed to verify them."""

    clusters: Sequence[Cluster]
    models: Sequence[ObjectModel]
    cloud: WorldCloud
    T_scene_world: F64
    """(4, 4) similarity."""


def vector(values: NDArray[Any]) -> Vector:
    """Three numbers of an array as a tuple."""
    x, y, z = (float(v) for v in values)
    return x, y, z
