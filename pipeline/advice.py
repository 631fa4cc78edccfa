"""What a run that found nothing would have needed: lines that name the odd number and the key."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np

from spinpipe.pipeline.context import RunReader
from spinpipe.pipeline.results.life import deciding_part
from spinpipe.schemas import CLUSTERS, HITS, MODELS, PLANE, SAMPLING, SCENE, SCORES, TILES
from spinpipe.schemas.records import Detection
from spinpipe.stages.ground.ground import SMALL

_TRY = {
    "model": "allow [[model]] stretch, or cut one from the scene with 'spinpipe model cut'",
    "sides": 'allow [[model]] stretch; visible_from = "above" if the photos show no sides',
    "scene": "the model is smaller than what stands there: is its unit right?",
    "residual": "allow [[model]] stretch, or state [verify.evidence] tolerance_m",
    "outline": "what stands there goes on beyond the model: is its unit right?",
    "alike": "they fit worse than what was accepted: [verify.evidence] tolerance_m allows for more",
    "stands": "the model's file may have its base elsewhere, or the ground lies higher there",
}
"""What to do where a part of the score is the weakest of most candidates."""


def advice(read: RunReader, detections: Sequence[Detection]) -> Iterator[str]:
    """Lines about a complete run; none where something was accepted.

    Parameters
    ----------
    read : its messages.
    detections : all candidates with their fates.
    """
    if any(d.fate == "accepted" for d in detections):
        return
    models, scene, plane = list(read(MODELS)), read(SCENE)[0], read(PLANE)[0]
    sizes = ", ".join(f"{m.name} {' x '.join(f'{v:.3g}' for v in m.size)} m" for m in models)
    if plane.inliers < SMALL * plane.points:
        yield (
            f"the ground holds only {plane.inliers / plane.points:.1%} of the surface: perhaps up "
            "is wrong; look at the recording and set [ground] up"
        )
    if not len(read(CLUSTERS)):
        best = max((float(t.correlation.max(initial=-1)) for t in read(SCORES)), default=-1.0)
        hits = sum(len(h.points) for h in read(HITS))
        yield (
            f"the scan found {hits} hits and no candidate; the best place correlates with "
            f"{best:.2f} ([scan] min_correlation says from where a place counts)"
        )
    elif detections:
        weakest = Counter(part.name for d in detections if (part := deciding_part(d)) is not None)
        if weakest:
            name, count = weakest.most_common(1)[0]
            mend = f"; {_TRY[name]}" if name in _TRY else ""
            yield f"of {len(detections)} candidates {count} fail first by '{name}'{mend}"
    tiles = read(TILES)[0]
    extent = " x ".join(f"{v:.3g}" for v in tiles.high.max(axis=0) - tiles.low.min(axis=0))
    yield (
        f"the scene was taken to be {extent} m with points {read(SAMPLING)[0].spacing_m:.2g} m "
        f"apart ({' x '.join(f'{v:g}' for v in dict.fromkeys(scene.scale))} m a unit), the models "
        f"to be {sizes}"
    )
    if np.allclose(scene.scale, 1.0):
        yield (
            "if a size is wrong, say the unit: [ingest] scale = 0.3048 for feet, 0.001 for "
            "millimetres, or scale in the [[model]]"
        )
    for model in models:
        if model.size[2] > max(model.size[:2]):
            yield f"model '{model.name}' is higher than long: does it stand? its up may be another"
