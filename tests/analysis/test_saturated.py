"""Channels that saturate, on benches in closed form: what was beyond the ceiling is in no value.

Muscles that come to rest, are held, stick or flatten by themselves look alike and are none.
"""

from dataclasses import replace

import numpy as np
import pytest

from pmabench.analysis.shared.saturated import saturated
from pmabench.kinds import registry
from pmabench.kinds.reduce import reduce_runs, verdicts
from pmabench.store.records import Command, TrialData
from tests.analysis.judged_forms import as_run

RATE = 100.0
CALIBRATED = {"force": 1.0, "pressure": 1e3, "displacement": 5e-5, "angle": 4e-3, "torque": 0.02}
NOISE = {"force": 0.3, "pressure": 300.0, "displacement": 1e-5, "angle": 5e-4, "torque": 0.01}
SENT = ("pressure_command", "displacement_command")


def lagged(y, seconds):
    """The answer of a first-order lag to samples that are held."""
    keep, found = np.exp(-1 / seconds / RATE), [y[0]]
    for value in y[1:]:
        found.append(value + (found[-1] - value) * keep)
    return np.array(found)


def run_of(kind, trials, cut=None, seed=0, settings=None, noise=1.0):
    """A run of trials: operating point, times, channels, commands, searches. `cut`: channel -> level that its
    amplifier does not pass, before noise is added.
    """
    rng, made, begin = np.random.default_rng(seed), [], 0.0
    for number, (point, t, channels, commands, found) in enumerate(trials):
        read = {name: np.minimum(y, (cut or {}).get(name, np.inf)) for name, y in channels.items()}
        read |= {name: y + noise * rng.normal(0, NOISE[name], len(t)) for name, y in read.items() if name in NOISE}
        commands = tuple(replace(one, t=begin + one.t) for one in commands)
        found = {what: {**law, "t0": begin + law["t0"], "t1": begin + law["t1"]} for what, law in found.items()}
        flags = np.zeros(len(t), dtype=np.uint16)
        made.append(TrialData("a", number, point, number, False, "finished", begin + t, read, flags, commands, found))
        begin += t[-1] + 10.0
    known = {name: {"offset_uncertainty": CALIBRATED[name]} for name in CALIBRATED if name in made[0].channels}
    return as_run(kind, made, RATE, settings or {}, known)


def held_lengths(late=0.0):
    """F = 0.65 N/kPa (1 - x/60 mm) P - 30 N at three lengths, filled and emptied at 50 kPa/s, twice."""
    t = np.arange(2800) / RATE
    P = np.interp(t, [3, 13, 15, 25], [0.0, 500e3, 500e3, 0.0])
    read = np.interp(t - late, [3, 13, 15, 25], [0.0, 500e3, 500e3, 0.0])
    commands = (
        Command(3.0, "pressure", "ramp", 500e3, 0.0, "fill", {"rate": 50e3}),
        Command(15.0, "pressure", "ramp", 0.0, 500e3, "empty", {"rate": 50e3}),
    )
    for x in (0.0, 0.005, 0.01) * 2:
        F = np.maximum(0.65e-3 * (1 - x / 0.06) * P - 30.0, 0.0)
        channels = {"pressure": read, "pressure_command": P, "force": F, "displacement": np.full(len(t), x)}
        yield {"contraction": x}, t, channels, commands, {}


def sines(lag=0.03):
    """300 +- 50 kPa; x = 0.3 mm/kPa times the pressure, a lag later."""
    for f in (0.25, 0.5, 1.0):
        t = np.arange(round(8 / f * RATE)) / RATE
        P = 300e3 + 50e3 * np.sin(2 * np.pi * f * t)
        w = 2 * np.pi * f
        x = 0.09 + 0.3e-6 * 50e3 * np.sin(w * t - np.arctan(w * lag)) / np.hypot(1, w * lag)
        yield {"frequency": f}, t, {"pressure": P, "displacement": x}, (), {}


def steps():
    """Steps of 100 kPa that a regulator reaches within 80 ms and a load that hangs 40 ms later."""
    for begin, end in ((200e3, 300e3), (300e3, 400e3), (400e3, 300e3), (300e3, 200e3)) * 2:
        t = np.arange(300) / RATE
        sent = np.where(t < 0.5, begin, end)
        P = lagged(sent, 0.08)
        x = lagged(lagged(0.3e-6 * (P - 50e3), 0.04), 0.01)
        yield {"from": begin, "pressure": end}, t, {"pressure": P, "pressure_command": sent, "displacement": x}, (), {}


