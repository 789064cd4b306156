"""The figures of a report as files of their own, for papers and slides."""

from __future__ import annotations

import re
from pathlib import Path

from pmabench.plotting.svg import as_file
from pmabench.report.document.content import Content
from pmabench.report.writing import write_file

FONT = "Inter, Helvetica, Arial, sans-serif"
CAPTIONS = "captions.txt"


def write_figures(content: Content, folder: Path) -> Path:
    """Write each figure as SVG, numbered as in the report, and `captions.txt`; the folder. Raises RecordError."""
    lines = [f"{content.title}\n"]
    for item in [*content.front, *(figure for section in content.sections for figure in section.figures)]:
        short = re.sub(r"[^a-z0-9]+", "-", item.picture.title.lower()).strip("-")[:50].strip("-")
        name = f"{item.n:02d}-{short or 'figure'}.svg"
        write_file(folder / name, as_file(item.picture.svg, FONT), "the figure")
        lines.append(f"{name}\n  Figure {item.n}: {item.picture.title}. {item.picture.caption}\n")
    write_file(folder / CAPTIONS, "\n".join(lines), "the captions")
    return folder
