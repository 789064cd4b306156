"""The report in a real browser: two sheets of A4, a phone, without scripts, zoom and values; nothing is asked for."""

import io
import re
from dataclasses import astuple, replace

import numpy as np
import pypdf
import pytest

from pmabench.plotting.chart import BLUE, BROWN, Chart, Series
from pmabench.plotting.pictures import of_charts
from pmabench.plotting.wording import Frame
from pmabench.report.certificate.interactive import chart_data
from pmabench.report.document.content import content_of, page_of
from pmabench.store.analyses.results import Parts

from . import samples
from .samples import render
from .test_hostile import analyses as hostile_analyses
from .test_hostile import runs as hostile_runs
from .test_names import echo, withheld

A4 = (595.3, 841.9)


def fine():
    """Contraction and relaxation at 15 pressures, with the ends of its strokes, so that page 1 is as full as can be."""
    made = samples.contraction()
    more = [
        replace(e, at={"pressure": e.at["pressure"] + off})
        for e in made.estimates
        for off in (0.0, 25e3)
        if set(e.at) == {"pressure"} and e.at["pressure"] + off <= 500e3
    ]
    steps = [{"pressure": P, "load": F, "phase": "contract", "x_inf": (samples.truth("F_ce", P) - F) / samples.truth("K", P)}
             for P in samples.PRESSURES for F in (60.0, 250.0)]  # fmt: skip
    return [replace(made, estimates=tuple(more), facts={**made.facts, "steps": steps})]


def sharp():
    """The same test with intervals thirty times narrower: two to three digits more in each cell."""
    made = samples.contraction()
    estimates = [
        replace(e, parts=Parts(*(None if p is None else p / 30 for p in astuple(e.parts)))) for e in made.estimates
    ]
    return [replace(made, estimates=tuple(estimates))]


def long_serial():
    specimen = {"make": "Festo", "type": "MAS-20", "serial": f"SN-{'0123456789' * 14}", "nominal_length": 0.25,
                "inner_diameter": 0.02}  # fmt: skip
    return [samples.run("contraction-relaxation", specimen=specimen)]


REPORTS = {
    "narrow intervals": (sharp, lambda: [samples.run("contraction-relaxation")]),
    "many pressures": (fine, lambda: [samples.run("contraction-relaxation")]),
    "all four tests": (samples.all_analyses, samples.all_runs),
    "static load": (lambda: [samples.static_load()], lambda: [samples.run("static-load")]),
    "sines": (lambda: [samples.sine()], lambda: []),
    "ultimate gain": (lambda: [samples.ultimate_gain()], lambda: [samples.run("ultimate-gain")]),
    "withheld": (lambda: [withheld()], lambda: [samples.run("contraction-relaxation")]),
    "a foreign kind": (lambda: [echo()], lambda: []),
    "a long serial number": (fine, long_serial),
    "nothing": (lambda: [], lambda: []),
    "hostile": (hostile_analyses, hostile_runs),
}
CUT = """[...document.querySelectorAll('.sheet')].flatMap(sheet => [sheet, ...sheet.querySelectorAll('figure, .two, .main')])
.filter(e => e.scrollHeight > e.clientHeight + 2).map(e => e.className + ' ' + e.scrollHeight + ' ' + e.clientHeight)
.concat([...document.querySelectorAll('.sheet .scroll')].filter(e => e.scrollWidth > e.clientWidth)
.map(e => e.innerText + ' ' + e.scrollWidth + ' ' + e.clientWidth))"""
OVERLAP = """[...document.querySelectorAll('.sheet')].flatMap(sheet => {
  const boxes = [...sheet.children].map(e => e.getBoundingClientRect());
  return boxes.slice(1).filter((box, n) => box.top < boxes[n].bottom - 2).map(box => box.top);
})"""


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    """The report of a name as an address, written once."""
    folder = tmp_path_factory.mktemp("reports")

    def address(name: str) -> str:
        path = folder / f"{name.replace(' ', '-')}.html"
        if not path.exists():
            analyses, runs = REPORTS[name]
            path.write_text(render(analyses(), runs()), encoding="utf-8")
        return path.as_uri()

    return address


def sheets(page, path) -> pypdf.PdfReader:
    page.pdf(path)
    return pypdf.PdfReader(io.BytesIO(path.read_bytes()))


@pytest.mark.parametrize("name", REPORTS)
def test_the_certificate_is_two_sheets_and_nothing_is_cut(browser, pages, tmp_path, name):
    page = browser.open(pages(name), width=680, height=1000)
    page.media(printed=True)
    assert page.run(CUT) == []
    assert page.run(OVERLAP) == []
    page.media()
    printed = sheets(page, tmp_path / "p.pdf")
    assert len(printed.pages) == 2
    for n, sheet in enumerate(printed.pages, 1):
        assert (float(sheet.mediabox.width), float(sheet.mediabox.height)) == pytest.approx(A4, abs=1.5)
        assert f"page {n} of 2" in sheet.extract_text()
    page.size(390, 844, mobile=True)
    assert page.run("document.documentElement.scrollWidth") == 390
    assert page.problems == []
    assert all(address.startswith(("file:", "data:")) for address in page.requests)
    page.close()


