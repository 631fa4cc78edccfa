"""Draw the candidates that the hits were grouped into."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
import rerun as rr

from spinpipe.pipeline.drawing import palette
from spinpipe.pipeline.drawing.drawing import WORLD, Reader, at_stage, at_stages, note, put
from spinpipe.pipeline.drawing.model import model_bounds
from spinpipe.pipeline.drawing.timelines import candidate_step
from spinpipe.schemas import CLUSTERS, MODELS
from spinpipe.schemas.records import Cluster

_LABELLED = 12
_NOTED = 40


def draw(read: Reader, rec: rr.RecordingStream, preview_points: int) -> None:
    """Log a pin for each candidate; along the timeline ``candidate`` one of them stands out."""
    clusters = sorted(read(CLUSTERS), key=lambda cluster: cluster.id)
    shown = clusters[:preview_points]
    tallest = max((model_bounds(model)[1, 2] for model in read(MODELS)), default=1.0)
    pin = np.array([0, 0, tallest])
    positions = np.array([c.position for c in shown], np.float64).reshape(-1, 3)
    at_stage(rec, "cluster")
    note(rec, _summary(clusters))
    at_stages(rec, "cluster/candidates", "cluster", "cluster")
    put(
        rec,
        "cluster/candidates",
        rr.LineStrips3D(
            np.stack([positions, positions + pin], axis=1).astype(np.float32),
            colors=palette.WHITE,
            radii=-0.7,
            labels=[f"{c.id}: {c.correlation:.2f}" for c in shown],
            show_labels=len(shown) <= _LABELLED,
        ),
        WORLD,
    )
    if not shown:
        return
    mark = rr.Points3D.from_fields(colors=palette.MARK, radii=-6.0)
    rec.log("cluster/candidate", rr.CoordinateFrame(WORLD), mark, static=True)
    rec.send_columns(
        "cluster/candidate",
        indexes=[rr.TimeColumn("candidate", sequence=[candidate_step(c.id) for c in shown])],
        columns=rr.Points3D.columns(
            positions=positions, labels=[f"candidate {c.id}" for c in shown]
        ),
    )


def _summary(clusters: Sequence[Cluster]) -> str:
    models = Counter(cluster.model for cluster in clusters)
    total = ", ".join(f"{count} of {model}" for model, count in models.items()) or "none"
    lines = [
        f"## Candidates: {total}",
        "",
        "| id | model | hits | correlation | method |",
        "|---|---|---|---|---|",
    ]
    lines += [
        f"| {c.id} | {c.model} | {c.hits} | {c.correlation:.3f} | {c.method} |"
        for c in clusters[:_NOTED]
    ]
    if len(clusters) > _NOTED:
        lines.append(f"\n... and {len(clusters) - _NOTED} more")
    return "\n".join(lines)
