"""One self-contained page: nothing fetched, hostile text inert, every figure described and tabled, the same bytes."""

import hashlib
import os
import random
import re
import subprocess
import sys
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from pmabench.report.document.content import content_of, write_page
from pmabench.report.writing import css_text, symbols_marked
from pmabench.store.analyses.results import Analysis, Dropped, Estimate, Finding, Parts, Trace
from tests.report.samples import render

from . import samples

VOID = {"meta", "br", "img", "link", "input", "hr"}
EVIL = '"><script>alert(1)</script><img src=x onerror=alert(1)>{{7*7}}{% raw %}</style></svg>[/]=1+1'


class Page(HTMLParser):
    """Tags, attributes and text of a page; complains about tags that do not close."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str]]] = []
        self.stack: list[str] = []
        self.words: list[str] = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.stack.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        assert self.stack, f"</{tag}> closes nothing"
        assert self.stack.pop() == tag

    def handle_data(self, data):
        if not self.stack or self.stack[-1] not in ("style", "script"):
            self.words.append(data)

    @property
    def text(self) -> str:
        return re.sub(r"\s+", " ", " ".join(self.words))


@pytest.fixture(scope="module")
def report() -> str:
    return render(samples.all_analyses(), samples.all_runs())


@pytest.fixture(scope="module")
def page(report) -> Page:
    return Page(report)


def outside(text: str) -> list[str]:
    """References out of the file; scripts are known by their hash, and fonts are data."""
    text = re.sub(r"(?s)<script>.*?</script>|url\(data:font/woff2;base64,[A-Za-z0-9+/=]*\)", "", text)
    return re.findall(
        r"https?:|//[a-z]|@import|url\((?!#)|src\s*=\s*[\"']?(?!data:)|<link|<iframe", text, re.IGNORECASE
    )


def test_nothing_outside_the_file_is_referenced(report, page):
    assert outside(report) == []
    for _, attributes in page.tags:
        assert attributes.get("href", "#").startswith("#")
        assert not any(name.startswith("on") for name in attributes)
    assert len(report.encode()) < 2_000_000
    assert page.stack == []


def test_references_inside_the_file_lead_somewhere(page):
    ids = [attributes["id"] for _, attributes in page.tags if "id" in attributes]
    assert len(ids) == len(set(ids))
    for _, attributes in page.tags:
        if "href" in attributes:
            assert attributes["href"][1:] in ids
        for used in re.findall(r"url\(#([^)]*)\)", " ".join(v or "" for v in attributes.values())):
            assert used in ids


def test_every_figure_is_numbered_described_and_tabled(report):
    figures = re.findall(r"<figure.*?</figure>", report, re.DOTALL)
    assert len(figures) >= 10
    for n, figure in enumerate(figures, 1):
        assert f"<b>Figure {n}</b>" in figure
        described = re.search(r'role="img" aria-labelledby="([^"]+)"><desc id="([^"]+)">([^<]{40,})</desc>', figure)
        assert described is not None
        assert described[1] == described[2]
        assert re.search(r"<details[^>]*>.*<table.*<td.*</table>.*</details>", figure, re.DOTALL)
        assert "SIMULATED" in figure


def test_the_first_page_says_what_matters(page):
    first = page.text.split("Protocol and deviations")[0]
    for words in (
        "Festo MAS-20-250N-AA-MC-K, serial A017",
        "mock bench",
        "4 runs: 4 finished",
        "SIMULATED",
        "Usable with care",
    ):
        assert words in first
    assert "7.552" not in first or "±" in first
    assert first.count("Figure ") >= 3


def test_everything_that_was_left_out_is_reported(page):
    for words in (
        "the load, 157 N, is not below",
        "not identifiable",
        "the bench lacks: no dump valve",
        "samples flagged gaps: 3",
        "prompts to the operator confirmed beforehand",
        "CAL-P-7",
        "0" * 64,
        "46 trials used, 1 not used",
    ):
        assert words in page.text


def test_simulated_is_said_everywhere_and_real_runs_are_not_called_so(report):
    assert "<title>SIMULATED: " in report
    assert "all of these values come from a simulated bench" in report
    real = render(samples.all_analyses(False), samples.all_runs(False))
    named = "".join(samples.RUNS.values())
    assert "SIMULATED" in named
    without = real
    for run in samples.RUNS.values():
        without = without.replace(run, "")
    assert "SIMULATED" not in without
    mixed = render([samples.static_load(False), samples.sine(True)], [])
    assert "some of these values come from a simulated bench" in mixed


def test_the_same_input_gives_the_same_bytes(report):
    """In another process, with other hashes, clock and place, and whatever the order of the runs."""
    code = (
        "import hashlib; from tests.report import samples; from tests.report.samples import render;"
        "print(hashlib.sha256(render(samples.all_analyses(), samples.all_runs()[::-1]).encode()).hexdigest())"
    )
    root = Path(__file__).resolve().parents[2]
    environment = {**os.environ, "PYTHONHASHSEED": "7", "SOURCE_DATE_EPOCH": "1", "TZ": "Asia/Tokyo"}
    out = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=root, env=environment
    )
    assert out.stdout.strip() == hashlib.sha256(report.encode()).hexdigest()


def hostile() -> tuple[list[Analysis], list]:
    estimate = Estimate(
        EVIL, 1.0, EVIL, EVIL, EVIL, {"pressure": 1e5, EVIL: 1.0}, note=EVIL, trials=(EVIL,), coordinate=EVIL
    )
    columns = {"t": np.arange(5.0), EVIL: np.arange(5.0)}
    traces = (
        Trace(EVIL, EVIL, EVIL, columns, {"t": EVIL, EVIL: EVIL}, {EVIL: 1.0}),
        Trace("a", "overlay", EVIL, {"t": np.arange(5.0), "displacement": np.arange(5.0), "model": np.arange(5.0)}, {}),
    )
    analysis = Analysis(
        EVIL,
        (EVIL,),
        True,
        estimates=(
            estimate,
            replace(estimate, at={"pressure": 2e5}, value=2.0),
            replace(estimate, at={"pressure": 3e5}),
        ),
        dropped=(Dropped(EVIL, {EVIL: 1.0}, EVIL),),
        findings=(Finding(EVIL, EVIL), Finding("fault", EVIL)),
        traces=traces,
        facts={
            "trials": EVIL,
            "tuning": [{"rule": EVIL, "at": {EVIL: 1.0}, "gains": {EVIL: {"value": 1.0, "unit": EVIL}}}],
        },
    )
    manifest = {
        "specimen": {"make": EVIL, "type": [EVIL], "serial": {EVIL: EVIL}},
        "bench": {"name": EVIL},
        "devices": {EVIL: {"maker": EVIL}},
        "protocol": EVIL,
        "operator": EVIL,
        "started_utc": EVIL,
        "deviations": [EVIL],
        "hazards": EVIL,
        "versions": {EVIL: EVIL},
        "why": EVIL,
        "plan_sha256": EVIL,
        "trials_planned": EVIL,
        "end": EVIL,
    }
    run = replace(samples.run("static-load", **manifest), id=EVIL, status=EVIL, kind=EVIL, plan={"accept": EVIL})
    return [analysis], [run]


def test_hostile_text_is_text():
    analyses, runs = hostile()
    text = render(analyses, runs, title=EVIL)
    page = Page(text)
    assert page.stack == []
    assert outside("".join(re.findall(r"<style>.*?</style>", text, re.DOTALL))) == []
    assert not any(tag in ("img", "iframe") for tag, _ in page.tags)
    assert [tag for tag, _ in page.tags].count("script") == text.count("<script") == 3
    for _, attributes in page.tags:
        assert "src" not in attributes
        assert attributes.get("href", "#").startswith("#")
        assert not any(name.startswith("on") for name in attributes)
    assert "49" not in symbols_marked("{{7*7}}")
    assert [tag for tag, _ in page.tags].count("style") == text.count("<style") > 0
    assert "alert(1)" in page.text


def test_manifests_of_any_shape_are_read():
    for odd in (None, 3, "x", [1, [2]], {"a": {"b": None}}, True, float("nan")):
        names = ("specimen", "bench", "devices", "versions", "end", "imported", "deviations", "operator", "duration")
        run = samples.run("static-load", **dict.fromkeys(names, odd))
        render([samples.static_load()], [replace(run, plan={"accept": odd})])


def test_empty_and_unknown_analyses_make_a_report(tmp_path):
    unknown = Trace("x", "nebula", "Something new", {"a": np.arange(9.0), "b": np.arange(9.0) ** 2}, {"a": "time"})
    broken = (
        Trace("n", "overlay", "t", {"t": np.full(3, np.nan), "displacement": np.zeros(3), "model": np.zeros(3)}, {}),
        Trace("e", "loop", "t", {"displacement": np.empty(0), "force": np.empty(0)}, {}),
        Trace("u", "bode", "t", {"frequency": np.zeros(4), "stiffness": np.ones(3)}, {}),
        Trace("h", "growth", "t", {"gain": np.full(3, 1e300), "log_ratio": np.zeros(3), "used": np.ones(3)}, {}),
    )
    analyses = [Analysis("nothing", (), False), Analysis("new-test", ("r",), False, traces=(unknown, *broken))]
    path = write_page(content_of(analyses, []), tmp_path / "sub" / "r.html")
    text = path.read_text(encoding="utf-8")
    assert "Something new" in text
    assert "Every trial entered its fit" in text
    assert Page(text).stack == []
    assert render([], [])


@pytest.mark.parametrize("analysis", [samples.sine(), samples.ultimate_gain(), samples.static_load()])
def test_the_section_of_coefficients_is_never_empty(analysis):
    text = render([analysis], [])
    section = text[text.index('id="coefficients"') :].partition("<section")[0]
    assert "<tbody>" in section or "the values are under each test" in section


NUMBERS = (0.0, -1.0, 1e300, -1e-300, 1e308)


def damaged(analysis: Analysis, rng: random.Random) -> Analysis:
    """The analysis with some of its numbers replaced by ones that no measurement gives."""

    def column(values: np.ndarray, n: int) -> np.ndarray:
        kinds = (
            np.zeros(n),
            np.full(n, np.nan),
            np.full(n, 1e300),
            np.full(n, np.inf),
            -np.ones(n),
            np.resize(values, n),
        )
        return rng.choice(kinds)

    def estimate(e: Estimate) -> Estimate:
        return rng.choice(
            (
                e,
                replace(e, value=rng.choice((*NUMBERS, None, float("nan"), float("inf")))),
                replace(e, parts=Parts(rng.choice((*NUMBERS, float("nan"))))),
                replace(e, at=dict.fromkeys(e.at, rng.choice(NUMBERS))),
            )
        )

    traces = []
    for trace in analysis.traces:
        n = rng.choice((0, 1, 2, 50))
        columns = {name: column(values, n) for name, values in trace.columns.items()}
        traces.append(replace(trace, columns=columns, marks=dict.fromkeys(trace.marks, rng.choice(NUMBERS))))
    domains = ((0.0, 0.0), (1.0, -1.0), (1e5, 5e5))
    curves = [
        replace(c, domain=rng.choice(domains), residual_rms=rng.choice((0.0, float("nan")))) for c in analysis.curves
    ]
    return replace(
        analysis, estimates=tuple(map(estimate, analysis.estimates)), curves=tuple(curves), traces=tuple(traces)
    )


@pytest.mark.parametrize("seed", range(3))
def test_absurd_numbers_make_a_report_without_a_warning(seed):
    rng = random.Random(seed)
    text = render([damaged(analysis, rng) for analysis in samples.all_analyses()], [])
    assert Page(text).stack == []


def test_a_title_cannot_leave_its_css_string():
    assert re.fullmatch(r"[A-Za-z0-9 \\]*", str(css_text(EVIL + "\n\\")))


def test_symbols_are_set_and_text_stays_escaped():
    assert symbols_marked("F_ce [N] <b>") == "<i>F</i><sub>ce</sub> [N] &lt;b&gt;"
    assert symbols_marked("N") == "N"
    assert symbols_marked("a fit, F_ce known") == "a fit, <i>F</i><sub>ce</sub> known"
