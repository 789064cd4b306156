"""A report in other formats, from the content of the page: a tagged PDF (PDF/UA-1, set by typst) and a workbook.

They need the extras `pdf` and `xlsx`. The same report gives the same bytes; every text is data, and never markup or a
formula. The font of the PDF is Inter, as in the page; a few signs come from the fonts of typst, scripts that these lack
from those of the machine, else as boxes. Numbers of the workbook are numbers in display units.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from datetime import datetime
from importlib.resources import files
from io import BytesIO
from math import floor, log10
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from pmabench.base.errors import PmaError, UsageError
from pmabench.plotting.svg import as_file, symbol_parts
from pmabench.plotting.wording import clean, shown
from pmabench.report.certificate.sheet import Sheet
from pmabench.report.document.content import Content, Numbered
from pmabench.report.document.deviations import Said
from pmabench.report.files.csv_files import coefficient_rows, curve_rows, estimate_rows, inert
from pmabench.report.words import kind_title
from pmabench.report.writing import write_file
from pmabench.store.analyses.results import Analysis

FONT = "Inter"
TALL = 230.0
"""Height from which on a wide picture of the certificate is as high as its place, not as wide [pt]."""
OTHER_SCRIPTS = re.compile("[\u0530-\u1dff\u2c00-\U0010ffff]")
"""Neither Latin, Greek nor Cyrillic, no punctuation and no sign of mathematics."""


def write_pdf(content: Content, path: Path) -> Path:
    """Write the report; UsageError without the extra, RecordError where it cannot be written."""
    return write_file(path, pdf_bytes(content), "the PDF")


def pdf_bytes(content: Content) -> bytes:
    """The report as the bytes of a PDF."""
    try:
        import typst
    except ImportError as error:
        raise UsageError('--pdf needs typst: pip install "pmabench[pdf]"') from error
    with TemporaryDirectory(prefix="pmabench-pdf-") as place:
        folder = Path(place)
        data = json.dumps(_Data(content, folder).all(), ensure_ascii=False)
        (folder / "content.json").write_text(data, encoding="utf-8")
        source = files("pmabench.report").joinpath("templates", "report.typ").read_text(encoding="utf-8")
        (folder / "report.typ").write_text(source, encoding="utf-8")
        try:
            pdf = typst.compile(
                str(folder / "report.typ"),
                root=place,
                font_paths=[str(files("pmabench.plotting") / "web")],
                ignore_system_fonts=not OTHER_SCRIPTS.search(data),
                format="pdf",
                pdf_standards="ua-1",
                timestamp=0,
            )
            return bytes(pdf)
        except (RuntimeError, typst.TypstError) as error:
            raise PmaError(f"typst could not set the PDF: {clean(error, 300)}; write the HTML page alone") from error


class _Data:
    """The content as plain data for the template, its pictures as files in `folder`."""

    def __init__(self, content: Content, folder: Path) -> None:
        self.content, self.folder = content, folder
        self.texts: set[str] = set()

    def all(self) -> dict[str, Any]:
        """Every field, and the pieces of each text that has a symbol in it."""
        data = {name: self.plain(value) for name, value in vars(self.content).items()}
        pieces = {text: symbol_parts(text) for text in sorted(self.texts)}
        return data | {"pieces": {text: found for text, found in pieces.items() if found != [("text", text)]}}

    def plain(self, value: Any) -> Any:
        """Dataclasses and sequences down to texts and numbers."""
        if isinstance(value, str):
            value = value.encode("utf-8", "replace").decode()  # names of traces are shown nowhere and not cleaned
            self.texts.add(value)
        elif isinstance(value, Numbered):
            p, name = value.picture, f"figure-{value.n}.svg"
            (self.folder / name).write_text(as_file(p.svg, FONT), encoding="utf-8")
            about = self.plain({"title": p.title, "caption": p.caption, "alt": p.alt})
            return about | {
                "n": value.n,
                "file": name,
                "wide": p.wide,
                "charted": p.wide and p.height < TALL,
                "height": p.height,
            }
        elif isinstance(value, Said):
            return _note(value)
        elif isinstance(value, Sheet):
            front = {"first": len(value.first), "second": len(value.second)}
            return {name: self.plain(of) for name, of in vars(value).items() if name not in front} | front
        elif is_dataclass(value):
            return {field.name: self.plain(getattr(value, field.name)) for field in fields(value)}
        elif isinstance(value, dict):
            return {name: self.plain(of) for name, of in value.items()}
        elif isinstance(value, list | tuple | frozenset):
            return [self.plain(one) for one in value]
        return value


def _note(note: Said) -> str:
    """A note with the names of what is attached; the page shows the pictures."""
    files = ", ".join([*note.files, *(name for name, _ in note.pictures)])
    return f"{note.run}, {note.utc} UTC, {note.operator}: {note.text}{f' (attached: {files})' if files else ''}"


EPOCH = datetime(2000, 1, 1)
"""Date of creation in the file: always this one, so that equal content gives equal files."""
WIDEST = 60
"""Letters that a column shows at once."""
DIGITS = 5
"""Significant digits that are shown of a number; its cell holds all."""
LONGEST = 32_000
"""Letters of a cell; a spreadsheet takes 32,767."""
NAME = 31
"""Letters of a sheet's name."""


