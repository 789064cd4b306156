"""How reports are written to files, how their pages are rendered, the short page for what is no report, the card of a
bench, and kept pages.

A page is one self-contained HTML file; every text on it is escaped. The page of the last report of stored analyses is
kept next to them: the same report once more is a copy. Imports little, so that a copy costs no more than looking
whether anything changed.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pmabench import __version__
from pmabench.base.errors import RecordError
from pmabench.base.text import clean
from pmabench.store.analyses.folder import key_of
from pmabench.store.folder import open_regular
from pmabench.store.since import stamp

if TYPE_CHECKING:
    from pmabench.plotting.pictures import Picture
    from pmabench.store.analyses.results import Finding


@contextmanager
def writing(path: Path, what: str) -> Iterator[None]:
    """Raise RecordError for an operating system error inside: `what` (as "the report") cannot be written to `path`."""
    try:
        yield
    except OSError as error:
        raise RecordError(f"{path}: {what} cannot be written: {error.strerror or error}") from error


def write_file(path: Path, data: str | bytes, what: str) -> Path:
    """Write text (UTF-8, line ends as they are) or bytes, the folder made where needed. Raises RecordError."""
    with writing(path, what):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data.encode() if isinstance(data, str) else data)
    return path


def render(template: str, context: dict[str, Any], **filters: Callable[[Any], Any]) -> str:
    """A page from a template of this package; `filters` are added to `sym` and `css`."""
    from jinja2 import Environment, FileSystemBytecodeCache, PackageLoader, StrictUndefined

    compiled = Path(__file__).parent / "templates/__pycache__"  # a tenth of the time of a report is their compilation
    with suppress(OSError):
        if not sys.dont_write_bytecode:
            compiled.mkdir(exist_ok=True)
    environment = Environment(
        loader=PackageLoader("pmabench.report"),
        bytecode_cache=FileSystemBytecodeCache(str(compiled)) if os.access(compiled, os.W_OK) else None,
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update({"sym": symbols_marked, "css": css_text} | filters)
    return environment.get_template(template).render(context) + "\n"


def symbols_marked(text: object) -> Any:
    """Escaped text with symbols in italics and their subscripts lowered."""
    from markupsafe import Markup

    from pmabench.plotting.svg import symbol_parts

    tags = {"symbol": ("<i>", "</i>"), "sub": ("<sub>", "</sub>"), "text": ("", "")}
    return Markup("".join(escape(part).join(tags[kind]) for kind, part in symbol_parts(str(text))))  # noqa: S704


def css_text(text: object) -> Any:
    """Text inside a CSS string: everything but letters, digits and blanks as an escape."""
    from markupsafe import Markup

    inert = (c if c.isascii() and (c.isalnum() or c == " ") else f"\\{ord(c):06x} " for c in clean(text, 90))
    return Markup("".join(inert))  # noqa: S704


@dataclass(frozen=True)
class TextTable:
    """Heads, and rows of text under them; the first `texts` columns are words, the others numbers."""

    title: str
    heads: Sequence[str]
    rows: Sequence[Sequence[str]]
    texts: int = 1


@dataclass(frozen=True)
class Page:
    """The content of a page for what is no report."""

    kicker: str
    title: str
    simulated: bool
    facts: Sequence[tuple[str, str]]
    failed: Sequence[str]
    findings: Sequence[Finding]
    pictures: Sequence[Picture]
    tables: Sequence[TextTable]


def write_page(page: Page, path: Path) -> Path:
    """Write a page to `path`; raises RecordError where it cannot be."""
    tables = [
        TextTable(f"Numbers of figure {number}: {picture.title}", picture.table.columns, picture.table.cells(), 2)
        for number, picture in enumerate(page.pictures, 1)
    ]
    context = {"page": page, "numbers": tables, "version": __version__}
    return write_file(path, render("page.html.j2", context, sym=lambda text: symbols_marked(clean(text))), "the page")


KEPT = ".report.kept"
LONGEST = 200_000_000
"""Bytes of a kept page that is read."""


@dataclass(frozen=True)
class KeptPage:
    """A report as text."""

    text: str
    since: Mapping[str, Any]
    """What came to its runs after they were closed, by run."""
    remarks: Sequence[str]
    """The same as lines for the terminal."""


def page_key(folders: Sequence[Path], runs: Sequence[Path], about: Mapping[str, Any]) -> str:
    """Hash of analyses, runs, program and what else the page says; empty where it cannot be known to be the same."""
    stamps = [stamp(folder) for folder in folders]
    return key_of(runs, {"analyses": stamps, **about}) if all(stamps) else ""


def keep(place: Path, key: str, page: KeptPage) -> None:
    """Keep a page in `place`, in place of an earlier one; a folder that cannot be written keeps none."""
    body = page.text.encode()
    head = {"key": key, "sha256": hashlib.sha256(body).hexdigest(), "since": page.since, "remarks": list(page.remarks)}
    with suppress(OSError):
        (place / KEPT).write_bytes(json.dumps(head).encode() + b"\n" + body)


def kept(place: Path, key: str) -> KeptPage | None:
    """The page of `key` that was kept in `place`; None where there is none, or it was changed."""
    with suppress(OSError, ValueError, TypeError, KeyError), open_regular(place / KEPT) as file:
        head, body = json.loads(file.readline(LONGEST)), file.read(LONGEST)
        if key and head["key"] == key and head["sha256"] == hashlib.sha256(body).hexdigest():
            return KeptPage(body.decode(), head["since"], head["remarks"])
    return None


LETTERS = {24: 7.4, 31: 6.6}
SMALLEST = 5.0
"""Rows up to which letters are so large [pt], and their size on a card with more."""


def write_card(card: Mapping[str, Any], path: Path) -> Path:
    """Write the card (the fields of `pmabench.bench.card.Card`) to `path`; raises RecordError where it cannot be."""
    return write_file(path, render_card(card), "the card")


def render_card(card: Mapping[str, Any]) -> str:
    """The card of a bench as text, which prints on one A4 page, two if it has very much; every value is escaped."""
    context = {**card, "version": __version__, "size": letter_size(card)}
    return render("bench_card.html.j2", context, nb=unbroken)


def letter_size(card: Mapping[str, Any]) -> float:
    """Size of the letters [pt] by the number of rows; a card with very many may take a second page."""
    rows = sum(len(card[part]) for part in ("limits", "channels", "outputs", "watch", "vent", "failures", "lacks"))
    return next((size for most, size in LETTERS.items() if rows <= most), SMALLEST)


def unbroken(text: object) -> str:
    """The text with its numbers kept next to their units."""
    return re.sub(r"(?<=\d) (?=\S)", "\u00a0", str(text))
