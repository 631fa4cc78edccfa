"""What speaks for and against a model at a pose; compiled.

Model and points are compared both ways. A visible sample of the model is *supported* where the
scene has a surface, *contradicted* where rays from above passed through it (points below, none at
it, none above) or a surface stands beside it, *empty* or *covered* where nothing can be said. A
scene point is *claimed* when it lies in the model's bounding box and is not ground, and *explained*
when it lies on the model's surface.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from spinpipe.stages.compiled import inner
from spinpipe.stages.verify.evidence.outline import TOUCHED, outline_evidence
from spinpipe.stages.verify.evidence.scene import root_mean_square, scene_evidence
from spinpipe.stages.verify.evidence.sides import side_evidence
from spinpipe.stages.verify.evidence.surface import surface_evidence


class EvidenceColumns(NamedTuple):
    """Columns of the evidence of a hypothesis; each a float."""

    supported: float
    """This to ``sheltered``: shares of the visible surface, see ``surface_evidence``."""
    contradicted: float
    empty: float
    covered: float
    sheltered: float
    claimed: float
    """This and ``explained``: weights of points, see ``scene_evidence``."""
    explained: float
    rms_m: float
    """Root mean square distance of the explained points to the surface; infinite without any."""
    drop: float
    """This to ``grounded``: see ``outline_evidence``."""
    ring: float
    grounded: float
    side_supported: float
    """Shares of the upright surface, see ``side_evidence``."""
    side_contradicted: float
    front: float
    """This to ``right``: the drop at each side of the outline."""
    left: float
    back: float
    right: float
    front_level: float
    """This to ``right_level``: share of each side where a level surface goes on."""
    left_level: float
    back_level: float
    right_level: float


EVIDENCE = EvidenceColumns._fields


@inner
def gather_evidence(grid, body, field, pose, gate, sharp):
    """All evidence about a model at a pose.

    Parameters
    ----------
    grid : CellGrid, all points around.
    body : Points, those of bodies near the candidate.
    field : ModelField.
    pose : Pose.
    gate, sharp : see ``Tolerance``.

    Returns
    -------
    EvidenceColumns
    """
    surface = surface_evidence(grid, field, pose, gate, sharp)
    outline = outline_evidence(grid, field, pose, gate)
    free = np.array([outline.front, outline.left, outline.back, outline.right]) >= TOUCHED
    claim = scene_evidence(body, field, pose, gate, free)
    side_supported, side_contradicted = side_evidence(grid, field, pose, gate, sharp, free)
    return EvidenceColumns(
        surface.supported,
        surface.contradicted,
        surface.empty,
        surface.covered,
        surface.sheltered,
        claim.claimed,
        claim.explained,
        root_mean_square(claim),
        outline.drop,
        outline.ring,
        outline.grounded,
        side_supported,
        side_contradicted,
        outline.front,
        outline.left,
        outline.back,
        outline.right,
        outline.front_level,
        outline.left_level,
        outline.back_level,
        outline.right_level,
    )
