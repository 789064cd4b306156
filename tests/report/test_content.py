"""What a report says beside its numbers: the verdict, deviations, the checklist, and parents."""

import re
from dataclasses import replace

import numpy as np
import pytest

from pmabench.plotting import pictures
from pmabench.report import figures
from pmabench.report.document.content import content_of
from pmabench.report.document.deviations import Issuer, deviations
from pmabench.report.document.special_tables import budget_table, change_rows
from pmabench.report.document.tables import trial_ranges
from pmabench.report.foremost import verdict_of
from pmabench.store.analyses.results import PUBLISHED, Analysis, Estimate, Finding, Parts, Source, Trace
from pmabench.store.notes import Note
from pmabench.store.records import TrialData

from . import samples


def trial(index, *, P=3e5, rate=100.0, seconds=5.0, begin=None, **more) -> TrialData:
    begin = 10.0 * index if begin is None else begin
    t = begin + np.arange(0.0, seconds, 1 / rate)
    command = np.full(len(t), P)
    channels = {"pressure": command, "pressure_command": command}
    usual = {"status": "finished", "repeat": 0, "reference": False, "commands": (), "found": {}}
    flags = np.zeros(len(t), np.uint16)
    return TrialData("run", index, {"pressure": P}, t=t, channels=channels, flags=flags, **(usual | more))


def said(trials, plan=None, notes=(), **manifest) -> list[str]:
    quiet = {"deviations": [], "hazards": [], "lacks": [], "end": {}} | manifest
    run = replace(samples.run("static-load", **quiet), trials=tuple(trials), plan=plan or {}, notes=notes, events=())
    return [text.removeprefix("R1: ") for text in deviations([run], {run.id: "R1"})]


def test_a_run_as_planned_has_no_deviation():
    plan = {"rate": 100.0, "record": ["pressure", "pressure_command"]}
    assert said([trial(0), trial(1)], plan, trials_planned=2) == []


@pytest.mark.parametrize(
    ("trials", "plan", "words"),
    [
        ([trial(0)], {}, "1 of 2 planned trials are not finished"),
        ([trial(0), trial(1, attempt=2)], {}, "begun again: trial 2"),
        ([trial(0, begin=50.0), trial(1, begin=0.0)], {}, "trials were not done in the planned order"),
        ([trial(0, rate=90.0), trial(1, rate=90.0)], {"rate": 100.0}, "sampled at 90 Hz; 100 Hz was planned"),
        ([trial(0), trial(1)], {"record": ["force"]}, "planned but not recorded: force"),
    ],
)
def test_deviations_are_found_in_the_record(trials, plan, words):
    assert said(trials, plan, trials_planned=2) == [words]


def test_exclusions_say_who_and_why():
    note = Note(1, "2026-11-22T10:00", "B. Ito", "", 0, "the table was hit", ())
    reported = said([trial(0, status="excluded"), trial(1)], notes=(note,), trials_planned=2)
    assert reported == ["trials: 1 excluded", "trial 1 is left out by B. Ito: the table was hit"]


def finding(level: str) -> Analysis:
    return replace(samples.static_load(), findings=(Finding(level, "x"),))


@pytest.mark.parametrize(
    ("analyses", "status", "failed", "accepted", "level", "word"),
    [
        ([finding("note")], "finished", [], True, "good", "Accepted"),
        ([finding("note")], "finished", [], False, "good", "No doubt"),
        ([finding("doubt")], "finished", [], True, "doubt", "Usable with care"),
        ([finding("note")], "aborted", [], True, "doubt", "Usable with care"),
        ([finding("fault")], "finished", [], True, "fault", "Faults were found"),
        ([finding("note")], "finished", ["K: interval +-9 %"], True, "fault", "Not accepted"),
        ([Analysis("static-load", (), False)], "finished", [], True, "fault", "No result"),
    ],
)
def test_the_verdict_is_the_worst_that_is_known(analyses, status, failed, accepted, level, word):
    runs = [replace(samples.run("static-load"), status=status)]
    verdict = verdict_of(analyses, runs, failed, accepted=accepted)
    assert (verdict.level, verdict.word) == (level, word)


def test_the_checklist_names_what_is_missing_and_takes_what_is_given():
    bare = content_of([samples.static_load()], samples.all_runs())
    missing = {item.asked for item in bare.checklist if not item.there}
    assert {"the customer", "date of issue", "who authorises the report"} <= missing
    reported = Issuer("Muscle Lab, 1 Air St", "ACME", "A. Meyer", "2026-11-23")
    full = content_of([samples.static_load()], samples.all_runs(), issuer=reported)
    assert missing - {item.asked for item in full.checklist if not item.there} == {
        "the laboratory, its address, where it was tested",
        "the customer",
        "date of issue",
        "who authorises the report",
    }
    nothing = content_of([], [])
    assert sum(item.there for item in nothing.checklist) < 5


def test_every_value_leads_to_its_trials():
    assert trial_ranges(("a/1", "a/2", "a/3", "a/7", "b/2", "odd"), {"a": "R1", "b": "R2"}) == "R1: 1–3, 7; R2: 2; odd"
    many = tuple(f"a/{n}" for n in range(1, 60, 2))
    analysis = samples.static_load()
    estimates = tuple(replace(e, trials=many) for e in analysis.estimates)
    content = content_of([replace(analysis, runs=("a",), estimates=estimates)], [])
    parts = content.sections[0].parts
    column = [c.head for c in parts.columns].index("from")
    assert {row[column].text[:11] for _, rows in parts.groups for row in rows} == {"R1: 1, 3, 5"}


