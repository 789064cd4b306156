"""Driven sines behind sensors that nobody described: filters of any channel, few samples, a pressure that swings along.

The force is a Fourier series of F_ce - K x - B x' - F_c sign x' + S (P - 300 kPa), each wave times the filter at its
frequency.
"""

from dataclasses import replace

import numpy as np
import pytest

from pmabench.kinds.sinusoidal_displacement.reduction import reduce
from tests.analysis.loop_rig import as_run
from tests.analysis.sine_rig import Muscle51, value

A, MEAN, F_CE, S = 5e-3, 0.01, 275.0, 1.01e-3
K, F_C = 6773.0, 6.0
PLACES = 2**14
FILTERS = {
    "first order": lambda s, tau: 1 / (1 + s * tau),
    "second order": lambda s, tau: 1 / (1 + s * tau + (s * tau / 1.4) ** 2),
    "delay": lambda s, tau: np.exp(-s * tau),
}
TWO, FOUR = ((0.5, 6), (3.0, 31)), ((0.1, 4), (0.5, 6), (1.0, 11), (3.0, 31))


def read(wave, frequency, t, kind="delay", tau=0.0):
    """One cycle of `wave` at (n + 1/2)/PLACES of it, behind a filter, at times `t` [s]."""
    s = 2j * np.pi * frequency * np.arange(PLACES // 2 + 1)
    filtered = np.fft.irfft(np.fft.rfft(wave) * FILTERS[kind](s, tau), PLACES)
    at = (frequency * t) % 1.0 * PLACES - 0.5
    return np.interp(at, np.arange(-1, PLACES + 1), np.r_[filtered[-1], filtered, filtered[0]])


def trial(index, frequency, cycles, B, behind, rate=500.0, swing=0j, pressure=3e5):
    """A sine of 5 mm about 10 mm; `behind` is channel -> (filter, tau [s]), `swing` the pressure's amplitude [Pa]."""
    template = Muscle51().trial(index, frequency, cycles, pressure=pressure)
    t = np.arange(round(cycles / frequency * rate)) / rate
    theta = 2 * np.pi * (np.arange(PLACES) + 0.5) / PLACES
    v = 2 * np.pi * frequency * A * np.cos(theta)
    P = pressure + np.imag(swing * np.exp(1j * theta))
    F = F_CE + S * (P - 3e5) - K * (MEAN + A * np.sin(theta)) - np.where(v > 0, *B) * v - F_C * np.sign(v)
    waves = {"displacement": MEAN + A * np.sin(theta), "force": F, "pressure": P}
    noise = np.random.default_rng(index).standard_normal((3, len(t)))
    channels = {
        name: read(wave, frequency, t, *behind.get(name, ("delay", 0.0))) + size * one
        for (name, wave), size, one in zip(waves.items(), (2e-6, 0.3, 500.0), noise, strict=True)
    }
    return replace(template, t=template.t[0] + t, channels=channels, flags=np.zeros(len(t), dtype=np.uint16))


def reduced(plan, B, behind=None, repeats=2, pressures=(3e5,), settings=None, **more):
    sines = [(f, n, P) for P in pressures for f, n in plan * repeats]
    trials = [trial(i, f, n, B, behind or {}, pressure=P, **more) for i, (f, n, P) in enumerate(sines)]
    return reduce([as_run("sinusoidal-displacement", trials, {"discard": 1, **(settings or {})})])


def truth(e, B):
    """What the muscle has of an estimate; None of those that are not asked for."""
    omega, both = 2 * np.pi * e.at.get("frequency", 0.0), sum(B) / 2
    L = both * omega + 4 * F_C / np.pi / A
    return {
        "K": K, "K_A": K, "B": both, "F_c": F_C, "phi": np.arctan2(L, K), "H": 2 * (both * omega * A + F_C),
        "W": np.pi * L * A**2,
    }.get(e.symbol)  # fmt: skip


def errors(found, B):
    """Estimate and its error in half widths, of all that have a value."""
    known = [(e, truth(e, B)) for e in found.estimates if e.value is not None]
    return [(e, (e.value - right) / e.parts.combined) for e, right in known if right is not None]


@pytest.mark.parametrize(("kind", "plan", "B"), [
    ("first order", FOUR, (400.0, 400.0)), ("second order", FOUR, (1680.0, 2120.0)),
    ("second order", TWO, (400.0, 400.0)), ("first order", TWO, (1680.0, 2120.0)),
])  # fmt: skip
@pytest.mark.parametrize("channel", ["force", "displacement"])
def test_a_filter_of_5_ms_on_force_or_displacement_is_in_all_intervals(channel, kind, plan, B):
    """B was up to 1.5 half widths off, W and H 1.6: a filter counted to first order, and of the force only."""
    found = errors(reduced(plan, B, {channel: (kind, 5e-3)}), B)
    assert {e.symbol for e, _ in found} >= {"B", "F_c", "phi", "H", "W"}
    for e, error in found:
        assert abs(error) < (1.0 if e.symbol in ("B", "F_c") else 1.2 if e.symbol == "K" else 1.05)


def test_a_bench_without_a_filter_keeps_its_intervals():
    """Of K, B and F_c as before; where the time is stated they are those of the sines alone."""
    for settings, widest in (
        ({}, {"K": 0.004, "B": 0.10, "F_c": 0.03}),
        ({"time_skew": 1e-7}, dict.fromkeys("KB", 0.01)),
    ):
        found = reduced(FOUR, (400.0, 400.0), settings=settings)
        for e, error in errors(found, (400.0, 400.0)):
            assert abs(error) < 1.3
            if e.symbol in widest and "frequency" not in e.at:
                assert e.parts.combined < widest[e.symbol] * e.value


def test_a_filter_of_the_displacement_counts_where_that_of_the_force_is_declared():
    """The force's was known to 0.2 ms, and B of 400 N.s/m 25 half widths off."""
    B, behind = (400.0, 400.0), {"displacement": ("first order", 5e-3), "force": ("first order", 1e-3)}
    run = as_run(
        "sinusoidal-displacement", [trial(i, f, n, B, behind) for i, (f, n) in enumerate(FOUR)], {"discard": 1}
    )
    declared = {**run.channels, "force": replace(run.channels["force"], sensor_lag=1e-3)}
    for e, error in errors(reduce([replace(run, channels=declared)]), B):
        assert abs(error) < 1.1, (e.symbol, e.at)


@pytest.mark.parametrize("swing", [300j, 3000.0])
def test_a_pressure_that_swings_with_the_sine_is_in_the_intervals(swing):
    """At one pressure nothing tells its force: 3 kPa made K 50 half widths wrong, 0.3 kPa H at 0 Hz 9 and phi 2."""
    found = errors(reduced(FOUR, (400.0, 400.0), swing=swing), (400.0, 400.0))
    assert len(found) > 17
    assert max(abs(error) for _, error in found) < 1.0
    assert any(line.name == "pressure that swings with the sine" for e, _ in found for line in e.budget)


@pytest.mark.parametrize("tau", [2e-3, 4e-3])
def test_a_filter_of_the_pressure_is_in_the_intervals_where_its_force_is_taken_off(tau):
    """3 kPa that swing with the sine, at two pressures, the time between force and displacement stated: B 2 off."""
    settings = {"time_skew": 1e-5}
    found = reduced(TWO, (400.0, 400.0), {"pressure": ("first order", tau)}, 2, (3e5, 4e5), settings, swing=3000.0)
    for e, error in errors(found, (400.0, 400.0)):
        assert abs(error) < 1.1, (e.symbol, e.at)


@pytest.mark.parametrize("rate", [60.0, 100.0])
def test_few_samples_a_cycle_leave_loop_width_and_work_as_they_are(rate):
    """15 to 100 samples a cycle: H at 4 Hz was 60 half widths off, and W by all that its replay had said."""
    found = reduced(((0.1, 4), (1.0, 11), (4.0, 30)), (400.0, 400.0), rate=rate, settings={"time_skew": 1e-7})
    checked = [(e, error) for e, error in errors(found, (400.0, 400.0)) if e.symbol in ("H", "W", "phi")]
    assert len(checked) == 10
    assert max(abs(error) for _, error in checked) < 1.2
    W = value(found, "W", "loop-width", {"frequency": 4.0})
    assert W.corrected
    assert abs(W.value / truth(W, (400.0, 400.0)) - 1) < 2e-3


@pytest.mark.parametrize(("period", "channel"), [(25, "force"), (10, "force"), (10, "displacement")])
def test_a_channel_that_is_read_less_often_than_it_is_recorded_counts_where_it_is_new(
    period: int, channel: str
) -> None:
    """Values that are held are late by half their time: K at 3 Hz was 15 N/mm for 6.8, B 881 for 1200."""
    trials = []
    for trial in Muscle51(B_c=1200.0, B_r=1200.0, noise=(3e-6, 0.3, 250.0)).trials(repeats=2):
        held = trial.channels[channel][(np.arange(len(trial.t)) // period) * period]
        trials.append(replace(trial, channels={**trial.channels, channel: held}))
    found = reduce([as_run("sinusoidal-displacement", trials, {"discard": 1})])
    known = [e for e in found.estimates if e.symbol in ("K", "B") and e.value is not None]
    assert len(known) > 3
    for e in known:
        assert abs(e.value - {"K": 6773.0, "B": 1200.0}[e.symbol]) < e.parts.combined, (e.symbol, dict(e.at))
    slow = [one for one in found.dropped if "held in between" in one.reason]
    assert len(slow) == (2 if period == 25 else 0), "6.7 values a cycle are no sine"


def test_a_friction_below_0_is_withheld_with_all_that_rests_on_the_loop() -> None:
    """A cell with 2 N of hysteresis: F_c was -1.6 +- 0.9 N, H at 0.1 Hz 4.2 +- 0.2 N for 7.5 N."""
    trials = []
    for trial in Muscle51(B_c=1200.0, B_r=1200.0, noise=(3e-6, 0.3, 250.0)).trials(repeats=2):
        shown, now = [], trial.channels["force"][0]
        for F in trial.channels["force"]:
            shown.append(now := min(max(now, F - 2.0), F + 2.0))
        trials.append(replace(trial, channels={**trial.channels, "force": np.array(shown)}))
    found = reduce([as_run("sinusoidal-displacement", trials, {"discard": 1, "time_skew": 1e-7})])
    of_loop = [e for e in found.estimates if e.symbol in ("F_c", "H", "W", "phi")]
    assert len(of_loop) > 10
    assert all(e.withheld for e in of_loop)
    B = value(found, "B", "sine-harmonic")
    assert abs(B.value - 1200.0) < B.parts.combined


def test_half_a_step_of_a_converter_that_cuts_off_is_in_the_mean_force() -> None:
    """A cell in 1 N: F was 7 half widths off."""
    trials = []
    for trial in Muscle51(B_c=1200.0, B_r=1200.0, noise=(3e-6, 0.05, 250.0)).trials(repeats=2):
        trials.append(replace(trial, channels={**trial.channels, "force": np.floor(trial.channels["force"])}))
    F = value(reduce([as_run("sinusoidal-displacement", trials, {"discard": 1})]), "F", "sine-mean")
    assert 0.4 < 275.0 - 67.73 - F.value < 1.1 * F.parts.combined < 0.7, "half a step, as a square next to the scatter"
