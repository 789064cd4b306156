"""Open-loop steps of a loop in closed form: valves that limit the flow, filters of the gauge, channels read in steps.

40 ms, a lag of 95.5 ms from command to pressure, one of 247 ms and 0.1466 mm/kPa from there to the contraction. The
ultimate gain solves the phase equation, by bisection here.
"""

import re
from dataclasses import replace
from functools import cache
from itertools import pairwise
from math import atan, exp, pi

import numpy as np
import pytest
from scipy.optimize import brentq

from pmabench.kinds.ultimate_gain.reduction import reduce
from pmabench.store.records import Command, TrialData
from tests.analysis.loop_rig import as_run

GAIN, DEAD, LAG, TAU, TS = 0.1466e-6, 0.040, 0.0955, 0.247, 0.002
BIAS, HOLD, CYCLES, FIRST = 220e3, 2.5, 3, 2.0


def theory(late=0.0):
    """K_u [Pa/m] and T_u [s]; the hold of the controller is half a sample of dead time, a sensor may be `late` [s]."""
    w = brentq(lambda w: w * (DEAD + TS / 2 + late) + atan(w * LAG) + atan(w * TAU) - pi, 1.0, 60.0)
    return float(np.hypot(1, w * LAG) * np.hypot(1, w * TAU) / GAIN), 2 * pi / w


def lagged(t, y, lag):
    """First-order lag of straight lines between samples, from the first value on."""
    keep, h, found = exp(-(t[1] - t[0]) / lag), t[1] - t[0], [y[0]]
    for before, after in pairwise(y):
        rate = (after - before) / h
        found.append(after - rate * lag + (found[-1] - before + rate * lag) * keep)
    return np.array(found)


def pressure(s, height, rate):
    """Pressure [Pa] at times s [s] after a step of the command that it follows at `rate` [Pa/s] at most."""
    straight = max(0.0, abs(height) / rate - LAG)
    late = np.maximum(s - straight, 0.0)
    rest = 1 - min(1.0, rate * LAG / abs(height)) * np.exp(-late / LAG)
    return height * np.where(s < straight, np.maximum(s, 0.0) * rate / abs(height), rest)


@cache
def steps(amplitude, rate):
    """Times [s], pressure over the bias [Pa] and contraction [m], and the commands."""
    at = [FIRST + HOLD * i for i in range(4 * CYCLES)]
    values = [amplitude, 0.0, -amplitude, 0.0] * CYCLES
    t = np.arange(0.0, at[-1] + HOLD, TS)
    P, before, commands = np.zeros_like(t), 0.0, []
    for begin, value in zip(at, values, strict=True):
        P += np.where(t > begin + DEAD, pressure(t - begin - DEAD, value - before, rate), 0.0)
        commands.append(Command(begin, "pressure", "set", BIAS + value, BIAS + before, "open-loop", {}))
        before = value
    return t, P, GAIN * lagged(t, P, TAU), tuple(commands)


def found(
    seed, amplitude=20e3, rate=1e9, gauge=0.0, step=0.0, noise=500.0, drift=0.0, late=(0.0, 0.0), answered=0.0,
    lag=0.0, hunts=0.0, reach=1.0,
):  # fmt: skip
    """K_u and T_u, and the analysis, of a trial whose gauge has a filter [s] and reads in steps [Pa], and whose
    displacement drifts [m/s]; displacement and gauge are `late` [s]. Commands may be off by `answered` [s] in the
    record; `lag` is what the gauge declares [s]; the pressure `hunts` by so much [Pa], and its steps `reach` that share.
    """
    rng = np.random.default_rng(seed)
    t, P, x, commands = steps(amplitude, rate)
    if hunts or reach < 1:
        P = reach * P + hunts * np.sin(2 * pi * 2.1 * t)
        x = GAIN * lagged(t, P, TAU)
    x, P = (np.interp(t - delay, t, y) for delay, y in zip(late, (x, P), strict=True))
    P = BIAS + (lagged(t, P, gauge) if gauge else P) + rng.normal(0, noise, len(t))
    P = step * np.round(P / step) if step else P
    commands = [replace(one, t=one.t + 0.9 * answered, data={"late": abs(answered)}) for one in commands]
    channels = {"displacement": 0.03 + x + drift * t + rng.normal(0, 2e-6, len(t)), "pressure": P}
    trial = TrialData("o", 0, {"setpoint": 0.03, "load": 0.0, "bias": BIAS}, 0, False, "finished", t, channels,
                      np.zeros(len(t), dtype=np.uint16), commands, {})  # fmt: skip
    run = as_run("ultimate-gain", [replace(trial, commands=tuple(commands))])
    run.channels["pressure"] = replace(run.channels["pressure"], sensor_lag=lag)
    analysis = reduce([run])
    K, T = (next(e for e in analysis.estimates if e.symbol == symbol) for symbol in ("K_u", "T_u"))
    return K, T, analysis


def off(e, truth):
    return abs(e.value - truth) / e.parts.combined


@pytest.mark.parametrize(("amplitude", "rate"), [(20e3, 0.12e6), (40e3, 0.25e6)])
def test_a_valve_that_limits_the_flow_is_named(amplitude, rate):
    """The fitted lags made of it one that is slower: K_u 10 to 20 % low with +- 1.2 %."""
    K, T, _ = found(1, amplitude, rate)
    assert K.value is None
    assert T.value is None
    (named,) = re.findall(r"no more than (\d+) kPa/s", K.note)
    assert float(named) == pytest.approx(rate / 1e3, rel=0.03)
    assert "limits the flow" in K.note


