"""Records that travel between stages: frozen dataclasses, one for each message on a topic.

Frames: ``scene`` as imported; ``local`` = (scene - origin) * scale, metres; ``world`` = local
turned upright, ground at z = 0; ``model`` = coordinates of a model's file; ``object`` = the
model upright in metres, base centre at the origin.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from spinpipe.schemas.arrays import F32, F64, I32, I64, U8

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class CloudTile:
    """A piece of the cloud: points near each other, in the local frame."""

    xyz: F32
    """(N, 3) metres, local frame."""
    rgb: U8
    """(N, 3); white where the source has no colours."""


@dataclass(frozen=True)
class TileIndex:
    """Bounds of every cloud tile, row i for message i of the cloud topic."""

    low: F32
    """(T, 3) metres, local frame."""
    high: F32
    """(T, 3) metres, local frame."""
    counts: I64
    """(T,) points."""


@dataclass(frozen=True)
class SceneFrame:
    """How the imported scene became the local frame: ``local = (scene - origin) * scale``."""

    origin: Vector
    """In scene coordinates."""
    scale: Vector
    """Metres per unit of the scene, along x, y and z."""
    points: int
    dropped: int
    """Points left out because a coordinate is not finite."""
    coloured: bool
    source: str
    """Name of the imported file or folder."""
    strays: int = 0
    """Points left out because they lie far from everything else."""
    duplicates: int = 0
    """Points left out because another one has the same coordinates."""
    kind: str = ""
    """Format and dialect."""
    crs: str = ""
    """Coordinate reference system, ``EPSG:...`` or WKT; empty where the file names none."""
    up: tuple[float, ...] = ()
    """Which way is up by the file's format or coordinate system, scene frame; empty if unsaid."""
    up_reason: str = ""
    spacing_m: float = 0.0
    """Typical distance of neighbouring points; 0 where they are too few."""
    step_m: float = 0.0
    """Grid that the coordinates are written on, along the coarsest axis; 0 without one."""
    photos: str = ""
    """Folder of the photos that the cameras are named after; empty if it is not known."""
    fields: tuple[str, ...] = ()
    """Names of what each point carries in the file besides coordinates and colour."""
    unit_source: str = ""
    """What says the unit; empty where nothing does and metres are assumed, or the config does."""


@dataclass(frozen=True)
class ObjectModel:
    """A model of an object: a cloud of its visible surface, and its mesh where there is one."""

    name: str
    points: F32
    """(N, 3) metres, object frame."""
    normals: F32
    """(N, 3) unit normals, all zero where the model has none."""
    vertices: F32
    """(V, 3) metres, object frame; (0, 3) for a model given as a cloud."""
    faces: I32
    """(F, 3) rows of ``vertices``; (0, 3) for a cloud."""
    T_object_model: F64
    """(4, 4) similarity from the model file's coordinates to the object frame."""
    visible_from: str
    """``"all"`` or ``"above"``: which part of the surface the sensor could see."""
    stretch: float = 0.0
    """Largest relative change of length along each axis; 0 for a rigid object."""

    @cached_property
    def size(self) -> F32:
        """(3,) extents of the whole object, seen or not, metres."""
        return np.ptp(self.vertices if len(self.vertices) else self.points, axis=0)


@dataclass(frozen=True)
class Evidence:
    """One reason for the sign of up: positive speaks for the normal, negative against it."""

    name: str
    value: float


@dataclass(frozen=True)
class Level:
    """A height on which ground lies, on one piece or several."""

    height_m: float
    """Above z = 0 of the world."""
    share: float
    """Of the scene's surface."""


@dataclass(frozen=True)
class Plane:
    """The ground in the local frame: ``dot(normal, p) + offset = 0``, the normal points up."""

    normal: Vector
    offset: float
    inliers: int
    points: int
    """Points that took part in the estimate."""
    rms_m: float
    """Root mean square distance of the inliers."""
    inlier_distance_m: float
    up_source: str
    """What decided which way is up."""
    evidence: tuple[Evidence, ...] = ()
    levels: tuple[Level, ...] = ()
    """Of the ground, the lowest first; small pieces are none."""


@dataclass(frozen=True)
class ErrorOver:
    """How far points lie off a plane through a square patch of surface."""

    side_m: float
    """Of the patch."""
    error_m: float
    """Standard deviation."""


@dataclass(frozen=True)
class Sampling:
    """How the cloud samples the world; tolerances follow from it."""

    spacing_m: float
    """Typical distance between neighbouring points on a horizontal surface."""
    noise_m: float
    """Standard deviation of the points about the surface."""
    errors: tuple[ErrorOver, ...] = ()
    """The same over patches of growing side: how wavy surfaces are that should be flat."""
    blur_m: float = 0.0
    """Standard deviation by which steps are blurred where the cloud is a skin, see
    ``geometry.skin``; 0 where it is none."""

    @property
    def density(self) -> float:
        """Points per square metre."""
        return self.spacing_m**-2


