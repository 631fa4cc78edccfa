"""Tables for the terminal, readable at 80 columns."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence

from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined
from rich.console import Group
from rich.table import Table
from rich.text import Text

from spinpipe.pipeline.config import SECTIONS, brackets, own_keys
from spinpipe.pipeline.inspect import Facts, fact_rows
from spinpipe.pipeline.plan import Step
from spinpipe.schemas.records import Detection
from spinpipe.stages import STAGES
from spinpipe.stages.stage import Section

MAX_ROWS = 40


def detection_table(detections: Sequence[Detection]) -> Group:
    """The accepted and ambiguous detections, and a line that counts all fates."""
    shown = sorted(
        (d for d in detections if d.fate in ("accepted", "ambiguous")),
        key=lambda d: (d.fate, -d.score, d.id),
    )
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("id", justify="right")
    table.add_column("model")
    frames = {"x": "scene", "y": "scene", "z": "scene", "heading": "world", "rms": "m"}
    for name, unit in frames.items():
        table.add_column(f"{name}\n{unit}", justify="right", no_wrap=True)
    table.add_column("score", justify="right", no_wrap=True)
    table.add_column("fate")
    for d in shown[:MAX_ROWS]:
        position = (f"{v:z.2f}" for v in d.position_scene)
        numbers = (f"{d.heading_deg:.0f}°", f"{d.rms_m:.3f}", f"{d.score:.2f}")
        table.add_row(str(d.id), d.model, *position, *numbers, d.fate)
    more = len(shown) - MAX_ROWS
    lines: list[Table | Text] = [table] if shown else []
    if more > 0:
        lines.append(Text(f"and {more} more in detections.csv"))
    lines.append(Text(_summary(detections)))
    return Group(*lines)


def _summary(detections: Sequence[Detection]) -> str:
    if not detections:
        return "no detections: the scan found no candidate"
    fates = Counter(d.fate for d in detections)
    models = Counter(d.model for d in detections if d.fate == "accepted")
    found = ", ".join(f"{n} {model}" for model, n in sorted(models.items())) or "none"
    rest = [
        f"{fates[fate]} {fate}" for fate in ("ambiguous", "duplicate", "rejected") if fates[fate]
    ]
    return f"accepted: {found}" + "".join(f"; {text}" for text in rest)


def plan_table(steps: Sequence[Step]) -> Table:
    """What every stage would do and why."""
    table = Table(box=None, pad_edge=False, header_style="bold")
    for name in ("stage", "action", "why"):
        table.add_column(name)
    for step in steps:
        table.add_row(step.stage.name, step.action, Text(step.reason))
    return table


def facts_table(facts: Facts) -> Group:
    """What is known of a scene or a model."""
    table = Table(box=None, pad_edge=False, show_header=False)
    table.add_column(no_wrap=True, style="dim")
    table.add_column()
    for name, text in fact_rows(facts):
        table.add_row(f"  {name}", Text(text))
    return Group(Text(f"{facts['path']}: a {facts['role']}", style="bold"), table)


def stage_tables() -> Iterator[Group]:
    """For every section its keys with defaults and meanings; for stages their topics too."""
    for stage in STAGES:
        flow = [f"reads  {', '.join(t.name for t in stage.inputs) or 'the input files'}"]
        flow.append(f"writes {', '.join(t.name for t in stage.outputs)}")
        summary = (type(stage).__doc__ or "").strip().partition("\n")[0]
        yield Group(
            Text(f"\n{stage.name}: {summary}", style="bold"),
            *(Text(line, style="dim") for line in flow),
        )
        yield from (_keys(n, s) for n, s in SECTIONS.items() if n.split(".")[0] == stage.name)
    for name in ("run", "execution", "record"):
        yield _keys(name, SECTIONS[name])


def _keys(name: str, section: type[Section]) -> Group:
    """The keys of one section below its heading."""
    table = Table(box=None, pad_edge=False, show_header=False)
    table.add_column(no_wrap=True)
    table.add_column(no_wrap=True)
    table.add_column()
    for key, field in own_keys(section).items():
        # as text: rich would take [x, y, z] for markup
        cells = (f"  {key}", default_text(field), field.description or "")
        table.add_row(*(Text(cell) for cell in cells))
    summary = (section.__doc__ or "").strip().partition("\n")[0]
    return Group(Text(f"{brackets(name)} {summary}"), table)


def default_text(field: FieldInfo) -> str:
    """A default as it stands in a config file; ``needed`` where there is none."""
    value = field.get_default(call_default_factory=True)
    if value is PydanticUndefined:
        return "needed"
    if value is None:
        return "none"
    if isinstance(value, bool):
        return str(value).lower()
    return f'"{value}"' if isinstance(value, str) else str(value)