def test_a_limit_that_looks_like_a_second_lag_is_in_the_interval():
    """At 0.16 MPa/s, 20 kPa begin with 0.21 MPa/s: noise does not let one tell, and K_u was 5 % low with +- 1.3 %."""
    K_u, T_u = theory()
    K, T, _ = found(1, rate=0.16e6)
    assert K.value is None or off(K, K_u) <= 1.3
    assert T.value is None or off(T, T_u) <= 1.3


def test_a_limit_that_noise_nearly_hides_counts_with_all_of_its_effect():
    """At 0.19 MPa/s; it counted by a share of its likelihood, and T_u was 2.3 half widths off. What noise hides quite
    (fits of other seeds see no limit at all) is not in the interval.
    """
    K, T, _ = found(5, rate=0.19e6, noise=200.0)
    assert max(off(e, truth) for e, truth in zip((K, T), theory(), strict=True)) <= 1.3
    plain, period, _ = found(5, noise=200.0)
    assert plain.parts.combined < 0.015 * plain.value
    assert period.parts.combined < 0.01 * period.value


def test_a_filter_of_the_gauge_is_seen_and_taken_off():
    """The contraction then begins before its pressure. K_u was 2 % high with 10 ms, with 20 ms 8 %."""
    K_u, T_u = theory()
    K, T, analysis = found(2, gauge=0.01, noise=200.0)
    assert off(K, K_u) <= 1
    assert off(T, T_u) <= 1
    assert K.parts.combined < 0.03 * K.value
    assert any("gauge has a filter" in finding.text for finding in analysis.findings)


def test_a_gauge_that_reads_in_steps_has_them_in_its_intervals():
    """Steps of 10 bar / 2^10 under noise of 50 Pa: K_u was 8 half widths off."""
    K_u, T_u = theory()
    K, T, _ = found(3, step=1e6 / 2**10, noise=50.0)
    assert off(K, K_u) <= 1
    assert off(T, T_u) <= 1
    assert any(line.name == "steps of the channels" for line in K.budget)
    assert K.parts.combined < 0.08 * K.value


def test_a_displacement_that_drifts_is_named_and_taken_off():
    """0.1 mm in a minute moved K_u by 2 %, with an interval of 1.3 %."""
    drift = 0.1e-3 / 60
    *without, sound = found(3)
    *values, analysis = found(3, drift=drift)
    assert [e.value for e in values] == pytest.approx([e.value for e in without], rel=1e-3)
    (said,) = (one.text for one in analysis.findings if "moves on" in one.text)
    assert f"by {6e4 * drift:.1g} mm in a minute, which is taken off" in said
    assert not [one for one in sound.findings if "moves on" in one.text]


def test_a_sound_loop_keeps_its_interval():
    K_u, T_u = theory()
    K, T, analysis = found(4)
    assert K.value == pytest.approx(K_u, rel=0.015)
    assert T.value == pytest.approx(T_u, rel=0.015)
    assert K.parts.combined < 0.025 * K_u
    assert not [f for f in analysis.findings if f.level != "note"]
    fine, *_ = found(4, step=1e6 / 2**16, noise=50.0)
    assert fine.parts.combined < 0.003 * K_u


@pytest.mark.parametrize("answered", [-0.009, 0.018])
def test_the_time_that_a_device_took_to_answer_is_in_the_intervals_or_withholds(answered):
    """Commands had their effect 9 ms before what is recorded, or after, of 10: K_u was 26 and 16 % off with +- 1.3 %."""
    for e, truth in zip(found(1, answered=answered)[:2], theory(), strict=True):
        if e.value is None:
            assert "the commands and the displacement may be" in e.note
        else:
            assert off(e, truth) <= 1


def test_a_displacement_that_is_late_is_a_delay_and_no_inertia():
    """A controller sees it, so that it is in the truth. 20 ms made K_u 4 % high with +- 0.1 %."""
    for e, truth in zip(found(2, late=(0.02, 0.0), noise=50.0)[:2], theory(0.02), strict=True):
        assert off(e, truth) <= 1
        assert e.parts.combined < 0.015 * truth


@pytest.mark.parametrize(("gauge", "late"), [(0.0, 0.02), (0.05, 0.0)])
def test_a_declared_lag_of_the_gauge_may_be_a_delay_or_a_filter(gauge, late):
    """A delay of 20 ms made K_u 7 % low, a filter of 50 ms 6 % in the noise of 500 Pa that it raised."""
    for e, truth in zip(found(3, gauge=gauge, late=(0.0, late), lag=gauge + late)[:2], theory(), strict=True):
        assert off(e, truth) <= 1
        assert e.parts.combined < 0.02 * truth


def test_a_pressure_that_does_not_go_where_it_is_sent_or_hunts_is_named():
    """It met a limit at 95 % of the command's steps: K_u was 5 % high with +- 1.2 %; hunting, 13 %."""
    K, *_ = found(4, reach=0.95)
    assert K.value is None
    assert "5.0% off those of the command" in K.note
    K, T, _ = found(4, hunts=1e3)
    assert K.value is None
    assert T.value is None
    assert "at rest the pressure swings by" in K.note
