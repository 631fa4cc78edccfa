"""Stage 4: hits that stand for the same instance become one candidate."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

import numpy as np
from pydantic import Field

from spinpipe.schemas import CLUSTERS, HITS, MODELS
from spinpipe.schemas.records import Cluster, Hits, Vector
from spinpipe.stages.delaunay import delaunay_components
from spinpipe.stages.stage import Context, Section
from spinpipe.stages.suppression import suppress


class Clustering:
    """Groups the hits of each model into candidates."""

    name = "cluster"
    version = 1
    inputs = (HITS, MODELS)
    outputs = (CLUSTERS,)

    class Config(Section):
        """How near hits of one instance are to each other."""

        method: Literal["delaunay", "suppression"] = Field(
            "delaunay",
            description="delaunay: components of the tessellation, as in the paper; "
            "suppression: the best hit within max_edge_m, for things that stand close together",
        )
        max_edge_m: float | None = Field(
            None,
            gt=0,
            le=1000,
            description="longest edge, or reach of the best hit; none: half the model's diagonal "
            "(delaunay) or half its narrow side (suppression)",
        )
        min_hits: int = Field(3, ge=1, description="fewer hits are no candidate")

    def run(self, ctx: Context[Config]) -> None:
        """Write the candidates of all models, numbered from 0."""
        sizes = {m.name: np.ptp(m.points, axis=0) for m in ctx.read(MODELS)}
        count = 0
        for hits in ctx.read(HITS):
            reach_m = ctx.config.max_edge_m or _reach_m(sizes[hits.model], ctx.config.method)
            small = 0
            for position, rows in _groups(hits, ctx.config.method, reach_m):
                if len(rows) < ctx.config.min_hits:
                    small += 1
                    continue
                best = float(hits.correlation[rows].max())
                method = ctx.config.method
                ctx.write(CLUSTERS, Cluster(count, hits.model, position, len(rows), best, method))
                count += 1
            if small:
                ctx.log(f"{hits.model}: {small} groups below {ctx.config.min_hits} hits left out")
        ctx.log(f"{count} candidates")


def _reach_m(size: np.ndarray, method: str) -> float:
    if method == "delaunay":
        return float(np.hypot(size[0], size[1])) / 2
    return float(min(size[0], size[1])) / 2


def _groups(hits: Hits, method: str, reach_m: float) -> Iterator[tuple[Vector, np.ndarray]]:
    """Position and rows of each group; best or first in space comes first."""
    if method == "delaunay":
        members = delaunay_components(hits.points, reach_m)
        centres = None
    else:
        peaks, members = suppress(hits.points, hits.correlation, reach_m)
        centres = hits.points[peaks]
    order = np.argsort(members, kind="stable")
    groups = np.split(order, np.flatnonzero(np.diff(members[order])) + 1) if len(order) else []
    for number, rows in enumerate(groups):
        centre = (
            hits.points[rows].mean(axis=0, dtype=np.float64)
            if centres is None
            else (centres[number])
        )
        x, y, z = (float(c) for c in centre)
        yield (x, y, z), rows
