"""The page of all keys is that of the present config."""

from __future__ import annotations

from pathlib import Path

from spinpipe.pipeline.config import SECTIONS, own_keys
from spinpipe.pipeline.config_reference import config_reference

PAGE = Path(__file__).parents[3] / "docs" / "config.md"


def test_the_page_is_up_to_date() -> None:
    assert PAGE.read_text() == config_reference(), (
        "run: uv run python -m spinpipe.pipeline.config_reference > docs/config.md"
    )


def test_every_key_is_on_it() -> None:
    lines = PAGE.read_text().splitlines()
    for section in SECTIONS.values():
        for key in own_keys(section):
            assert any(line.startswith(f"| `{key}` |") for line in lines), key
