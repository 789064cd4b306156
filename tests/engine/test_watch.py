"""Each kind of limit on what is measured, on synthetic samples; how they are cut into blocks does not matter (S2)."""

from __future__ import annotations

import itertools
import math
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pmabench.bench.interface import ChannelRecord, Scale, TripRecord
from pmabench.engine.acquire import Acquisition, Tripped
from pmabench.engine.commanded import SETTLES, Commanded
from pmabench.engine.watch import Trip, Watch

RATE = 500.0
CHANNEL = ChannelRecord("pressure", "pressure", "adc", "p", "int32", "count", Scale(), 0.0, 1000e3)
T = np.arange(2000) / RATE


def limit(kind, **changes):
    given = {"low": None, "high": None, "delay": 0.0, "action": "vent", "source": "test:1:1", **changes}
    return TripRecord("pressure", kind=kind, **given)


def look(trip, samples, t=T, cuts=(), commanded=None):
    """Every trip of a signal that comes in blocks."""
    watch = Watch([trip], [CHANNEL], commanded)
    found = []
    for first, last in itertools.pairwise(sorted({0, *cuts, len(samples)})):
        for crossed in watch.look(t[first:last], {"pressure": np.asarray(samples[first:last], dtype=float)}):
            found.append((round(crossed.t, 6), crossed.value, crossed.over, str(crossed)))
            if trip.action in {"stop", "vent"}:
                return found
    return found


def step(at, before=100e3, after=700e3):
    return np.where(at <= T, after, before)


def commands(*steps):
    made = Commanded()
    for t, value in steps:
        made.set("pressure", t, value)
    return made


