"""The two pages of a report: numbers as the tables have them, no contradiction, colours that everybody tells apart."""

import itertools
import json
import math
import re
from dataclasses import replace

import numpy as np
import pytest

from pmabench.plotting import chart, drawing
from pmabench.plotting.chart import Chart, Series
from pmabench.report.certificate import quality
from pmabench.report.certificate.force_chart import READABLE, blue
from pmabench.report.certificate.quality import limits
from pmabench.report.certificate.result_table import result_table, thousands
from pmabench.report.certificate.sheet import sheet_of
from pmabench.report.document.content import content_of, page_of
from pmabench.report.foremost import Verdict, how_well, left_out
from pmabench.store.analyses.results import Dropped, Finding, Parts, Trace

from . import samples
from .samples import render
from .test_html import Page
from .test_names import withheld

FIGURE_SPACES = re.compile("[\u2007\u2008\u2009]")


def linear(share: float) -> float:
    return share / 12.92 if share <= 0.04045 else ((share + 0.055) / 1.055) ** 2.4


def light(color: str) -> list[float]:
    """Linear red, green and blue of `#rrggbb`."""
    color = "#" + "".join(2 * sign for sign in color[1:]) if len(color) == 4 else color
    return [linear(int(color[n : n + 2], 16) / 255) for n in (1, 3, 5)]


def contrast(color: str, ground: str = "#ffffff") -> float:
    """WCAG 2.1, relative luminance."""
    one, two = sorted(0.2126 * r + 0.7152 * g + 0.0722 * b for r, g, b in (light(color), light(ground)))
    return (two + 0.05) / (one + 0.05)


SIGHT = {
    "normal": np.eye(3),
    "protanopia": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deuteranopia": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.01182, 0.04294, 0.968881]],
}
"""Machado, Oliveira and Fernandes 2009, severity 1, on linear colours."""


def lab(color: str, sight: str) -> list[float]:
    """CIE L*a*b*, D65."""
    r, g, b = np.clip(np.asarray(SIGHT[sight]) @ light(color), 0, 1)
    whole = (0.4124 * r + 0.3576 * g + 0.1805 * b, 0.2126 * r + 0.7152 * g + 0.0722 * b,
             0.0193 * r + 0.1192 * g + 0.9505 * b)  # fmt: skip
    x, y, z = (
        t ** (1 / 3) if t > 0.008856 else 7.787 * t + 16 / 116
        for t in (v / w for v, w in zip(whole, (0.95047, 1, 1.08883), strict=True))
    )
    return [116 * y - 16, 500 * (x - y), 200 * (y - z)]


def test_the_measures_of_colour_are_right():
    assert contrast("#000000") == pytest.approx(21)
    assert contrast("#767676") == pytest.approx(4.54, abs=0.01)
    assert lab("#ff0000", "normal") == pytest.approx([53.24, 80.09, 67.20], abs=0.1)


@pytest.mark.parametrize("pair", list(itertools.combinations(chart.PALETTE, 2)))
def test_two_series_are_distinguished_by_everybody(pair):
    for sight in SIGHT:
        assert math.dist(*(lab(color, sight) for color in pair)) >= 30


@pytest.mark.parametrize("color", [*chart.PALETTE])
def test_series_are_seen_on_paper(color):
    assert contrast(color) >= 2.99


def test_every_text_of_the_page_is_readable(page_text):
    """Text of charts by its attribute, of the page by the style sheet's colours, on white."""
    drawn = set(re.findall(r'<text [^>]*fill="(#[0-9a-f]{3,6})"', page_text))
    style = page_text.partition("<style>")[2].partition("</style>")[0]
    named = dict(re.findall(r"--([a-z]+): (#[0-9a-f]{6})", style))
    inside = {color for rule in re.findall(r"(?<![-\w])color: (#[0-9a-f]{3,6})", style) for color in [rule]} - {"#fff"}
    texts = drawn | inside | {named[name] for name in ("ink", "quiet", "accent", "warn", "fault", "good")}
    assert len(drawn) > 4
    assert {color: contrast(color) for color in texts if contrast(color) < 4.5} == {}
    assert contrast(blue(READABLE)) >= 4.5
    assert contrast("#16202a", "#d3e1f0") >= 4.5
    assert all(contrast(color) >= 4.5 for color in quality.COLORS.values())


@pytest.fixture(scope="module")
def content():
    return content_of(samples.all_analyses(), samples.all_runs())


