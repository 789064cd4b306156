"""The line of a trial says what was put in, and doubts what was made doubtful."""

import numpy as np
import pytest
from scipy.stats import linregress
from scipy.stats import t as student_t

from pmabench.display.lines import half_text, plain_line
from pmabench.display.state import RunState
from pmabench.display.verdicts import Verdicts
from pmabench.display.web.picture import trials_part
from pmabench.store.reader import open_run
from pmabench.store.records import Flag, RunData, TrialData
from tests.display.recorded import TAU, F_ce, K, Recorded

LIGHT, HEAVY, P = 58.86, 107.91, 3e5


def state_of(folder):
    state = RunState(folder)
    while state.poll():
        pass
    return state


def lines_of(folder):
    return state_of(folder).lines


def numbers(line):
    return {number.symbol: number for number in line.numbers}


def test_numbers_of_a_trial_are_those_that_made_it(tmp_path):
    run = Recorded(tmp_path, [(LIGHT, P), (HEAVY, P)])
    run.trial(0)
    run.trial(1)
    first, second = lines_of(run.close())
    assert first.ok, first.doubts
    assert second.ok, second.doubts
    one, two = numbers(first), numbers(second)
    assert one["x_inf"].value == pytest.approx((F_ce(P) - LIGHT) / K(P), rel=1e-3)
    assert one["x_inf"].reference == pytest.approx((F_ce(P) - LIGHT) / K(P), rel=1e-9)
    assert one["tau"].value == pytest.approx(TAU, rel=1e-3)
    assert one["K"].assumed
    assert one["F_ce"].assumed
    assert not two["K"].assumed
    assert two["K"].value == pytest.approx(K(P), rel=1e-3)
    assert two["F_ce"].value == pytest.approx(F_ce(P), rel=1e-3)


def test_stiffness_has_the_interval_of_the_scatter_of_its_trials(tmp_path):
    """By scipy's straight line through the contractions of five trials; without a degree of freedom there is none."""
    loads, off = [40.0, 60.0, 80.0, 100.0, 120.0], [1.003, 0.998, 1.001, 0.996, 1.002]
    run = Recorded(tmp_path, [(load, P) for load in loads])
    for index, factor in enumerate(off):
        run.trial(index, factor=factor)
    lines = lines_of(run.close())
    line = linregress(loads, [numbers(one)["x_inf"].value for one in lines])
    K_last, half = -1 / line.slope, student_t.ppf(0.975, 3) * line.stderr / line.slope**2
    assert numbers(lines[1])["K"].half is None
    last = numbers(lines[4])["K"]
    assert last.value == pytest.approx(K_last, rel=1e-6)
    assert last.half == pytest.approx(half, rel=1e-6)
    assert half_text(last) == f"±{100 * half / K_last:.1f}%"
    assert f"N/mm ±{100 * half / K_last:.1f}%" in plain_line(lines[4], 5)


@pytest.mark.parametrize(
    ("change", "doubt"),
    [
        ({"factor": 1.2}, "x_inf 20% above expected"),
        ({"reached": 0.95}, "pressure not reached: 285 kPa of 300 kPa"),
        ({"drift": 2e-3}, "still drifting"),
        ({"flags": int(Flag.DROPOUT)}, "samples flagged DROPOUT"),
        ({"factor": 0.0}, "did not lift the load"),
        ({"status": "failed"}, "the trial is failed"),
    ],
)
def test_what_speaks_against_a_trial_is_said(tmp_path, change, doubt):
    run = Recorded(tmp_path, [(LIGHT, P)])
    run.trial(0, **change)
    (line,) = lines_of(run.close())
    assert any(doubt in reported for reported in line.doubts), line.doubts


def test_a_limit_that_was_reached_is_a_doubt_of_its_trial_only(tmp_path):
    run = Recorded(tmp_path, [(LIGHT, P), (LIGHT, P)])
    run.begin(0)
    run.contract(0)
    run.writer.event("limit-reached", run.t, phase="contract", trial=0, reason="waited 5 s for nothing")
    run.end(0)
    run.trial(1, repeat=1)
    first, second = lines_of(run.close())
    assert "waited 5 s for nothing" in first.doubts
    assert second.ok