MOMENTS = (T < 1.0) | (np.arange(-500, len(T) - 500) % 30 >= 20)
"""Inside up to 1 s; then outside for 20 samples, inside for 10, and so on."""
NOISE = np.random.default_rng(5).normal(0.0, 50.0, len(T))
CASES = {
    # name: limit, signal, commanded, moment of the trip [s]
    "above": (limit("range", high=650e3), step(1.0), None, 1.0),
    "at the limit": (limit("range", high=650e3), step(1.0, after=650e3), None, 1.0),
    "below": (limit("range", low=-30e3), step(1.0, after=-30e3), None, 1.0),
    "above for long enough": (limit("range", high=650e3, delay=0.1), step(1.0), None, 1.1),
    "no number": (limit("range", high=650e3), step(1.0, after=math.nan), None, 1.0),
    "no number for long enough": (limit("range", high=650e3, delay=0.02), step(1.0, after=math.nan), None, 1.02),
    "infinite": (limit("range", low=-30e3), step(1.0, after=math.inf), None, 1.0),
    "rate upwards": (limit("rate", high=1e6), np.interp(T, [1.0, 1.2], [1e5, 5e5]), None, 1.012),
    "rate downwards": (limit("rate", high=1e6), np.interp(T, [1.0, 1.2], [5e5, 1e5]), None, 1.012),
    "frozen": (limit("frozen", delay=0.5), np.where(T < 1.0, 1e5 + NOISE, 1e5), None, 1.5),
    "off range high": (limit("off-range", delay=0.01), step(1.0, after=1000e3), None, 1.01),
    "off range low": (limit("off-range"), step(1.0, after=0.0), None, 1.0),
    "off range, no number": (limit("off-range"), step(1.0, after=math.nan), None, 1.0),
    "far from what is commanded": (limit("following", high=60e3, delay=0.5), 1e5 + NOISE, commands((1.0, 3e5)), 1.5),
    "burst": (limit("burst", high=60e3, window=0.05), np.interp(T, [1.0, 1.1], [3e5, 0.0]), commands((0.0, 3e5)), 1.022),
    "slack": (limit("slack", low=10.0), step(1.0, after=5.0), None, 1.0),
    # of each 60 ms 38 ms are outside and 20 ms inside after it: 4 * 18 ms, and 28 ms of the fifth
    "slack, with moments without": (
        limit("slack", low=10.0, delay=0.1), np.where(MOMENTS, 50.0, 5.0), None, 1.268,
    ),
    "off range, with moments inside": (
        limit("off-range", delay=0.1), np.where(MOMENTS, 5e5, 0.0), None, 1.268,
    ),
    "neither follows nor falls at rest": (limit("following", high=60e3, delay=3.0), 1e5 + NOISE, commands((0.0, 1e5), (1.0, 0.0)), 1.5),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_a_crossing_is_found_at_its_sample(name):
    trip, samples, commanded, moment = CASES[name]
    found = look(trip, samples, commanded=commanded)
    assert [item[0] for item in found] == [pytest.approx(moment, abs=1.01 / RATE)]
    assert "test:1:1" in found[0][3]


@cache
def in_one_piece(name):
    trip, samples, commanded, _ = CASES[name]
    return look(trip, samples, commanded=commanded)


@pytest.mark.parametrize("name", CASES)
@settings(max_examples=25)
@given(cuts=st.lists(st.integers(0, len(T)), max_size=12))
def test_blocks_do_not_matter(name, cuts):
    trip, samples, commanded, _ = CASES[name]
    assert look(trip, samples, cuts=cuts, commanded=commanded)[0][:1] == in_one_piece(name)[0][:1]


@pytest.mark.parametrize("name", CASES)
def test_every_single_cut_gives_the_same(name):
    trip, samples, commanded, moment = CASES[name]
    whole = in_one_piece(name)[0]
    near = round(moment * RATE)
    for cut in [*range(0, len(T), 97), *range(near - 40, near + 40)]:
        assert look(trip, samples, cuts=[cut], commanded=commanded)[0][0] == whole[0]


@pytest.mark.parametrize("name", CASES)
def test_sample_by_sample_gives_the_same(name):
    trip, samples, commanded, moment = CASES[name]
    watch = Watch([trip], [CHANNEL], commanded)
    found = next(
        crossed[0].t for t, value in zip(T, samples, strict=True)
        if (crossed := watch.look_once(float(t), {"pressure": float(value)}))
    )  # fmt: skip
    assert found == pytest.approx(moment, abs=1.01 / RATE)


QUIET = {
    "inside": (limit("range", low=-30e3, high=650e3), np.linspace(0, 649e3, len(T)), None),
    "too short": (limit("range", high=650e3, delay=0.1), np.where((T >= 1.0) & (T < 1.098), 700e3, 1e5), None),
    "again and again, each too short": (limit("range", high=650e3, delay=0.1), np.where(T % 0.1 < 0.09, 700e3, 1e5), None),
    "slow": (limit("rate", high=1e6), np.interp(T, [1.0, 1.5], [1e5, 5e5]), None),
    "alive": (limit("frozen", delay=0.5), np.where(np.arange(len(T)) % 240, 1e5, 1e5 + 1), None),
    "in range": (limit("off-range"), np.linspace(1.0, 999e3, len(T)), None),
    "follows in time": (limit("following", high=60e3, delay=0.5), np.interp(T, [1.0, 1.6], [1e5, 3e5]), commands((1.0, 3e5))),
    "never commanded": (limit("following", high=60e3), step(1.0), None),
    "rises": (limit("burst", high=60e3, window=0.05), np.interp(T, [1.0, 1.1], [0.0, 3e5]), commands((0.0, 3e5))),
    "falls as commanded": (limit("burst", high=60e3, window=0.05), np.interp(T, [1.0, 1.1], [3e5, 0.0]),
                           commands((0.0, 3e5), (1.0, 0.0))),
    "falls slowly": (limit("burst", high=60e3, window=0.05), np.interp(T, [1.0, 2.0], [3e5, 0.0]), commands((0.0, 3e5))),
}  # fmt: skip


@pytest.mark.parametrize("name", QUIET)
@settings(max_examples=25)
@given(cuts=st.lists(st.integers(0, len(T)), max_size=6))
def test_what_is_inside_does_not_trip(name, cuts):
    trip, samples, commanded = QUIET[name]
    assert look(trip, samples, cuts=cuts, commanded=commanded) == []


def regulated(commands, lasts, tau, dead=0.0, aim=lambda asked: asked, block=1, action="stop"):
    """Trips of `following: 60 kPa for 3 s` at a regulator of first order: lag `tau` and dead time [s].

    It goes for `aim` of its command; the first one has long been reached. Blocks of samples at 100 Hz.
    """
    t = np.arange(round(lasts * 100)) / 100.0
    times, values = np.array([at for at, _ in commands]), np.array([value for _, value in commands])
    goals = aim(values[np.searchsorted(times, np.maximum(t - dead, 0.0) + 1e-9) - 1])
    pressure, at = np.empty(len(t)), goals[0]
    for index, goal in enumerate(goals):
        pressure[index] = at = at + (goal - at) * -math.expm1(-0.01 / tau)
    made, found = Commanded(), []
    watch = Watch([limit("following", high=60e3, delay=3.0, action=action)], [CHANNEL], made, 20e3)
    todo = list(commands)
    for first in range(0, len(t), block):
        while todo and todo[0][0] <= t[first]:
            made.set("pressure", *todo.pop(0))
        found += watch.look(t[first : first + block], {"pressure": pressure[first : first + block]})
        if found and action != "warn":
            break
    return [round(trip.t, 6) for trip in found]


STAIRS = [(t + 6.0 * n, value) for n in range(10) for t, value in ((0.0, 3e5), (2.4, 2e5), (4.4, 1e5))]
"""300 kPa for 2.4 s, then two lower pressures, again and again; none is rest."""


def opposite(asked):
    """A regulator that is wired the wrong way round: it agrees at 300 kPa."""
    return 600e3 - asked


@pytest.mark.parametrize("block", [1, 20])
def test_a_regulator_that_does_the_opposite_is_found_although_it_agrees_in_between(block):
    """Off for 3.6 s it is found as before. Off for 1.6 s, in agreement for 0.4 s, off for 1.6 s, in agreement for 2.4 s:

    1.59 - 0.40 + 1.59 - 2.40 = 0.38 s are left of 6 s; 0.38 + 1.59 - 0.40 + 1.43 = 3 s at 10.4 + 1.43 s.
    """
    assert regulated(STAIRS, 60.0, 1e-3, 0.0, opposite, block) == [pytest.approx(5.4, abs=0.011)]
    agrees = sorted([*STAIRS, *((t - 0.4, 3e5) for t, value in STAIRS if value == 1e5)])
    assert regulated(agrees, 60.0, 1e-3, 0.0, opposite, block) == [pytest.approx(11.83, abs=0.011)]


@pytest.mark.parametrize("block", [1, 20])
@pytest.mark.parametrize(("tau", "dead"), [(0.02, 0.0), (0.3, 0.05), (0.3, 0.3), (0.8, 0.2), (1.2, 0.1)])
def test_a_regulator_that_only_lags_is_left_alone(tau, dead, block):
    stairs = [*STAIRS, *((60.0 + 6.0 * n + t, value) for n in range(5) for t, value in ((0.0, 6e5), (3.0, 0.0)))]
    assert regulated(stairs, 90.0, tau, dead, block=block) == []


@pytest.mark.parametrize("period", [1.0, 2.0, 5.0])
def test_a_loop_that_commands_faster_than_the_regulator_follows_is_left_alone(period):
    """A relay of +-100 kPa around 300 kPa, and a regulator that lags by 0.4 s: off most of the time, and sound."""
    relay = [(n * period / 2, 4e5 - 2e5 * (n % 2)) for n in range(round(120 / period))]
    assert regulated(relay, 60.0, 0.4, 0.05) == []


CYCLES = [(0.0, 0.0), *((2.0 + 4.0 * n + t, value) for n in range(20) for t, value in ((0.0, 4e5), (2.0, 0.0)))]
"""400 kPa for 2 s, and as long without pressure, as in a warm-up."""


@pytest.mark.parametrize("action", ["stop", "vent", "hold"])
@pytest.mark.parametrize("block", [1, 7])
def test_a_gauge_in_another_unit_is_found_though_each_hold_is_shorter_than_the_limit(action, block):
    """In psi, read as kPa: 58 for 400. It is known when the first hold ends, at 4 s, before the next pressure."""
    found = regulated(CYCLES, 80.0, 0.1, aim=lambda asked: asked / 6.895, block=block, action=action)
    assert found == [pytest.approx(4.0, abs=0.01 * block + 0.001)]


def test_a_warning_at_the_end_of_each_hold_ends_nothing():
    warnings = regulated(CYCLES, 80.0, 0.1, aim=lambda asked: asked / 6.895, action="warn")
    assert warnings == [pytest.approx(4.0 + 4.0 * n, abs=0.011) for n in range(19) for _ in ("warns", "is over")]


@pytest.mark.parametrize(
    ("high", "low", "tau", "dead"), [(2.0, 2.0, 0.6, 0.3), (0.25, 0.25, 0.02, 0.1), (0.3, 3.0, 0.02, 0.2)]
)
def test_cycles_between_pressure_and_none_are_left_alone(high, low, tau, dead):
    cycles = [(n * (high + low) + t, value) for n in range(200) for t, value in ((0.0, 0.0), (low, 4e5))]
    assert regulated(cycles, cycles[-1][0], tau, dead) == []


@given(cuts=st.lists(st.integers(0, len(T)), max_size=12), period=st.floats(0.05, 1.0), high=st.floats(1e5, 6e5))
def test_a_warning_comes_and_goes_at_the_same_samples_however_it_is_cut(cuts, period, high):
    samples = 3.5e5 + 3e5 * np.sin(2 * np.pi * T / period)
    trip = limit("range", high=high, delay=0.01, action="warn")
    found = look(trip, samples, cuts=cuts)
    assert found == look(trip, samples)
    assert [item[2] for item in found] == [bool(n % 2) for n in range(len(found))]


def test_a_fall_that_settles_is_no_burst_and_one_afterwards_is():
    fall = np.interp(T, [3.2, 3.3], [3.03e5, 0.0])
    early, late = commands((0.0, 4e5), (3.2 - SETTLES + 0.3, 0.0)), commands((0.0, 4e5), (3.2 - SETTLES - 0.1, 0.0))
    trip = limit("burst", high=60e3, window=0.05)
    for cuts in ([], [700], [1610], list(range(0, 2000, 25))):
        assert look(trip, fall, cuts=cuts, commanded=early) == []
        assert [item[0] for item in look(trip, fall, cuts=cuts, commanded=late)] == [3.22]


@given(cuts=st.lists(st.integers(0, len(T)), max_size=12))
def test_a_fall_deeper_than_any_command_is_a_burst_right_after_a_step_down(cuts):
    """3.03 bar to nothing in 0.1 s, from 3.2 s on; 3 bar is the lowest command: found 63 kPa later, at 3.2208 s."""
    fall = np.interp(T, [3.2, 3.3], [3.03e5, 0.0])
    trip = limit("burst", high=60e3, window=0.05)
    (found,) = look(trip, fall, cuts=cuts, commanded=commands((0.0, 4e5), (3.1, 3e5)))
    assert found[0] == pytest.approx(3.222, abs=1e-9)
    assert look(trip, fall, cuts=cuts, commanded=commands((0.0, 4e5), (2.5, 1e3), (3.1, 3e5))) == []
    assert look(
        trip, fall, cuts=cuts, commanded=commands((0.0, 4e5), (3.0 - SETTLES, 1e3), (3.1 - SETTLES, 3e5), (3.15, 2.9e5))
    )


def test_a_burst_in_a_loop_that_commands_at_every_sample_is_found():
    """A loop steps between 2.8 and 3.2 bar each 2 ms, half of the steps down; the pressure follows their mean."""
    loop = Commanded()
    trip = limit("burst", high=60e3, window=0.05)
    watch = Watch([trip], [CHANNEL], loop)
    for k, t in enumerate(T):
        loop.set("pressure", float(t), 3e5 + (2e4 if k % 2 else -2e4))
        value = 3e5 if t < 3.0 else 3e5 * math.exp(-(t - 3.0) / 0.1)
        found = watch.look_once(float(t), {"pressure": value})
        if found:
            break
    # e-fold 0.1 s: the fall over 50 ms beyond the 20 kPa down to the lowest command is above 60 kPa from 32 ms on
    assert found[0].t == pytest.approx(3.0 - 0.1 * math.log(1 - 80e3 / 3e5), abs=0.003)


def test_the_lowest_command_counts_for_as_long_as_a_pressure_may_follow_it():
    reported = commands((0.0, 4e5), (1.0, 1e5), (2.0, 3e5), (2.5, 2e5), (5.0, 3e5))
    at = np.array([0.5, 1.5, 2.0 + SETTLES - 0.01, 2.0 + SETTLES + 0.01, 5.0 + SETTLES - 0.01, 5.0 + SETTLES + 0.01])
    assert reported.lowest("pressure", at[3:]).tolist() == [2e5, 2e5, 3e5]
    assert Commanded().lowest("pressure", at[:1]).tolist() == [math.inf]


@given(cuts=st.lists(st.integers(0, len(T)), max_size=6))
def test_a_burst_during_a_sine_or_a_ramp_is_found_and_the_motion_itself_is_none(cuts):
    trip = limit("burst", high=60e3, window=0.05)
    moving = Commanded()
    moving.sine("pressure", 0.0, 3e5, 1e5, 1.0, 10)
    sine = 3e5 + 1e5 * np.sin(2 * np.pi * T)
    assert look(trip, sine, cuts=cuts, commanded=moving) == []
    (found,) = look(trip, np.where(T < 1.0, sine, 0.0), cuts=cuts, commanded=moving)
    assert found[0] == 1.0
    moving = Commanded()
    moving.ramp("pressure", 0.0, 6e5, 0.0, 2e5)
    ramp = 6e5 - 2e5 * np.minimum(T, 3.0)
    assert look(trip, ramp, cuts=cuts, commanded=moving) == []
    (found,) = look(trip, np.where(T < 1.0, ramp, 0.0), cuts=cuts, commanded=moving)
    assert found[0] == 1.0


def test_a_faster_fall_before_a_slower_one_is_not_forgotten():
    both = Commanded()
    both.ramp("pressure", 0.0, 6e5, 5e5, 1e5)
    both.ramp("pressure", 1.0, 5e5, 4e5, 1e4)
    both.set("pressure", 2.0, 5e5)
    assert both.falling("pressure", np.array([0.5, 2.9, 3.1, 12.9, 13.1])).tolist() == [1e5, 1e5, 1e4, 1e4, 0.0]
    both.set("pressure", 20.0, 1e5)
    assert both.falling("pressure", np.array([21.9, 22.1])).tolist() == [math.inf, 0.0]
    assert Commanded().falling("pressure", np.array([0.0])).tolist() == [0.0]


def test_no_command_explains_a_fall_before_it():
    """A burst at 1 s whose samples come when 1 bar was commanded already, at 1.9 s."""
    held = np.where(T < 1.0, 4e5, 0.0)
    late = commands((0.0, 4e5), (1.9, 1e5))
    (found,) = look(limit("burst", high=60e3, window=0.05), held[:750], T[:750], commanded=late)
    assert found[0] == 1.0
    assert late.falling("pressure", np.array([1.0, 1.8, 1.9, 3.8, 4.0])).tolist() == [0.0, 0.0, math.inf, math.inf, 0.0]


def test_a_fall_counts_for_samples_before_the_next_one_too():
    """5 kPa/s from 1 s on, a step down at 2 s, up at 3 s, and down at 6 s: each from its own moment on."""
    many = Commanded()
    many.ramp("pressure", 1.0, 6e5, 5e5, 5e3)
    many.set("pressure", 2.0, 4e5)
    for step in range(1000):  # a loop that is closed keeps no more than it needs
        many.set("pressure", 3.0 + 1e-3 * step, 4e5 - (step % 2) * 1e4)
    at = np.array([0.9, 1.5, 1.9, 2.1, 2.9, 5.9, 6.1])
    assert many.falling("pressure", at).tolist() == [0.0, 5e3, 5e3, math.inf, math.inf, math.inf, 0.0]
    assert len(many._falls["pressure"]) <= 2


def test_a_silent_channel_is_found_by_the_time_and_heard_again():
    watch = Watch([limit("stale", delay=0.25, action="warn")])
    assert watch.silent(10.0) == []
    assert watch.silent(10.2) == []
    (found,) = watch.silent(10.25)
    assert "has given no sample for 0.250 s" in str(found)
    assert watch.silent(11.0) == []
    (over,) = watch.look(np.array([11.0]), {"pressure": np.array([1.0])}, 11.1)
    assert over.over
    assert watch.silent(11.3) == []
    assert len(watch.silent(11.4)) == 1


def test_a_device_clock_that_is_far_ahead_hides_no_silence():
    watch = Watch([limit("stale", delay=0.25)])
    watch.look(np.array([5000.0]), {"pressure": np.array([1.0])}, 1.0)
    assert len(watch.silent(1.25)) == 1


def test_a_missing_channel_and_an_empty_block_show_nothing():
    watch = Watch([limit("range", high=1.0)])
    assert watch.look(T[:1], {"force": np.array([5.0])}) == []
    assert watch.look(T[:0], {"pressure": np.zeros(0)}) == []
    assert watch.look_once(0.0, {"force": 5.0}) == []


def test_the_first_that_ends_the_run_is_the_last_that_is_reported():
    warn, stop = limit("range", high=2e5, action="warn"), limit("range", high=4e5, action="stop")
    watch = Watch([stop, warn, limit("range", high=6e5)], [CHANNEL])
    found = watch.look(T, {"pressure": np.linspace(0.0, 8e5, len(T))})
    assert [item.limit.action for item in found] == ["warn", "stop"]


ABOVE = {
    # what the pressure does while 200 kPa is commanded from 0.5 s on, and when it is vented [s]
    "another program's command": (np.where(T < 1.0, 2e5, 5.9e5), 2.0),
    "a valve that sticks, and leaks a little": (np.where(T < 1.0, 2e5, 5.9e5 - 2e3 * T), 2.0),
    "a regulator that runs away": (np.interp(T, [1.0, 2.0], [2e5, 6.4e5]), 2.136),
    "a muscle that empties slowly": (2e5 + 4e5 * np.exp(-np.maximum(T - 0.5, 0.0) / 1.0), None),
    "a supply that is lost": (np.where(T < 1.0, 2e5, 5e4), None),
    "for a short time": (np.where((T < 1.0) | (T > 1.9), 2e5, 5.9e5), None),
}


@pytest.mark.parametrize("what", ABOVE)
@pytest.mark.parametrize("cuts", [(), range(7, 2000, 7)])
def test_a_pressure_above_its_command_is_not_held_for(what, cuts):
    """A bench that holds sends nothing: who waits for it to follow keeps it where it is."""
    samples, moment = ABOVE[what]
    watch = Watch(
        [limit("following", high=60e3, delay=1.0, action="hold")], [CHANNEL], commands((0.0, 6e5), (0.5, 2e5))
    )
    ends = []
    for first, last in itertools.pairwise(sorted({0, *cuts, len(T)})):
        found = watch.look(T[first:last], {"pressure": samples[first:last]})
        ends = ends or [trip for trip in found if trip.limit.action == "vent"]
    assert [round(trip.t, 2) for trip in ends] == ([] if moment is None else [round(moment, 2)])
    assert all("more than 60 kPa above what is commanded and does not fall" in str(trip) for trip in ends)


@pytest.mark.parametrize(
    ("action", "found"), [("warn", ("warn", 4.0)), ("stop", ("vent", 1.5)), ("hold", ("vent", 1.5))]
)
def test_a_pressure_that_stays_where_a_vented_muscle_is_commanded_is_vented(action, found):
    """One that only warns goes on to do so."""
    t = np.arange(2500) / RATE
    watch = Watch(
        [limit("following", high=60e3, delay=3.0, action=action)], [CHANNEL], commands((0.0, 1e5), (1.0, 5e3)), 20e3
    )
    (trip,) = watch.look(t, {"pressure": np.full(len(t), 1e5)})
    assert (trip.limit.action, round(trip.t, 2)) == found


@pytest.mark.parametrize("stuck", [False, True])
@pytest.mark.parametrize(("every", "waits"), [(0.02, 0.5), (0.6, 1.2), (1.0, 2.0)])
def test_a_gauge_that_is_seldom_new_does_not_show_a_fall_at_once(every, waits, stuck):
    """A regulator with a lag of 0.3 s is left alone; one that sticks is vented after two new values, at least 0.5 s."""
    t = np.arange(0.0, 12.0, 1 / RATE)
    for late in np.linspace(0.0, 0.9 * every, 7):
        read = np.maximum(every * np.floor((t + late) / every + 1e-6) - late, 0.0)
        rises = 6e5 * -np.expm1(-np.maximum(read - 1.0, 0.0) / 0.3)
        pressure = rises * (np.exp(-np.maximum(read - 7.0, 0.0) / 0.3) if not stuck else 1.0)
        commanded = commands((0.0, 0.0), (1.0, 6e5), (7.0, 0.0))
        watch = Watch([limit("following", high=60e3, delay=3.0, action="stop")], [CHANNEL], commanded, 20e3)
        found = [(trip.limit.action, trip.t) for trip in watch.look(t, {"pressure": pressure})]
        assert found == ([("vent", pytest.approx(7.0 + waits, abs=0.01))] if stuck else [])


@pytest.mark.parametrize(
    ("kind", "channel", "value", "too_high"),
    [
        ("range", "pressure", 660e3, True),
        ("range", "pressure", -40e3, False),
        ("range", "pressure", math.nan, False),
        ("range", "force", 660e3, False),
        ("following", "pressure", 360e3, True),
        ("following", "pressure", 240e3, False),
        ("above", "pressure", 360e3, True),
        ("burst", "pressure", 90e3, True),
        ("stale", "pressure", 0.3, False),
    ],
)
def test_a_pressure_that_is_too_high_waits_for_no_ramp(kind, channel, value, too_high):
    commanded = Commanded()
    commanded.set("pressure", 0.0, 300e3)
    high = {"range": 650e3, "following": 50e3}.get(kind)
    made = TripRecord(channel, -30e3 if kind == "range" else None, high, 0.1, "vent", kind=kind)
    assert Trip(made, 0, 1.0, value).too_high(commanded) == too_high


def test_what_another_channel_does_leaves_the_doubt_of_a_gauge():
    """A force that stood still took its place, and cleared it by moving again: the dead gauge confirmed the vent."""
    acquisition = Acquisition.__new__(Acquisition)
    acquisition._bench = SimpleNamespace(hands_below=10e3)
    acquisition._recorder = SimpleNamespace(event=lambda *_, **__: None)
    acquisition.doubted, acquisition.holding = set(), set()
    names = ("pressure", "pressure_2", "force")
    gauge, other, cell = (TripRecord(name, None, None, 5.0, "warn", "bench.yaml", "frozen") for name in names)
    seen = []
    for trip in (Trip(gauge, 0, 10.0, 0.0), Trip(cell, 0, 11.0, 350.0), Trip(cell, 0, 12.0, 351.0, over=True),
                 Trip(other, 0, 12.0, 0.0), Trip(gauge, 0, 13.0, 50e3, over=True)):  # fmt: skip
        acquisition._act([trip])
        seen.append(set(acquisition.doubted))
    assert seen == [{names[0]}, {names[0]}, {names[0]}, {*names[:2]}, {names[1]}]


def test_of_two_gauges_that_do_not_move_from_the_same_sample_on_both_are_doubted():
    """The first one ended the run, and the second confirmed its vent."""
    names = ("pressure_1", "pressure_2")
    limits = [TripRecord(name, None, None, 5.0, "vent", "bench.yaml", "frozen") for name in names]
    t = np.arange(0.0, 8.0, 0.01)
    trips = Watch(limits).look(t, {name: np.zeros(len(t)) for name in names})
    assert [trip.limit.channel for trip in trips] == [*names]
    acquisition = Acquisition.__new__(Acquisition)
    acquisition._bench, acquisition.clock = SimpleNamespace(hands_below=10e3), SimpleNamespace(now=lambda: 8.0)
    acquisition._recorder = SimpleNamespace(event=lambda *_, **__: None)
    acquisition.doubted, acquisition.commanded, acquisition.on_trip = set(), Commanded(), lambda *_: None
    with pytest.raises(Tripped):
        acquisition._act(trips)
    assert acquisition.doubted == {*names}
