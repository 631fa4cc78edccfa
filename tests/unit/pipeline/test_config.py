"""Config files: defaults, overrides, and errors that name file, key and the mend in one line."""

from __future__ import annotations

import os
import re
import tomllib
from pathlib import Path

import pytest

from spinpipe.pipeline.config import SECTIONS, ConfigError, RunConfig, load_config
from spinpipe.pipeline.input_files import hash_path
from spinpipe.stages import STAGES
from spinpipe.stages.ingest.ingest import Ingest
from spinpipe.stages.ingest.model import Model
from spinpipe.stages.ingest.object_model import ModelConfig
from spinpipe.stages.scan.scan import Scan
from spinpipe.stages.stage import Section, StageError

MINIMAL = """\
[ingest]
scene = "data/scene.ply"

[[model]]
name = "car"
path = "car.obj"
"""


def load(tmp_path: Path, text: str = MINIMAL, *overrides: str) -> RunConfig:
    path = tmp_path / "lot.toml"
    path.write_text(text)
    return load_config(path, overrides)


def error(tmp_path: Path, text: str = MINIMAL, *overrides: str) -> str:
    with pytest.raises(ConfigError) as caught:
        load(tmp_path, text, *overrides)
    message = str(caught.value)
    assert "\n" not in message
    return message


def ingest(config: RunConfig) -> Ingest.Config:
    section = config.stages["ingest"]
    assert isinstance(section, Ingest.Config)
    return section


def models(config: RunConfig) -> tuple[ModelConfig, ...]:
    section = config.stages["model"]
    assert isinstance(section, Model.Config)
    return section.models


def scan(config: RunConfig) -> Scan.Config:
    section = config.stages["scan"]
    assert isinstance(section, Scan.Config)
    return section


def test_everything_but_scene_and_model_has_a_default(tmp_path: Path) -> None:
    config = load(tmp_path)
    assert config.run.name == "lot"
    assert config.run.seed == 0
    assert set(config.stages) == {stage.name for stage in STAGES}


def test_paths_are_relative_to_the_file(tmp_path: Path) -> None:
    config = load(tmp_path)
    assert ingest(config).scene == tmp_path / "data" / "scene.ply"
    assert models(config)[0].path == tmp_path / "car.obj"


def test_paths_may_start_at_home_or_be_absolute(tmp_path: Path) -> None:
    text = MINIMAL.replace("data/scene.ply", "~/scene.ply").replace("car.obj", "/data/car.obj")
    config = load(tmp_path, text)
    assert ingest(config).scene == Path.home().resolve() / "scene.ply"
    assert models(config)[0].path == Path("/data/car.obj")


def test_paths_of_overrides_are_relative_to_the_current_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here = tmp_path / "here"
    here.mkdir()
    monkeypatch.chdir(here)
    config = load(tmp_path, MINIMAL, "ingest.scene=other.ply", "model.car.path=../model.ply")
    assert ingest(config).scene == here / "other.ply"
    assert models(config)[0].path == tmp_path / "model.ply"


@pytest.mark.parametrize(
    ("override", "expected"),
    [("scan.bin_m=0.25", 0.25), ("scan.bin_m = 2", 2.0), ("scan.bin_m=1e-1", 0.1)],
)
def test_an_override_is_a_toml_value(tmp_path: Path, override: str, expected: float) -> None:
    assert scan(load(tmp_path, MINIMAL, override)).bin_m == expected


def test_an_override_needs_no_quotes(tmp_path: Path) -> None:
    assert scan(load(tmp_path, MINIMAL, "scan.origins=voxel")).origins == "voxel"
    assert scan(load(tmp_path, MINIMAL, 'scan.origins="voxel"')).origins == "voxel"
    assert load(tmp_path, MINIMAL, "run.name=lot-7").run.name == "lot-7"


def test_the_last_override_wins(tmp_path: Path) -> None:
    assert scan(load(tmp_path, MINIMAL, "scan.bin_m=1", "scan.bin_m=2")).bin_m == 2


def test_models_are_overridden_by_name_or_number(tmp_path: Path) -> None:
    text = MINIMAL + '\n[[model]]\nname = "van"\npath = "van.obj"\n'
    config = load(tmp_path, text, "model.van.scale=2", "model.0.scale=3")
    assert [model.scale for model in models(config)] == [3.0, 2.0]


