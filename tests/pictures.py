"""Makes the pictures of the README by the program itself: `python -m tests.pictures`.

docs/pictures/display.svg: `pmabench watch` of a run on the simulated bench, docs/pictures/live.png: `watch --web` of
the same. docs/pictures/report.png: the first page of the demo's report, as a browser prints it. Both need Chromium.
docs/pictures/straight.svg: the simulated muscle with
hysteresis and creep, as the campaign `real-muscle` measures it and `process --form surface` describes it.
"""

import os
import tempfile
import time
from io import StringIO
from pathlib import Path

import numpy as np
from click.testing import CliRunner
from rich.console import Console

from pmabench.cli.main import main
from pmabench.display.console import ALONE
from pmabench.display.state import RunState
from pmabench.display.view import Extra, screen
from pmabench.display.web.server import start
from pmabench.plotting.chart import BLUE, BROWN, FAINT, GREEN, Chart, Series
from pmabench.plotting.drawing import joined
from pmabench.plotting.svg import as_file
from pmabench.report.document.content import FONT
from pmabench.store.analyses.folder import read_analysis
from pmabench.store.reader import open_run
from tests.browser import CHROMIUM, Browser
from tests.display.paced import Paced

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
    if CHROMIUM is not None:
        live(folder, run)


def live(folder, run):
    """The same run in the browser, at the end of its second trial."""
    paced = Paced(run, folder / "paced")
    paced.advance(next(event.t for event in paced.events if event.kind == "trial-begin" and event.data["trial"] == 2))
    paced.advance(paced.t + 8.0)
    server = start(folder / "paced", "token")
    with Browser(folder / "profile") as browser:
        page = browser.open(server.link(), width=1280, height=1010)
        page.wait("document.querySelector('#trials-count').textContent === '2 of 3'", within=30.0)
        page.wait("new Promise(done => setTimeout(() => done(true), 500))")
        page.picture(PICTURES / "live.png")
    server.stop()
    paced.finish()


def report(folder):
    """The first page of the demo's report, as a browser prints it."""
    os.chdir(folder)
    for line in (["campaign", "demo", "--yes", "-q", "--operator", "A. Reader"], ["report", "runs", "-o", "r.html"]):
        if line[0] == "report":
            line[1:2] = [str(path) for path in sorted(Path("runs").iterdir()) if (path / "manifest.json").exists()]
        result = CliRunner().invoke(main, line)
        assert result.exit_code == 0, result.output
    with Browser(folder / "profile") as browser:
        page = browser.open((folder / "r.html").as_uri())
        page.media(printed=True)
        metrics = {"width": 720, "height": 1049, "deviceScaleFactor": 1.25, "mobile": False}
        page.send("Emulation.setDeviceMetricsOverride", **metrics)
        page.run("document.body.setAttribute('style', 'padding: 20px')")
        page.picture(PICTURES / "report.png")


def straight(folder):
    """Force over contraction, one small loop, and force over the logarithm of time."""
    os.chdir(folder)
    for line in (["campaign", "real-muscle", "--yes", "-q"], ["process", "--form", "surface", "-q", "--out", "found"]):
        if line[0] == "process":
            line += [str(path) for path in sorted(Path("runs").glob("2*"))]
        result = CliRunner().invoke(main, line)
        assert result.exit_code == 0, result.output
    loops = read_analysis(Path("found") / "surface").traces
    run = open_run(next(Path("runs").glob("*step-displacement*")))
    held = next(trial for trial in run.trials if trial.point["pressure"] == 350e3)
    series = []
    ramps = [trace for trace in loops if "isobaric" in trace.title]
    for trace in ramps:
        x, F = 1e3 * trace.columns["displacement"], trace.columns["force"]
        ends = np.array([x.min(), x.max()])
        line = np.polyval(np.polyfit(x, F, 1), ends)
        series += [Series("", x, F, FAINT, width=2.6), Series("", x, trace.columns["model"], BLUE, width=0.9)]
        series.append(Series(f"{trace.marks['pressure'] / 1e3:.0f} kPa", ends, line, BROWN, width=0.9, dashed=True))
    force = "force [N]"
    wide = Chart("contraction [mm]", force, tuple(series), 250.0, 220.0, title="Surface (blue), straight line (brown)")
    trace = ramps[len(ramps) // 2]
    x, F = 1e3 * trace.columns["displacement"], trace.columns["force"]
    near = (x > 3) & (x < 10)
    points = (Series("", x[near], F[near], FAINT, "o"), Series("", x[near], trace.columns["model"][near], BLUE, "."))
    small = Chart("contraction [mm]", force, points, 195.0, 220.0, title="A small loop within the large one")
    t, F = held.t, held.channels["force"]
    begin = next(c for c in held.commands if c.phase == "step" and c.kind == "ramp").t + 0.5
    kept = np.flatnonzero((t > begin + 0.3) & (t < begin + 199))
    level = np.median(F[kept][-200:])
    kept = kept[np.unique(np.geomspace(1, len(kept), 600).astype(int)) - 1]
    points = (Series("", t[kept] - begin, F[kept] - level, GREEN, "."),)
    label, decades = "force above its last value [N]", (1.0, 10.0, 100.0)
    creep = Chart("time [s]", label, points, 195.0, 220.0, title="Creep, length held", log=True, x_ticks=decades)
    alt = "Force over contraction, a small loop, creep"
    (PICTURES / "straight.svg").write_text(as_file(joined([[wide, small, creep]], alt), FONT), encoding="utf-8")


if __name__ == "__main__":
    PICTURES.mkdir(exist_ok=True)
    for picture in (display, report, straight):
        picture(Path(tempfile.mkdtemp()))
