"""Models of objects: read a mesh or a cloud, set it upright, sample the surface that is visible."""

# trimesh's types are incomplete
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false

from __future__ import annotations

import re
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field, field_validator, model_validator

from spinpipe.schemas.records import F64, ObjectModel
from spinpipe.stages.geometry.seen_from_above import sample_seen, seen_from_above, seen_from_around
from spinpipe.stages.geometry.shapes import Mesh, face_areas_and_normals, transform
from spinpipe.stages.ingest.read_ply import read_header
from spinpipe.stages.ingest.scene_source import open_scene
from spinpipe.stages.ingest.vehicles import VEHICLES, vehicle_mesh
from spinpipe.stages.stage import InputPath, Section, StageError

Axis = Literal["x", "y", "z", "-x", "-y", "-z"]

_MESHES = (".obj", ".stl", ".ply", ".glb", ".gltf", ".off")
_CLOUDS = (".ply", ".las", ".laz")
_CHUNK = 1 << 18


class ModelConfig(Section):
    """One ``[[model]]``: an object to look for."""

    name: str = Field(description="name of the object: letters, digits, '_', '-' and '.'")
    path: InputPath | None = Field(
        default=None, description="mesh (OBJ, STL, PLY, GLB, OFF) or cloud (PLY, LAS)"
    )
    shape: Literal["", *VEHICLES] = Field(  # pyright: ignore[reportInvalidTypeForm]
        default="", description=f"instead of a path a shape that ships: {', '.join(VEHICLES)}"
    )
    visible_from: Literal["all", "above"] = Field(
        default="all",
        description="which part of a mesh the photos show: all of it or what lies open above",
    )
    scale: float = Field(default=1.0, gt=0, description="metres per unit of the file")
    up: Axis = Field(default="z", description="axis of the file that points up")
    forward: Axis = Field(
        default="x", description="axis of the file that points forward: heading 0"
    )
    samples: int = Field(
        default=25_000, ge=100, le=5_000_000, description="points drawn from a mesh"
    )
    stretch: float = Field(
        default=0.0, ge=0, le=0.5, description="how far each axis may stretch to fit, 0.1 = 10 %"
    )

    @field_validator("name")
    @classmethod
    def _plain(cls, name: str) -> str:
        if not re.fullmatch(r"[A-Za-z0-9_.-]+", name):
            raise ValueError(f"'{name}' may hold only letters, digits, '_', '-' and '.'")
        return name

    @model_validator(mode="after")
    def _one_source(self) -> ModelConfig:
        if (self.path is None) == (self.shape == ""):
            raise ValueError("give either a path or the shape of a model that ships")
        return self

    @model_validator(mode="after")
    def _not_parallel(self) -> ModelConfig:
        if self.up[-1] == self.forward[-1]:
            raise ValueError(
                f"up = '{self.up}' and forward = '{self.forward}' lie along one axis; "
                "set forward to another"
            )
        return self


def load_model(config: ModelConfig, rng: np.random.Generator) -> ObjectModel:
    """Read or make an object's model and bring it to the object frame.

    A mesh is sampled uniformly by area where it shows from around; with ``visible_from = "above"``
    only where the surface lies open to a sensor that looks straight down [Bovenkamp 2010, section
    3.2]. Of a cloud all points stay: it already is what a sensor saw.

    Raises
    ------
    StageError
        When the file is missing, unreadable, empty, without area, or holds NaN.
    """
    where = f"[[model]] '{config.name}': {config.path or config.shape}"
    if config.path is None:
        mesh = Mesh(*vehicle_mesh(config.shape))
        corners = mesh.vertices
    else:
        if not config.path.is_file():
            raise StageError(f"{where}: no such file; correct the model's path")
        mesh = _read_mesh(config.path, where)
        corners = mesh.vertices if mesh else _read_cloud(config.path, where)
    if not np.isfinite(corners).all():
        raise StageError(f"{where}: holds coordinates that are not finite; repair the model")
    T_object_model = _object_from_model(corners, config)
    points = transform(T_object_model, corners)
    if mesh is None:
        return ObjectModel(
            name=config.name,
            points=points.astype(np.float32),
            normals=np.zeros((len(points), 3), np.float32),
            vertices=np.empty((0, 3), np.float32),
            faces=np.empty((0, 3), np.int32),
            T_object_model=T_object_model,
            visible_from=config.visible_from,
            stretch=config.stretch,
        )
    upright = Mesh(points, mesh.faces)
    if not face_areas_and_normals(*upright)[0].sum() > 0:
        raise StageError(f"{where}: its faces have no area; give a mesh with a surface")
    samples, normals = _sample_visible(upright, config, rng)
    return ObjectModel(
        name=config.name,
        points=samples.astype(np.float32),
        normals=normals.astype(np.float32),
        vertices=upright.vertices.astype(np.float32),
        faces=upright.faces.astype(np.int32),
        T_object_model=T_object_model,
        visible_from=config.visible_from,
        stretch=config.stretch,
    )


def _read_mesh(path: Path, where: str) -> Mesh | None:
    """All faces of the file in one mesh; None where the file is a cloud."""
    suffix = path.suffix.lower()
    if suffix not in _MESHES:
        if suffix in _CLOUDS:
            return None
        known = ", ".join(dict.fromkeys(_MESHES + _CLOUDS))
        raise StageError(f"{where}: cannot read '{suffix}' files as a model; give one of {known}")
    if suffix == ".ply" and not read_header(path).count("face"):
        return None
    import trimesh  # heavy: only where needed

    try:
        scene = trimesh.load_scene(path, process=False, skip_materials=True)
        mesh = scene.to_mesh()
    except Exception as error:  # trimesh's loaders raise many kinds
        raise StageError(
            f"{where}: cannot read the mesh ({' '.join(str(error).split())}); export it again"
        ) from error
    faces = np.asarray(mesh.faces, np.int64).reshape(-1, 3)
    if not len(faces):
        raise StageError(f"{where}: has no faces; give a mesh, or a cloud as PLY")
    used, compact = np.unique(faces, return_inverse=True)
    return Mesh(np.asarray(mesh.vertices, np.float64)[used], compact.reshape(-1, 3))


def _read_cloud(path: Path, where: str) -> F64:
    chunks = [xyz for xyz, _ in open_scene(path).chunks(_CHUNK)]
    points = np.concatenate([np.empty((0, 3)), *chunks])
    if len(points) < 3:
        raise StageError(f"{where}: has neither faces nor enough points; give a mesh or a cloud")
    return points


def _object_from_model(points: F64, config: ModelConfig) -> F64:
    """Similarity T_object_model: metres, upright, base centre at the origin."""
    up, forward = _direction(config.up), _direction(config.forward)
    T = np.eye(4)
    T[:3, :3] = config.scale * np.stack([forward, np.cross(up, forward), up])
    turned = transform(T, points)
    low, high = turned.min(axis=0), turned.max(axis=0)
    T[:3, 3] = -np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
    return T


def _direction(axis: Axis) -> F64:
    direction = np.zeros(3)
    direction["xyz".index(axis[-1])] = -1.0 if axis.startswith("-") else 1.0
    return direction


def _sample_visible(mesh: Mesh, config: ModelConfig, rng: np.random.Generator) -> tuple[F64, F64]:
    """Like ``sample_surface``, but only points that show, with normals to where they show."""
    if config.visible_from == "all":
        return sample_seen(mesh, config.samples, seen_from_around, rng)
    points, normals = sample_seen(mesh, config.samples, seen_from_above, rng)
    # Whichever way a face is wound: from above one sees the side that is turned up
    normals[normals[:, 2] < 0] *= -1
    return points, normals
