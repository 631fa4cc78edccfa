"""Things that stand on level ground, sampled, and what verification says of them."""

import numpy as np

from spinpipe.stages.geometry.sampling import measure_sampling
from spinpipe.stages.geometry.shapes import merged, sample_surface, surface_area
from spinpipe.stages.verify.decide.verdict import Rules
from spinpipe.stages.verify.model.field import build_model_field
from spinpipe.stages.verify.model.known_object import KnownObject
from spinpipe.stages.verify.recognition import verify_candidates


def known_object(name, mesh, stretch=0.0, visible_from="all"):
    """A model, sampled on its whole surface."""
    points, normals = sample_surface(*mesh, 40_000, np.random.default_rng(0))
    return KnownObject(build_model_field(name, points, normals), stretch, visible_from)


def cloud_of(items, extent, density, noise=0.0, seed=1):
    """Items on a square ground, sampled evenly by area on all their surfaces."""
    rng = np.random.default_rng(seed)
    mesh = merged(items)
    points, _ = sample_surface(*mesh, int(surface_area(mesh) * density), rng)
    ground = np.c_[
        rng.uniform(-extent / 2, extent / 2, (int(extent**2 * density), 2)),
        np.zeros(int(extent**2 * density)),
    ]
    cloud = np.concatenate([points, ground])
    return cloud + rng.normal(0, noise, cloud.shape)


def verdicts_on(cloud, objects, places, **rules):
    """Verdicts on candidates at places."""
    return verify_candidates(
        cloud, objects, np.array(places, float), measure_sampling(cloud), Rules(**rules)
    )
