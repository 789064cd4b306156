"""Channels of several streams on one time base: nothing is interpolated across a hole, and where is said (R5, R11)."""

import json

import numpy as np
import pytest

from pmabench.store.reader import open_run, read_stream
from pmabench.store.records import Flag
from pmabench.store.timebase import onto
from pmabench.store.writer import RunWriter
from tests.cli.test_cli import call
from tests.store.runs import COLUMNS, begin, block, die

GAP = int(Flag.GAP)


def place(t, other_t, values, rate, flags=None):
    """One channel on the times `t`, with the flags that come of it."""
    other_flags = np.zeros(len(other_t), np.uint16) if flags is None else np.asarray(flags, np.uint16)
    given = {"a": np.asarray(values, float)}
    moved, reported, how = onto(
        np.asarray(t), np.zeros(len(t), np.uint16), np.asarray(other_t), other_flags, given, rate
    )
    return moved["a"].tolist(), reported.tolist(), how


def test_a_straight_line_comes_back_exactly_between_its_samples():
    t = np.arange(0.1, 0.8, 0.002)
    other = np.arange(0, 1, 0.1) + 0.013
    values, flags, how = place(t, other, 3 - 2 * other, 10.0)
    assert np.allclose(values, 3 - 2 * t, atol=1e-12)
    assert (set(flags), how) == ({0}, "interpolated from")


def test_an_exponential_comes_back_far_better_than_by_straight_lines():
    """A regulator of 0.1 s, asked every 20 ms: straight lines are off by up to P'' h^2 / 8 = 1.5 kPa of 300 kPa."""
    t, other = np.arange(0.03, 0.9, 0.002), np.arange(0, 1, 0.02)

    def pressure(at):
        return 300e3 * (1 - np.exp(-at / 0.1))

    values, _, _ = place(t, other, pressure(other), 50.0)
    assert np.abs(np.interp(t, other, pressure(other)) - pressure(t)).max() > 1e3
    assert np.abs(values - pressure(t)).max() < 100.0


def test_a_step_is_never_overshot_and_next_to_a_hole_it_is_straight():
    other = np.array([0.0, 0.1, 0.2, 0.3, 0.4, 0.8, 0.9, 1.0])
    t = np.linspace(0, 1, 101)
    values, _, _ = place(t, other, [0, 0, 0, 5, 5, 5, 7, 20], 10.0)
    found = np.array(values)
    assert np.nanmin(found) >= 0.0
    assert np.nanmax(found[t <= 0.4]) == 5.0
    assert np.isnan(found[(t > 0.401) & (t < 0.799)]).all()
    alone, _, _ = place([0.85], [0.8, 0.9], [5, 7], 10.0)
    assert alone == [pytest.approx(6.0)]


def test_the_cubic_is_that_of_an_independent_program():
    from scipy.interpolate import PchipInterpolator

    chance = np.random.default_rng(1)
    other = np.cumsum(chance.uniform(0.08, 0.12, 60))
    given = chance.standard_normal(60).cumsum()
    t = np.linspace(other[1], other[-2], 500)
    values, _, _ = place(t, other, given, 10.0)
    assert np.allclose(values, PchipInterpolator(other, given)(t), atol=1e-12)


def test_before_the_first_and_after_the_last_sample_there_is_nothing():
    values, flags, _ = place([0.0, 0.1, 0.2, 0.3, 0.4], [0.1, 0.2, 0.3], [1, 2, 3], 10.0)
    assert np.isnan([values[0], values[-1]]).all()
    assert values[1:4] == [1, 2, 3]
    assert flags == [GAP, 0, 0, 0, GAP]


@pytest.mark.parametrize(("width", "reached"), [(0.14, True), (0.16, False)])
def test_a_hole_of_more_than_one_and_a_half_periods_is_not_bridged(width, reached):
    values, flags, _ = place([0.05, 0.12, 0.1 + width], [0.0, 0.1, 0.1 + width], [0, 1, 1 + 10 * width], 10.0)
    assert values[0] == pytest.approx(0.5)
    assert values[2] == 1 + 10 * width, "a sample of its own stands whatever is beside it"
    assert flags == [0, 0 if reached else GAP, 0]
    assert np.isnan(values[1]) != reached


@pytest.mark.parametrize("flag", [Flag.GAP, Flag.OVERRANGE, Flag.STALE, Flag.TIME_JUMP, Flag.DROPOUT, Flag.SUSPECT])
def test_a_sample_that_cannot_be_used_is_no_neighbour(flag):
    values, flags, _ = place([0.05, 0.1, 0.15, 0.25], [0.0, 0.1, 0.2, 0.3], [0, 1, 2, 3], 10.0, [0, int(flag), 0, 0])
    assert np.isnan(values[:3]).all()
    assert flags == [GAP, GAP, GAP, 0]
    assert values[3] == pytest.approx(2.5)


