"""What every reduction owes: a reason for each part that is missing, and a calibration part that is worth its name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from pmabench.analysis.shared.calibration import Scales
from pmabench.analysis.shared.student import mean_over
from pmabench.base.kind import Result
from pmabench.kinds.contraction_relaxation import reduction as contraction
from pmabench.kinds.isometric import reduction as isometric
from pmabench.kinds.recorded_sine import reduction as recorded_sines
from pmabench.kinds.recorded_step import reduction as recorded_steps
from pmabench.kinds.reduce import compared
from pmabench.kinds.sinusoidal_displacement import reduction as sine
from pmabench.kinds.static_load import reduction as static_load
from pmabench.kinds.ultimate_gain import reduction as ultimate_gain
from pmabench.store.analyses.results import Analysis, Estimate, Parts, Source
from pmabench.store.reader import open_run
from pmabench.store.records import RunData, TrialData
from tests.analysis.loop_rig import as_run
from tests.analysis.simulate import LOADS, PRESSURES, contraction_run, rig, static_run
from tests.analysis.sine_rig import Muscle51
from tests.analysis.test_static_load import found_at
from tests.analysis.test_ultimate_gain import clean
from tests.importing import import_files

OLD = Path(__file__).resolve().parents[2] / "fixtures" / "old-runs"
BENCH = Muscle51(F_s=10.0, F_c=6.0, noise=(2e-6, 0.3, 500.0), lag=0.005)
PARTS = ("repeats", "method", "calibration")
GAIN = 0.01
CELLS = [(load, P) for load in LOADS[:6:2] for P in PRESSURES]


@cache
def contracting(repeats: int = 1, uncertain: bool = False) -> RunData:
    return contraction_run(rig(uncertainty=uncertain), CELLS, repeats)


def sines(*frequencies: float, repeats: int = 1, pressures: tuple[float, ...] = (3e5,)) -> RunData:
    trials = []
    for P in pressures:
        # K, B and F_c of plant 5.1 depend on the pressure
        p = P / 1e3
        muscle = replace(
            BENCH, K=5600 + p + 9.7e-3 * p**2, B_c=1200 + 1.6 * p, B_r=1100 + 3.4 * p, F_ce=275 + 1.01 * (3e2 - p)
        )
        for f in frequencies * repeats:
            trials.append(muscle.trial(len(trials), f, max(4, round(10 * f) + 1), pressure=P))
    return as_run("sinusoidal-displacement", trials, {"discard": 1})


def static(*loads: float, repeats: int = 1) -> RunData:
    off = np.random.default_rng(3).normal(0, 0.2, (len(loads), repeats, 2))
    trials = [
        found_at(F, 1e3 * (F + 10 + off[i, k, 0]), 1e3 * (F - 10 + off[i, k, 1]), k + 10 * i)
        for i, F in enumerate(loads)
        for k in range(repeats)
    ]
    return replace(static_run(rig(), LOADS[:1], 1), trials=tuple(trials))


def old(pattern: str, map_name: str, folder: Path) -> list[RunData]:
    return [open_run(run.path) for run in import_files(sorted(OLD.glob(pattern)), OLD / map_name, folder)]


def unexplained(analysis: Analysis) -> list[str]:
    """Estimates that lack a value or a part of which neither their note nor a finding tells why."""
    said = "\n".join(f.text for f in analysis.findings)
    estimates = [*analysis.estimates, *(term for curve in analysis.curves for term in curve.terms)]
    bare = [f"{e.symbol} {dict(e.at)}: no value" for e in estimates if e.value is None and not e.note]
    for e in (e for e in estimates if e.value is not None):
        for name in PARTS:
            reported = f"no {name} part" in e.note or f"no {name} part" in said
            if getattr(e.parts, name) is None and not reported:
                bare.append(f"{e.symbol} {e.coordinate} {e.method} {dict(e.at)}: {name}")
    return bare


CASES: dict[str, Callable[[Path], Analysis]] = {
    "contraction": lambda _: contraction.reduce([contracting()]),
    "contraction, repeats": lambda _: contraction.reduce([contracting(2, uncertain=True)]),
    "contraction, two loads": lambda _: contraction.reduce([contraction_run(rig(), CELLS[:16])]),
    "contraction, one cell": lambda _: contraction.reduce([contraction_run(rig(), CELLS[3:4])]),
    "static, two loads": lambda _: static_load.reduce([static(100.0, 200.0)]),
    "static, three loads": lambda _: static_load.reduce([static(100.0, 200.0, 300.0)]),
    "static, repeats": lambda _: static_load.reduce([static(100.0, 200.0, repeats=2)]),
    "one sine": lambda _: sine.reduce([sines(1.0)]),
    "two sines": lambda _: sine.reduce([sines(0.5, 3.0)]),
    "sines": lambda _: sine.reduce([sines(0.5, 1.0, 3.0, repeats=2)]),
    "ultimate gain": lambda _: ultimate_gain.reduce([as_run("ultimate-gain", [clean()[0]])]),
    "isometric": lambda folder: isometric.reduce(old("isometric/*.csv", "isometric.yaml", folder)),
    "one isometric": lambda folder: isometric.reduce(old("isometric/*.csv", "isometric.yaml", folder)[:1]),
    "steps": lambda folder: recorded_steps.reduce(old("polled/*step_exp/*_data.dat", "step.yaml", folder)),
    "one step": lambda folder: recorded_steps.reduce(old("polled/*step_exp/*_data.dat", "step.yaml", folder)[:1]),
    "recorded sines": lambda folder: recorded_sines.reduce(old("polled/*frq*/*_data.dat", "sine.yaml", folder)),
}


@pytest.mark.parametrize("name", list(CASES))
def test_every_missing_part_has_its_reason_and_no_interval_goes_below_0_or_is_of_no_width(name: str, tmp_path: Path):
    analysis = CASES[name](tmp_path)
    assert any(e.value is not None for e in analysis.estimates) or name == "contraction, one cell"
    assert unexplained(analysis) == []
    for e in analysis.estimates:
        ci = e.ci95
        if ci is None:
            continue
        assert ci[0] < ci[1], e
        assert not e.positive or ci[0] >= 0 or e.value < 0, e
        assert e.parts.repeats is not None, e


# -- the calibration part against an instrument that really reads wrong ----------------------------------------------


def reads(run: RunData, channel: str, gain: float = 0.0, offset: float = 0.0) -> RunData:
    """The run had `channel` read (1 + gain) times as much, plus `offset` [SI]; searches found it so, too."""

    def wrong(trial: TrialData) -> TrialData:
        channels = {name: v * (1 + gain) + offset if name == channel else v for name, v in trial.channels.items()}
        found = {
            phase: {**f, channel: f[channel] * (1 + gain) + offset} if channel in f else f
            for phase, f in trial.found.items()
        }
        return replace(trial, channels=channels, found=found)

    return replace(run, trials=tuple(wrong(trial) for trial in run.trials))


def reported(run: RunData, channel: str, gain: float = 0.0, offset: float = 0.0) -> RunData:
    """The run whose record tells this uncertainty of `channel`, and none of any other."""
    channels = {
        name: replace(
            info,
            gain_uncertainty=gain if name == channel else 0.0,
            offset_uncertainty=offset if name == channel else 0.0,
        )
        for name, info in run.channels.items()
    }
    return replace(run, channels=channels)


def refuse_unexplained_moves(
    reduce: Callable[[list[RunData]], Analysis], run: RunData, channel: str, gain: float, offset: float
) -> int:
    """No value moves beyond its interval when a channel reads wrong by its uncertainty; how many were compared."""
    base = reported(run, channel, gain, offset)
    right = values(reduce([base]))
    high, low = (values(reduce([reads(base, channel, way * gain, way * offset)])) for way in (1, -1))
    known = right.keys() & high.keys() & low.keys()
    for key in known:
        moved = 0.5 * abs((high[key].value or 0.0) - (low[key].value or 0.0))
        assert moved <= 1.05 * (right[key].parts.combined or 0.0) + 1e-4 * abs(right[key].value or 0.0), key
    return len(known)


def values(analysis: Analysis) -> dict[tuple[object, ...], Estimate]:
    found = {
        (e.symbol, e.method, e.coordinate, *((k, round(v, 6)) for k, v in e.at.items())): e
        for e in analysis.estimates
        if e.value is not None
    }
    return found | {
        (c.symbol, c.method, c.form, term.coordinate): term for c in analysis.curves for term in c.terms if term.value
    }


def compare(
    reduce: Callable[[list[RunData]], Analysis], run: RunData, channel: str, gain: float, offset: float,
    symbols: set[str], within: float,
) -> int:  # fmt: skip
    """Values move by their calibration part when the channel reads wrong by its uncertainty; how many were compared.

    Both ways, and the mean of both: where a coefficient bends, they differ.
    """
    right = values(reduce([reported(run, channel, gain, offset)]))
    high, low = (
        values(reduce([reported(reads(run, channel, way * gain, way * offset), channel, gain, offset)]))
        for way in (1, -1)
    )
    count = 0
    for key, e in right.items():
        if e.symbol not in symbols or key not in high or key not in low:
            continue
        moved = abs(high[key].value - low[key].value) / 2
        part = e.parts.calibration or 0.0
        assert moved == pytest.approx(part, rel=within, abs=within * 1e-2 * abs(e.value)), (key, moved, part)
        count += 1
    return count


@pytest.mark.parametrize(
    ("channel", "gain", "offset"),
    [
        ("force", GAIN, 0.0),
        ("force", 0.0, 1.0),
        ("displacement", GAIN, 0.0),
        ("displacement", 0.0, 20e-6),
        ("pressure", GAIN, 0.0),
        ("pressure", 0.0, 1500.0),
    ],
)
def test_contraction(channel: str, gain: float, offset: float):
    def primary(runs: list[RunData]) -> Analysis:
        found = contraction.reduce(runs, {"replays": 0})
        return replace(found, estimates=tuple(e for e in found.estimates if e.method == "measured-pressure"), curves=())

    count = compare(primary, contracting(), channel, gain, offset, {"F_ce", "K", "B_c", "B_r", "F_c"}, 0.05)
    assert count > 25


def test_the_papers_way():
    def next_to(runs: list[RunData]) -> Analysis:
        found = contraction.reduce(runs, {"replays": 0})
        return replace(found, estimates=tuple(e for e in found.estimates if e.method == "step-exponential"), curves=())

    # the velocity gate of the segments has a little to say here, too: which trials count as moved
    assert compare(next_to, contracting(), "displacement", GAIN, 0.0, {"F_ce", "K", "B_c", "B_r"}, 0.06) > 20


@pytest.mark.parametrize(("gain", "offset"), [(GAIN, 0.0), (0.0, 1500.0)])
def test_static_load(gain: float, offset: float):
    run = static_run(rig(), LOADS[::2], repeats=3)
    assert compare(static_load.reduce, run, "pressure", gain, offset, {"F_ce", "F_f"}, 0.03) > 20


@pytest.mark.parametrize("channel", ["force", "displacement", "pressure"])
def test_sines(channel: str):
    if channel != "pressure":
        run = sines(0.5, 1.0, 3.0, pressures=(2e5, 4e5))
        assert compare(sine.reduce, run, channel, GAIN, 0.0, {"K", "B", "F_c", "H", "W", "phi"}, 0.03) > 25
        return
    run = sines(0.5, 1.0, 3.0, pressures=(2e5, 3e5, 4e5))
    # a run at 300 kPa as read was at 303 kPa when the gauge reads 1 % too little: K is off by the slope of K there
    found = values(sine.reduce([reported(run, "pressure", GAIN)]))
    there = values(sine.reduce([sines(0.5, 1.0, 3.0, pressures=(2.02e5, 3.03e5, 4.04e5))]))
    for symbol, slope in (("K", 1e-3 + 2 * 9.7e-9 * 3e5), ("B", 2.5e-3)):
        (e,) = [e for e in found.values() if e.symbol == symbol and e.method == "sine-harmonic"
                and e.at["pressure"] == 3e5 and "frequency" not in e.at]  # fmt: skip
        assert e.parts.calibration == pytest.approx(slope * GAIN * 3e5, rel=0.03)
        (off,) = [e for e in there.values() if e.symbol == symbol and e.method == "sine-harmonic"
                  and e.at["pressure"] == 3.03e5 and "frequency" not in e.at]  # fmt: skip
        assert off.value - e.value == pytest.approx(e.parts.calibration, rel=0.1)


@pytest.mark.parametrize("channel", ["displacement", "pressure"])
def test_ultimate_gain(channel: str):
    run = as_run("ultimate-gain", [clean()[0]])
    (K_u, T_u) = ultimate_gain.reduce([reported(run, channel, GAIN)]).estimates
    # K_u = command per displacement at the edge of stability; time has no scale
    assert K_u.parts.calibration == pytest.approx(GAIN * K_u.value)
    assert T_u.parts.calibration == 0.0


@pytest.mark.parametrize(
    ("channel", "gain", "offset"),
    [("force", GAIN, 0.0), ("pressure", GAIN, 0.0), ("pressure", 0.0, 3e3), ("force", 0.0, 2.0)],
)
def test_isometric(channel: str, gain: float, offset: float, tmp_path: Path):
    runs = old("isometric/*.csv", "isometric.yaml", tmp_path)

    def line(given: list[RunData]) -> Analysis:
        # no threshold on the force: it would let other samples in when the force reads wrong
        return isometric.reduce(given, {"force_above": -1e3, "also_at": []})

    symbols = {"m", "c"} if gain else {"c"}
    assert compare(line, runs[0], channel, gain, offset, symbols, 0.03) > 0


# -- small sets --------------------------------------------------------------------------------------------------------


def test_unlike_conditions_are_no_repeats():
    mean, half, ends = mean_over([0.05, 0.10, 0.30], [1, 2, 3])
    assert (mean, half, ends) == (pytest.approx(0.15), None, (0.05, 0.30))
    # two conditions far apart, each repeated with a difference of 2: s = sqrt(2), se = s sqrt(1/2 + 1/2) / 2, t(2) = 4.303
    mean, half, _ = mean_over([9.0, 11.0, 99.0, 101.0], [1, 1, 2, 2])
    assert mean == 55.0
    assert half == pytest.approx(4.3027 * np.sqrt(2) / 2, rel=1e-4)


def test_dead_times_of_motion_do_not_take_loads_for_repeats():
    once = contraction.reduce([contracting()], {"replays": 0})
    times = [e for e in once.estimates if e.symbol == "t_d" and e.coordinate == "command-to-motion" and e.at]
    several = [e for e in times if e.n > 1]
    assert several
    for e in several:
        assert e.ci95 is None
        assert "each load and pressure was tested once" in e.note
        assert "mean over the loads, from" in e.note
    twice = contraction.reduce([contracting(2)], {"replays": 0})
    times = [e for e in twice.estimates if e.symbol == "t_d" and e.coordinate == "command-to-motion" and e.at]
    # the same motion twice, with other noise: known to a few samples at 500 Hz although loads differ by far more
    several = [e for e in times if e.n > 2]
    assert several
    for e in several:
        assert e.parts.repeats < 0.02
        assert e.parts.method > 0.02
        assert e.ci95[0] >= 0


def test_one_sine_is_not_known_better_than_its_cycles_scatter():
    exact = sine.reduce([sines(1.0)])
    (K,) = [e for e in exact.estimates if e.symbol == "K" and "frequency" not in e.at]
    cycles = [k for trial in sines(1.0).trials for k in _stiffness_by_cycle(trial)]
    assert K.parts.repeats == pytest.approx(2.262 * np.std(cycles, ddof=1) / np.sqrt(len(cycles)), rel=0.5)
    assert "one trial" in K.note


def _stiffness_by_cycle(trial: TrialData) -> list[float]:
    """-Re(F/x) of each whole cycle but the first, by numpy's Fourier transform (1 Hz at 500 Hz: 500 samples)."""
    x, F = trial.channels["displacement"], trial.channels["force"]
    rows = [slice(first, first + 500) for first in range(500, len(x) - 499, 500)]
    return [-float((np.fft.rfft(F[row])[1] / np.fft.rfft(x[row])[1]).real) for row in rows]


