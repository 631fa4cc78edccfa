"""Values that nobody should type, objects and clouds that are hardly any: a sentence, or a run."""

from __future__ import annotations

import math
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from spinpipe.pipeline.config import SECTIONS, ConfigError, load_config, own_keys

if TYPE_CHECKING:
    from tests.conftest import Cli, Outcome, YardRun

Bounds = tuple[float, float]


def numbers() -> dict[str, tuple[Bounds, ...]]:
    """Least and greatest value of every key that takes a number, for each way to give it."""
    found: dict[str, tuple[Bounds, ...]] = {}
    for name, section in SECTIONS.items():
        properties = section.model_json_schema()["properties"]
        for key in own_keys(section):
            place = "model.saloon" if name == "model" else name
            if ranges := tuple(_ranges(properties[key])):
                found[f"{place}.{key}"] = ranges
    return found


def _ranges(schema: dict[str, Any]) -> list[Bounds]:
    if schema.get("type") in ("integer", "number"):
        low, high = schema.get("minimum"), schema.get("maximum")
        if low is None:
            low = math.nextafter(schema["exclusiveMinimum"], math.inf)
        if high is None:
            high = math.nextafter(schema["exclusiveMaximum"], -math.inf)
        return [(low, high)]
    return [found for way in schema.get("anyOf", ()) for found in _ranges(way)]


NUMBERS = numbers()
ODD = (
    "0",
    "-1",
    "1e-300",
    "1e-9",
    "1e9",
    "1e300",
    "-1e300",
    "nan",
    "-inf",
    "true",
    "[]",
    "[0, 0, 0]",
)
VECTORS = ("[1.0]", "[1, 2, 3, 4]", "[nan, 0, 1]", "[inf, 0, 1]", '["x", "y", "z"]', "[[1, 2, 3]]")


@pytest.mark.parametrize("key", [*NUMBERS, "ground.up", "ingest.scale_from.points"])
def test_a_config_takes_what_is_possible_and_names_the_rest(
    key: str, finished_yard: YardRun
) -> None:
    for text in (*ODD, *VECTORS):
        said = refusal(finished_yard.config, f"{key}={text}")
        assert "\n" not in said
        value = tomllib.loads(f"v = {text}")["v"]
        if isinstance(value, list):
            assert said or key in ("ground.up", "ingest.scale")
        else:
            inside = any(low <= value <= high for low, high in NUMBERS.get(key, ()))
            assert inside or key.rpartition(".")[2] in said, text


def refusal(config: Path, override: str) -> str:
    try:
        load_config(config, [override])
    except ConfigError as error:
        return str(error)
    return ""


def well_told(outcome: Outcome) -> None:
    assert outcome.code in (0, 1, 2), outcome.err
    assert outcome.err.count("\n") == (1 if outcome.code else 0), outcome.err


RUNS = [
    *(("ingest.scale", value) for value in (1e-9, 1e9, [1e-9, 1, 1e9])),
    *(("model.saloon.scale", value) for value in NUMBERS["model.saloon.scale"][0]),
    *(("ground.up", value) for value in ([1e-300, 0, 0], [0, 1e300, 1e300])),
    *(("ground.min_margin", value) for value in NUMBERS["ground.min_margin"][0]),
    *(
        (f"scan.{key}", value)
        for key in ("radius_m", "height_m", "bin_m", "lift_m", "noise_m", "voxel_m")
        for value in NUMBERS[f"scan.{key}"][0]
    ),
    *(("cluster.max_edge_m", value) for value in NUMBERS["cluster.max_edge_m"][0]),
]


@pytest.fixture(scope="module")
def other_yard(finished_yard: YardRun, tmp_path_factory: pytest.TempPathFactory) -> YardRun:
    return finished_yard.copy(tmp_path_factory.mktemp("odd"))


@pytest.mark.parametrize(("key", "value"), RUNS, ids=str)
def test_the_ends_of_what_is_possible_run(
    key: str, value: object, other_yard: YardRun, cli: Cli
) -> None:
    stage = "scan" if key.startswith("ground") else key.partition(".")[0]
    until = {"ingest": "model"}.get(stage, stage)
    arguments = ("--until", until, "--rerun", "off", "-o", other_yard.output)
    well_told(cli("run", other_yard.config, *arguments, "--set", f"{key}={value}"))