def test_budgets_show_shares_and_what_was_not_assessed():
    sources = (
        Source("calibration of pressure", "calibration", "B", 4.0),
        Source("scatter", "repeats", "A", 3.0),
        Source("steps", "repeats", "B", 0.1),
        Source("drift", "drift", "B", None, "no reference trial"),
    )
    analysis = samples.static_load()
    e = replace(analysis.estimates[0], parts=Parts(repeats=(9.01) ** 0.5, calibration=4.0), budget=sources)
    table = budget_table(replace(analysis, estimates=(e, *analysis.estimates[1:])))
    assert table.caption.endswith("not assessed: drift (no reference trial)")
    (row,) = table.frame.rows
    assert row["sources, shares of the variance"] == "calibration of pressure 64 %, scatter 36 %, 1 other < 0.1 %"
    assert row["± 95 %"] == "5.0"
    assert budget_table(analysis) is None


def test_values_below_resolution_are_not_drawn_and_small_ones_have_no_exponent_at_the_axis():
    def drawn(size):
        at = [{"pressure": 1e5 * n} for n in (1, 2, 3)]
        estimates = tuple(Estimate("F_c", size * n, "N", "force", "m", p) for n, p in enumerate(at, 1))
        return figures.others(Analysis("x", ("r",), False, estimates))

    assert drawn(1e-14) == []
    (picture,) = drawn(2e-6)
    assert "[10⁻⁶ N]" in picture.svg
    assert "1e" not in re.sub(r"<path[^>]*>", "", picture.svg)


def test_each_further_method_lies_aside_by_its_place_and_published_values_are_never_cut(monkeypatch):
    """Ten methods of our own, of which eight are drawn, and a table of somebody; the range is 200 kPa."""
    at = [{"pressure": 1e5 * n} for n in (1, 2, 3)]

    def values(method):
        return tuple(Estimate("K", 7000.0 + n, "N/m", "stiffness", method, p) for n, p in enumerate(at))

    mine = Analysis("x", ("r",), False, tuple(e for n in range(10) for e in values(f"m{n}")))
    theirs = Analysis(PUBLISHED, (), False, values("Serres 2009"))
    drawn = []

    def kept(rows, *args, **more):
        drawn.extend(rows[0])
        return pictures.of_charts(rows, *args, **more)

    monkeypatch.setattr(figures, "of_charts", kept)
    (picture,) = figures.over_pressure([mine, theirs], {}, ("m0", "m1"))
    (chart,) = drawn
    first = [float(s.x[0]) for s in chart.series if s.mark == "o"]
    assert first == pytest.approx([100.0 + 200.0 * figures.ASIDE * n for n in range(8)])
    assert [(s.mark, float(s.x[0])) for s in chart.series][8:] == [("x", 100.0)]
    assert "Crosses: Serres 2009" in picture.caption


def test_labels_of_long_numbers_are_not_cut():
    long = [{"pressure": 1e5 * n} for n in (1, 2, 3)]
    estimates = tuple(
        Estimate("F_c", 90_000.0 + 0.01 * n, "N", "force", "m", p, Parts(1e-3)) for n, p in enumerate(long, 1)
    )
    (picture,) = figures.others(Analysis("x", ("r",), False, estimates))
    ticks = re.findall(r'<text x="([\d.]+)" y="[\d.]+" text-anchor="end"[^>]*>([^<]+)', picture.svg)
    assert len({text for _, text in ticks}) == len(ticks) > 2
    assert all(float(end) > 0.5 * 7.4 * len(text) for end, text in ticks), "a digit is as wide as half its height"


def test_a_test_of_a_new_kind_has_its_figures_on_the_first_page():
    columns = {"t": np.arange(9.0), "angle": np.arange(9.0) ** 2}
    new = Analysis("new-kind", ("r",), False, traces=(Trace("x", "nebula", "Angle", columns, {"t": "time"}),))
    content = content_of([new], [])
    (item,) = content.front
    assert item.picture.title == "Angle"
    assert content.sections == [] or content.sections[0].figures == [], "each figure stands once"


def test_only_what_is_shown_is_drawn(monkeypatch):
    """A report looks through many figures for its first pages; drawing is most of what it costs."""
    drawn = []
    draw = pictures.joined
    monkeypatch.setattr(pictures, "joined", lambda rows, alt: drawn.append(alt) or draw(rows, alt))
    content = content_of(samples.all_analyses(), samples.all_runs())
    shown = [*content.front, *(item for section in content.sections for item in section.figures)]
    assert len(drawn) == len(shown) > 8


def test_a_value_next_to_0_has_the_half_width_that_was_not_cut_off():
    side = {"value": 0.59, "ci95": [0.0, 1.99]}
    entry = {"symbol": "F_c", "method": "m", "quantity": "force", "unit": "N", "at": {}, "before": side, "after": side}
    (row,) = change_rows([entry])
    assert row["as recorded"] == "0.6 ± 1.4"