def test_an_interval_ends_at_0_only_for_what_cannot_be_below():
    time = Estimate("t_d", 0.02, "s", "time", "onset", parts=Parts(0.05), coordinate="command-to-motion")
    slope = Estimate("K", 1.0, "N/m/Pa", "stiffness per pressure", "m", parts=Parts(3.0), coordinate="slope")
    width = Estimate("H", 1.0, "N", "force", "m", parts=Parts(3.0))
    declared = (
        Result("t_d", "dead time", "time", positive=True),
        Result("K", "stiffness", "stiffness", positive=True),
        Result("H", "loop width", "force"),
    )
    time, slope, width = Analysis("new-kind", (), False, (time, slope, width), results=declared).estimates
    assert time.ci95 == (0.0, 0.07)
    assert replace(time, value=-0.01).ci95 == (pytest.approx(-0.06), pytest.approx(0.04)), "it holds its value"
    assert slope.ci95 == (-2.0, 4.0)
    assert width.ci95 == (-2.0, 4.0)


def test_scales_show_what_they_do_not_know():
    run = contracting()
    half = reported(run, "force", GAIN)
    scales = Scales.of([half])
    assert scales.part({"force": 100.0, "displacement": 100.0}) == pytest.approx(1.0)
    assert scales.lack(("force", "displacement")) == (
        "incomplete calibration part: the record gives no gain uncertainty of displacement"
    )
    assert Scales.of([half, run]).part({"force": 1.0}) is None
    assert Scales.of([half]).part({}) == 0.0