def write_workbook(content: Content, analyses: Sequence[Analysis], path: Path) -> Path:
    """Write the workbook; UsageError without the extra, RecordError where it cannot be written."""
    return write_file(path, workbook_bytes(content, analyses), "the workbook")


def workbook_bytes(content: Content, analyses: Sequence[Analysis]) -> bytes:
    """The workbook as bytes."""
    try:
        import xlsxwriter
    except ImportError as error:
        raise UsageError('--xlsx needs xlsxwriter: pip install "pmabench[xlsx]"') from error
    buffer = BytesIO()
    options = {"in_memory": True, "strings_to_formulas": False, "strings_to_urls": False, "strings_to_numbers": False}
    book = xlsxwriter.Workbook(buffer, options | {"nan_inf_to_errors": True})
    book.set_properties(
        {"title": clean(content.title, 200), "created": EPOCH, "comments": f"report {content.report_id}"}
    )
    sheets = _Sheets(book, content)
    sheets.lines("Summary", _summary(content))
    for analysis in analyses:
        sheets.rows(kind_title(analysis.kind), coefficient_rows(analysis.estimates), simulated=analysis.simulated)
    simulated = content.simulated
    sheets.rows("Estimates", estimate_rows(analyses), simulated=simulated)
    sheets.rows("Curves", curve_rows(curve for a in analyses for curve in a.curves), simulated=simulated)
    sheets.rows("Budgets", _budgets(analyses), simulated=simulated)
    sheets.rows("Findings", [dict(zip(("level", "test", "finding"), row, strict=True)) for row in content.findings])
    heads = [column.head for column in content.dropped.columns]
    unused = [(name, [cell.text for cell in cells]) for name, rows in content.dropped.groups for cells in rows]
    sheets.rows(
        "Not used", [({"of": name} if name else {}) | dict(zip(heads, texts, strict=True)) for name, texts in unused]
    )
    book.close()
    return buffer.getvalue()


def _summary(content: Content) -> list[tuple[str, str]]:
    lines = [("Report", content.title), ("Verdict", f"{content.verdict.word}: {content.verdict.text}")]
    lines += [("Not accepted", text) for text in content.failed]
    lines += [(f"{t.symbol}, {t.name}", f"{t.value} {t.unit} ({t.where})") for t in content.tiles]
    lines += [("Evaluated with", f"pmabench {content.version}; report {content.report_id}")]
    return [(head, text) for head, text in lines if text]


def _budgets(analyses: Sequence[Analysis]) -> list[dict[str, Any]]:
    """Sources of the interval of every estimate that has a budget, a row each."""
    rows = []
    for analysis in analyses:
        for row, e in zip(estimate_rows([analysis]), analysis.estimates, strict=True):
            keep = ("kind", "symbol", "coordinate", "method", "unit")
            where = {head: value for head, value in row.items() if head in keep or "[" in head}
            scale = shown(e.quantity, e.unit).scale
            for source, share in zip(e.budget, e.shares, strict=True):
                half = None if source.half is None else source.half / scale
                entry = {"source": source.name, "type": source.kind, "half width 95 %": half, "share": share}
                rows.append(where | entry | {"note": source.note})
    return rows


