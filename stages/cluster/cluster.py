"""Stage 5: hits that stand for the same instance become one candidate."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Literal

import numpy as np
from pydantic import Field
from scipy.sparse.csgraph import connected_components

from spinpipe.schemas import CLUSTERS, HITS, MODELS
from spinpipe.schemas.arrays import F32, I64
from spinpipe.schemas.records import Cluster, Hits, ObjectModel, Vector
from spinpipe.stages.cluster.delaunay import delaunay_components
from spinpipe.stages.cluster.suppression import suppress
from spinpipe.stages.geometry.frames import vector
from spinpipe.stages.stage import Context, Section

PEAK_HALF_WIDTHS = 0.9


class Clustering:
    """Groups the hits of each model into candidates."""

    name = "cluster"
    version = 1
    inputs = (HITS, MODELS)
    outputs = (CLUSTERS,)

    class Config(Section):
        """How near hits of one instance are to each other."""

        method: Literal["suppression", "delaunay"] = Field(
            "suppression",
            description="suppression: the best hit within max_edge_m, among models that may be "
            "fitted to the same size, for things that stand close together; delaunay: components "
            "of the tessellation of each model's hits, as in the paper",
        )
        max_edge_m: float | None = Field(
            None,
            gt=0,
            le=1000,
            description="reach of the best hit, or longest edge; none: 0.9 times half the narrow "
            "side of the smallest of them (suppression) or half the model's diagonal (delaunay)",
        )
        min_hits: int | None = Field(
            None,
            ge=1,
            le=1_000_000,
            description="fewer hits are no candidate; none: 1 (suppression) or 3 (delaunay)",
        )

    def run(self, ctx: Context[Config]) -> None:
        """Write the candidates of all models, numbered from 0."""
        config = ctx.config
        models = list(ctx.read(MODELS))
        groups = _peaks if config.method == "suppression" else _components
        least = config.min_hits or (1 if config.method == "suppression" else 3)
        count = small = 0
        for model, position, correlation in groups(ctx.read(HITS), models, config.max_edge_m):
            if len(correlation) < least:
                small += 1
                continue
            best = float(correlation.max())
            hits = len(correlation)
            ctx.write(CLUSTERS, Cluster(count, model, position, hits, best, config.method))
            count += 1
        if small:
            ctx.log(f"{small} groups of fewer than {least} hits left out")
        ctx.log(f"{count} candidates")


Group = tuple[str, Vector, F32]
"""Model, position and the correlations of the hits."""


def _components(
    messages: Iterable[Hits], models: Sequence[ObjectModel], reach_m: float | None
) -> Iterator[Group]:
    """Delaunay components of each model's hits; the centroid is the candidate."""
    sizes = {model.name: model.size for model in models}
    for hits in messages:
        longest_m = reach_m or float(np.hypot(*sizes[hits.model][:2])) / 2
        for rows in _rows_of_groups(delaunay_components(hits.points, longest_m)):
            centre = hits.points[rows].mean(axis=0, dtype=np.float64)
            yield hits.model, vector(centre), hits.correlation[rows]


def _peaks(
    messages: Iterable[Hits], models: Sequence[ObjectModel], reach_m: float | None
) -> Iterator[Group]:
    """Hits that no better one is near to, of a model or of any like it; best first."""
    found = {hits.model: hits for hits in messages}
    for family in _families(models):
        members = [found[model.name] for model in family]
        points = np.concatenate([hits.points for hits in members])
        correlation = np.concatenate([hits.correlation for hits in members])
        name = np.repeat([hits.model for hits in members], [len(hits.points) for hits in members])
        narrow_m = min(float(model.size[:2].min()) / 2 for model in family)
        peaks, owner = suppress(points, correlation, reach_m or PEAK_HALF_WIDTHS * narrow_m)
        for peak, rows in zip(peaks, _rows_of_groups(owner), strict=True):
            yield str(name[peak]), vector(points[peak]), correlation[rows]


def _families(models: Sequence[ObjectModel]) -> list[list[ObjectModel]]:
    """Models that may be fitted to the same size, directly or through others, together."""
    size = np.array([model.size for model in models])
    stretch = np.array([model.stretch for model in models])[:, None]
    low, high = size * (1.0 - stretch), size * (1.0 + stretch)
    alike = np.all((low[:, None] <= high) & (high[:, None] >= low), axis=2)
    family = connected_components(alike, directed=False)[1]
    return [
        [model for model, own in zip(models, family, strict=True) if own == number]
        for number in np.unique(family)
    ]


def _rows_of_groups(members: I64) -> list[I64]:
    """Rows of each group, by the group's number."""
    if len(members) == 0:
        return []
    order = np.argsort(members, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(members[order])) + 1)
