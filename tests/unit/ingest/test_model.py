"""The stage that reads the objects to look for."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from spinpipe.schemas import SCENE, TILES
from spinpipe.schemas.records import ObjectModel, SceneFrame, TileIndex
from spinpipe.stages.geometry.shapes import box
from spinpipe.stages.ingest.model import Model
from spinpipe.stages.ingest.readers.mesh import read_mesh
from spinpipe.stages.stage import StageError


@pytest.fixture(scope="module")
def brick(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A model of 4 x 2 x 1 m."""
    path = tmp_path_factory.mktemp("model") / "brick.obj"
    vertices, faces = box(4, 2, 1)
    lines = [f"v {x} {y} {z}" for x, y, z in vertices]
    lines += [f"f {a} {b} {c}" for a, b, c in faces + 1]
    path.write_text("\n".join(lines))
    return path


def read_models(side_m: float, *models: dict[str, Any]) -> list[ObjectModel]:
    """Run the stage in a scene of ``side_m`` in each direction."""
    low, high = (np.full((1, 3), at, np.float32) for at in (0, side_m))
    written: list[ObjectModel] = []
    context = SimpleNamespace(
        config=Model.Config.model_validate({"models": models}),
        rng=np.random.default_rng(0),
        read_one={
            TILES: TileIndex(low, high, np.array([9], np.int64)),
            SCENE: SceneFrame(
                (0.0, 0.0, 0.0), (1.0, 1.0, 1.0), 9, 0, False, "scene.ply", spacing_m=0.1
            ),
        }.__getitem__,
        write=lambda _, model: written.append(model),
        log=lambda _: None,
        progress=lambda *_: SimpleNamespace(advance=lambda: None),
    )
    Model().run(context)
    return written


def test_models_come_in_the_order_of_the_config(brick: Path) -> None:
    models = [{"name": name, "path": brick, "samples": n} for name, n in (("b", 500), ("a", 400))]
    assert [(m.name, len(m.points)) for m in read_models(50, *models)] == [("b", 500), ("a", 400)]


def test_a_model_must_have_room_in_the_scene(brick: Path) -> None:
    with pytest.raises(StageError, match=r"the whole scene 3 m; correct \[ingest\] scale"):
        read_models(3, {"name": "a", "path": brick})


@pytest.mark.parametrize(
    ("scale", "hint"), [(1e3, "0.001 for millimetres"), (100, "0.01 for centimetres or 0.0254")]
)
def test_units_are_named_in_which_a_model_would_show(brick: Path, scale: float, hint: str) -> None:
    model = {"name": "a", "path": brick, "scale": scale}
    with pytest.raises(StageError, match=rf"try \[\[model\]\] scale = {hint}"):
        read_models(36, model)


def test_config_bounds(brick: Path) -> None:
    model = {"name": "a", "path": brick}
    cases: list[tuple[list[dict[str, Any]], str]] = [
        ([], "at least 1 item"),
        ([model, model], "two models have the name 'a'"),
        ([{**model, "stretch": 0.6}], "less than or equal to 0.5"),
        ([{**model, "visible_from": "below"}], "'all' or 'above'"),
    ]
    for models, message in cases:
        with pytest.raises(ValidationError, match=message):
            Model.Config.model_validate({"models": models})


@pytest.mark.parametrize(
    "document",
    [
        "[]",
        '{"asset": {}, "meshes": 7}',
        '{"asset": {}, "meshes": [{}]}',
        '{"asset": {}, "meshes": [{"primitives": [{"attributes": {"POSITION": 9}}]}]}',
        '{"asset": {}, "extensionsUsed": 5}',
    ],
)
def test_gltf_of_another_form_ends_in_a_sentence(tmp_path: Path, document: str) -> None:
    path = tmp_path / "thing.gltf"
    path.write_text(document)
    with pytest.raises(StageError, match=r"thing\.gltf: cannot read the mesh"):
        read_mesh(path, "gltf")
