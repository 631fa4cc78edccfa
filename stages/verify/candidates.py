"""What every way of verification works on: candidates, models and the cloud around them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from spinpipe.schemas.arrays import F64
from spinpipe.schemas.records import Cluster, ObjectModel
from spinpipe.stages.geometry.world_cloud import WorldCloud


@dataclass(frozen=True)
class Candidates:
    """Candidates of a scene and what is needed to verify them."""

    clusters: Sequence[Cluster]
    models: Sequence[ObjectModel]
    cloud: WorldCloud
    T_scene_world: F64
    """(4, 4) similarity."""
