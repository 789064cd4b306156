"""Cycles and time at pressure counted by hand, control limits by hand, coefficients against cycles."""

from __future__ import annotations

from datetime import datetime, timedelta

import numpy as np
import pytest

from pmabench.analysis.verdict.life import (
    Past,
    References,
    Use,
    chart,
    chosen,
    findings,
    leak_of,
    pasts,
    series_of,
    use_of,
)
from pmabench.store.analyses.results import Analysis, Estimate, Parts
from pmabench.store.records import Event


def events(*reported):
    """(t, kPa) commands, (t, "vent"), or (t, {data})."""
    made = []
    for seq, (t, what) in enumerate(reported):
        if what in ("vent", "end", "prompt"):
            made.append(Event(seq, t, what, {}))
        else:
            data = what if isinstance(what, dict) else {"output": "pressure", "type": "set", "value": 1e3 * what}
            made.append(Event(seq, t, "command", data))
    return made


def test_a_cycle_is_a_rise_from_low_to_high_pressure():
    steps_down = events((1.0, 400.0), (11.0, 300.0), (15.0, 200.0), (19.0, 0.0), (30.0, "end"))
    assert use_of(steps_down) == Use(1, 0.0, 18.0, 4e5)
    up_and_down = events((0.0, 400.0), (1.0, 100.0), (2.0, 400.0), (3.0, 50.0), (4.0, 99.0), (5.0, 100.0), (6.0, 0.0))
    assert use_of(up_and_down) == Use(2, 0.0, 5.0, 4e5)  # 3 s above 50 kPa, then 1 s at 99 and 1 s at 100


def test_a_vent_ends_the_time_at_pressure_and_a_dead_run_counts_to_its_last_event():
    assert use_of(events((1.0, 300.0), (4.0, "vent"), (9.0, "end"))).at_pressure == 3.0
    assert use_of(events((1.0, 300.0), (7.5, "prompt"))).at_pressure == 6.5
    assert use_of([]) == Use()


def test_strokes_of_a_driven_end_are_counted_apart():
    driven = {"output": "displacement", "value": 0.01}
    reported = events(
        (0.0, 300.0), (1.0, {**driven, "type": "sine", "cycles": 4}), (2.0, {**driven, "type": "ramp"}),
        (3.0, {**driven, "type": "ramp"}), (4.0, {**driven, "type": "set"}), (5.0, 0.0),
    )  # fmt: skip
    assert use_of(reported) == Use(1, 5.0, 5.0, 3e5)
    odd = {"output": "pressure", "type": "set", "value": "x"}
    assert use_of(events((0.0, odd), (1.0, {**driven, "type": "sine", "cycles": None}))) == Use()


def test_time_at_pressure_counts_ramps_as_they_go():
    """A ramp counted as at its end from its beginning: one that empties slowly lost the whole way down."""
    ramp = {"output": "pressure", "type": "ramp", "rate": 10e3}
    up_and_down = events(
        (0.0, {**ramp, "value": 400e3, "before": 0.0}), (50.0, {**ramp, "value": 0.0, "before": 400e3}), (100.0, "end"),
    )  # fmt: skip
    assert use_of(up_and_down) == Use(1, 0.0, 45.0 + 35.0, 4e5)
    stopped = events((0.0, {**ramp, "value": 400e3, "before": 0.0}), (30.0, {**ramp, "value": 0.0, "before": 80e3}))
    assert use_of(stopped) == Use(0, 0.0, 25.0, 8e4)  # at 80 kPa after 8 s
    cut = events((0.0, {**ramp, "value": 400e3, "before": 0.0}), (20.0, "vent"), (21.0, "end"))
    assert use_of(cut) == Use(1, 0.0, 15.0, 2e5)


