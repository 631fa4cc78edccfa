"""A model as its file holds it: mesh or cloud, and which of the file's axes point up and forward.

glTF fixes the axes. Other formats do not: CAD and survey put z up, modellers and game engines y.
What is stated counts; else what would stand more plausibly.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from scipy.spatial import KDTree

from spinpipe.schemas.arrays import F64, I64
from spinpipe.schemas.records import Vector
from spinpipe.stages.geometry.hashing import GOLDEN
from spinpipe.stages.geometry.shapes import face_areas_and_normals, sample_surface
from spinpipe.stages.ingest.point_blocks import hashed
from spinpipe.stages.ingest.readers.coordinates import Coordinates
from spinpipe.stages.ingest.readers.file_kind import file_kind
from spinpipe.stages.ingest.readers.mesh import MESHES, collada_asset, read_mesh
from spinpipe.stages.ingest.readers.open_scene import open_scene
from spinpipe.stages.stage import StageError

Axis = Literal["x", "y", "z", "-x", "-y", "-z"]
Direction = Axis | Vector
"""An axis of the file, or any direction in its coordinates."""

_CHUNK = 1 << 18
_SAMPLES = 2000
_FEWEST = 50
"""Points that show a shape; the verification asks for as many."""
_FARTHEST = 1e15
"""Of a coordinate: nanometres to the Moon; the areas of faces must be finite."""
_MIRROR_REACH = 0.03
"""How near to a mirrored point there must be another, as a share of the model's diagonal."""
_BASE = 0.01
"""A model stands on the plane of its axes if its lowest point is as near, in its height."""
_BASE_WEIGHT = 0.5
"""A base put at zero on purpose speaks as much as half the symmetry of a car."""
_THIN = 0.05
"""A model is flat if it is thinner along z than this share of its longest side."""
_LONGER = 1.2
"""Things face along the axis in which they are longer by this much, whatever is usual."""
_CLEARLY = 0.2
"""Difference in plausibility from which one axis is taken for another."""


@dataclass(frozen=True)
class ModelFile:
    """What a model's file holds, in the file's own coordinates."""

    kind: str
    corners: F64
    """(V, 3) vertices, or points of a cloud."""
    faces: I64 | None
    """(F, 3) rows of them; None for a cloud."""
    up: Direction
    forward: Axis
    reason: str
    """Why that axis is up, to stand behind its name."""
    doubt: str = ""
    """What the user should look at, empty where nothing."""
    coordinates: Coordinates = field(default_factory=Coordinates)
    """Unit as far as the file tells."""

    @property
    def metres(self) -> float | None:
        """Metres a unit; None where the file does not say, or has several."""
        told = set(self.coordinates.metres or ())
        return told.pop() if len(told) == 1 else None

    @property
    def closed(self) -> bool:
        """Whether every edge of the mesh belongs to exactly two faces."""
        if self.faces is None:
            return False
        # Files repeat a vertex for every face that has other normals there
        place = np.unique(hashed(self.corners, GOLDEN), return_inverse=True)[1]
        faces = place[self.faces]
        edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]))
        edges = edges[edges[:, 0] != edges[:, 1]]
        keys = edges[:, 0] * len(place) + edges[:, 1]
        return bool((np.unique(keys, return_counts=True)[1] == 2).all())