def arm():
    """An arm that bends by the pressure on stairs, with more weight by less."""
    corners, levels = [0.0], [0.0]
    for level in (100e3, 200e3, 300e3, 400e3, 300e3, 200e3, 100e3):
        corners += [corners[-1] + 1.0, corners[-1] + 4.0]
        levels += [level, level]
    t = np.arange(round(corners[-1] * RATE)) / RATE
    P = np.interp(t, corners, levels)
    for load in (0.0, 0.15, 0.3):
        yield {"tip_mass": load}, t, {"pressure": P, "angle": (2.5e-6 - 2e-6 * load) * lagged(P, 0.15)}, (), {}


def joint():
    """A joint that is swept: its torque falls with the angle, with a gap of 1 N.m."""
    t = np.arange(4800) / RATE
    angle = 0.6 * np.abs((t / 6 + 1) % 4 - 2) - 0.6
    gap = 0.5 * np.sign(np.gradient(angle))
    for level in (200e3, 300e3):
        channels = {"torque": -8 * angle - gap, "angle": angle, "pressure_1": np.full(len(t), level)}
        yield {"pressure_1": level, "pressure_2": level}, t, channels, (), {}


STEP = 0.03


def overshoots(omega=6.0, damping=0.45):
    """A set-point of 30 mm, reached by a second-order answer."""
    t = np.arange(-2, 10, 1 / RATE)
    after, root = np.maximum(t, 0), np.sqrt(1 - damping**2)
    swing = np.cos(omega * root * after) + damping / root * np.sin(omega * root * after)
    x = np.where(t > 0, STEP * (1 - np.exp(-damping * omega * after) * swing), 0.0)
    law = {"t0": 2.0, "t1": 12.0, "ended": "time", "setpoint": STEP}
    for _ in range(3):
        yield {"setpoint": STEP, "load": 0.0}, t + 2, {"displacement": x}, (), {"position": law}


BENCHES = {
    "isometric-pressurisation": (held_lengths, "force", 200.0),
    "recorded-sine": (sines, "displacement", 0.098),
    "recorded-step": (steps, "displacement", 0.085),
    "arm-angle": (arm, "angle", 0.7),
    "joint-torque": (joint, "torque", 3.0),
    "positioning": (overshoots, "displacement", 0.0315),
}


def ceilings(run):
    return list(saturated(run, registry.kind_of(run.kind).loop))


@pytest.mark.parametrize("noise", [1.0, 0.0])
@pytest.mark.parametrize("kind", BENCHES)
def test_a_ceiling_is_found_with_noise_on_top_and_without(kind, noise):
    bench, channel, level = BENCHES[kind]
    (found,) = ceilings(run_of(kind, bench(), {channel: level}, noise=noise))
    assert found.channel == channel
    assert found.level == pytest.approx(level, rel=0.05)
    assert "saturation" in found.text
    assert not ceilings(run_of(kind, bench(), noise=noise))


def test_a_gauge_at_its_end_is_found_where_command_and_force_go_on():
    (found,) = ceilings(run_of("isometric-pressurisation", held_lengths(), {"pressure": 450e3}))
    assert (found.channel, found.level) == ("pressure", pytest.approx(450e3, rel=0.02))


def test_a_supply_that_gives_no_more_is_no_gauge_at_its_end():
    """The command goes on to 500 kPa, and the supply has 450 kPa: so does the muscle, and its force is right."""

    def limited():
        for point, t, channels, commands, found in held_lengths():
            P = np.minimum(channels["pressure"], 450e3)
            F = np.maximum(0.65e-3 * (1 - point["contraction"] / 0.06) * P - 30.0, 0.0)
            yield point, t, {**channels, "pressure": P, "force": F}, commands, found

    assert not ceilings(run_of("isometric-pressurisation", limited()))


def free(P, x):
    t = np.arange(len(P)) / RATE
    return run_of("free-contraction", [({}, t, {"pressure": P, "displacement": x}, (), {})] * 3)


