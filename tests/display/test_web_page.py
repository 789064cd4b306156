"""What a person sees and does in the browser, in Debian's Chromium."""

import json
import re
import sys
import threading
import time
from contextlib import contextmanager

import pytest

from pmabench.display.web.server import start
from tests.display.browsed import TOKEN, served
from tests.display.recorded import BASELINE, Recorded

POINTS = [(58.86, 2e5), (58.86, 3e5), (58.86, 4e5)]
PRESSURE = "document.querySelector('.number b')?.textContent === '300.0'"


@pytest.fixture
def run(tmp_path):
    """A run that is being written: one trial is over, the second is under way."""
    run = Recorded(tmp_path / "runs", POINTS)
    run.load()
    run.trial(0)
    run.begin(1)
    run.contract(1)
    return run


@contextmanager
def opened(browser, run, at="/", **size):
    """The page of a run, once its curves are drawn; nothing may be in its console when the block ends."""
    with served(run.folder.parent) as server:
        page = browser.open(server.link(at), **size)
        page.wait("document.querySelectorAll('.curve canvas').length === 3")
        yield page
        assert page.problems == []
        page.close()


def drawn(page, selector=".curve"):
    """Wait until more than 200 pixels of a canvas are in the colour of the curve's title."""
    page.wait(
        f"""(() => {{
          const host = document.querySelector('{selector}'), canvas = host.querySelector('canvas');
          const wanted = getComputedStyle(host.querySelector('h3')).color.match(/\\d+/g).map(Number);
          const copy = new OffscreenCanvas(canvas.width, canvas.height).getContext('2d', {{willReadFrequently: true}});
          copy.drawImage(canvas, 0, 0);
          const data = copy.getImageData(0, 0, canvas.width, canvas.height).data;
          let count = 0;
          for (let i = 0; i < data.length; i += 4)
            if (data[i + 3] > 200 && wanted.every((v, k) => Math.abs(data[i + k] - v) < 24)) count++;
          return count > 200;
        }})()"""
    )


def test_a_run_is_seen_while_it_goes_on(browser, run):
    with opened(browser, run) as page:
        page.wait("document.title === 'trial 2/3 · pmabench'")
        page.wait(PRESSURE)
        assert page.text("#status") == "running"
        assert page.text("#simulated") == "SIMULATED"
        assert "load 58.86 N, pressure 300 kPa" in page.text("#point")
        assert page.run("location.hash") == ""  # the token is not left in the address
        page.wait("document.querySelector('#trials-count').textContent === '1 of 3'")
        page.wait("document.querySelector('#loop-title').textContent === 'Trial 2'")
        for n in (1, 2, 3):
            drawn(page, f".curve:nth-child({n})")
        run.end(1)
        run.trial(2, factor=1.3)
        page.wait("document.querySelector('#trials-count').textContent === '3 of 3, 1 in doubt'", within=5.0)
        assert "30% above expected" in page.text("#trials tbody")
        assert page.text("#trials tbody tr").startswith("! 3")
        assert page.run("document.querySelector('#coefficient').getAttribute('aria-label')").startswith(
            "K over P: 3 tr"
        )
        paint = page.run("performance.getEntriesByName('first-contentful-paint')[0].startTime")
        assert paint < 3000  # 0.3 s on a quiet machine
    run.close()


def test_zoom_and_back_by_keys_wheel_and_mouse(browser, run):
    with opened(browser, run) as page:
        page.wait(PRESSURE)
        drawn(page)  # numbers come before the history: until then the curves have no time to choose from
        window = "document.querySelector('#window').textContent"
        assert page.run(window) == ""
        x, y = page.centre(".u-over")
        page.mouse("mousePressed", x, y)
        for step in (10, 40, 80):
            page.mouse("mouseMoved", x + step, y, button="left", buttons=1)
        page.mouse("mouseReleased", x + 80, y)
        page.wait(f"{window}.includes(' to ')")
        begin, end = re.findall(r"(\d+):(\d+\.\d)", page.run(window))
        assert 0.5 < float(end[1]) - float(begin[1]) < 10
        page.press("l")
        page.wait(f"{window} === ''")
        page.mouse("mouseWheel", x, y, deltaX=0, deltaY=-200)
        page.wait(f"{window}.includes(' to ')")
        page.press("5")
        page.wait("document.querySelector('#spans').lastChild.getAttribute('aria-pressed') === 'true'")
        page.press("?")
        page.wait("document.querySelector('#help').open")
        page.press("Escape")
        page.wait("!document.querySelector('#help').open")
    run.close()


