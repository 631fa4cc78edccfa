"""Stage 4: hits that stand for the same instance become one candidate."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Literal

import numpy as np
from pydantic import Field

from spinpipe.schemas import CLUSTERS, HITS, MODELS
from spinpipe.schemas.records import F32, I64, Cluster, Hits, Vector
from spinpipe.stages.candidates import vector
from spinpipe.stages.delaunay import delaunay_components
from spinpipe.stages.stage import Context, Section
from spinpipe.stages.suppression import suppress

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
            description="suppression: the best hit of any model within max_edge_m, for things "
            "that stand close together; delaunay: components of the tessellation of each model's "
            "hits, as in the paper",
        )
        max_edge_m: float | None = Field(
            None,
            gt=0,
            le=1000,
            description="reach of the best hit, or longest edge; none: 0.9 times half the narrow "
            "side of the smallest model (suppression) or half the model's diagonal (delaunay)",
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
        sizes = {m.name: np.ptp(m.points, axis=0) for m in ctx.read(MODELS)}
        groups = _peaks if config.method == "suppression" else _components
        least = config.min_hits or (1 if config.method == "suppression" else 3)
        count = small = 0
        for model, position, correlation in groups(ctx.read(HITS), sizes, config.max_edge_m):
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
    messages: Iterable[Hits], sizes: dict[str, F32], reach_m: float | None
) -> Iterator[Group]:
    """Delaunay components of each model's hits; the centroid is the candidate."""
    for hits in messages:
        longest_m = reach_m or float(np.hypot(*sizes[hits.model][:2])) / 2
        for rows in _rows_of_groups(delaunay_components(hits.points, longest_m)):
            centre = hits.points[rows].mean(axis=0, dtype=np.float64)
            yield hits.model, vector(centre), hits.correlation[rows]


def _peaks(
    messages: Iterable[Hits], sizes: dict[str, F32], reach_m: float | None
) -> Iterator[Group]:
    """Hits of all models that no better one is near to; best first."""
    found = list(messages)
    points = np.concatenate([hits.points for hits in found])
    correlation = np.concatenate([hits.correlation for hits in found])
    model = np.repeat([hits.model for hits in found], [len(hits.points) for hits in found])
    narrow_m = min(float(min(size[0], size[1])) / 2 for size in sizes.values())
    peaks, members = suppress(points, correlation, reach_m or PEAK_HALF_WIDTHS * narrow_m)
    for peak, rows in zip(peaks, _rows_of_groups(members), strict=True):
        yield str(model[peak]), vector(points[peak]), correlation[rows]


def _rows_of_groups(members: I64) -> list[I64]:
    """Rows of each group, by the group's number."""
    if len(members) == 0:
        return []
    order = np.argsort(members, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(members[order])) + 1)