def on_top(kind, lag, sent, cut=None, ramp=2.0):
    """A ramp to the highest pressure, or a stage to its full length, recorded to the rest there; the gauge has a lag."""
    t = np.arange(0, 1 + ramp + 5, 1 / RATE)
    part = np.interp(t, [1, 1 + ramp], [0.0, 1.0])
    read = lagged(part, lag) if lag else part
    trials = []
    for x in (0.0, 0.005, 0.01):
        if kind == "isometric-pressurisation":
            F, cause, size, rest = 500 * (1 - x / 0.06) * part, "pressure", 500e3, {"displacement": np.full(len(t), x)}
        else:
            size, cause, rest = 0.02, "displacement", {"pressure": np.full(len(t), 200e3 + 1e7 * x)}
            F = -(200 + 1e4 * x) * (1 - part) * (1 - part / 3)
        commands = {f"{cause}_command": size * part} if sent else {}
        trials.append(({"contraction": x}, t, {cause: size * read, **commands, "force": F, **rest}, (), {}))
    return run_of(kind, trials, cut)


@pytest.mark.parametrize("sent", [True, False])
@pytest.mark.parametrize("ramp", [1.0, 2.0, 4.0])
@pytest.mark.parametrize("lag", [0.05, 0.1, 0.2, 0.3])
@pytest.mark.parametrize("kind", ["isometric-pressurisation", "isobaric-ramp"])
def test_a_gauge_with_a_filter_is_no_ceiling_of_the_force(kind, lag, ramp, sent):
    """The gauge goes on after the end of the ramp, at which the force comes to rest."""
    assert not ceilings(on_top(kind, lag, sent, ramp=ramp))


def test_a_declared_filter_counts_where_it_looks_like_a_motion_that_goes_on():
    """Readings 0.1 s late go on without slowing down."""
    run = on_top("isometric-pressurisation", 0.0, False)
    late = [
        replace(one, channels={**one.channels, "pressure": np.interp(one.t - 0.1, one.t, one.channels["pressure"])})
        for one in run.trials
    ]
    known = {**run.channels, "pressure": replace(run.channels["pressure"], sensor_lag=0.1)}
    assert not ceilings(replace(run, trials=tuple(late), channels=known))


@pytest.mark.parametrize("sent", [True, False])
@pytest.mark.parametrize("lag", [0.0, 0.1])
def test_a_ceiling_is_found_where_the_record_ends_on_top(lag, sent):
    (found,) = ceilings(on_top("isometric-pressurisation", lag, sent, {"force": 300.0}))
    assert (found.channel, found.level) == ("force", pytest.approx(300.0, rel=0.05))


T = np.arange(3000) / RATE
TRIANGLE = np.interp(T % 10, [0, 5, 10], [0.0, 500e3, 0.0])


def stuck(P, band):
    """What follows P with a play of `band`: it rests where P turns."""
    found = [0.0]
    for value in P:
        found.append(min(max(found[-1], value - band / 2), value + band / 2))
    return np.array(found[1:])


@pytest.mark.parametrize(
    ("P", "x"),
    [
        (np.where(T < 1, 0.0, 400e3), 0.05 * (1 - np.exp(-np.maximum(T - 1, 0) / 0.3))),
        (TRIANGLE, 1e-7 * stuck(TRIANGLE, 60e3)),
        (TRIANGLE, 0.05 * (1 - np.exp(-TRIANGLE / 100e3))),
        (TRIANGLE, 0.05 * np.tanh(TRIANGLE / 200e3)),
        (np.clip(TRIANGLE, 0, 300e3), 1e-7 * np.clip(TRIANGLE, 0, 300e3)),
        (300e3 + 50e3 * np.sin(4 * T), 0.05 + 0.01 * np.sin(4 * T - 0.9)),
    ],
    ids=["a step that settles", "dry friction", "flattens", "flattens less", "ramp and hold", "sine"],
)  # fmt: skip
def test_what_rests_or_flattens_by_itself_has_no_ceiling(P, x):
    assert not ceilings(free(P, x))


def test_a_weight_that_is_lifted_is_no_ceiling_of_the_force():
    """It hangs from the cell at 60 N, and the pressure goes on."""
    P = np.interp(T % 15, [1, 6, 8, 13], [0.0, 400e3, 400e3, 0.0])
    F, x = np.minimum(0.6e-3 * P, 60.0), 1e-7 * np.maximum(P - 100e3, 0.0)
    channels = {"pressure": P, "force": F, "displacement": x}
    assert not ceilings(run_of("static-load", [({"load": 60.0}, T, channels, (), {})]))