def test_values_without_an_interval_are_not_called_alike():
    K = Estimate("K", 6773.0, "N/m", "stiffness", "sine-harmonic", {"pressure": 3e5}, Parts(None, 1.0, 1.0))
    steps = replace(K, method="measured-pressure", parts=Parts(10.0, 1.0, 1.0))
    one = Analysis("sinusoidal-displacement", ("a",), True, (K,))
    two = Analysis("contraction-relaxation", ("b",), True, (steps,))
    found = compared([one, two])
    assert found.estimates == ()
    assert "not compared" in found.findings[0].text


def test_a_stiffness_whose_interval_reaches_to_0_is_withheld_and_a_friction_or_a_time_is_not():
    declared = (
        Result("K", "stiffness", "stiffness", positive=True), Result("F_c", "Coulomb friction", "force", positive=True),
        Result("t_d", "dead time", "time", positive=True), Result("x", "way", "length"),
    )  # fmt: skip
    values = (
        ("K", 2e4, "N/m", "stiffness"),
        ("F_c", 5.0, "N", "force"),
        ("t_d", 0.02, "s", "time"),
        ("x", 0.1, "m", "length"),
    )
    wide = [
        Estimate(
            *one, "any", parts=Parts(0.3 * one[1], 1.2 * one[1]),
            budget=(Source("bend", "method", "B", 1.2 * one[1]), Source("scatter", "repeats", "A", 0.3 * one[1])),
        ) for one in values
    ]  # fmt: skip
    near = replace(wide[0], parts=Parts(0.3 * 2e4, 0.9 * 2e4))
    K, *others = Analysis("any", (), simulated=False, estimates=tuple(wide), results=declared).estimates
    assert K.withheld
    assert "20 N/mm +- 24.7 N/mm" in K.note
    assert "Most of it is from: bend" in K.note
    assert [e.value for e in others] == [5.0, 0.02, 0.1]
    assert Analysis("any", (), simulated=False, estimates=(near,), results=declared).estimates[0].value == 2e4
