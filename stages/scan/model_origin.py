"""Where on a model its spin image is taken: the one place that every instance shows again.

[Bovenkamp 2010, section 2.1] takes the topmost point. That is a fixed point of a car's drawing; of
a flat roof, or of a model that was cut from a noisy scene, it is an accident: a bump, an antenna, a
corner, of which the next instance has none.
"""

from __future__ import annotations

import numpy as np

from spinpipe.schemas.arrays import F64
from spinpipe.stages.geometry.model_surface import top_of
from spinpipe.stages.scan.image import SpinGrid, spin_image

MOST_PLACES = 300
"""Places on a top that are compared: one in each voxel of an eighth of the radius, thinned out."""
MOST_POINTS = 15_000
"""Of the model that their images are made of: chosen, as the places are, so that it takes 0.2 s."""
AS_TYPICAL = 0.9
"""Share of the greatest mean correlation that is as good: then the place nearest to the middle.
Chosen: at 0.95 it is off the middle of what is round; from 0.8 to 0.9 three cut buses and a cut
prism keep theirs, and those of six shapes of cars stay within 0.4 m on their roofs."""


def typical_point(points: F64, grid: SpinGrid, lift_m: float) -> F64:
    """(3,) the point of a model's top whose spin image most resembles those of the whole top.

    Whatever part of an instance's top the sensor shows, some of its points then resemble it.

    Parameters
    ----------
    points : (N, 3) on the model's surface, object frame, z up, metres.
    grid : extent and bins of the images.
    lift_m : how far above a point its image is taken.
    """
    top = points[top_of(points)]
    rows = np.unique(np.floor(top / (grid.radius_m / 8)), axis=0, return_index=True)[1]
    rows = np.sort(rows)
    places = top[rows[np.linspace(0, len(rows) - 1, min(len(rows), MOST_PLACES)).astype(int)]]
    surface = points[:: max(1, -(-len(points) // MOST_POINTS))]
    images = np.array(
        [spin_image(surface - place - [0, 0, lift_m], np.zeros(3), grid) for place in places], float
    ).reshape(len(places), -1)
    images -= images.mean(axis=1, keepdims=True)
    length = np.linalg.norm(images, axis=1, keepdims=True)
    images /= np.where(length > 0, length, 1.0)
    resemblance = images @ images.mean(axis=0)
    typical = places[resemblance >= AS_TYPICAL * resemblance.max()]
    middle = top[:, :2].mean(axis=0)
    return typical[np.argmin(np.square(typical[:, :2] - middle).sum(axis=1))]