def test_flags_that_do_not_forbid_are_handed_on():
    late, slack = int(Flag.LATE), int(Flag.SLACK)
    _, flags, _ = place([0.05, 0.15, 0.25], [0.0, 0.1, 0.2, 0.3], [0, 1, 2, 3], 10.0, [0, late, slack, 0])
    assert flags == [late, late | slack, slack]


def test_time_that_goes_back_is_left_out():
    values, _, _ = place([0.05, 0.15, 0.25], [0.0, 0.1, 0.2, 0.05, 0.3], [0, 1, 2, 99, 3], 10.0)
    assert values == pytest.approx([0.5, 1.5, 2.5])


def test_a_stream_without_samples_gives_none():
    values, flags, _ = place([0.0, 1.0], [], [], 10.0)
    assert np.isnan(values).all()
    assert flags == [GAP, GAP]


@pytest.fixture
def two_rates(tmp_path):
    """Displacement at 500 Hz; pressure at 100 Hz on a stream of its own, shifted by 3 ms, without 0.5 s to 0.6 s."""
    columns = {column["name"]: dict(column, raw_type="float64") for column in COLUMNS}
    writer = RunWriter.create(tmp_path, "run", {}, {})
    writer.open_stream("daq", [columns["displacement"]], 500.0)
    writer.open_stream("a-valve", [columns["pressure"]], 100.0)
    writer.event("trial-begin", 0.0, trial=0, point={}, repeat=0, reference=False)
    fast = np.arange(0, 500, dtype=np.int64) * 2_000_000
    slow = np.arange(0, 100, dtype=np.int64) * 10_000_000 + 3_000_000
    slow = slow[(slow < 500_000_000) | (slow > 600_000_000)]
    flags = np.zeros(len(slow), np.uint16)
    flags[50] = GAP
    writer.append("daq", fast, {"displacement": fast / 1e9}, np.zeros(500, np.uint16))
    writer.append("a-valve", slow, {"pressure": 4.0 * slow / 1e9}, flags)
    writer.event("trial-end", 1.0, trial=0, status="finished")
    return writer.close("finished")


def test_the_stream_of_the_displacement_gives_the_times_and_the_record_says_so(two_rates):
    run = open_run(two_rates)
    (trial,) = run.trials
    assert (run.rate, len(trial.t)) == (500.0, 500)
    hole = np.isnan(trial.channels["pressure"])
    assert trial.t[hole].min() == 0.0, "before the first sample of the pressure"
    assert (trial.flags[hole] == GAP).all()
    assert trial.usable.tolist() == (~hole).tolist()
    inside = (trial.t > 0.494) & (trial.t < 0.612)
    assert hole[inside].all(), "the hole, and beside the sample that is flagged"
    expected = 4.0 * trial.t * 0.25 - 500.0
    assert np.allclose(trial.channels["pressure"][~hole], expected[~hole], atol=1e-9)
    assert run.interpolated == {
        "pressure": "interpolated from the stream a-valve (100 Hz), on the times of daq (500 Hz)"
    }
    assert len(read_stream(two_rates, "a-valve")) == 90, "the raw samples stay what they were"


def test_show_says_what_was_interpolated(two_rates):
    assert "interpolated from the stream a-valve (100 Hz)" in call("runs", "show", two_rates).stdout
    shown = json.loads(call("runs", "show", two_rates, "--json").stdout)
    assert set(shown["interpolated"]) == {"pressure"}


def test_a_trial_of_a_dead_run_is_finished_only_where_every_stream_reaches_its_end(tmp_path):
    writer = begin(tmp_path)
    writer.open_stream("gauge", [dict(COLUMNS[2], name="supply")], 50.0)
    for trial in range(2):
        writer.event("trial-begin", trial, trial=trial, point={}, repeat=0, reference=False)
        writer.event("trial-end", trial + 0.99, trial=trial, status="finished")
    writer.append("daq", *block(0, 1000))
    writer.append("gauge", np.arange(50) * 20_000_000, {"supply": np.zeros(50)}, np.zeros(50, np.uint16))
    die(writer)
    assert [trial.status for trial in open_run(writer.folder).trials] == ["finished", "interrupted"]
    (writer.folder / "streams" / "gauge.arrows").write_bytes(b"")
    assert [trial.status for trial in open_run(writer.folder).trials] == ["interrupted", "interrupted"]