def test_of_several_muscles_the_most_counts():
    """Muscles of a joint had "0 pressure cycles, 0.0 s at pressure, at most 0 kPa"."""

    def both(one, other):
        return [{"output": f"pressure_{k}", "type": "set", "value": 1e3 * P} for k, P in enumerate((one, other), 1)]

    pairs = [(1.0, (300.0, 200.0)), (6.0, (0.0, 200.0)), (8.0, (350.0, 0.0)), (12.0, (0.0, 0.0))]
    joint = events(*((t, data) for t, pair in pairs for data in both(*pair)), (13.0, "end"))
    assert use_of(joint) == Use(2, 0.0, 9.0, 3.5e5)
    aims = {"columns": ["t", "pressure_1", "tilt"], "aims": [[0.5, 2.5e5, 0.1], [1.0, 3e5, 0.1], [1.5, 2e5, 0.1]]}
    platform = [Event(0, 1.6, "steered", aims), Event(1, 3.5, "vent", {})]
    assert use_of(platform) == Use(1, 0.0, 3.0, 3e5)


def test_a_pressure_that_a_closed_loop_leads_is_reported():
    ends = events((0.0, 0.0), (40.0, {"output": "pressure", "type": "set", "value": 0.0, "before": 3e5}), (41.0, "end"))
    use = use_of(ends)
    assert (use.led, use.highest) == (40.0, 3e5)
    reported = [line.text for line in findings([Past("r", "2026-01-01", "k", "b", "finished", False, use, 0)], [], [])]
    assert any("for 40.0 s a closed loop led the pressure" in text for text in reported)


def row(run, date, before=0, cycles=10):
    return (run, date, "contraction-relaxation", "bench", "finished", False, before, Use(cycles, 0.0, 60.0, 4e5))


def test_cycles_add_up_in_order_of_time_and_a_specimen_file_may_know_of_more():
    life = pasts([row("c", "2026-03-01", 100), row("a", "2026-01-01", 5), row("b", "2026-02-01", 5)])
    assert [(past.run, past.before) for past in life] == [("a", 5), ("b", 15), ("c", 100)]


def test_limits_are_the_mean_and_the_moving_range():
    """Mean 10.5, moving range 1: limits 10.5 +- 2.66; 13.2 is beyond, 13.1 is not."""
    base = [10.0, 11.0] * 6
    reported = chart([*base, 13.1, 13.2])
    assert (reported.centre, reported.low, reported.high) == (10.5, pytest.approx(7.84), pytest.approx(13.16))
    assert reported.beyond == (13,)
    assert reported.shifted is None
    assert reported.first_alarm == 13
    assert chart(base[:4]) is None
    drifted = chart([*base, *[10.9] * 7])
    assert (drifted.beyond, drifted.shifted) == ((), 18)  # the last of the base lies above the centre, too
    assert chart([1.0] * 6).first_alarm is None


DAY = timedelta(days=1)


