"""Results at a glance: 25 lines of 80 columns with the lines that follow, the costliest finding first, nothing hidden."""

import random
from dataclasses import replace

import pytest

from pmabench.report.foremost import Verdict, glance, verdict_of
from pmabench.store.analyses.results import AGREEMENT, Analysis, Dropped, Finding
from tests.report.samples import all_analyses, contraction, sine, static_load, ultimate_gain
from tests.report.test_html import damaged

FOLLOWED_BY = 4
"""Lines that a command writes below: what came to runs since, where it is, what to type next."""
GOOD = Verdict("good", "Accepted", "")


@pytest.mark.parametrize("make", [contraction, static_load, sine, ultimate_gain, lambda: None])
def test_it_fits_a_terminal(make):
    made = make()
    analyses = [made] if made else all_analyses()
    lines = glance(analyses, verdict_of(analyses, [], [], accepted=True), ())
    assert len(lines) + FOLLOWED_BY <= 25
    assert all(len(line) <= 80 for line in lines)
    assert lines[0].startswith("SIMULATED  ")
    assert any("±" in line for line in lines)


def test_the_table_has_the_values_of_the_analysis_at_each_pressure():
    lines = glance([contraction()], GOOD, ())
    head = next(line for line in lines if line.startswith("P [kPa]"))
    assert head.split("  ")[0] == "P [kPa]"
    assert all(f"{symbol} [" in head for symbol in ("F_ce", "K"))
    K = next(e for e in contraction().estimates if e.symbol == "K")
    row = next(line for line in lines if line.split()[:1] == [f"{K.at['pressure'] / 1e3:g}"])
    assert f"{K.value / 1e3:.3g}"[:3] in row


def test_what_two_methods_say_of_one_pressure_is_one_row():
    """F_b and F_ce were rows of their own, and where these were too many every second was shown: half of each."""
    made = contraction()
    of = {symbol: [e for e in made.estimates if e.symbol == symbol and e.at] for symbol in ("K", "F_ce")}
    of["F_ce"] = [replace(e, method="another") for e in of["F_ce"]]
    lines = glance([replace(made, estimates=(*of["K"], *of["F_ce"]))], GOOD, ())
    head = next(place for place, line in enumerate(lines) if line.startswith("P [kPa]"))
    rows = [line.split() for line in lines[head + 1 : lines.index("", head)]]
    pressures = [row[0] for row in rows if "±" in row]
    assert len(pressures) == len(set(pressures)) > 1
    assert all(row.count("±") == 2 for row in rows if "±" in row)


def test_the_costliest_findings_come_first_and_the_rest_is_counted():
    made = contraction()
    first = replace(made.estimates[0], value=None, withheld=True, note="the form does not hold")
    levels = ("note", "doubt", "doubt", "fault")
    findings = tuple(Finding(level, f"{level} {place}") for place, level in enumerate(levels))
    dropped = tuple(Dropped(f"trial {n}", {}, f"too little motion: {n} mm") for n in range(5))
    bad = replace(made, estimates=(first, *made.estimates[1:]), findings=findings, dropped=dropped)
    lines = glance([bad], verdict_of([bad], [], ["K is too wide"], accepted=True), ["K is too wide"])
    shown = [line for line in lines if line.startswith("!")]
    assert shown[0] == "!  not accepted: K is too wide"
    assert "the form does not hold" in shown[1]
    assert shown[2] == "!  fault 3"
    assert len(shown) == 3
    assert "   4 more findings: -v, or the report" in lines
    assert lines[1].startswith("NOT ACCEPTED")
    agreement = Analysis(AGREEMENT, (), simulated=True, findings=(Finding("note", "they agree"),))
    assert "   5 more findings: -v, or the report" in glance([bad, agreement], GOOD, ["K is too wide"]), (
        "as in appendix C"
    )
    alone = glance([replace(made, findings=(), dropped=dropped)], GOOD, ())
    assert "!  5 trials not used: too little motion (5)" in alone


@pytest.mark.parametrize("seed", range(20))
def test_absurd_numbers_and_texts_still_fit(seed):
    rng = random.Random(seed)
    analyses = [damaged(analysis, rng) for analysis in all_analyses()]
    reasons = ["x" * 300, "\x1b[31m red"]
    lines = glance(analyses, verdict_of(analyses, [], reasons, accepted=True), reasons)
    assert len(lines) + FOLLOWED_BY <= 25
    assert all(len(line) <= 80 and "\x1b" not in line and "\n" not in line for line in lines)


def test_without_a_result_it_says_so():
    empty = replace(contraction(), estimates=(), findings=(), curves=(), dropped=())
    lines = glance([empty], verdict_of([empty], [], [], accepted=False), ())
    assert lines[1].startswith("NO RESULT")