def test_appendices_that_are_open_are_printed(browser, tmp_path):
    path = tmp_path / "long.html"
    path.write_text(page_of(content_of([samples.static_load()], []), long=True), encoding="utf-8")
    page = browser.open(path.as_uri())
    printed = sheets(page, tmp_path / "p.pdf")
    assert len(printed.pages) > 3
    assert any("Checklist" in sheet.extract_text() for sheet in printed.pages[3:])
    page.close()


ASTRAY = """[...document.querySelectorAll('.appendix table')].flatMap(table => {
  const row = [...table.querySelectorAll('tbody tr')].find(row => row.cells[0].scope !== 'rowgroup');
  let at = 0;
  return [...table.tHead.rows[0].cells].flatMap(head => {
    const below = [];
    for (let wide = 0; wide < head.colSpan; wide += row.cells[at++].colSpan) below.push(row.cells[at].getBoundingClientRect());
    const {left, right} = head.getBoundingClientRect();
    const off = Math.abs(left - below[0].left) + Math.abs(right - below.at(-1).right);
    return off > 1 ? [head.innerText] : [];
  });
})"""


@pytest.mark.parametrize("width", [680, 1000])
def test_every_head_is_above_its_column(browser, pages, width):
    page = browser.open(pages("all four tests"), width=width)
    page.run("document.querySelectorAll('details').forEach(part => part.open = true)")
    assert page.run("document.querySelectorAll('.appendix th.pair').length") > 10
    assert page.run(ASTRAY) == []
    page.close()


def test_curves_are_drawn_anew_with_values_zoom_and_methods(browser, pages):
    page = browser.open(pages("all four tests"), width=1100, height=900)
    shown = "document.querySelectorAll('.sheet .still').length"
    page.wait(f"document.querySelectorAll('.sheet .drawn').length === {shown} && {shown} > 0")
    assert page.run("getComputedStyle(document.querySelector('.still')).display") == "none"
    x, y = page.centre("#figure-1 .chart:nth-child(2) .u-over")
    page.mouse("mouseMoved", x, y)
    page.wait("document.querySelector('#figure-1 .values b') !== null")
    said = page.text("#figure-1 .values").replace("\u2009", " ")
    pressure = int(re.match(r"P = (\d+) kPa", said)[1])
    assert pressure in (300, 350)
    assert f"K {samples.truth('K', pressure * 1e3) / 1e3:.5g} ± 0.0".rstrip("0.") in said, (
        "of all panels, at one pressure"
    )
    assert "Fce" in said
    assert page.run("document.querySelector('#figure-1 .controls button').hidden")
    page.mouse("mousePressed", x - 30, y)
    page.mouse("mouseMoved", x, y)
    page.mouse("mouseMoved", x + 30, y)
    page.mouse("mouseReleased", x + 30, y)
    page.wait("!document.querySelector('#figure-1 .controls button').hidden")
    page.click("#figure-1 .controls button")
    page.wait("document.querySelector('#figure-1 .controls button').hidden")
    page.click("#figure-1 .controls button:nth-of-type(2)")
    page.wait("document.querySelector('#figure-1 .controls [aria-pressed=true]') !== null")
    assert page.run("document.querySelectorAll('.appendix .live').length") == 0
    page.run("document.querySelectorAll('.appendix').forEach(part => part.open = true)")
    page.wait("document.querySelectorAll('.drawn').length === document.querySelectorAll('.still').length")
    assert page.problems == []
    page.close()


WATCHED = """(() => {
  let made;
  window.plots = []; window.texts = [];
  Object.defineProperty(window, 'uPlot', {get: () => made, set: plot => { made = new Proxy(plot, {
    construct: (of, given) => { const one = new of(...given); plots.push(one); return one; }}); }});
  const write = CanvasRenderingContext2D.prototype.fillText;
  CanvasRenderingContext2D.prototype.fillText = function (text, ...at) { texts.push(text); write.call(this, text, ...at); };
})()"""
"""Keeps the plots and the texts that are written on them where a test finds them."""


