"""Scenes made of rectangles and boxes, and the ground stage run on them in memory."""

import numpy as np

from spinpipe.schemas import CAMERAS, CLOUD, PLANE, SCENE, TILES, TRAJECTORY, UPRIGHT
from spinpipe.schemas.records import CloudTile, SceneFrame, TileIndex
from spinpipe.stages.ground.ground import Ground

UP = np.array([0.0, 0.0, 1.0])


class Memory:
    """A context in memory that holds the stage to its own topics."""

    threads, memory_bytes = 1, 2**30

    def __init__(self, tiles, cameras=None, seed=0, declared=(), lidar=None, **config):
        self.config = Ground.Config(**config)
        self.rng = np.random.default_rng(seed)
        white = [np.full(tile.shape, 255, np.uint8) for tile in tiles]
        low = np.array([t.min(axis=0) for t in tiles], np.float32)
        high = np.array([t.max(axis=0) for t in tiles], np.float32)
        self.messages = {
            CLOUD: [CloudTile(t, rgb) for t, rgb in zip(tiles, white, strict=True)],
            TILES: [TileIndex(low, high, np.array([len(t) for t in tiles]))],
            SCENE: [SceneFrame((0, 0, 0), (1, 1, 1), 0, 0, False, "scene", up=declared)],
            CAMERAS: [] if cameras is None else [cameras],
            TRAJECTORY: [] if lidar is None else [lidar],
        }
        self.written = {}

    def read(self, topic):
        return self.messages[topic]

    def read_one(self, topic):
        (message,) = self.messages[topic]
        return message

    def write(self, topic, message):
        assert topic in Ground.outputs
        assert topic not in self.written
        self.written[topic] = message

    def progress(self, label, total):
        return self

    def advance(self, steps=1):
        pass

    def log(self, text):
        assert "\n" not in text


def ground_of(points, cameras=None, pieces=3, seed=0, **config):
    """Plane and upright of a cloud that is cut into pieces."""
    tiles = np.array_split(np.asarray(points, np.float32), pieces)
    context = Memory(tiles, cameras, seed, **config)
    Ground().run(context)
    return context.written[PLANE], context.written[UPRIGHT]


def up_of(points, cameras=None, **config):
    return np.array(ground_of(points, cameras, **config)[0].normal)


def angle_deg(a, b):
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))


def rectangle(rng, corner, a, b, density=40):
    """Uniform points on a parallelogram."""
    corner, a, b = (np.asarray(v, float) for v in (corner, a, b))
    n = int(np.linalg.norm(np.cross(a, b)) * density)
    u = rng.uniform(size=(2, n, 1))
    return corner + u[0] * a + u[1] * b


def box(rng, x, y, length, width, height, density=40):
    """The four sides and the top of a box that stands on z = 0."""
    o, a, b, c = (np.array(v) for v in ((x, y, 0), (length, 0, 0), (0, width, 0), (0, 0, height)))
    sides = [(o, a, c), (o + b, a, c), (o, b, c), (o + a, b, c), (o + c, a, b)]
    return np.concatenate([rectangle(rng, *map(np.asarray, s), density) for s in sides])


def car_park(rng, cars=8, size=30.0):
    """Flat ground with car-sized boxes on it, nothing under them."""
    ground = rectangle(rng, (-size / 2, -size / 2, 0), (size, 0, 0), (0, size, 0))
    parts = []
    for x, y in rng.uniform(-size / 2, size / 2 - 5, (cars, 2)):
        parts.append(box(rng, x, y, 4.2, 1.8, 1.4))
        under = (abs(ground[:, 0] - x - 2.1) < 2.1) & (abs(ground[:, 1] - y - 0.9) < 0.9)
        ground = ground[~under]
    return np.concatenate([ground, *parts])
