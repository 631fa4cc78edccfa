"""The config that init writes: complete, commented, and the same as all defaults."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import pytest

from spinpipe.pipeline.config import SECTIONS, brackets, load_config, own_keys
from spinpipe.pipeline.init import commented_config

DOCUMENT: dict[str, Any] = {
    "ingest": {"scene": "lot/scene.ply"},
    "model": [
        {"name": "saloon_v2", "path": "lot/saloon v2.obj", "visible_from": "above", "stretch": 0.1}
    ],
}
TEXT = commented_config("config.toml", DOCUMENT)


def test_it_is_a_config_with_the_scene_and_the_model(tmp_path: Path) -> None:
    path = tmp_path / "config.toml"
    path.write_text(TEXT)
    config = load_config(path)
    models = config.stages["model"].model_dump()["models"]
    assert [model["name"] for model in models] == ["saloon_v2"]
    assert models[0]["path"] == tmp_path / "lot" / "saloon v2.obj"


def test_it_changes_no_default(tmp_path: Path) -> None:
    path, minimal = tmp_path / "config.toml", tmp_path / "minimal.toml"
    path.write_text(TEXT)
    minimal.write_text(
        "[run]\nname = 'config'\n[ingest]\nscene = 'lot/scene.ply'\n"
        "[[model]]\nname = 'saloon_v2'\npath = 'lot/saloon v2.obj'\n"
        "visible_from = 'above'\nstretch = 0.1\n"
    )
    assert load_config(path) == load_config(minimal)


def test_every_key_is_there_and_explained() -> None:
    for name, section in SECTIONS.items():
        body = TEXT.split(f"\n{brackets(name)}\n", 1)[1].split("\n[", 1)[0]
        for key, field in own_keys(section).items():
            assert re.search(rf"^(# )?{key} = ", body, re.MULTILINE), (name, key)
            assert field.description


def test_keys_behind_a_hash_can_be_freed(tmp_path: Path) -> None:
    freed = re.sub(r"^# (\w+ = (?!\.\.\.))", r"\1", TEXT, flags=re.MULTILINE)
    tomllib.loads(freed)
    path = tmp_path / "config.toml"
    path.write_text(freed)
    behind = tmp_path / "behind" / "config.toml"
    behind.parent.mkdir()
    behind.write_text(TEXT.replace("lot/", "../lot/"))
    assert load_config(path).stages == load_config(behind).stages


def test_lines_fit_a_hundred_columns() -> None:
    assert max(map(len, TEXT.splitlines())) <= 100


@pytest.mark.parametrize("model", ["C:\\models\\car.obj", 'say "car".obj', "a\\b.obj"])
def test_odd_file_names_stay_what_they_are(tmp_path: Path, model: str) -> None:
    text = commented_config("config.toml", {"model": [{"name": "car", "path": model}]})
    document = tomllib.loads(text)
    assert document["model"][0]["path"] == model