def open_model(path: Path, up: Direction | None, forward: Axis | None) -> ModelFile:
    """Read a model and settle its axes.

    Parameters
    ----------
    path : a mesh, or a cloud in any format of scenes.
    up, forward : as stated; None to find out.

    Raises
    ------
    StageError
        When the file is missing, unreadable, empty or holds coordinates that are not finite.
    """
    kind = file_kind(path) if not path.is_dir() else "colmap"
    mesh = read_mesh(path, kind) if kind in MESHES else None
    said: Axis | None = None
    why = ""
    if mesh is not None:
        corners, faces, name, told = mesh.vertices, mesh.faces, mesh.kind, mesh.coordinates
        if mesh.up is not None:  # [Khronos glTF 2.0, section 3.4]: the front faces +z
            said, why = "y", "by the glTF specification"
        elif kind == "dae":
            said, why = collada_asset(path)[1], "as the DAE file says"
    else:
        source = open_scene(path)
        chunks = [xyz for xyz, _ in source.chunks(_CHUNK)]
        corners, faces = np.concatenate([np.empty((0, 3)), *chunks]), None
        corners = corners[np.isfinite(corners).all(axis=1)]
        name, told = f"{source.about.kind} cloud", source.about.coordinates
        if kind == "las":
            said, why = "z", "the height in LAS"
        if len(corners) < _FEWEST:
            raise StageError(
                f"{path}: has neither faces nor enough points ({len(corners)}, {_FEWEST} are the "
                "least); give a mesh or a denser cloud"
            )
    if not (np.abs(corners) < _FARTHEST).all():
        raise StageError(
            f"{path}: holds coordinates that are not finite or over {_FARTHEST:g}; repair the model"
        )
    doubt = ""
    chosen: Direction
    if up is not None:
        chosen, why = up, "as stated"
    elif said is not None:
        chosen = said
        if kind == "dae" and said != (other := _plausible_up(corners, faces)[0]):
            doubt = (
                f"{said} is taken for up, as the file says, but {other} stands more plausibly; "
                f"state up = '{said}' or up = '{other}'"
            )
    else:
        chosen, why, doubt = _plausible_up(corners, faces)
        if forward is not None and forward[-1] == chosen:
            chosen, why, doubt = ("y" if forward[-1] == "z" else "z"), "forward is stated", ""
    # many exporters leave the front of glTF at +x
    usual: Axis = "z" if kind in ("glb", "gltf") and not up else "x"
    front = forward or _front(corners, nearest_axis(chosen), usual)
    return ModelFile(name, corners, faces, chosen, front, why, doubt, told)


def nearest_axis(direction: Direction) -> Axis:
    """The axis of the file that is least off."""
    if isinstance(direction, str):
        return direction
    axes: tuple[Axis, ...] = ("x", "y", "z")
    return axes[int(np.argmax(np.abs(direction)))]


def _front(corners: F64, up: Axis, usual: Axis = "x") -> Axis:
    """The usual axis, unless the model is clearly longer along the other level one."""
    axes: tuple[Axis, ...] = ("x", "y", "z")
    level: list[Axis] = [axis for axis in axes if axis != up[-1]]
    first = usual if usual in level else level[0]
    other = level[1] if first == level[0] else level[0]
    size: dict[Axis, float] = dict(zip(axes, np.ptp(corners, axis=0).tolist(), strict=True))
    return other if size[other] > _LONGER * size[first] else first


def _plausible_up(corners: F64, faces: I64 | None) -> tuple[Axis, str, str]:
    """The axis along which the model stands most plausibly; why; and what is doubtful.

    Things that stand are alike left and right, not top and bottom; and modellers put the base of
    a thing at zero. Hardly any file has x up: the base must be at zero along x and no other axis.
    """
    size = np.ptp(corners, axis=0)
    if size[2] <= _THIN * size.max():
        return "z", "the model is flat and lies", ""
    if faces is not None and face_areas_and_normals(corners, faces)[0].sum() > 0:
        rng = np.random.default_rng(0)
        points = sample_surface(corners, faces, _SAMPLES, rng)[0]
    else:
        points = corners[:: max(1, len(corners) // _SAMPLES)]
    tree = KDTree(points)
    reach = _MIRROR_REACH * float(np.linalg.norm(size))
    middle = (corners.min(axis=0) + corners.max(axis=0)) / 2
    plausible: dict[Axis, float] = {}
    based: dict[Axis, bool] = {}
    axes: tuple[tuple[int, Axis], ...] = ((0, "x"), (1, "y"), (2, "z"))
    for axis, name in axes:
        mirrored = points.copy()
        mirrored[:, axis] = 2 * middle[axis] - mirrored[:, axis]
        unlike = float(np.mean(tree.query(mirrored, distance_upper_bound=reach)[0] > reach))
        based[name] = abs(float(corners[:, axis].min())) <= _BASE * size[axis]
        plausible[name] = unlike + _BASE_WEIGHT * based[name]
    other: Axis = "y" if plausible["y"] > plausible["z"] else "z"
    x_alone = based["x"] and not (based["y"] or based["z"])
    if x_alone and plausible["x"] - plausible[other] > _CLEARLY:
        return (
            "x",
            f"it stands more plausibly than along {other}",
            f"x is taken for up, it stands more plausibly than {other}; state up = 'x' or up = "
            f"'{other}'",
        )
    more = plausible["y"] - plausible["z"]
    if more > _CLEARLY:
        return (
            "y",
            "it stands more plausibly than along z",
            "y is taken for up, it stands more plausibly than z; state up = 'y' or up = 'z'",
        )
    if more > -_CLEARLY:
        return (
            "z",
            "as is usual; y is as plausible",
            "z is taken for up, y would do as well; state up = 'z' or up = 'y'",
        )
    return "z", "it stands more plausibly than along y", ""
