"""Things that stand on level ground, sampled, and what verification says of them."""

import functools

import numpy as np

from spinpipe.schemas.records import CloudTile, TileIndex, Upright
from spinpipe.stages.geometry.sampling import measure_sampling
from spinpipe.stages.geometry.shapes import merged, sample_surface, surface_area
from spinpipe.stages.geometry.world_cloud import WorldCloud
from spinpipe.stages.verify.decide.decision import decide
from spinpipe.stages.verify.decide.verdict import Rules
from spinpipe.stages.verify.judge.search import Search, Store
from spinpipe.stages.verify.model.field import build_model_field
from spinpipe.stages.verify.model.known_object import KnownObject


def known_object(name, mesh, stretch=0.0, visible_from="all"):
    """A model, sampled on its whole surface."""
    field = _field(name, *(tuple(map(tuple, rows.tolist())) for rows in mesh))
    return KnownObject(name, field, stretch, visible_from)


@functools.cache
def _field(name, vertices, faces):
    """Fields take a second: tests share them."""
    mesh = np.array(vertices), np.array(faces)
    points, normals = sample_surface(*mesh, 40_000, np.random.default_rng(0))
    return build_model_field(name, points, normals)


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


def cloud_in_memory(points):
    """A cloud of one tile whose local frame is the world."""
    xyz = np.asarray(points, np.float32)
    tile = CloudTile(xyz, np.zeros((len(xyz), 3), np.uint8))
    low, high = xyz.min(axis=0, keepdims=True), xyz.max(axis=0, keepdims=True)
    index = TileIndex(low, high, np.array([len(xyz)]))
    return WorldCloud.of([tile], index, Upright((0.0, 0.0, 0.0, 1.0), (0.0, 0.0, 0.0)))


def found_in(cloud, objects, places, sampling=None, threads=1, error_m=None, proposed=None):
    """All hypotheses about candidates at places."""
    places = np.array(places, float)
    if proposed is None:  # as the one that is about as high
        heights = np.array([o.field.size[2] for o in objects])
        proposed = np.abs(places[:, 2:] - heights).argmin(axis=1)
    proposed = np.asarray(proposed)
    sampling = sampling or measure_sampling(cloud)
    search = Search(objects, sampling, cloud_in_memory(cloud), places, proposed, threads)
    return search.run(error_m, map, Store(lambda block: None), lambda count: None)


def verdicts_on(cloud, objects, places, *, sampling=None, threads=1, proposed=None, **rules):
    """Verdicts on candidates at places."""
    found = found_in(cloud, objects, places, sampling, threads, proposed=proposed)
    return decide(found.standards, found.table, np.array(places, float), Rules(**rules))
