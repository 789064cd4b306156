"""A report as a tagged PDF (PDF/UA-1), set by typst from the same content; every text is data and never markup.

Needs the extra `pdf`. Fonts are those that matplotlib brings, and where these lack a sign also those of the machine.
The same report gives the same bytes.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from pmabench.base.errors import PmaError, UsageError
from pmabench.plotting.svg import as_file, symbol_parts
from pmabench.plotting.wording import clean
from pmabench.report.document.content import LEVELS, Content, Numbered
from pmabench.report.document.deviations import Said
from pmabench.report.document.grids import Grid
from pmabench.report.writing import write_file

FONT = "DejaVu Sans"


def write_pdf(content: Content, path: Path) -> Path:
    """Write the report; UsageError without the extra, RecordError where it cannot be written."""
    return write_file(path, pdf_bytes(content), "the PDF")


def pdf_bytes(content: Content) -> bytes:
    """The report as the bytes of a PDF."""
    try:
        import typst
    except ImportError as error:
        raise UsageError('--pdf needs typst: pip install "pmabench[pdf]"') from error
    import matplotlib as mpl
    from matplotlib.ft2font import FT2Font

    with TemporaryDirectory(prefix="pmabench-pdf-") as place:
        folder = Path(place)
        content_json = json.dumps(_Data(content, folder).all(), ensure_ascii=False)
        (folder / "content.json").write_text(content_json, encoding="utf-8")
        source = files("pmabench.report").joinpath("templates", "report.typ").read_text(encoding="utf-8")
        (folder / "report.typ").write_text(source, encoding="utf-8")
        fonts = Path(mpl.get_data_path()) / "fonts" / "ttf"
        known = FT2Font(str(fonts / "DejaVuSans.ttf")).get_charmap()
        try:
            data = typst.compile(
                str(folder / "report.typ"),
                root=str(folder),
                font_paths=[str(fonts)],
                ignore_system_fonts=all(ord(sign) in known for sign in set(content_json)),
                format="pdf",
                pdf_standards="ua-1",
                timestamp=0,
            )
            return bytes(data)
        except (RuntimeError, typst.TypstError) as error:
            raise PmaError(f"typst could not set the PDF: {clean(error, 300)}; write the HTML page alone") from error


class _Data:
    """The content as JSON for the template, its pictures as files in `folder`."""

    def __init__(self, content: Content, folder: Path) -> None:
        self.content, self.folder = content, folder

    def all(self) -> dict[str, Any]:
        c = self.content
        plain = ("title", "report_id", "version", "simulated", "operators", "statuses")
        grids = ("coefficients", "compared", "tuning")
        return {
            **{name: getattr(c, name) for name in plain},
            **{name: [self.grid(grid) for grid in getattr(c, name)] for name in grids},
            "banner": f"{'some' if c.mixed else 'all'} of these values come from a simulated bench, no real muscle",
            "verdict": vars(c.verdict),
            "said": [
                c.issuer.laboratory,
                f"for {c.issuer.customer}" * bool(c.issuer.customer),
                c.issuer.issued or c.when,
            ],
            "sheet": self.sheet(),
            "first": self.figures(c.front[: len(c.sheet.first)]),
            "second": self.figures(c.front[len(c.sheet.first) :]),
            "protocol": self.grid(c.protocol, "What was tested"),
            "benches": self.pairs([(name, about or "No devices are recorded.") for name, about in c.benches]),
            "deviations": [symbol_parts(text) for text in c.deviations],
            "missing": ", ".join(c.missing),
            "notes": [self.note(note) for note in c.notes],
            "curves": self.grid(c.curves, "Fitted curves over pressure; valid inside their range only"),
            "polynomials": self.grid(c.polynomials, "Fitted polynomials, terms by power of z"),
            "sections": [
                {
                    "title": s.title + (" (simulated)" if s.simulated else ""),
                    "counts": f"{s.counts}.",
                    "tables": [self.grid(grid) for grid in s.tables],
                    "figures": self.figures(s.figures),
                }
                for s in c.sections
            ],
            "published": self.grid(c.published, "Mean relative differences"),
            "publishers": self.pairs([(n, about or "The file names no source.") for n, about in c.publishers]),
            "dropped": self.grid(c.dropped),
            "findings": [
                {"level": _level(level), "word": LEVELS.get(level, level), "test": test, "text": symbol_parts(text)}
                for level, test, text in c.findings
            ],
            "methods": self.pairs(c.methods),
            "run_details": [self.pairs([(head, text) for head, text in run if text]) for run in c.run_details],
            "calibrations": self.grid(c.calibrations, "Calibrations of the channels"),
            "authorised_by": c.issuer.authorised_by,
            "issued": c.issuer.issued,
            "checklist": [vars(item) for item in c.checklist],
            "paragraph": symbol_parts(c.paragraph),
            "cite": list(c.cite),
            "parts": [self.grid(s.parts, f"{s.title}: half widths by cause") for s in c.sections if s.parts],
            "budgets": [self.grid(s.budget) for s in c.sections if s.budget],
        }

    def sheet(self) -> dict[str, Any]:
        """The two pages without their figures."""
        s = self.content.sheet
        covered = s.coverage and {
            "down": symbol_parts(s.coverage.down),
            "across": symbol_parts(s.coverage.across),
            "columns": s.coverage.columns,
            "rows": [[name, [[box.look, box.text] for box in boxes]] for name, boxes in s.coverage.rows],
            "words": symbol_parts(f"Left out: {s.coverage.words}." if s.coverage.words else ""),
            "counts": f"{s.coverage.used} used, {s.coverage.left} left out",
        }
        bars = s.sources and {
            "where": s.sources.where,
            "causes": s.sources.causes,
            "bars": [{**vars(bar), "symbol": symbol_parts(bar.symbol)} for bar in s.sources.bars],
        }
        return {
            **{name: getattr(s, name) for name in ("item", "table_title", "checks", "seals")},
            **{name: self.pairs(getattr(s, name)) for name in ("also", "limits", "statistics")},
            "about": s.about or self.content.title,
            "sentence": symbol_parts(s.sentence),
            "columns": [[head, [symbol_parts(line) for line in lines]] for head, lines in s.columns],
            "heads": [symbol_parts(f"{head} [{unit}]" if unit else head) for head, unit in s.table.heads],
            "rows": [[[symbol_parts(v.text), v.half, v.words] for v in row] for row in s.table.rows],
            "notes": [symbol_parts(note) for note in s.table.notes],
            "coverage": covered,
            "sources": bars,
            "findings": [symbol_parts(text) for text in s.findings],
            "method": symbol_parts(s.method),
        }

    def pairs(self, items: Sequence[tuple[str, str]]) -> list[list[Any]]:
        return [[symbol_parts(head), symbol_parts(text)] for head, text in items if text]

    def grid(self, grid: Grid, caption: str = "") -> dict[str, Any]:
        return {
            "caption": symbol_parts("; ".join(part for part in (caption, grid.caption) if part)),
            "columns": [{"head": symbol_parts(column.head), "align": column.align} for column in grid.columns],
            "groups": [
                {
                    "heading": symbol_parts(heading),
                    "rows": [
                        [{"value": c.text, "text": symbol_parts(c.text), "half": c.half, "muted": c.muted} for c in row]
                        for row in rows
                    ],
                }
                for heading, rows in grid.groups
            ],
        }

    def figures(self, items: Sequence[Numbered]) -> list[dict[str, Any]]:
        found = []
        for item in items:
            p = item.picture
            name = f"figure-{item.n}.svg"
            (self.folder / name).write_text(as_file(p.svg, FONT), encoding="utf-8")
            title, caption = symbol_parts(p.title), symbol_parts(p.caption)
            look = {"wide": p.wide, "charted": bool(p.charts)}
            found.append({"n": item.n, "file": name, "alt": p.alt, "title": title, "caption": caption, **look})
        return found

    def note(self, note: Said) -> str:
        """A note with the names of what is attached; the page shows the pictures."""
        files = ", ".join([*note.files, *(name for name, _ in note.pictures)])
        return f"{note.run}, {note.utc} UTC, {note.operator}: {note.text}{f' (attached: {files})' if files else ''}"


def _level(level: str) -> str:
    return level if level in ("good", "doubt", "fault") else "note"