def test_a_session_is_seen(browser, tmp_path):
    run = Recorded(tmp_path / "runs", POINTS, kind="session", trials_planned=0)
    (run.folder / "plan.json").write_text(json.dumps({"schema": "pmabench.plan/1", "trials": [], "steps": []}))
    run.writer.event("prompt", 0.0, text="Is the rig clear?", phase="clear", demands="vented")
    with served(run.folder.parent) as server:
        page = browser.open(server.link())
        page.wait("!document.querySelector('#asked').hidden")
        assert page.text("#asked").startswith("Is the rig clear?")
        assert "answered at the terminal of the run" in page.text("#asked")
        run.writer.event("answer", 1.0, text="Is the rig clear?", answer="clear", pressure=0.0)
        run.flush()
        page.wait("document.querySelector('#asked').hidden", within=5.0)
        run.close()
        page.wait("document.querySelector('#status').textContent === 'finished, vent confirmed'", within=5.0)
        after = Recorded(tmp_path / "runs", POINTS, name="after")
        after.trial(0)
        page.wait("document.querySelector('#kind').textContent === 'contraction-relaxation'", within=6.0)
        assert page.run("[...document.querySelectorAll('#list li')].length") == 2
        page.run("[...document.querySelectorAll('#list a')][1].click()")
        page.wait("document.querySelector('#kind').textContent === 'session'", within=6.0)
        assert page.run("location.pathname") == f"/run/{run.folder.name}"
        assert page.problems == []
        page.close()
        after.close()


def test_a_trip_is_seen(browser, run):
    with opened(browser, run) as page:
        run.samples(1, BASELINE + 4.2)
        run.writer.event("trip", run.t + BASELINE + 4.1, reason="pressure 653 kPa is above its limit of 650 kPa")
        run.close("tripped", "pressure 653 kPa is above its limit of 650 kPa", vent="commanded")
        page.wait("document.querySelector('#status').textContent === 'tripped, vent commanded'", within=5.0)
        assert page.run("document.querySelector('#status').className") == "pill bad"
        assert "above its limit" in page.text("#why")
        page.wait("document.querySelector('#why code') !== null", within=5.0)
        assert f"pmabench continue {run.folder}" in page.text("#why code")
        assert "TRIPPED" in page.text("#log")
        assert page.run("document.title") == "tripped · pmabench"


def test_an_end_is_seen_with_the_next_command(browser, run):
    with opened(browser, run) as page:
        run.end(1)
        run.trial(2)
        run.close()
        page.wait("document.querySelector('#status').textContent === 'finished, vent confirmed'", within=5.0)
        page.wait("document.querySelector('#why code') !== null", within=5.0)
        assert page.text("#why code") == f"pmabench process {run.folder}"
        drawn(page)  # the last picture stays


@contextmanager
def written(run):
    """The trial goes on in real time while the block lasts."""
    over = threading.Event()

    def write():
        began, until = time.monotonic(), BASELINE + 4.0
        while not over.wait(0.1):
            run.samples(1, until + time.monotonic() - began)

    thread = threading.Thread(target=write)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


@pytest.mark.realtime
def test_it_comes_back_without_a_gap(browser, run):
    server = start(run.folder.parent, TOKEN)
    port = server.server_address[1]
    page = browser.open(server.link())
    page.wait(PRESSURE)
    with written(run):
        page.wait("document.querySelector('#trial').textContent === 'trial 2 of 3'")
        server.stop()
        page.wait("document.body.classList.contains('lost')", within=6.0)
        assert re.match(r"no data for \d+ s; trying again", page.text("#trouble"))
        server = start(run.folder.parent, TOKEN, ports=(port,))
        began = time.monotonic()
        page.wait("!document.body.classList.contains('lost')", within=8.0)
        back = time.monotonic() - began
        page.wait("performance.now() - window.seen > 1200 || (window.seen ??= performance.now(), false)")
        blank = page.run(
            """(() => { const canvas = document.querySelectorAll('.curve canvas')[0];
               const [w, h] = [canvas.width, canvas.height];
               const c = new OffscreenCanvas(w, h).getContext('2d', {willReadFrequently: true});
               c.drawImage(canvas, 0, 0);
               let blank = 0;
               for (let x = Math.round(0.75 * w); x < w - 24; x++) {
                 const d = c.getImageData(x, 0, 1, h - 30).data;
                 let found = false;
                 for (let i = 0; i < d.length; i += 4) if (d[i + 3] > 100 && d[i + 2] - d[i] > 60) found = true;
                 if (!found) blank++;
               }
               return blank; })()"""
        )
    server.stop()
    page.close()
    run.close("aborted")
    assert back < 4.0
    assert blank == 0