@pytest.fixture(scope="module")
def page_text(content) -> str:
    return page_of(content)


def cells(text: str) -> set[str]:
    """Every `value ± half` that the page says, without spaces."""
    words = re.sub(r"\s+", " ", " ".join(Page(text).words))
    return {re.sub(r"\s", "", pair) for pair in re.findall(r"[−\d.\u2007\u2008\u2009]+ ?± ?[\d.\u2007\u2008]+", words)}


def test_the_table_says_what_the_appendix_says(content):
    """7.552 ± 0.021 at 400 kPa is the worked example; every pair of the table is in the appendix, digit by digit."""
    rows = [[FIGURE_SPACES.sub("", f"{v.text} ± {v.half}" if v.half else v.text) for v in row]
            for row in content.sheet.table.rows]  # fmt: skip
    by = {row[0]: row for row in rows}
    assert by["400"][2] == "7.552 ± 0.021"
    assert by["500"][4] == "not identifiable"
    appendix = {
        f"{cell.text} ± {cell.half}" if cell.half else cell.text
        for grid in content.coefficients
        for _, lines in grid.groups
        for line in lines
        for cell in line
    }
    pairs = {text for row in rows for text in row if "±" in text}
    assert len(pairs) == 31
    assert pairs <= appendix


def test_where_all_values_are_at_one_place_a_note_says_it_and_the_table_what_differs():
    """Of sines the column was wider than the page: its end and the number of trials were cut off."""
    at = {"pressure": 3e5, "mean": 0.01, "amplitude": 0.005}
    plain = samples.sine()
    e = next(e for e in plain.estimates if e.symbol == "K")
    values = [replace(e, at=at), replace(e, at={**at, "frequency": 0.1})]
    table, _, over = result_table([replace(plain, estimates=tuple(values))])
    assert over == ""
    assert [row[-2].text for row in table.rows] == ["", "f 0.1 Hz"]
    assert table.notes[0] == "All at amplitude 5 mm, mean x 10 mm, P 300 kPa"


def test_values_without_an_interval_keep_their_digits():
    """A limit cycle of 0.3291 mm was "0" in the table, as every value of a column without any interval."""
    plain = samples.sine()
    e = next(e for e in plain.estimates if e.symbol == "K")
    sizes = (0.3291e3, 7.582e3, 56.82e3)  # 0.3291 N/mm, ...
    values = [
        replace(e, value=K, parts=Parts(), budget=(), at={"pressure": 1e5 * (n + 1)}) for n, K in enumerate(sizes)
    ]
    table, _, _ = result_table([replace(plain, estimates=tuple(values))])
    column = next(n for n, head in enumerate(table.heads) if head[0] == "K")
    texts = [row[column].text.replace("\u2007", " ").strip() for row in table.rows]
    assert texts == ["0.3291", "7.582", "56.82"]
    assert not any(row[column].half or row[column].words for row in table.rows)


def test_points_are_below_each_other():
    table, _, _ = result_table(samples.all_analyses())
    for column in zip(*table.rows, strict=True):
        texts = [v.text.replace("\u2008", ".") for v in column if not v.words and v.half]
        assert len({len(text) for text in texts}) <= 1
        assert len({text.index(".") for text in texts if "." in text}) <= 1


@pytest.mark.parametrize(
    ("digits", "text"), [("1234", "1234"), ("12345", "12\u2009345"), ("−1234567", "−1\u2009234\u2009567"), ("7", "7")]
)
def test_thousands_are_apart_from_five_digits_on(digits, text):
    assert thousands(digits) == text


@pytest.mark.parametrize("half", np.geomspace(0.0101, 9.99, 60))
def test_rounding_takes_off_no_more_than_five_per_cent_of_an_interval(half):
    """EA-4/02 M:2022, 6.3: to two digits; rounded up where rounding down would take off more than 5 %."""
    from pmabench.plotting.wording import half_width

    assert float(half_width(half)) >= 0.95 * half


VERDICTS = [
    (samples.all_analyses(), "Usable with care"),
    ([withheld()], "Not accepted"),
    ([replace(samples.contraction(), findings=(), dropped=())], "Accepted"),
    ([replace(samples.contraction(), findings=(Finding("fault", "the cell is wired wrong"),))], "Faults were found"),
    ([replace(samples.contraction(), estimates=(), curves=(), findings=(), traces=())], "No result"),
]