def test_zoom_holds_a_straight_line_its_name_and_the_ticks(browser, tmp_path):
    """Straight parts are sent as their ends. At 6 to 7 there are x, 1, and -x/2 and -x of a loop; at 20 to 50 10 log10(x)."""
    x, f = np.linspace(0, 10, 300), np.geomspace(1, 100, 300)
    loop = Series("", np.append(x, x[::-1]), np.append(-x / 2, -x[::-1]), BROWN)
    flat = Series("flat", x, np.full(300, 1.0), BROWN, ".")
    charts = [
        Chart("x [mm]", "y [N]", (Series("straight", x, x, BLUE), flat, loop)),
        Chart("f [Hz]", "K [N]", (Series("decades", f, 10 * np.log10(f), BLUE),), log=True, x_ticks=(1.0, 30.0, 100.0)),
        Chart("x [mm]", "z [N]", (Series("kept", x, x, BLUE), Series("other", x, -x, BROWN, method="m")), legend=True),
    ]
    assert all(len(one["x"]) <= 4 for one in chart_series(charts) if "mark" not in one)
    content = content_of([samples.static_load()], [])
    picture = of_charts([charts], "Lines", "", Frame([{"a": "1"}]), simulated=False)
    path = tmp_path / "zoom.html"
    path.write_text(page_of(replace(content, front=[replace(content.front[0], picture=picture)])), encoding="utf-8")
    page = browser.open("about:blank", width=1100)
    page.send("Page.addScriptToEvaluateOnNewDocument", source=WATCHED)
    page.go(path.as_uri())
    page.wait("document.querySelector('.drawn') !== null && window.plots.length === 3")
    place = page.centre("#figure-1 .chart:nth-child(2) .u-over")
    page.mouse("mouseMoved", *place)
    page.wait("document.querySelector('#figure-1 .values b') !== null")
    said = [float(text) for text in re.findall(r"[\d.]+", page.text("#figure-1 .values").replace("\u2009", " "))]
    assert said[1] == pytest.approx(10 * np.log10(said[0]), abs=0.05)
    page.run("texts.length = 0")
    page.run("plots[0].setScale('x', {min: 6, max: 7}), plots[1].setScale('x', {min: 20, max: 50}), 0")
    page.wait("texts.includes('straight') && texts.includes('decades')")
    scales = page.run("plots.map(plot => [plot.scales.y.min, plot.scales.y.max])")
    assert -8 < scales[0][0] < -7 < 7 < scales[0][1] < 8
    assert scales[1] == pytest.approx(10 * np.log10([20, 50]), abs=0.3)
    assert page.run("plots[1].axes[0]._splits") == [30]
    page.run("plots[1].setScale('x', {min: 40, max: 50}), 0")
    page.wait("plots[1].axes[0]._splits.join() === '40,50'")
    assert not page.run("texts.includes('other')")
    page.click("#figure-1 .controls button:nth-of-type(2)")
    page.wait("texts.includes('other')")
    assert not page.run("texts.includes('kept')"), "that one is in the strip above"
    assert page.problems == []
    page.close()


def test_charts_of_one_x_axis_zoom_to_the_same_x(browser, tmp_path):
    """A drag in one of two charts whose axes differ in width by their labels."""
    x = np.linspace(0, 10, 300)
    above = Chart("x [mm]", "y [N]", (Series("a", x, 1e4 * x, BLUE),), together="x")
    below = Chart("x [mm]", "z [N]", (Series("longer name", x, x, BROWN),), together="x")
    content = content_of([samples.static_load()], [])
    picture = of_charts([[above, below]], "Lines", "", Frame([{"a": "1"}]), simulated=False)
    path = tmp_path / "linked.html"
    path.write_text(page_of(replace(content, front=[replace(content.front[0], picture=picture)])), encoding="utf-8")
    page = browser.open("about:blank", width=1100)
    page.send("Page.addScriptToEvaluateOnNewDocument", source=WATCHED)
    page.go(path.as_uri())
    page.wait("document.querySelector('.drawn') !== null && window.plots.length === 2")
    across, down = page.centre("#figure-1 .chart:nth-child(1) .u-over")
    page.mouse("mouseMoved", across, down)
    page.mouse("mousePressed", across, down, button="left")
    page.mouse("mouseMoved", across + 97, down, button="left")
    page.mouse("mouseReleased", across + 97, down, button="left")
    page.wait("plots[0].scales.x.max < 9")
    one, other = page.run("plots.map(plot => [plot.scales.x.min, plot.scales.x.max])")
    assert one == other
    assert 4 < one[0] < one[1] < 9
    page.click("#figure-1 .controls button")
    page.wait("plots.every(plot => plot.scales.x.max >= 10)")
    assert page.problems == []
    page.close()


def chart_series(charts):
    picture = of_charts([charts], "", "", Frame([{"a": "1"}]), simulated=False)
    return [series for chart in chart_data([(1, picture)])[0]["charts"] for series in chart["series"]]


def test_without_scripts_every_chart_is_a_picture(browser, pages):
    page = browser.open("about:blank")
    page.send("Emulation.setScriptExecutionDisabled", value=True)
    page.go(pages("all four tests"))
    page.send("Emulation.setScriptExecutionDisabled", value=False)
    seen = page.run("[...document.querySelectorAll('.sheet .still > svg')].map(e => e.getBoundingClientRect().height)")
    assert len(seen) >= 3
    assert min(seen) > 60
    assert page.run("document.querySelectorAll('canvas, button').length") == 0
    page.close()
