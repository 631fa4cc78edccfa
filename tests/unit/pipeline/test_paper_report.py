"""Reports as Markdown and as tables."""

import io

from rich.console import Console

from spinpipe.pipeline.evaluation.paper_report import Section, markdown, section_table

SECTION = Section(
    title="3.1 Bins",
    paper="all are found.",
    here="all but one.",
    header=("rho", "found"),
    rows=[["0.1", "4"], ["0.2", "7"]],
    figures=[("a.png", "A figure")],
)


def test_markdown():
    text = markdown("Report", "Intro.", [SECTION])
    assert text.startswith("# Report\n\nIntro.\n\n## 3.1 Bins\n\n**Paper.** All are found.\n")
    assert "| rho | found |\n| --- | ---: |\n| 0.1 | 4 |\n| 0.2 | 7 |\n" in text
    assert text.endswith("![A figure](a.png)\n")


def test_table_fits_a_terminal():
    console = Console(width=80, record=True, file=io.StringIO())
    console.print(section_table(SECTION))
    lines = console.export_text().splitlines()
    assert max(map(len, lines)) <= 80
    assert any("0.2" in line and "7" in line for line in lines)