def test_an_overshoot_that_friction_holds_has_none():
    """It comes to its highest place with less and less speed, rests there for 1 s, and slips back."""
    ((point, t, channels, _, law), *_) = overshoots()
    x = channels["displacement"]
    top = int(np.argmax(x))
    held = np.concatenate([x[:top], np.full(100, x[top]), x[top] - 0.5 * (t[: len(x)] ** 2)])[: len(x)]
    held = np.maximum(held, np.where(t > 4, STEP, 0.0))
    trials = [(point, t, {"displacement": held}, (), law)] * 3
    assert not ceilings(run_of("positioning", trials))


def test_a_stage_that_stops_has_none_nor_the_force_that_relaxes_there():
    t = np.arange(4000) / RATE
    x = np.interp(t % 10, [0, 4, 5, 9, 10], [0.0, 0.02, 0.02, 0.0, 0.0])
    F = 600 - 2e4 * lagged(x, 0.3) + 30 * np.exp(-(t % 5))
    channels = {"pressure": np.full(len(t), 300e3), "displacement": x, "displacement_command": x, "force": F}
    assert not ceilings(run_of("isobaric-ramp", [({"pressure": 300e3, "speed": 5e-3}, t, channels, (), {})]))


def test_a_force_that_is_recorded_two_seconds_early_has_none():
    assert not ceilings(run_of("isometric-pressurisation", held_lengths(late=2.0)))


def off(e, truth):
    return abs(e.value - truth) / e.parts.combined


def test_a_blocked_force_beyond_the_ceiling_is_withheld_and_those_below_are_as_before():
    """900 N of 1376 N: F_b was given 55 half widths too low."""
    kind, sound = "isometric-pressurisation", {}
    for e in reduce_runs([run_of(kind, held_lengths())])[0].estimates:
        sound[e.symbol, e.method, tuple(e.at.items())] = e
    cut = run_of(kind, held_lengths(), {"force": 200.0})
    (analysis,) = reduce_runs([cut])
    blocked = [e for e in analysis.estimates if e.symbol == "F_b"]
    beyond = [e for e in blocked if 0.65e-3 * e.at["pressure"] - 30.0 > 205.0]
    assert len(beyond) >= 2
    assert all(e.withheld and "saturation: the force does not pass 200" in e.note for e in beyond)
    below = [e for e in blocked if 0.65e-3 * e.at["pressure"] - 30.0 < 190.0 and e.value]
    assert below
    assert all(off(e, 0.65e-3 * e.at["pressure"] - 30.0) < 1.0 for e in below)
    assert any("saturation" in why for why in verdicts([cut], [analysis]))


def test_an_overshoot_beyond_the_ceiling_is_withheld_and_the_error_at_rest_is_not():
    settings = {"window": [7.0, 10.0], "band": 0.02}
    (analysis,) = reduce_runs([run_of("positioning", overshoots(), {"displacement": 0.0315}, settings=settings)])
    found = {e.symbol: e for e in analysis.estimates if "simulated" not in e.method}
    assert found["OS"].withheld
    assert "saturation: the displacement does not pass 31.4" in found["OS"].note
    assert not found["e_ss"].withheld


def test_a_sine_cut_off_above_gives_its_pressure_and_no_motion():
    """x was given 60 half widths too small, and only H withheld."""
    (analysis,) = reduce_runs([run_of("recorded-sine", sines(), {"displacement": 0.098})])
    for e in analysis.estimates:
        if e.symbol in ("x", "P/x"):
            assert e.withheld
        if e.symbol == "P":
            assert off(e, 50e3) < 1.0


def test_a_gap_within_the_ceiling_is_withheld_as_well():
    """Torques that are at the ceiling throughout have the gap of the amplifier's noise: 0 for 1 N.m."""
    bench = list(joint())
    for number, (point, t, channels, *more) in enumerate(bench):
        bench[number] = (point, t, {**channels, "torque": channels["torque"] + 20.0 * number}, *more)
    (found,) = ceilings(run := run_of("joint-torque", bench, {"torque": 3.0}))
    before, after = run.trials[1].channels["torque"], found.of(run.trials[1]).channels["torque"]
    assert np.ptp(after - before) > 0.1
