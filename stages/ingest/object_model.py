"""Models of objects: read a mesh or a cloud, set it upright, sample the surface that is visible."""

from __future__ import annotations

import re
from typing import Literal

import numpy as np
from pydantic import Field, field_validator, model_validator

from spinpipe.schemas.arrays import F64
from spinpipe.schemas.records import ObjectModel
from spinpipe.stages.geometry.columns import extremes
from spinpipe.stages.geometry.frames import transform
from spinpipe.stages.geometry.seen_from_above import sample_seen, seen_from_above, seen_from_around
from spinpipe.stages.geometry.shapes import Mesh, face_areas_and_normals
from spinpipe.stages.ingest.model_file import Axis, Direction, ModelFile, open_model
from spinpipe.stages.ingest.vehicles import VEHICLES, vehicle_mesh
from spinpipe.stages.stage import InputPath, Scale, Section, StageError

_SIZES_M = (1e-4, 1e6)
"""Longest side of a model: sizes that photos resolve, and that float32 holds to a decimetre."""
_NOT_PARALLEL = 0.01
"""Sine of the least angle between up and forward."""
_LEAST_STRETCH = 0.001
"""Millimetres of a car."""


class ModelConfig(Section):
    """One ``[[model]]``: an object to look for."""

    name: str = Field(description="name of the object: letters, digits, '_', '-' and '.'")
    path: InputPath | None = Field(
        default=None,
        description="mesh (OBJ, STL, PLY, GLB, OFF, DAE), or cloud in any format of scenes",
    )
    shape: Literal["", *VEHICLES] = Field(  # pyright: ignore[reportInvalidTypeForm]
        default="", description=f"instead of a path a shape that ships: {', '.join(VEHICLES)}"
    )
    visible_from: Literal["all", "above"] = Field(
        default="all",
        description="which part of a mesh the photos show: all of it or what lies open above",
    )
    scale: Scale | None = Field(
        default=None, description="metres per unit of the file; none: as the file says, else 1"
    )
    up: Direction | None = Field(
        default=None,
        description="axis of the file that points up, or [x, y, z] in it; none: y for glTF, else "
        "the one along which the model stands most plausibly",
    )
    forward: Axis | None = Field(
        default=None,
        description="axis of the file that points forward, heading 0; none: x (glTF: z), or the "
        "other level one if the model is clearly longer along it",
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

    @field_validator("stretch")
    @classmethod
    def _none_or_some(cls, stretch: float) -> float:
        if 0 < stretch < _LEAST_STRETCH:
            raise ValueError(f"must be 0 or at least {_LEAST_STRETCH:g}: less cannot be seen")
        return stretch

    @model_validator(mode="after")
    def _one_source(self) -> ModelConfig:
        if (self.path is None) == (self.shape == ""):
            raise ValueError("give either a path or the shape of a model that ships")
        return self

    @model_validator(mode="after")
    def _not_parallel(self) -> ModelConfig:
        if isinstance(self.up, tuple) and not any(self.up):
            raise ValueError("up must not be [0, 0, 0]")
        if not self.up or not self.forward:
            return self
        up, forward = _direction(self.up), _direction(self.forward)
        if not np.linalg.norm(np.cross(up, forward)) > _NOT_PARALLEL:
            raise ValueError(
                f"up = '{self.up}' and forward = '{self.forward}' lie along one axis; "
                "set forward to another"
            )
        return self


def object_model(config: ModelConfig, file: ModelFile, rng: np.random.Generator) -> ObjectModel:
    """Bring what a model's file holds to the object frame and sample it where it shows.

    A mesh is sampled uniformly by area where it shows from around; with ``visible_from = "above"``
    only where the surface lies open to a sensor that looks straight down [Bovenkamp 2010, section
    3.2]. Of a cloud all points stay: it already is what a sensor saw.

    Parameters
    ----------
    config : the ``[[model]]`` section.
    file : see ``read_model``.
    rng : draws the samples.

    Raises
    ------
    StageError
        When it is too small or too large to be looked for, or its faces have no area.
    """
    where = f"[[model]] '{config.name}': {config.path}"
    T_object_model = _object_from_model(file, config.scale or file.metres or 1.0)
    points = transform(T_object_model, file.corners)
    low, high = extremes(points)
    longest_m = float((high - low).max())
    if not _SIZES_M[0] <= longest_m <= _SIZES_M[1]:
        raise StageError(f"{where}: is {longest_m:.3g} m long; correct its scale, or the file")
    if file.faces is None:
        samples, normals = points, np.zeros(points.shape)
        upright = Mesh(np.empty((0, 3)), np.empty((0, 3), np.int64))
    else:
        upright = Mesh(points, file.faces)
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


def read_model(config: ModelConfig) -> ModelFile:
    """The file or the shape of a ``[[model]]``.

    Raises
    ------
    StageError
        As ``open_model``; the message names the model.
    """
    if config.path is None:
        return ModelFile("shape that ships", *vehicle_mesh(config.shape), "z", "x", "as it ships")
    try:
        return open_model(config.path, config.up, config.forward)
    except StageError as error:
        raise StageError(f"[[model]] '{config.name}': {error}") from error


def _object_from_model(file: ModelFile, scale: float) -> F64:
    """Similarity T_object_model: metres, upright, base centre at the origin."""
    up, forward = _direction(file.up), _direction(file.forward)
    forward = forward - up * (up @ forward)
    forward /= np.linalg.norm(forward)
    T = np.eye(4)
    T[:3, :3] = scale * np.stack([forward, np.cross(up, forward), up])
    turned = transform(T, file.corners)
    low, high = extremes(turned)
    T[:3, 3] = -np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
    return T


def _direction(axis: Direction) -> F64:
    """(3,) unit vector."""
    if isinstance(axis, tuple):
        largest = np.array(axis) / np.abs(axis).max()
        return largest / np.linalg.norm(largest)
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