def test_repeats_count_more_than_the_prediction(tmp_path):
    """All are 20 % off the prediction: only the first is doubted for it; a fourth far from its repeats is doubted."""
    run = Recorded(tmp_path, [(LIGHT, P)] * 5)
    for index, factor in enumerate((1.200, 1.203, 1.197, 1.201, 1.23)):
        run.trial(index, repeat=index, factor=factor)
    lines = lines_of(run.close())
    assert [line.ok for line in lines] == [False, True, True, True, False]
    assert any("above its repeats" in doubt for doubt in lines[4].doubts)


def test_without_a_prediction_the_repeats_are_next_to(tmp_path, monkeypatch):
    monkeypatch.setattr("tests.display.recorded.SPECIMEN", "schema: pmabench.specimen/1\n")
    run = Recorded(tmp_path, [(LIGHT, P)] * 2)
    run.trial(0)
    run.trial(1, factor=1.02)
    first, second = (numbers(line)["x_inf"] for line in lines_of(run.close()))
    assert first.reference is None
    assert second.reference_is == "repeats"
    assert second.off == pytest.approx(0.02, abs=1e-3)


def test_lines_read_while_the_run_is_written_are_those_read_afterwards(tmp_path):
    points = [(LIGHT, P), (HEAVY, P), (LIGHT, 2e5), (HEAVY, 2e5)]
    run = Recorded(tmp_path, points)
    state = RunState(run.folder)
    for index in range(len(points)):
        run.begin(index)
        state.poll()
        run.contract(index, until=1.0)
        state.poll()
        run.samples(index, 3.0)
        assert len(state.lines) == index
        run.end(index)
        state.poll()
        assert len(state.lines) == index + 1
    folder = run.close()
    state.poll()
    assert state.ended
    assert state.lines == lines_of(folder)


def test_a_trial_that_was_cut_short_is_doubted_for_that_alone(tmp_path):
    run = Recorded(tmp_path, [(LIGHT, P)])
    run.begin(0)
    run.contract(0, until=0.3)
    run.writer.event("trial-end", run.t + 0.5, trial=0, status="interrupted")
    (line,) = lines_of(run.close("aborted", "ended by Ctrl-C"))
    assert (line.numbers, line.doubts) == ((), ("the trial is interrupted",))


def test_a_trial_that_is_done_again_takes_the_place_of_the_first(tmp_path):
    """The first is neither in the table nor among the repeats that later ones are held against."""
    run = Recorded(tmp_path, [(LIGHT, P), (LIGHT, P)])
    run.trial(0, factor=1.4)
    run.trial(0)
    run.trial(1, repeat=1)
    lines = lines_of(run.close())
    assert [(line.index, line.ok) for line in lines] == [(0, True), (1, True)]
    assert numbers(lines[1])["tau"].reference == pytest.approx(TAU, rel=1e-3)


@pytest.mark.parametrize("closed", [True, False])
def test_a_long_run_that_is_read_piece_by_piece_gets_the_same_lines(tmp_path, monkeypatch, closed):
    """The events are known at once, the samples come later: no line is made before its samples are there."""
    points = [(LIGHT, P), (HEAVY, P), (LIGHT, 2e5)]
    run = Recorded(tmp_path, points)
    for index in range(3):
        run.trial(index)
    folder = run.close() if closed else run.folder
    at_once = lines_of(folder)
    assert all(line.ok for line in at_once)
    monkeypatch.setattr("pmabench.display.follow.MOST_BYTES", 3000)
    monkeypatch.setattr("pmabench.display.follow.MOST_ROWS", 700)
    assert lines_of(folder) == at_once


