"""A short page for what is no characterisation report: facts, findings, figures, tables; computes nothing.

One self-contained HTML file; every text on it is escaped.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from pmabench import __version__
from pmabench.analysis.results import Finding
from pmabench.plotting.pictures import Picture
from pmabench.plotting.wording import clean
from pmabench.report.writing import render, symbols_marked, write_file


@dataclass(frozen=True)
class TextTable:
    """Heads, and rows of text under them; the first `texts` columns are words, the others numbers."""

    title: str
    heads: Sequence[str]
    rows: Sequence[Sequence[str]]
    texts: int = 1


@dataclass(frozen=True)
class Page:
    """The content of the page."""

    kicker: str
    title: str
    simulated: bool
    facts: Sequence[tuple[str, str]]
    failed: Sequence[str]
    findings: Sequence[Finding]
    pictures: Sequence[Picture]
    tables: Sequence[TextTable]


def write_page(page: Page, path: Path) -> Path:
    """Write the page to `path`; raises RecordError where it cannot be."""
    tables = [
        TextTable(
            f"Numbers of figure {number}: {picture.title}",
            picture.table.columns,
            picture.table.cells(),
            2,
        )
        for number, picture in enumerate(page.pictures, 1)
    ]
    context = {"page": page, "numbers": tables, "version": __version__}
    return write_file(path, render("page.html.j2", context, sym=lambda text: symbols_marked(clean(text))), "the page")
