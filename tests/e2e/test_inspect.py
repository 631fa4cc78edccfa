"""What inspect says of files, against what is known of them."""

from __future__ import annotations

import json
import os
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

if TYPE_CHECKING:
    from tests.conftest import Cli, Yard

COLUMNS = 80


def inspected(cli: Cli, *arguments: str | Path) -> Any:
    outcome = cli("inspect", "--json", *arguments)
    assert outcome.out, outcome.err
    return json.loads(outcome.out)["files"]


def test_a_scene_and_a_model_as_a_table(
    cli: Cli, yard: Yard, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    yard.write(tmp_path)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    monkeypatch.setenv("COLUMNS", str(COLUMNS))
    outcome = cli("inspect", "scene.ply", "gone.ply", cwd=tmp_path)
    assert outcome.code == 1
    assert "gone.ply: no such file" in outcome.err
    lines = outcome.out.splitlines()
    assert max(map(len, lines)) <= COLUMNS
    assert lines[0] == "scene.ply: a scene"
    rows = {line[:11].strip(): line[11:].strip() for line in lines[1:]}
    assert rows["points"] == f"{len(yard.xyz):,}"
    assert rows["up"].startswith("[0.0000, 0.0000, 1.0000], from points")
    assert rows["unit"].startswith("1 m, assumed")
    assert not list((tmp_path / "temporary").iterdir()), "it leaves nothing behind"
    (cloud,) = inspected(cli, "--as", "model", tmp_path / "saloon.ply")
    assert (cloud["role"], cloud["faces"], cloud["points"]) == ("model", 0, len(yard.model))
    np.testing.assert_allclose(cloud["size_m"], np.ptp(yard.model, axis=0), rtol=1e-3)


def test_what_does_not_tell_its_up_is_told_all_else(cli: Cli, tmp_path: Path) -> None:
    xyz = np.random.default_rng(0).normal(0, 1, (3000, 3))
    np.savetxt(tmp_path / "ball.xyz", xyz, fmt="%.6f")
    outcome = cli("inspect", "ball.xyz", "--json", cwd=tmp_path)
    assert outcome.code == 1
    assert "cannot tell which way is up" in outcome.err
    (facts,) = json.loads(outcome.out)["files"]
    assert facts["points"] == 3000
    assert "set ground.up" in facts["refused"]
    assert "up" not in facts


UP, FLAT = (0.0, 0.0, 1.0), 0.1
MANY = 250_000
SCENES: dict[str, tuple[int, dict[str, Any]]] = {
    # points with those left out, and what NOTES.md there says
    "photo-west/scene.ply": (222_508, {"coloured": True, "spacing_m": 0.12, "error_m": FLAT}),
    "lot-north/scene.ply": (649_938, {"coloured": True, "spacing_m": 0.08}),
    "bus-yard/scene.ply": (374_600, {"coloured": True, "spacing_m": 0.12, "error_m": FLAT}),
    "prisms-north/scene.laz": (721_024, {"coloured": True, "spacing_m": 0.11}),
    "lapaz-street/scene.laz": (1_410_248, {"coloured": True, "spacing_m": 0.1}),
    "deck-west/scene.ply": (576_782, {"coloured": True, "levels_m": (0, 17)}),
    "brighton/colmap_sparse": (6_847, {"cameras": 18}),
    "brighton/pmvs/scene_binary.ply": (591_970, {"fields": ["nx", "ny", "nz"]}),
    "brighton/pmvs/option-first30000.ply": (30_000, {"coloured": True}),
    "brighton/odm_model.laz": (940_393, {"crs": "EPSG:32615"}),
    "formats/laspy_las/autzen_trim.laz": (110_000, {"metres_a_unit": [0.3048] * 3}),
    "formats/odm_laz/brighton_small.laz": (401_286, {}),
    "formats/odm_laz/test.laz": (269_915, {}),
    "formats/colmap_old_bin/sparse/0": (699, {"cameras": 7, "up": None}),
    "formats/pmvs_bundler_kermit/option-0000.ply": (10_003, {"coloured": True, "up": None}),
    "formats/colmap_fused_crlf/fused.ply": (110_106, {"coloured": True, "up": None}),
}


@pytest.mark.parametrize("name", SCENES)
def test_it_agrees_with_the_notes_on_scenes(cli: Cli, shared_data: Path, name: str) -> None:
    points, expected = SCENES[name]
    path = shared_data / name
    if not path.exists():
        pytest.skip(f"{name} is not here")
    if points > MANY and not os.environ.get("SPINPIPE_ALL_DATA"):
        pytest.skip("takes seconds: with SPINPIPE_ALL_DATA=1 only")
    (facts,) = inspected(cli, path)
    left_out = facts["strays"] + facts["duplicates"] + facts["not_finite"]
    assert facts["points"] + left_out == points
    if expected.get("up", UP):
        assert facts["up"]["direction"] @ np.array(UP) > np.cos(np.radians(2))
    for key in {"coloured", "cameras", "fields", "crs", "metres_a_unit"} & expected.keys():
        assert facts[key] == expected[key]
    if "spacing_m" in expected:  # NOTES.md has points per square metre of plan, with their copies
        assert facts["spacing_m"] == pytest.approx(expected["spacing_m"], rel=0.3)
    if "error_m" in expected:
        assert facts["errors"][2]["error_m"] < expected["error_m"]
    if "levels_m" in expected:
        heights = [level["height_m"] for level in facts["ground"]["levels"]]
        np.testing.assert_allclose(heights, expected["levels_m"], atol=1.5)


def test_it_agrees_with_the_notes_on_models(cli: Cli, shared_data: Path) -> None:
    folder = shared_data / "models"
    if not folder.exists():
        pytest.skip("models are not here")
    names = ("saloon.obj", "sedan.glb", "beetle.obj")
    saloon, sedan, beetle = inspected(cli, *(folder / name for name in names))
    assert saloon["size_m"][0] == 4.2
    assert (saloon["up"]["axis"], saloon["forward"]) == ("z", "x")
    np.testing.assert_allclose(sedan["size_m"], (2.55, 1.5, 1.3))
    assert sedan["up"] == {"axis": "y", "why": "by the glTF specification"}
    assert (beetle["up"]["axis"], beetle["forward"]) == ("y", "z")