@pytest.mark.realtime
def test_eight_pages_next_to_each_other_none_hangs(browser, run):
    with served(run.folder.parent) as server, written(run):
        pages = [browser.open(server.link())]
        pages += [browser.open(server.link(), next_to=pages[0]) for _ in range(7)]
        for page in pages:
            browser.send("Target.activateTarget", targetId=page.target)
            page.wait("document.querySelector('#trial').textContent === 'trial 2 of 3'", within=10.0)
            page.wait("/^[\\d.]+$/.test(document.querySelector('.number b')?.textContent)")
            assert page.problems == []
        for page in pages:
            page.close()
    run.close("aborted")


def test_on_a_phone_nothing_is_wider_than_the_screen(browser, run):
    with opened(browser, run, width=390, height=844, mobile=True) as page:
        page.wait(PRESSURE)
        assert page.run("document.documentElement.scrollWidth") == 390
        small = page.run(
            "[...document.querySelectorAll('button, select')].filter(e => e.offsetParent && e.offsetHeight < 44)"
            ".map(e => e.id || e.textContent)"
        )
        assert small == []
        columns = page.run("getComputedStyle(document.querySelector('main')).gridTemplateColumns.split(' ').length")
        assert columns == 1


@pytest.mark.parametrize("width", [820, 1024, 1920])
def test_at_other_widths_nothing_overflows(browser, run, width):
    with opened(browser, run, width=width) as page:
        assert page.run("document.documentElement.scrollWidth") == width


CONTRAST = """(() => {
  const light = c => { const v = c.map(x => x / 255).map(x => x <= 0.03928 ? x / 12.92 : ((x + 0.055) / 1.055) ** 2.4);
    return 0.2126 * v[0] + 0.7152 * v[1] + 0.0722 * v[2]; };
  const read = text => text.match(/[\\d.]+/g).map(Number);
  const ground = e => { for (; e; e = e.parentElement) { const c = read(getComputedStyle(e).backgroundColor);
    if (c.length < 4 || c[3] > 0) return c; } return [255, 255, 255]; };
  const poor = [];
  for (const e of document.querySelectorAll('body *')) {
    if (!e.offsetParent || ![...e.childNodes].some(n => n.nodeType === 3 && n.data.trim())) continue;
    const [a, b] = [light(read(getComputedStyle(e).color)), light(ground(e))];
    const ratio = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
    if (ratio < 4.5) poor.push(`${e.textContent.trim().slice(0, 30)} ${ratio.toFixed(2)}`);
  }
  return poor; })()"""


@pytest.mark.parametrize("dark", [False, True])
def test_text_can_be_read_in_light_and_dark(browser, run, dark):
    with opened(browser, run, dark=dark) as page:
        page.wait("document.querySelectorAll('#trials tbody tr').length > 0")
        ground = page.run("getComputedStyle(document.body).backgroundColor")
        assert ground == ("rgb(23, 31, 39)" if dark else "rgb(255, 255, 255)")
        assert page.run(CONTRAST) == []
        drawn(page)
        page.press("d")
        page.wait(f"getComputedStyle(document.body).backgroundColor !== '{ground}'")
        assert page.run(CONTRAST) == []


def test_the_next_quantity_of_the_trials_by_a_key(browser, run):
    with opened(browser, run) as page:
        page.wait(PRESSURE)
        drawn(page)
        seen = []
        for _ in range(page.wait("document.querySelector('#symbol').length")):
            symbol = page.run("document.querySelector('#symbol').value")
            seen.append(symbol)
            assert page.text("#coefficient-title") == f"{symbol} over P, trial by trial"
            label = page.run("document.querySelector('#coefficient').getAttribute('aria-label')")
            assert label.startswith(f"{symbol} over P: 1 trial")
            page.press("s")
            page.wait(f"document.querySelector('#symbol').value !== '{symbol}'")
        assert sorted(seen) == ["F_ce", "K", "tau", "x_inf"]
        assert page.run("document.querySelector('#symbol').value") == seen[0]  # round and round