class _Sheets:
    """Sheets of one workbook, in one look."""

    def __init__(self, book: Any, content: Content) -> None:
        self.book, self.content = book, content
        self.names: set[str] = set()
        self.numbers: dict[str, Any] = {}
        self.title = book.add_format({"bold": True, "font_size": 13})
        self.mark = book.add_format({"bold": True, "font_color": "#a14a00"})
        self.head = book.add_format({"bold": True, "bottom": 1, "text_wrap": True, "valign": "bottom"})
        self.text = book.add_format({"text_wrap": True, "valign": "top"})
        self.name = book.add_format({"bold": True, "text_wrap": True, "valign": "top"})

    def _sheet(self, name: str, *, simulated: bool) -> Any:
        stem = "".join(c for c in clean(name, 80) if c not in "[]:*?/\\'")[:NAME].strip() or "Sheet"
        unique, count = stem, 1
        while unique.casefold() in self.names:
            count += 1
            unique = f"{stem[: NAME - 3]} {count}"
        self.names.add(unique.casefold())
        sheet = self.book.add_worksheet(unique)
        sheet.hide_gridlines(2)
        sheet.set_paper(9)
        sheet.set_landscape()
        sheet.fit_to_pages(1, 0)
        sheet.set_footer(f"&LReport {self.content.report_id}&RPage &P of &N")
        sheet.write_string(0, 0, inert(clean(name, 80)), self.title)
        if simulated:
            sheet.write_string(1, 0, "SIMULATED", self.mark)
            sheet.set_tab_color("#d98e04")
        return sheet

    def lines(self, name: str, lines: Sequence[tuple[str, str]]) -> None:
        """Pairs of a head and a text."""
        sheet = self._sheet(name, simulated=self.content.simulated)
        sheet.set_column(0, 0, 32)
        sheet.set_column(1, 1, 110)
        for row, (head, text) in enumerate(lines, 3):
            sheet.write_string(row, 0, inert(clean(head, 200)), self.name)
            sheet.write_string(row, 1, inert(clean(text, LONGEST)), self.text)

    def rows(self, name: str, rows: Sequence[Mapping[str, Any]], *, simulated: bool | None = None) -> None:
        """A table with all columns that any row has; nothing where there is no row."""
        if not rows:
            return
        sheet = self._sheet(name, simulated=self.content.simulated if simulated is None else simulated)
        columns = list(dict.fromkeys(head for row in rows for head in row))
        cells = [[row.get(head) for row in rows] for head in columns]
        longest = [max(9, *(len(value) if isinstance(value, str) else 10 for value in column)) for column in cells]
        for column, head in enumerate(columns):
            sheet.write_string(3, column, inert(clean(head, 200)), self.head)
            sheet.set_column(column, column, min(WIDEST, longest[column] + 1))
        for line, row in enumerate(rows, 4):
            for column, head in enumerate(columns):
                self._cell(sheet, line, column, row.get(head))
        sheet.freeze_panes(4, 0)
        sheet.autofilter(3, 0, 3 + len(rows), len(columns) - 1)

    def _cell(self, sheet: Any, line: int, column: int, value: Any) -> None:
        if value is None or value == "":
            return
        if isinstance(value, bool):
            sheet.write_boolean(line, column, value)
        elif isinstance(value, int | float):
            if value == value and abs(value) < 1e300:
                sheet.write_number(line, column, value, self._rounded(value))
        else:
            sheet.write_string(line, column, inert(clean(value, LONGEST)), self.text)

    def _rounded(self, value: float) -> Any:
        """Format that shows a number with `DIGITS` significant digits; the cell holds all of them."""
        if value == round(value):
            return None
        size = floor(log10(abs(value)))
        plain = -DIGITS < size < DIGITS + 4
        shown_as = f"0.{'0' * max(0, DIGITS - 1 - size)}".rstrip(".") if plain else f"0.{'0' * (DIGITS - 1)}E+00"
        if shown_as not in self.numbers:
            self.numbers[shown_as] = self.book.add_format({"num_format": shown_as})
        return self.numbers[shown_as]
