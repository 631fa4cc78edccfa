"""``docs/config.md``: every key of a config, from the models that check it.

``uv run python -m spinpipe.pipeline.config_reference > docs/config.md`` writes it anew.
"""

from __future__ import annotations

import sys

from pydantic.fields import FieldInfo

from spinpipe.pipeline.config import SECTIONS, brackets, own_keys
from spinpipe.pipeline.tables import default_text

HEADER = """\
# Every key of a config

Generated from the models that check a config: `spinpipe stages` prints the same.
"none" means: follows from the model, the density of the cloud or its noise.
"""


def config_reference() -> str:
    """The page, as markdown."""
    lines = [HEADER]
    for name, section in SECTIONS.items():
        summary = (section.__doc__ or "").strip().partition("\n")[0]
        lines += [f"## {brackets(name)}", "", summary, ""]
        keys = own_keys(section)
        if keys:
            lines += ["| key | default | range | meaning |", "|---|---|---|---|"]
        for key, field in keys.items():
            meaning = (field.description or "").replace("|", "\\|")
            lines.append(f"| `{key}` | `{default_text(field)}` | {_range(field)} | {meaning} |")
        lines.append("")
    return "\n".join(lines).rstrip() + "\n"


def _range(field: FieldInfo) -> str:
    """Bounds of a number in words, empty if there are none."""
    signs = {"ge": "≥", "gt": ">", "le": "≤", "lt": "<"}
    bounds = [
        f"{sign} {getattr(bound, name):g}"
        for name, sign in signs.items()
        for bound in field.metadata
        if hasattr(bound, name)
    ]
    return ", ".join(bounds)


if __name__ == "__main__":
    sys.stdout.write(config_reference())
