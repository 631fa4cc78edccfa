"""Sections of a report: for the terminal as tables, for a folder as Markdown with figures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from rich.console import Group
from rich.table import Table
from rich.text import Text


@dataclass(frozen=True)
class Section:
    """One experiment."""

    title: str
    paper: str
    """What the paper reports."""
    here: str
    """What was done here."""
    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    figures: Sequence[tuple[str, str]] = ()
    """File name and caption."""


def section_table(section: Section) -> Group:
    """A section for the terminal."""
    table = Table(box=None, pad_edge=False, header_style="bold")
    for i, name in enumerate(section.header):
        table.add_column(name, justify="right" if i else "left", overflow="fold")
    for row in section.rows:
        table.add_row(*row)
    return Group(
        Text(f"\n{section.title}", style="bold"),
        Text(f"paper: {section.paper}"),
        Text(f"here:  {section.here}"),
        table,
    )


def markdown(title: str, intro: str, sections: Sequence[Section]) -> str:
    """The whole report."""
    parts = [f"# {title}", intro]
    for s in sections:
        lines = [_row(s.header), _row(["---", *["---:"] * (len(s.header) - 1)])]
        lines += [_row(row) for row in s.rows]
        parts += [f"## {s.title}", f"**Paper.** {_begun(s.paper)}", f"**Here.** {_begun(s.here)}"]
        parts += ["\n".join(lines)]
        parts += [f"![{caption}]({name})" for name, caption in s.figures]
    return "\n\n".join(parts) + "\n"


def _begun(sentence: str) -> str:
    return sentence[:1].upper() + sentence[1:]


def _row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"
