"""A characterisation report as one HTML file that references nothing outside itself; computes no estimate.

The same input gives the same bytes. Every text is untrusted: Jinja2 escapes all of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

from pmabench.analysis.results import Analysis
from pmabench.plotting import wording
from pmabench.plotting.svg import symbol_parts
from pmabench.report.document.checklist import Issuer
from pmabench.report.document.content import LEVELS, Content, content_of
from pmabench.report.document.kept_page import write_text
from pmabench.report.figures import overlays
from pmabench.store.records import RunData


def write_report(
    analyses: Sequence[Analysis],
    runs: Sequence[RunData],
    path: Path,
    *,
    title: str | None = None,
    published: Sequence[overlays.Published] = (),
    issuer: Issuer | None = None,
) -> Path:
    """Write the report of `analyses`, with what `runs` record of bench, specimen and protocol, to `path`.

    `published` tables are drawn for comparison; `issuer` is who gives it out. Raises RecordError where it cannot be
    written, InvalidFile for a table that matches no figure.
    """
    return write_page(content_of(analyses, runs, title=title, published=published, issuer=issuer), path)


def write_page(content: Content, path: Path) -> Path:
    """Write a report's content as a page; raises RecordError where it cannot be written."""
    return write_text(page_of(content), path)


def render(
    analyses: Sequence[Analysis],
    runs: Sequence[RunData],
    *,
    title: str | None = None,
    published: Sequence[overlays.Published] = (),
    issuer: Issuer | None = None,
) -> str:
    """The report as text."""
    return page_of(content_of(analyses, runs, title=title, published=published, issuer=issuer))


def page_of(content: Content) -> str:
    """The content as an HTML page."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("pmabench.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["sym"] = symbols_marked
    environment.filters["css"] = css_text
    return environment.get_template("report.html.j2").render(vars(content) | {"levels": LEVELS}) + "\n"


def symbols_marked(text: object) -> Any:
    """Escaped text with symbols in italics and their subscripts lowered."""
    from markupsafe import Markup

    tags = {"symbol": ("<i>", "</i>"), "sub": ("<sub>", "</sub>"), "text": ("", "")}
    parts = symbol_parts(str(text))
    return Markup("".join(f"{tags[kind][0]}{escape(part)}{tags[kind][1]}" for kind, part in parts))  # noqa: S704


def css_text(text: object) -> Any:
    """Text inside a CSS string: everything but letters, digits and blanks as an escape."""
    from markupsafe import Markup

    inert = (c if c.isascii() and (c.isalnum() or c == " ") else f"\\{ord(c):06x} " for c in wording.clean(text, 90))
    return Markup("".join(inert))  # noqa: S704