def test_a_repeat_that_does_not_finish_takes_nothing_away(tmp_path):
    """`r`, and then a trip or a failed search: the good trial before it is still shown, counted and compared with."""
    run = Recorded(tmp_path, [(LIGHT, P), (HEAVY, P)])
    run.trial(0)
    run.trial(0, status="interrupted")
    run.trial(1)
    run.trial(1, status="failed")
    folder = run.close("tripped", "pressure above its limit")
    state = RunState(folder)
    while state.poll():
        pass
    assert [(line.number, line.status) for line in state.lines] == [
        (1, "finished"),
        (1, "interrupted"),
        (2, "finished"),
        (2, "failed"),
    ]
    assert state.done == 2
    assert numbers(state.lines[2])["K"].value == pytest.approx(K(P), rel=1e-3), "both loads are in it"
    assert [trial.status for trial in open_run(folder).trials] == ["finished", "interrupted", "finished", "superseded"]


def test_a_trial_that_was_cut_short_is_not_done(tmp_path):
    run = Recorded(tmp_path, [(LIGHT, P)])
    run.trial(0, status="interrupted")
    state = RunState(run.close("tripped"))
    while state.poll():
        pass
    assert state.done == 0


def test_nothing_moved_is_doubted_unless_the_specimen_says_so(tmp_path):
    """Under a load that F_ce does not lift by the specimen file nothing is expected to move, below it something is."""
    heavy = F_ce(P) + 10.0
    run = Recorded(tmp_path, [(LIGHT, P), (heavy, P)])
    run.trial(0, factor=0.0)
    run.trial(1, factor=0.0)
    light, held = lines_of(run.close())
    assert "displacement changed by less than its noise: nothing moved" in light.doubts
    assert held.ok


def test_a_trial_that_lifts_nothing_as_expected_is_neither_ok_nor_doubted(tmp_path):
    run = Recorded(tmp_path, [(F_ce(P) + 50.0, P), (LIGHT, P)])
    run.trial(0, factor=0.0)
    run.trial(1)
    idle, moved = lines_of(run.folder)
    assert (idle.ok, idle.mark, moved.mark) == (True, "– ", "ok")
    assert plain_line(idle, 2).endswith("; nothing measured, as expected")
    assert [row["mark"] for row in trials_part(state_of(run.folder))["rows"]] == ["–", "✓"]


@pytest.mark.parametrize(
    ("kind", "channel", "point"),
    [
        ("free-contraction", "displacement", {"pressure": 2e5}),
        ("sinusoidal-displacement", "displacement", {"pressure": 0.0, "frequency": 1.0}),
        ("positioning", "displacement", {"setpoint": 0.02}),
        ("isometric-pressurisation", "force", {"contraction": 0.01}),
        ("arm-angle", "angle", {"tip_mass": 0.1}),
        ("contraction-relaxation", "displacement", {"from": 0.0, "pressure": 2e5}),
    ],
)
def test_of_every_kind_what_should_move_is_looked_at(kind, channel, point):
    noise = np.random.default_rng(1).normal(0.0, 1.0, 2000)
    t = np.arange(2000) / 500.0
    still, step = 1e-4 * noise, 1e-4 * noise + np.where(t > 2.0, 2e-3, 0.0)
    doubts = []
    for y in (still, step):
        flags = np.ones(2000, np.uint16) * int(Flag.OK)
        trial = TrialData("run", 0, point, 0, False, "finished", t, {channel: y}, flags, (), {})
        doubts.append(Verdicts().judge(run_of(kind, trial), trial).doubts)
    assert f"{channel} changed by less than its noise: nothing moved" in doubts[0]
    assert not any("nothing moved" in doubt for doubt in doubts[1])
    trial = TrialData("run", 0, {"pressure": 0.0}, 0, False, "finished", t, {"displacement": still}, flags, (), {})
    assert not any(
        "nothing moved" in doubt for doubt in Verdicts().judge(run_of("free-contraction", trial), trial).doubts
    )


def run_of(kind, trial):
    return RunData("run", "run", kind, "running", True, {}, {}, (), {}, 500.0, (trial,))
