"""``spinpipe diff``: what one run found and another did not, in the same scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console, Group
from rich.table import Table
from rich.text import Text
from scipy.optimize import linear_sum_assignment

from spinpipe.pipeline.context import RunReader
from spinpipe.pipeline.outputs import write_new
from spinpipe.pipeline.results.complete import open_complete
from spinpipe.schemas import DETECTIONS, SCENE
from spinpipe.schemas.records import Detection, Vector

MOVED_M, TURNED_DEG = 0.05, 2.0
"""Less is no difference worth a row."""
KINDS = ("gained", "lost", "moved", "changed type", "same")


@dataclass(frozen=True)
class Difference:
    """One object in one or both runs."""

    kind: str
    before: Detection | None
    after: Detection | None
    distance_m: float = 0.0
    """Between the two."""
    turn_deg: float = 0.0


def diff_command(before: Path, after: Path, recording: Path | None, force: bool) -> None:
    """``spinpipe diff``."""
    folder_a, _ = open_complete(before)
    folder_b, config = open_complete(after)
    a, b = (_accepted(RunReader(folder)(DETECTIONS)) for folder in (folder_a, folder_b))
    differences = compare(a, b, RunReader(folder_b)(SCENE)[0].scale)
    console = Console()
    console.print(difference_table(differences), highlight=False)
    if recording is not None:
        from spinpipe.pipeline.drawing.difference import record_difference

        read = RunReader(folder_b)
        write_new(
            recording,
            lambda partial: record_difference(read, differences, config, partial),
            force=force,
        )
        console.print(f"wrote {recording}", highlight=False, soft_wrap=True)


def _accepted(detections: Sequence[Detection]) -> list[Detection]:
    return [d for d in detections if d.fate == "accepted"]


def compare(
    before: Sequence[Detection], after: Sequence[Detection], metres: Vector = (1.0, 1.0, 1.0)
) -> list[Difference]:
    """Match accepted detections one to one by their places in the scene.

    Two are the same object if they are nearer than half the shorter horizontal side of the larger
    one; of all matchings the one with the least sum of distances is taken. ``metres`` are those
    that a unit of the scene has along x, y and z.
    """
    a, b = (np.array([d.position_scene for d in x]).reshape(-1, 3) for x in (before, after))
    distance_m = np.linalg.norm((a[:, None] - b[None]) * metres, axis=2)
    reach = np.maximum(
        np.array([min(d.size_m[:2]) / 2 for d in before]).reshape(-1, 1),
        np.array([min(d.size_m[:2]) / 2 for d in after]).reshape(1, -1),
    )
    near = distance_m <= reach
    far = 1e6 * (1.0 + float(distance_m.max(initial=0)))
    rows, columns = linear_sum_assignment(np.where(near, distance_m, far))
    pairs = {int(r): int(c) for r, c in zip(rows, columns, strict=True) if near[r, c]}
    found: list[Difference] = []
    for i, d in enumerate(before):
        if i in pairs:
            found.append(_pair(d, after[pairs[i]], float(distance_m[i, pairs[i]])))
        else:
            found.append(Difference("lost", d, None))
    taken = set(pairs.values())
    found += [Difference("gained", None, d) for i, d in enumerate(after) if i not in taken]
    return sorted(found, key=lambda x: KINDS.index(x.kind))


def _pair(before: Detection, after: Detection, distance_m: float) -> Difference:
    turn = float(abs((after.heading_deg - before.heading_deg + 180) % 360 - 180))
    kind = "same"
    if before.model != after.model:
        kind = "changed type"
    elif distance_m > MOVED_M or turn > TURNED_DEG:
        kind = "moved"
    return Difference(kind, before, after, distance_m, turn)


def difference_table(differences: Sequence[Difference]) -> Group:
    """Every difference as a row, and how many of each kind there are."""
    table = Table(box=None, pad_edge=False, header_style="bold")
    for name in ("", "id", "id", "model", "x_scene", "y_scene", "moved m", "turned", "score"):
        table.add_column(name, justify="left" if name in ("", "model") else "right")
    for d in differences:
        if d.kind == "same":
            continue
        one = d.after or d.before
        assert one is not None
        ids = [str(x.id) if x else "–" for x in (d.before, d.after)]
        names = [x.model for x in (d.before, d.after) if x]
        scores = [f"{x.score:.2f}" for x in (d.before, d.after) if x]
        moved = (f"{d.distance_m:.2f}", f"{d.turn_deg:.0f}°") if len(names) == 2 else ("", "")
        model = " → ".join(dict.fromkeys(names))
        x, y, _ = one.position_scene
        cells = (d.kind, *ids, model, f"{x:.2f}", f"{y:.2f}", *moved, " → ".join(scores))
        table.add_row(*(Text(cell) for cell in cells))
    counts = [f"{sum(d.kind == kind for d in differences)} {kind}" for kind in KINDS]
    return Group(*([table] if table.row_count else []), Text(", ".join(counts)))