@pytest.mark.parametrize(("analyses", "word"), VERDICTS)
def test_no_part_of_the_page_contradicts_the_verdict(analyses, word):
    """What the first page says, what figures and tables show, and what the appendix counts, in the produced page."""
    runs = [samples.run("contraction-relaxation")]
    text = render(analyses, runs)
    page = Page(text)
    said = re.findall(r'<p class="verdict [a-z]+">([^<]*)</p>', text)
    assert said == [word]
    first, _, rest = page.text.partition("Appendices")
    bad = sum(f.level in ("fault", "doubt") for a in analyses for f in a.findings)
    assert rest.count("Doubt ") + rest.count("Fault ") >= bad
    if word == "Accepted":
        assert "withheld" not in first
        assert "Nothing that limits the use" in first
        assert not bad
    if word == "Not accepted":
        assert first.count("withheld") >= 3
        assert "Withheld: K at 200 kPa and K at 250 kPa" in first, "figure and table withhold the same"
        drawn = json.loads(re.search(r'id="charts">(.*?)</script>', text, re.DOTALL)[1].replace("\\u003c", "<"))
        dots = [s for c in drawn[0]["charts"] for s in c["series"] if s.get("said") == "K" and s.get("mark")]
        assert {200.0, 250.0}.isdisjoint(dots[0]["x"])
    elif word != "No result":
        assert "Not accepted" not in page.text
    if word == "No result":
        assert "No coefficient came out" in first
        assert "±" not in first


def test_the_charts_show_the_values_of_the_table(content, page_text):
    data = json.loads(re.search(r'id="charts">(.*?)</script>', page_text, re.DOTALL)[1])
    assert [entry["n"] for entry in data] == [item.n for item in content.figures]
    panel = data[0]["charts"][1]
    dots = next(s for s in panel["series"] if s.get("mark") and not s.get("method"))
    at = dots["x"].index(400.0)
    assert (dots["y"][at], dots["half"][at]) == (7.552, 0.021)
    methods = {s.get("method") for c in data[0]["charts"] for s in c["series"]}
    assert {"step-exponential", "static-mean"} <= methods, "other methods are there for the buttons"
    assert page_text.count('class="still') == len(content.figures)


def test_the_page_runs_its_own_scripts_only(page_text):
    import base64
    import hashlib

    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', page_text)[1]
    scripts = re.findall(r"<script>(.*?)</script>", page_text, re.DOTALL)
    hashes = {f"'sha256-{base64.b64encode(hashlib.sha256(s.encode()).digest()).decode()}'" for s in scripts}
    assert len(scripts) == 2
    assert set(re.findall(r"'sha256-[^']*'", policy)) == hashes
    assert "default-src 'none'" in policy
    assert "connect-src" not in policy


@pytest.mark.parametrize(
    "analyses", [[samples.static_load()], [samples.sine()], [samples.ultimate_gain()], [], samples.all_analyses()]
)
def test_no_frame_is_empty(analyses):
    text = render(analyses, [])
    page = text.partition("Appendices")[0]
    for part in ("table", "dl", "ol", "figure", "ul"):
        for inside in re.findall(rf"<{part}[ >].*?</{part}>", page, re.DOTALL):
            assert re.sub(r"<[^>]*>|\s", "", inside) or "<svg" in inside, part
    assert page.count("<figure") >= (1 if analyses else 0)
    assert page.count('class="sheet"') == 2


def test_the_certificate_counts_the_findings_of_its_appendix(content, page_text):
    assert f"all {len(content.findings)} findings: appendix C" in page_text
    listed = page_text.partition('id="findings"')[2].partition("</details>")[0]
    assert listed.count('class="mark') == len(content.findings)


@pytest.mark.parametrize(
    ("n", "words"), [(1, []), (5, ["n: trials that passed this pressure; one trial passes several"])]
)
def test_trials_that_count_in_several_rows_are_explained(n, words):
    made = samples.contraction()
    made = replace(
        made, estimates=tuple(replace(e, n=n if e.at.get("pressure", 1e6) < 210e3 else 0) for e in made.estimates)
    )
    notes = content_of([made], [samples.run("contraction-relaxation")]).sheet.table.notes
    assert [note for note in notes if note.startswith("n:")] == words