@dataclass(frozen=True)
class Upright:
    """The rigid transform from local to world: rotation, then translation."""

    quaternion_xyzw: tuple[float, float, float, float]
    translation: Vector

    @property
    def T_world_local(self) -> F64:
        """(4, 4) matrix of the transform."""
        x, y, z, w = self.quaternion_xyzw
        T = np.eye(4)
        T[:3, :3] = [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
        T[:3, 3] = self.translation
        return T


@dataclass(frozen=True)
class SpinImage:
    """A spin image about the vertical axis: rows go down from the origin, columns outwards."""

    model: str
    role: str
    """``"model"``, or ``"scene"`` for the origin that matches best."""
    radius_m: float
    height_m: float
    bin_m: float
    values: F32
    """(rows, columns) counts."""
    origin: Vector
    """World frame for a scene image, object frame for a model image."""
    correlation: float
    """With the model's image; 1 for the model itself."""


@dataclass(frozen=True)
class ScoreTile:
    """Origins of one tile with their correlation for each model: message i is tile i."""

    models: tuple[str, ...]
    points: F32
    """(N, 3) metres, world."""
    correlation: F32
    """(N, models)."""
    rgb: U8
    """(N, 3) the best correlation as a colour, for viewers."""


@dataclass(frozen=True)
class Hits:
    """Origins whose correlation with one model reached the threshold."""

    model: str
    points: F32
    """(N, 3) metres, world."""
    correlation: F32
    """(N,)."""


@dataclass(frozen=True)
class Cluster:
    """A group of hits that stands for one possible instance: a candidate."""

    id: int
    model: str
    position: Vector
    """World, metres."""
    hits: int
    correlation: float
    """The largest of its hits."""
    method: str


@dataclass(frozen=True, eq=False)
class BlockHypotheses:
    """What a look at the candidates of one block found; an interrupted run goes on after the last.

    Attributes
    ----------
    look : 1 or 2.
    candidate, model : (S,) rows of the clusters and of the models.
    start, pose : (S, 7) where registration began and ended: base centre, world, metres; yaw,
        radians; stretch.
    lean : (S, 2) slopes of the support along x and y.
    parts : (S, P) of the score, see ``Detection.parts``.
    evidence : (S, E) what was counted and measured at the pose.
    odds : (S,) logarithm of the odds that it is an instance.
    course_candidate, course_length : (K,) whose ways are kept, and how many poses each has.
    course_poses, course_rms_m : the poses (sum of the lengths, 7) of one way after the other, and
        the residuals there.
    """

    look: int
    candidate: I64
    model: I64
    start: F64
    pose: F64
    lean: F64
    parts: F64
    evidence: F64
    odds: F64
    course_candidate: I64
    course_length: I64
    course_poses: F64
    course_rms_m: F64


@dataclass(frozen=True)
class FitTrace:
    """How the registration of one candidate went, start by start."""

    cluster: int
    start_heading_deg: F64
    """(S,) heading each start began with."""
    rms_m: F32
    """(S, iterations); NaN where a start had stopped, or where only its end was kept: the last."""
    poses: F64
    """(iterations, 4, 4) T_world_object of the best start; one if only its end was kept."""


@dataclass(frozen=True)
class Part:
    """One named number that took part in a decision."""

    name: str
    value: float
    reference: float = 1.0
    """What a right instance gets in such a cloud."""
    merit: float = 0.0
    """What it adds to the logarithm of the odds; negative speaks against."""


@dataclass(frozen=True)
class Detection:
    """What became of one candidate, and why."""

    id: int
    """That of the candidate's ``Cluster``."""
    model: str
    fate: str
    """``"accepted"``, ``"ambiguous"``, ``"duplicate"`` or ``"rejected"``."""
    reason: str
    T_world_object: F64
    """(4, 4), the fitted stretch included."""
    T_scene_model: F64
    """(4, 4) from the model file's coordinates to the scene's."""
    position_world: Vector
    position_scene: Vector
    heading_deg: float
    """Of the object's +x axis in the world, counter-clockwise from +x."""
    heading_margin: float
    """How much better it is than the best other heading.

    By evidence: its score minus that one's, the score itself without a rival; by trimmed ICP:
    (that one's residual - its own) / its own.
    """
    correlation: float
    rms_m: float
    inlier_weight: float
    """Sum of the weights of the points that ``rms_m`` is over; by ICP the number of pairs."""
    runner_up_heading_deg: float
    runner_up_rms_m: float
    coverage_model: float
    """Share of the model's visible surface that the scene explains."""
    coverage_scene: float
    """Share of the scene's points in the object's box that the model explains."""
    observed: float
    """Share of the model's surface that could have been seen."""
    score: float
    """0..1."""
    parts: tuple[Part, ...] = field(default=())
    size_m: Vector = (0.0, 0.0, 0.0)
    """Length, width and height as fitted."""
    alternative: str = ""
    """Next best model for the same place, empty if there is none."""
    alternative_margin: float = 0.0
    cause: str = ""
    """What decided the fate: ``shown``, ``score``, ``observed``, ``sheltered``, ``continues``,
    ``type``, ``duplicate``, ``nothing``, ``residual`` or ``points``."""
    duplicate_of: int = -1
    """The candidate that stands in the same place, -1 if there is none."""
    log_odds: float = 0.0
    """Logarithm of the odds that it is an instance: it ranks what the score rounds to 0 or 1."""
    tilt_deg: float = 0.0
    """Of what it stands on, and of the object with it."""
    gate_m: float = 0.0
    """A point farther than this from the fitted surface is not explained by it."""
    sharp_m: float = 0.0
    """The same without the noise of single points."""
    min_score: float = 0.5
    """Score from which on it would be accepted."""