def test_what_a_key_does_is_in_the_help(browser, run):
    with opened(browser, run) as page:
        page.press("?")
        page.wait("document.querySelector('#help').open")
        assert page.run("[...document.querySelectorAll('#help dt')].map(e => e.textContent).join(' ')") == (
            "1 … 5 ← → + − L Y S D P"
        )


@pytest.mark.parametrize("long", [False, True])
def test_it_prints_on_one_page_in_light(browser, run, tmp_path, long):
    from pypdf import PdfReader

    if long:  # as tall as it gets: long names, many trials, a reason and the next command above the curves
        run = Recorded(
            tmp_path / "long", POINTS * 8, name="20261128-0807_MAS-20-250N-AA-MC-K-MOCK-P0_contraction-relaxation_7f3a",
            specimen={"type": "MAS-20-250N-AA-MC-K", "serial": "MOCK-P0"}, campaign={"name": "demonstration of a lab"},
        )  # fmt: skip
        for trial in range(20):
            run.trial(trial)
        run.begin(20)
        run.contract(20)
    with opened(browser, run, dark=True) as page:
        page.wait(f"document.querySelectorAll('#trials tbody tr').length > {15 if long else 0}")
        if long:
            page.wait("!document.querySelector('#loop-part').hidden")
            run.close("tripped", "pressure 653 kPa is above its limit of 650 kPa, set by the bench file at line 21")
            page.wait("document.querySelector('#why code') !== null")
        page.pdf(tmp_path / "view.pdf")
        [sheet] = PdfReader(tmp_path / "view.pdf").pages
        text = sheet.extract_text()
        assert re.search(r"printed\s20\d\d-\d\d-\d\d \d\d:\d\d", text)
        assert "contraction-relaxation" in text
        assert "Live" not in text  # no buttons


def test_a_page_without_the_token_says_so(browser, run):
    with served(run.folder.parent) as server:
        page = browser.open(server.url)
        page.wait("!document.querySelector('#trouble').hidden")
        assert "open the printed address again" in page.text("#trouble")
        page.close()


def test_the_vent_button_takes_two_steps(browser, run):
    (run.folder / "bench.yaml").write_text("schema: pmabench.bench/1\nweb_vent: true\n")
    script = "import json; print(json.dumps({'benches': [{'result': 'confirmed', 'actions': ['pressure to 0 Pa']}]}))"
    with served(run.folder.parent, vent=True) as server:
        server.vent_command = [sys.executable, "-c", script]
        page = browser.open(server.link())
        page.wait("!document.querySelector('#vent').hidden")
        assert page.text("#vent") == "Vent (not an emergency stop)"
        page.click("#vent", hold=0.1)  # too short
        page.run("document.querySelector('#vent').focus()")
        page.press("Enter")
        page.wait("!document.querySelector('#vented').hidden")
        assert page.text("#vented") == "press Enter once more within 3 s to vent"
        page.press("Enter")
        page.wait("document.querySelector('#vented').textContent.startsWith('vent confirmed')", within=5.0)
        server.vent_command = [sys.executable, "-c", "raise SystemExit('no bench')"]
        page.click("#vent", hold=3.0)  # long enough for a browser that gets little of a busy machine
        page.wait(
            "document.querySelector('#vented').textContent.startsWith('VENT NOT CONFIRMED: no bench')", within=20.0
        )
        assert page.problems == []
        page.close()


def test_device_text_cannot_become_markup(browser, tmp_path):
    nasty = "<img src=x onerror=\"document.title='hit'\"><script>document.title='hit'</script>"
    run = Recorded(tmp_path / "runs", POINTS, specimen={"type": nasty, "serial": nasty}, campaign={"name": nasty})
    run.writer.event("warning", 0.0, reason=nasty)
    run.writer.event("prompt", 0.0, text=nasty, phase="load", demands="vented")
    run.begin(0)
    run.contract(0)
    with opened(browser, run) as page:
        page.wait("!document.querySelector('#asked').hidden")
        assert page.text("#specimen").startswith("<img")
        assert page.run("document.querySelectorAll('img, body script:not(:last-of-type)').length") == 0
        assert page.run("document.title").startswith("trial 1")
    run.close()
