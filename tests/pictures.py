"""Makes the pictures of the README by the program itself: `python -m tests.pictures`.

docs/pictures/display.svg: `pmabench watch` of a run on the simulated bench. docs/pictures/report.png: the first
page of the demo's report, as `pmabench report --pdf` sets it.
"""

import os
import tempfile
import time
from io import StringIO
from pathlib import Path

import typst
from click.testing import CliRunner
from rich.console import Console

from pmabench.cli.main import main
from pmabench.display.console import ALONE
from pmabench.display.state import RunState
from pmabench.display.view import Extra, screen

PICTURES = Path(__file__).resolve().parents[1] / "docs" / "pictures"
SIZE = (104, 32)
RUN = (
    "contraction-relaxation", "--bench", "mock", "--specimen", "mas-20-250-paper0", "--yes", "-q",
    "--set", "sweep.matrix.load=[6 kg]", "--set", "sweep.matrix.pressure=[300 kPa, 400 kPa, 500 kPa]",
    "--set", "sweep.repeat.count=1",
)  # fmt: skip
SVG = """<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" font-family="DejaVu Sans Mono, Menlo, \
Consolas, monospace" font-size="{char_height}px"><style>{styles}</style><defs>{lines}</defs>
<rect width="100%" height="100%" rx="8" fill="#1e1e1e"/>
<g transform="translate({terminal_x}, 12)" clip-path="url(#{unique_id}-clip-terminal)">{backgrounds}
<g class="{unique_id}-matrix">{matrix}</g></g></svg>
"""


def display(folder):
    """The picture of a run on the simulated bench, as it is when its last trial has ended."""
    result = CliRunner().invoke(main, ["run", *RUN, "--out", str(folder / "runs")])
    assert result.exit_code == 0, result.output
    [run] = (folder / "runs").iterdir()
    state = RunState(run)
    while state.poll(time.time()):
        pass
    console = Console(record=True, width=SIZE[0], file=StringIO(), force_terminal=True, color_system="standard")
    for line in screen(state, *SIZE, Extra(footer=ALONE)):
        console.print(line, no_wrap=True, overflow="crop")
    (PICTURES / "display.svg").write_text(console.export_svg(code_format=SVG, unique_id="d"))


def report(folder, monkey=typst.compile):
    """The first page of the demo's report."""
    drawn = []

    def compiled(source, **options):
        drawing = {
            name: value for name, value in options.items() if name not in {"format", "pdf_standards", "timestamp"}
        }
        pages = monkey(source, format="png", ppi=72.0, **drawing)
        drawn.append(pages[0] if isinstance(pages, list) else pages)
        return monkey(source, **options)

    typst.compile = compiled
    os.chdir(folder)
    for line in (
        ["campaign", "demo", "--yes", "-q", "--operator", "A. Reader"],
        ["report", "runs", "-o", "r.html", "--pdf", "r.pdf"],
    ):
        if line[0] == "report":
            line[1:2] = [str(path) for path in sorted(Path("runs").iterdir()) if (path / "manifest.json").exists()]
        result = CliRunner().invoke(main, line)
        assert result.exit_code == 0, result.output
    (PICTURES / "report.png").write_bytes(drawn[0])


if __name__ == "__main__":
    PICTURES.mkdir(exist_ok=True)
    for picture in (display, report):
        picture(Path(tempfile.mkdtemp()))