def reference(strokes, a_day=1, step=0.0):
    """Reference trials in order of time, so many a day."""
    start = datetime(2026, 1, 1, 8)
    date = [(start + i // a_day * DAY + i % a_day * DAY / 24).isoformat() for i in range(len(strokes))]
    moments = tuple(
        (one, 10 * i, float(stroke), f"r/{i}") for i, (one, stroke) in enumerate(zip(date, strokes, strict=True))
    )
    return References((("pressure", 3e5),), moments, step)


def doubted(one):
    *_, reported = findings([Past("r", "2026-01-01", "k", "b", "finished", False, Use(), 0)], [], [one])
    return reported.level == "doubt"


@pytest.mark.parametrize(("days", "a_day"), [(12, 1), (60, 1), (12, 3), (100, 3)])
def test_of_an_unchanged_muscle_one_chart_in_twenty_is_doubted(days, a_day):
    """Days differ by 20 um and trials of a day by 5 um: 89 to 95 of 100 such charts said that the muscle had changed."""
    random, count = np.random.default_rng(5), 200
    charts = (
        20e-3 + np.repeat(20e-6 * random.standard_normal(days), a_day) + 5e-6 * random.standard_normal(days * a_day)
        for _ in range(count)
    )
    share = np.mean([doubted(reference(strokes, a_day)) for strokes in charts])
    assert share <= 0.05 + 3 * (0.05 * 0.95 / count) ** 0.5  # three standard deviations


def test_of_a_muscle_that_changed_most_charts_are_doubted():
    random = np.random.default_rng(6)
    moved = [random.standard_normal(30) + 2.0 * (np.arange(30) >= 12) for _ in range(200)]
    worn = [random.standard_normal(30) + 0.1 * np.arange(30) for _ in range(200)]
    for charts, least in ((moved, 0.8), (worn, 0.9)):
        assert np.mean([doubted(reference(20e-3 + 10e-6 * one)) for one in charts]) > least


def test_limits_are_not_narrower_than_a_stroke_is_known():
    """12 equal strokes had limits of 1e-18 m and 12 alarms."""
    assert not doubted(reference([20.3e-3] * 12))
    assert not doubted(reference([20e-3] * 12 + [20.0001e-3]))
    assert not doubted(reference([20e-3] * 12 + [20.01e-3] * 9, step=10e-6))  # one step of the sensor
    assert doubted(reference([20e-3] * 12 + [20.02e-3], step=10e-6))
    assert doubted(reference([20e-3] * 12 + [19.9e-3]))


def campaigns(values, half=70.0):
    life = pasts([row(f"{i:02}", f"2026-01-{i + 1:02}") for i in range(len(values))])
    halves = np.broadcast_to(half, len(values)).tolist()
    made = [analysis(f"{i:02}", K, half) for i, (K, half) in enumerate(zip(values, halves, strict=True))]
    (K,) = chosen([s for s in series_of(made, life) if s.first.symbol == "K"])
    *_, reported = findings(life, [K], [])
    return reported


def test_a_series_is_more_than_its_ends():
    """20 campaigns with one calibration known to 1 %: between equal ends, or steadily, K changed and nothing was said."""
    scatter = 0.001 * np.random.default_rng(0).standard_normal(20)
    falls = campaigns(7000.0 * (1 - 0.015 * np.arange(20) / 19 + scatter))
    assert (falls.level, "it falls steadily, by 0.1" in falls.text) == ("doubt", True)
    assert falls.text.endswith("the muscle changed, or the sensor or its mounting")
    sags = campaigns(7000.0 * (1 - 0.08 * np.sin(np.pi * np.arange(20) / 19)))
    assert (sags.level, "from 2026-01-01 to 2026-01-10 -8 %, more than the intervals of 20 values" in sags.text) == (
        "doubt",
        True,
    )
    assert campaigns(7000.0 * (1 + scatter)).level == "note"
    assert campaigns([7000.0] * 20).level == "note"


def test_a_poor_analysis_hides_no_change():
    """The largest and the smallest value were compared, whatever their intervals: 7400 +- 1200 hid 3 % of +- 0.1 %."""
    hidden = campaigns([6800.0, 7004.0, 7400.0], half=[7.0, 7.0, 1200.0])
    assert hidden.level == "doubt"
    assert "from 2026-01-01 to 2026-01-02 +3 %, more than the intervals of 3 values (E_n +20.61)" in hidden.text
    assert campaigns([6800.0, 6803.0, 7400.0], half=[7.0, 7.0, 1200.0]).level == "note"


def test_unchanged_coefficients_are_doubted_by_chance_only():
    """Last against first and largest against smallest: each in one of twenty series; a trend in one of a hundred."""
    random = np.random.default_rng(8)
    levels = [campaigns(random.normal(7000.0, 70.0 / 1.959964, 12)).level for _ in range(150)]
    assert 0.02 < np.mean([level == "doubt" for level in levels]) < 0.15


def analysis(run, K, half=20.0, kind="contraction-relaxation"):
    at = [{"pressure": P} for P in (2e5, 3e5, 4e5)]
    values = [Estimate("K", K, "N/m", "stiffness", "m", one, Parts(half)) for one in at]
    next_to = [Estimate("K", 1.0, "N/m", "stiffness", "other", at[0], Parts(half))]
    rare = [Estimate("t_d", 0.04, "s", "time", "m"), Estimate("K", None, "N/m", "stiffness", "m", {"pressure": 5e5})]
    return Analysis(kind, (run,), False, (*values, *next_to, *rare), facts={"leak": 0.01})


def test_values_are_followed_by_the_first_method_and_one_place_is_shown():
    life = pasts([row("a", "2026-01-01"), row("b", "2026-02-01"), row("c", "2026-03-01")])
    reported = [analysis("c", 6600.0), analysis("a", 6900.0), analysis("a", 7000.0), analysis("x", 1.0)]
    series = series_of(reported, life)
    assert [(one.first.symbol, one.first.method, len(one.moments)) for one in series] == [
        ("K", "m", 2), ("K", "m", 2), ("K", "m", 2), ("leak", "contraction-relaxation", 2),
    ]  # fmt: skip
    K, _leak = chosen(series)
    assert K.first.at == {"pressure": 3e5}
    assert [(m.run, m.cycles, m.estimate.value) for m in K.moments] == [("a", 0, 7000.0), ("c", 20, 6600.0)]
    assert (K.change.value, K.change.half) == (-400.0, pytest.approx(20 * 2**0.5))
    texts = [finding.text for finding in findings(life, [K], [])]
    assert texts[0].startswith("3 runs from 2026-01-01 to 2026-03-01: 30 pressure cycles, 3 min 00 s at pressure")
    assert texts[1].startswith("K at 300 kPa: -5.7 % over 20 cycles, 2 values, last against first more than their")


def test_runs_that_show_no_command_are_counted_apart():
    life = pasts([row("a", "2026-01-01"), (*row("b", "2026-02-01")[:-1], Use())])
    assert any(f.text.startswith("1 of them commands no pressure") for f in findings(life, [], []))
    assert not any("of them" in f.text for f in findings(life[:1], [], []))


def test_reference_trials_that_leave_their_limits_are_doubted_with_the_date():
    strokes = [10e-3, 10.1e-3] * 6 + [9e-3]
    moments = tuple((f"2026-01-{i + 1:02}", 10 * i, stroke, f"r/{i}") for i, stroke in enumerate(strokes))
    life = [Past("r", "2026-01-01", "k", "b", "finished", False, Use(), 0)]
    one = References((("load", 255.06), ("pressure", 3e5)), moments)
    *_, reported = findings(life, [], [one])
    assert reported.level == "doubt"
    assert "reference trial at load 255.1 N, pressure 300 kPa: 13 times" in reported.text
    assert "1 beyond the control limits, first on 2026-01-13 after 120 cycles (r/12)" in reported.text
    *_, quiet = findings(life, [], [References(one.point, moments[:12])])
    assert (quiet.level, "all within" in quiet.text) == ("note", True)


def self_test(**leak):
    return [Event(0, 1.0, "self-test", {"checks": [], "leak": leak or None}), Event(1, 2.0, "end", {})]


def test_the_leak_of_self_tests_is_followed_over_the_life():
    life = pasts([row("a", "2026-01-01"), row("b", "2026-02-01")])
    falls = {"a": 10.0, "b": 40.0}
    reported = [
        leak_of(run, self_test(pressure=1e5, falls=rate, half_width=5.0), simulated=False)
        for run, rate in falls.items()
    ]
    (leak,) = series_of(reported, life)
    assert [(m.cycles, m.estimate.value, m.estimate.parts.combined) for m in leak.moments] == [
        (0, 10.0, 5.0),
        (10, 40.0, 5.0),
    ]
    *_, finding = findings(life, [leak], [])
    assert finding.text.startswith("leak at 100 kPa: +300 % over 10 cycles")
    assert finding.level == "doubt"


@pytest.mark.parametrize(
    "leak",
    [{}, {"pressure": 1e5}, {"pressure": "x", "falls": 1.0}, {"pressure": 1e5, "falls": float("nan")},
     {"pressure": 1e5, "falls": True}],
)  # fmt: skip
def test_what_is_no_leak_is_not_followed(leak):
    assert leak_of("a", self_test(**leak), simulated=False) is None
    assert leak_of("a", [Event(0, 1.0, "self-test", {"leak": [1]})], simulated=False) is None
    bare = leak_of("a", self_test(pressure=1e5, falls=1.0, half_width="x"), simulated=False)
    assert bare.estimates[0].parts.combined is None
