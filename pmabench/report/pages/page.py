"""A short page for what is no characterisation report: facts, findings, figures, tables; computes nothing.

One self-contained HTML file; every text on it is escaped.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

from pmabench import __version__
from pmabench.analysis.results import Finding
from pmabench.base.errors import RecordError
from pmabench.plotting.pictures import Picture
from pmabench.plotting.svg import symbol_parts
from pmabench.plotting.wording import clean


@dataclass(frozen=True)
class TextTable:
    """Heads, and rows of text under them; the first `texts` columns are words, the others numbers."""

    title: str
    heads: Sequence[str]
    rows: Sequence[Sequence[str]]
    texts: int = 1


@dataclass(frozen=True)
class Page:
    """What it shows."""

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
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(render_page(page), encoding="utf-8", newline="")
    except OSError as error:
        raise RecordError(f"{path}: the page cannot be written: {error.strerror or error}") from error
    return path


def render_page(page: Page) -> str:
    """The page as text."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("pmabench.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["sym"] = _symbols
    tables = [
        *(
            TextTable(
                f"Numbers of figure {number}: {picture.title}",
                [str(head) for head in picture.table.columns],
                [[str(cell) for cell in row] for row in picture.table.itertuples(index=False)],
                2,
            )
            for number, picture in enumerate(page.pictures, 1)
        )
    ]
    return environment.get_template("page.html.j2").render(page=page, numbers=tables, version=__version__) + "\n"


def _symbols(text: object) -> Any:
    """Escaped text with symbols in italics and their subscripts lowered."""
    from markupsafe import Markup

    tags = {"symbol": ("<i>", "</i>"), "sub": ("<sub>", "</sub>"), "text": ("", "")}
    parts = symbol_parts(clean(text))
    return Markup("".join(f"{tags[kind][0]}{escape(part)}{tags[kind][1]}" for kind, part in parts))  # noqa: S704
