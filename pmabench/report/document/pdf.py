"""A report as a tagged PDF (PDF/UA-1), set by typst from the same content; every text is data and never markup.

Needs the extra `pdf`. The font is Inter, as in the page; a few signs come from the fonts of typst, scripts that these
lack from those of the machine, else as boxes. The same report gives the same bytes.
"""

from __future__ import annotations

import json
import re
from dataclasses import fields, is_dataclass
from importlib.resources import files
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from pmabench.base.errors import PmaError, UsageError
from pmabench.plotting.svg import as_file, symbol_parts
from pmabench.plotting.wording import clean
from pmabench.report.certificate.sheet import Sheet
from pmabench.report.document.content import Content, Numbered
from pmabench.report.document.deviations import Said
from pmabench.report.writing import write_file

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
            return about | {"n": value.n, "file": name, "wide": p.wide, "charted": p.wide and p.height < TALL}
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