def test_reasons_are_counted_without_their_numbers():
    loads = [Dropped("r/1", {}, f"the load, {n} N, is not below F_ce = {n - 0.5} N") for n in (157, 255.1, 353)]
    still = [Dropped("r/9", {}, "too little motion: 0.451 mm with F_ce - F_L = 10 N")]
    assert left_out([*loads, *still]) == "the load is not below F_ce (3), too little motion (1)"


def test_how_well_is_the_widest_interval():
    e = [samples.estimate("K", value, "m", {"pressure": P}, parts=Parts(repeats=half)) for value, P, half in
         ((5000.0, 1e5, 50.0), (8000.0, 5e5, 16.0))]  # fmt: skip
    assert how_well(e, "pressure") == "K within 1 % from 100 to 500 kPa"
    assert how_well([replace(e[0], parts=Parts())], "pressure") == ""


def test_an_interval_wider_than_half_its_value_is_said_in_its_unit():
    """0.01 N ± 0.2 N is not ± 2000 %."""
    e = samples.estimate("F", 0.01, "m", {"pressure": 1e5}, kind=("N", "force"), parts=Parts(repeats=0.2))
    assert [quality.sources([replace(e, value=v)], "pressure").bars[0].half for v in (0.01, 10)] == ["0.2 N", "2 %"]
    assert how_well([replace(e, parts=Parts(repeats=188.0))], "pressure").startswith("F within 190 N "), "not 1.9e+02"


@pytest.mark.parametrize("cause", ["withheld: the force is not at rest", "withheld: 20261201-1401_muscle_0a1b: a slip"])
def test_a_symbol_keeps_its_letter_and_the_only_run_is_not_named(cause):
    """`tau_F` was "Tau_F" at the beginning of a sentence, and then no symbol; a run's name filled the first line."""
    analysis = replace(samples.sine(), runs=("20261201-1401_muscle_0a1b",))
    failed = [f"tau_F at pressure 350 kPa: {cause}"]
    (said, *_) = quality.findings([analysis], failed)
    sheet = sheet_of([analysis], [], [], {}, Verdict("fault", "Not accepted", ""), failed)
    for text in (said.removeprefix("Not accepted: "), sheet.sentence):
        assert text.startswith("tau_F at pressure 350 kPa: withheld: ")
        assert "muscle_0a1b" not in text


def test_values_at_two_coordinates_are_drawn_over_that_with_more_places_each_other_in_a_colour():
    """Of ramps, the dots of all contractions lay in a heap at each pressure, and the numbers did not say which is which."""
    plain = samples.sine()
    e = next(e for e in plain.estimates if e.symbol == "K")
    places = [{"pressure": 1e5 * P, "contraction": 1e-3 * x} for P in (2, 3) for x in (1, 10, 19)]
    analysis = replace(plain, estimates=tuple(replace(e, at=at) for at in places), traces=())
    picture = content_of([analysis], []).sheet.first[0]
    assert picture.title == "Stiffness K over contraction, at each pressure"
    (drawn,) = picture.charts
    dots = [series for series in drawn.series if series.mark]
    assert [series.label for series in dots] == ["200 kPa", "300 kPa"]
    assert all(series.x.tolist() == pytest.approx([1, 10, 19]) for series in dots)
    assert {"P [kPa]", "x [mm]"} <= set(picture.table.columns)


def test_a_bar_ends_at_0_where_the_table_cuts_the_interval():
    """0.010 (0 to 0.049) had a bar down to -0.03."""
    x, y, half = np.array([1.0, 2.0, 3.0]), np.array([0.01, 0.05, 0.06]), np.array([0.04, 0.02, 0.01])
    cut, whole = (Series("", x, y, "#000", "o", half, positive) for positive in (True, False))
    assert cut.ends[0].tolist() == pytest.approx([0.0, 0.03, 0.05])
    assert cut.ends[1].tolist() == whole.ends[1].tolist() == pytest.approx([0.05, 0.07, 0.07])
    least, most = chart.limits(Chart("x", "y", (cut,), zero=True))[2:]
    assert (least, most) == (0.0, pytest.approx(0.07 * 1.06))
    assert chart.limits(Chart("x", "y", (whole,)))[2] < -0.03
    plain = samples.sine()
    e = replace(
        next(e for e in plain.estimates if e.symbol == "B"), value=10.0, parts=Parts(repeats=40.0), positive=True
    )
    places = ({"pressure": P} for P in (2e5, 3e5, 4e5))
    analysis = replace(plain, estimates=tuple(replace(e, at=at) for at in places), traces=())
    (drawn,) = [s for one in content_of([analysis], []).sheet.first for c in one.charts for s in c.series if s.mark]
    assert drawn.positive