def test_the_resolved_config_gives_the_same_config_from_anywhere(tmp_path: Path) -> None:
    text = MINIMAL + "\n[ground]\nup = [0, 0, 1]\n[scan]\nbin_m = 0.25\n[run]\nseed = 7\n"
    config = load(tmp_path, text)
    elsewhere = tmp_path / "else" / "where"
    elsewhere.mkdir(parents=True)
    (elsewhere / "config.resolved.toml").write_text(config.to_toml())
    assert load_config(elsewhere / "config.resolved.toml") == config


def test_a_file_with_crlf_and_a_byte_order_mark_is_read(tmp_path: Path) -> None:
    path = tmp_path / "lot.toml"
    path.write_bytes(MINIMAL.replace("\n", "\r\n").encode())
    assert load_config(path).run.name == "lot"
    path.write_bytes(b"\xef\xbb\xbf" + MINIMAL.encode())
    assert load_config(path).run.name == "lot"


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"nothing\.toml: no such file"):
        load_config(tmp_path / "nothing.toml")


def test_a_folder_is_no_config(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot be read"):
        load_config(tmp_path)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_an_unreadable_file_is_named(tmp_path: Path) -> None:
    path = tmp_path / "lot.toml"
    path.write_text(MINIMAL)
    path.chmod(0)
    with pytest.raises(ConfigError, match="cannot be read"):
        load_config(path)


@pytest.mark.parametrize("text", ["[scan\n", "scan = \n", "[scan]\nbin_m = 0,1\n", "\x00"])
def test_broken_toml_is_named_with_its_line(tmp_path: Path, text: str) -> None:
    assert "lot.toml: not valid TOML" in error(tmp_path, MINIMAL + text)


@pytest.mark.parametrize(
    ("line", "meant"),
    [
        ("scene = C:/data/scene.ply", "text stands in quotes"),
        ('scene = "C:\\data\\scene.ply"', "write paths with / or in single quotes"),
        ("scene = \u201cscene.ply\u201d", "its quotes are typographic"),
        ("scale = 0,3048", "decimals have a point"),
        ('scene = "a.ply"\nscene = "b.ply"', "'scene = \"b.ply\"' is there twice"),
    ],
)
def test_what_a_broken_line_was_meant_to_be(tmp_path: Path, line: str, meant: str) -> None:
    path = tmp_path / "lot.toml"
    path.write_text(f"[ingest]\n{line}\n", "utf-8")
    with pytest.raises(ConfigError, match=re.escape(meant)):
        load_config(path)


@pytest.mark.parametrize(
    ("name", "meant"),
    [
        ("Scene.PLY", "; did you mean 'scene.ply'?"),
        ("scene", "; did you mean 'scene.ply'?"),
        ('"scene.ply"', "; did you mean 'scene.ply'?"),
        ("sub\\scene.ply", "; folders are parted by / here"),
        ("a\temp.ply", "; escapes like \\t stand in it"),
        ("$HOME/scene.ply", "; variables are not replaced"),
        ("https://a.org/scene.ply", "; links are not followed"),
        ("gone/scene.ply", "gone is not there either"),
        ("other.las", "other.las does not exist"),
    ],
)
def test_what_a_missing_input_was_meant_to_be(tmp_path: Path, name: str, meant: str) -> None:
    (tmp_path / "scene.ply").touch()
    with pytest.raises(StageError, match=re.escape(meant)) as caught:
        hash_path(tmp_path / name, "[ingest] scene")
    assert meant != "other.las does not exist" or str(caught.value).endswith(meant)


def test_bytes_that_are_no_text_are_no_toml(tmp_path: Path) -> None:
    path = tmp_path / "lot.toml"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ConfigError, match="not valid TOML"):
        load_config(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[scan]\nraduis_m = 2\n", "[scan] has no key 'raduis_m'. Did you mean 'radius_m'?"),
        ("[scann]\nradius_m = 2\n", "no section [scann]. Did you mean 'scan'?"),
        ("[nonsense]\n", "no section [nonsense]. There are: run, ingest"),
        ("[scan]\nradius_m = -2\n", "[scan] radius_m = -2: input should be greater than"),
        ("[scan]\nradius_m = 'wide'\n", "[scan] radius_m = 'wide': input should be a valid number"),
        ("[scan]\nradius_m = nan\n", "[scan] radius_m = nan"),
        ("[scan]\nradius_m = inf\n", "[scan] radius_m = inf"),
        ("[scan]\norigins = 'some'\n", "[scan] origins = 'some'"),
        ("[verify.icp]\nstarts = 1.5\n", "[verify.icp] starts = 1.5"),
        ("[verify.icp]\nstart = 1\n", "[verify.icp] has no key 'start'. Did you mean 'starts'?"),
        (
            "[verify]\nstarts = 1\n",
            "[verify] has no key 'starts' any more: it stands in [verify.icp]",
        ),
        ("[verify]\nicp = 1\n", "[verify.icp] must be a section, not a value"),
        ("[run]\nseed = -1\n", "[run] seed = -1"),
        ("[ground]\nup = [0, 0, 0]\n", "[ground] up"),
        ("[ground]\nup = [0, 1]\n", "[ground] up"),
        ("[ground]\nup = 'down'\n", "[ground] up"),
    ],
)
def test_an_error_names_file_section_and_key(tmp_path: Path, text: str, message: str) -> None:
    found = error(tmp_path, MINIMAL + text)
    assert found.startswith("lot.toml: ")
    assert message in found


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no [[model]] section"),
        ("[[model]]\nname = 'a'\npath = 'b'\n", "[ingest] needs 'scene'"),
        ("[ingest]\nscene = 's.ply'\n[[model]]\nname = 'a'\n", "[[model]] 'a': give either"),
        (
            MINIMAL + "\n[[model]]\nname = 'b'\npath = 'c'\nstrech = 1\n",
            "[[model]] 'b' has no key 'strech'. Did you mean 'stretch'?",
        ),
        (MINIMAL + "scale = -1\n", "[[model]] 'car' scale = -1"),
        (MINIMAL.replace('"car"', '"a car"'), "[[model]] 'a car' name = 'a car'"),
        (MINIMAL + "\n[[model]]\nname = 'car'\npath = 'c'\n", "two models have the name 'car'"),
        (MINIMAL.replace("[[model]]", "[model]"), "double brackets"),
        ("scan = 3\n" + MINIMAL, "[scan] must be a section"),
        ("model = 3\n[ingest]\nscene = 'a'\n", "double brackets"),
        ("model = [3]\n[ingest]\nscene = 'a'\n", "double brackets"),
        ("model = []\n[ingest]\nscene = 'a'\n", "[[model]]"),
        ("[ingest]\nscene = 's'\n[[model]]\npath = 'a'\n", "[[model]] number 1 needs 'name'"),
        ("ingest = 3\n[[model]]\nname = 'a'\npath = 'b'\n", "[ingest] must be a section"),
        (MINIMAL.replace('"data/scene.ply"', "3"), "[ingest] scene = 3"),
        (MINIMAL + "up = 'x'\nforward = '-x'\n", "set forward to another"),
    ],
)
def test_an_error_of_models_and_sections_says_what_is_missing(
    tmp_path: Path, text: str, message: str
) -> None:
    assert message in error(tmp_path, text)


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("scan.raduis_m=2", "scan has no key 'raduis_m'. Did you mean 'radius_m'?"),
        ("verify.keep=1", "verify has no key 'keep' any more: it stands in [verify.icp]"),
        ("verify.icp=1", "verify has no key 'icp'. There are: method"),
        ("model.scale=2", "write section.key=value"),
        ("scan.radius_m", "write section.key=value"),
        ("radius_m=2", "write section.key=value"),
        ("scann.radius_m=2", "write section.key=value"),
        ("=", "write section.key=value"),
        ("", "write section.key=value"),
        ("model.bus.scale=2", "no such model. There are: car"),
        ("model.car.scael=2", "Did you mean 'scale'?"),
        ("scan.radius_m=-2", "radius_m = -2"),
        ("scan.radius_m=", "radius_m"),
    ],
)
def test_an_error_of_an_override_quotes_it(tmp_path: Path, override: str, message: str) -> None:
    assert message in error(tmp_path, MINIMAL, override)


def test_an_override_of_a_value_that_is_no_section_is_an_error(tmp_path: Path) -> None:
    assert "[scan] must be a section" in error(tmp_path, "scan = 3\n" + MINIMAL, "scan.bin_m=1")


def test_an_override_of_models_that_are_no_list_is_an_error(tmp_path: Path) -> None:
    text = "model = 3\n[ingest]\nscene = 'a'\n"
    assert "double brackets" in error(tmp_path, text, "model.car.scale=1")


@pytest.mark.parametrize("section", SECTIONS.values(), ids=SECTIONS)
def test_sections_are_frozen_and_forbid_unknown_keys(section: type[Section]) -> None:
    assert section.model_config.get("frozen")
    assert section.model_config.get("extra") == "forbid"


def test_the_resolved_config_holds_no_empty_values(tmp_path: Path) -> None:
    document = tomllib.loads(load(tmp_path).to_toml())
    assert set(document) == {name.partition(".")[0] for name in SECTIONS}
