"""Makes the pictures of the README by the program itself: `python -m tests.pictures`, some minutes in real time.

docs/pictures/display.svg: `pmabench run` on the simulated bench, in its third trial. docs/pictures/report.png: the first
page of the demo's report, as `pmabench report --pdf` sets it.
"""

import os
import subprocess
import sys
import tempfile
import time
from io import StringIO
from pathlib import Path

import typst
from click.testing import CliRunner
from rich.console import Console
from rich.text import Text

from pmabench.cli.main import main
from pmabench.display.console import LINKED
from pmabench.display.state import RunState
from pmabench.display.view import Extra, screen

PICTURES = Path(__file__).resolve().parents[1] / "docs" / "pictures"
SIZE = (104, 32)
RUN = (
    "contraction-relaxation", "--bench", "mock-realtime", "--specimen", "mas-20-250-paper0", "--yes", "-q",
    "--set", "sweep.matrix.load=[6 kg]", "--set", "sweep.matrix.pressure=[300 kPa, 400 kPa, 500 kPa]",
    "--set", "sweep.repeat.count=1", "--skip-warm-up", "--because", "a picture",
)  # fmt: skip
SVG = """<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" font-family="DejaVu Sans Mono, Menlo, \
Consolas, monospace" font-size="{char_height}px"><style>{styles}</style><defs>{lines}</defs>
<rect width="100%" height="100%" rx="8" fill="#1e1e1e"/>
<g transform="translate({terminal_x}, 12)" clip-path="url(#{unique_id}-clip-terminal)">{backgrounds}
<g class="{unique_id}-matrix">{matrix}</g></g></svg>
"""


def display(folder):
    """The picture of a run in its third trial."""
    process = subprocess.Popen([sys.executable, "-m", "pmabench", "run", *RUN, "--out", str(folder / "runs")])
    state, moving = None, 0
    while process.poll() is None and moving < 12:
        time.sleep(0.5)
        begun = [path.parent for path in (folder / "runs").glob("*contraction-relaxation*/manifest.json")]
        if begun and state is None:
            state = RunState(begun[0])
        if state is not None:
            state.poll(time.time())
            moving += len(state.lines) == 2
    console = Console(record=True, width=SIZE[0], file=StringIO(), force_terminal=True, color_system="standard")
    for line in screen(state, *SIZE, Extra(footer=LINKED)):
        console.print(line if isinstance(line, Text) else str(line), no_wrap=True, overflow="crop")
    process.terminate()
    process.wait()
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
    for line in (["campaign", "demo", "--yes", "-q"], ["report", "runs", "-o", "r.html", "--pdf", "r.pdf"]):
        if line[0] == "report":
            line[1:2] = [str(path) for path in sorted(Path("runs").iterdir()) if (path / "manifest.json").exists()]
        result = CliRunner().invoke(main, line)
        assert result.exit_code == 0, result.output
    (PICTURES / "report.png").write_bytes(drawn[0])


if __name__ == "__main__":
    PICTURES.mkdir(exist_ok=True)
    for picture in (display, report):
        picture(Path(tempfile.mkdtemp()))