def test_a_range_begins_at_0_where_a_unit_leaves_a_rounding_error():
    """ "Outside P 5.821e-14 to 360 kPa", of an imported command in mA."""
    plain = samples.sine()
    e = next(e for e in plain.estimates if e.symbol == "K")
    analysis = replace(plain, estimates=tuple(replace(e, at={"pressure": P}) for P in (5.8e-11, 360e3)))
    assert dict(limits(analysis, [], []))["Range"] == "outside P 0 to 360 kPa"


def test_what_other_methods_say_is_not_among_the_values():
    """With one operating point the table had B and F_c twice, and did not say that the others are for comparison."""
    plain = samples.sine()
    e = replace(next(e for e in plain.estimates if e.symbol == "K"), at={})
    table, _, _ = result_table([replace(plain, estimates=(e, replace(e, method="another", value=1.02 * e.value)))])
    assert len(table.rows) == 1


def test_an_axis_is_not_finer_than_the_digits_at_it():
    """Two values that differ in the fifth digit: ticks had the same text, and one dot was outside."""
    values = np.array([16.8712, 16.8728])
    low, high = chart.limits(Chart("x", "y", (Series("", np.array([0.0, 1.0]), values, "#000", "o"),)))[2:]
    texts = [f"{tick:.5g}" for tick in chart.ticks(low, high, 5)]
    assert len(set(texts)) == len(texts) > 2
    assert low < 16.871
    assert high > 16.873


def test_the_fastest_motion_is_that_of_the_record():
    """x = 30 mm (1 - exp(-t / 0.25 s)): over its first 20 ms the mean speed is 30 mm (1 - exp(-0.08)) / 20 ms."""
    t = np.arange(0.0, 2.0, 0.002)
    x = 0.03 * (1 - np.exp(-t / 0.25))
    trace = Trace("o", "overlay", "o", {"t": t, "displacement": x}, {"t": "time", "displacement": "length"})
    lines = dict(limits(replace(samples.contraction(), traces=(trace,)), [], []))
    speed = 0.03 * (1 - math.exp(-0.02 / 0.25)) / 0.02
    assert lines["Speed"].startswith(f"motion faster than {float(f'{1e3 * speed:.2g}'):g} mm/s")
    assert lines["Stroke"] == "contractions beyond 30.0 mm"


def test_ticks_are_round_and_few():
    assert chart.ticks(0, 520, 5) == [0, 200, 400]
    assert chart.ticks(-0.31, 0.24, 3) == [-0.2, 0.0, 0.2]
    for low, high in np.random.default_rng(1).normal(size=(200, 2)) * 10.0 ** np.arange(-5, 5).repeat(20)[:, None]:
        low, high = min(low, high), max(low, high)
        found = chart.ticks(low, high, 5)
        assert 1 <= len(found) <= 6
        assert all(low - 1e-9 * abs(low) <= tick <= high + 1e-9 * abs(high) for tick in found)


@pytest.mark.parametrize(
    ("value", "step", "text"),
    [(0.25, 0.25, "0.25"), (-0.2, 0.1, "−0.2"), (12000.0, 2000.0, "12\u2009000"), (7.0, 1.0, "7"), (-0.0, 0.5, "0.0")],
)
def test_ticks_have_the_decimals_of_their_step(value, step, text):
    assert chart.tick_text(value, step) == text


def test_names_at_curves_do_not_lie_on_each_other():
    x = np.linspace(0, 1, 20)
    lines = tuple(Series(f"name {n}", x, x + 0.001 * n, "#0b5394") for n in range(6))
    drawn = drawing.joined([[Chart("x", "y", lines, 300, 150)]], "six lines")
    places = sorted(float(y) for y in re.findall(r'y="([\d.]+)"[^>]*>name \d', drawn))
    assert len(places) == 6
    assert min(np.diff(places)) >= chart.NAME


def test_a_chart_has_no_style_and_says_what_it_shows():
    drawn = drawing.joined(
        [[Chart("x", "y", (Series("a", np.arange(3.0), np.arange(3.0), "#0b5394"),), 300, 150)]], "a line"
    )
    assert " style=" not in drawn
    assert re.search(r'role="img" aria-labelledby="(c\w+)"><desc id="\1">a line</desc>', drawn)
