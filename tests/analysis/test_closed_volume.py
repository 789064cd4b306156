"""Closed volumes against the simulated muscle's own volume, and against P V constant by hand."""

from dataclasses import replace
from math import pi, radians, sin, tan

import numpy as np
import pytest

from pmabench.analysis.trial import Quick
from pmabench.base.errors import InvalidFile
from pmabench.bench.compile import mount
from pmabench.display.verdicts import measure
from pmabench.engine.operator import ConfirmedBeforehand
from pmabench.engine.run import run_plan
from pmabench.kinds.closed_volume.protocol import Diameters
from pmabench.kinds.closed_volume.reduction import PRINTED, TIGHT, reduce
from pmabench.kinds.closed_volume.stroke import Gas, fit_volume, volume_at
from pmabench.kinds.compile import make_plan
from pmabench.model.library import MODELS
from pmabench.protocol.plan import Seek
from pmabench.store.reader import open_run
from tests.analysis.driven_runs import ROOT, planned, recorded

SHORT = (
    ("prepare.precondition.cycles", "0"), ("sweep.repeat.count", "1"), ("trial.speed", "6 mm/s"), ("trial.rest", "1 s"),
    ("trial.every", "6 mm"),
)  # fmt: skip
ROOM = 101325.0


def true_volume(x):
    eps = x / 0.2
    return pi / 4 * 0.02**2 * 0.2 * (1 / sin(radians(25)) ** 2 - (1 - eps) ** 2.6 / tan(radians(25)) ** 2) * (1 - eps)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Plant 5.5 at 3 and 5 bar, isothermal, with a leak of 2e-5 of the pressure a second, and noise."""
    return recorded(tmp_path_factory.mktemp("closed"), "closed-volume", "mock-daerden-closed", "daerden-20-200", *SHORT)


def volumes(found, method=TIGHT):
    return [e for e in found.estimates if e.symbol == "V" and e.method == method]


def test_the_volume_is_that_of_the_muscle_from_both_pressures(run):
    found = reduce([run])
    reported = volumes(found)
    assert {e.at["pressure"] for e in reported} == {3e5, 5e5}
    for e in reported:
        assert e.value == pytest.approx(true_volume(e.at["contraction"]), rel=1.5e-3)
        assert e.ci95[0] <= true_volume(e.at["contraction"]) <= e.ci95[1]
    assert any("within their intervals" in f.text for f in found.findings)
    D_0, theta_0, alpha = (next(e for e in found.estimates if e.symbol == s) for s in ("D_0", "theta_0", "alpha"))
    assert D_0.value == pytest.approx(0.02, rel=2e-3)
    assert theta_0.value == pytest.approx(radians(25), rel=1e-2)
    assert alpha.value == pytest.approx(2.6, rel=2e-2)
    for e, truth in ((D_0, 0.02), (theta_0, radians(25)), (alpha, 2.6)):
        assert e.ci95[0] <= truth <= e.ci95[1]


def bench_with(**options):
    """The shipped bench with other options of its plant."""
    mounted = mount(
        ROOT / "fixtures" / "benches" / "mock-daerden-closed.yaml",
        ROOT / "fixtures" / "specimens" / "daerden-20-200.yaml",
    )
    devices = tuple(replace(d, options={**d.options, **options}) for d in mounted.bench.devices)
    return replace(mounted, bench=replace(mounted.bench, devices=devices))


def held(folder, mounted):
    plan = make_plan(ROOT / "protocols" / "closed-volume.yaml", mounted, SHORT)[0]
    outcome = run_plan(plan, mounted, ConfirmedBeforehand(), out=folder / "runs")
    return outcome, open_run(outcome.folder)


def test_what_leaks_is_taken_out_and_left_in_as_printed(tmp_path):
    """0.1 % of the pressure a second: as printed the volume comes out too large, by what was lost on the way."""
    _, run = held(tmp_path, bench_with(leak=1e-3))
    found = reduce([run])
    truth = np.array([true_volume(e.at["contraction"]) for e in volumes(found)])
    tight, printed = (np.array([e.value for e in volumes(found, m)]) for m in (TIGHT, PRINTED))
    np.testing.assert_allclose(tight, truth, rtol=2e-3)
    assert (printed / truth > 1.004).all()
    assert not any(f.level == "doubt" and "leak" not in f.text for f in found.findings)


def test_gauge_pressure_would_be_wrong_by_far_and_is_never_taken(run):
    """P V with gauge pressures (a room of 0) makes 268 cm3 of 147 cm3 at 36 mm; by hand, from 3 bar."""
    end = [e for e in volumes(reduce([run])) if e.at["contraction"] == pytest.approx(0.036)]
    assert len(end) == 2
    gas = Gas(pi / 4 * 0.02**2 * 0.2, 0.0, 0.0, 1.0)
    from pmabench.kinds.closed_volume.stroke import measure as stroke_of

    (trial, *_) = run.trials
    wrong = stroke_of(run, trial, run.plan["settings"]).volumes(gas, leak=False)[0, -1]
    ratio = true_volume(0.0) / true_volume(0.036)
    assert wrong == pytest.approx(true_volume(0.0) * 3e5 / ((3e5 + ROOM) * ratio - ROOM), rel=0.02)
    assert wrong > 1.8 * end[0].value


def test_another_room_another_volume_and_the_pressures_disagree(run):
    found = reduce([run], {"atmosphere": 70e3, "atmosphere_half": 0.1e3})
    assert any(f.level == "doubt" and "differ" in f.text and "room" in f.text for f in found.findings)


def test_a_valve_that_stays_open_gives_no_volume(run):
    (trial, *_) = run.trials
    flat = {**trial.channels, "pressure": np.full(len(trial.t), 3e5) + np.linspace(0, -90, len(trial.t))}
    held = replace(trial, channels=flat)
    sunk = replace(trial, channels={**trial.channels, "pressure": trial.channels["pressure"] - 4e5})
    lost = replace(trial, found={"closed": {"found": False}})
    none = replace(trial, channels={"displacement": trial.channels["displacement"]})
    found = reduce([replace(run, trials=(held, sunk, lost, none, replace(trial, status="failed")))])
    assert [d.reason.split(":")[0] for d in found.dropped] == [
        "over the stroke the absolute pressure falls by 0.01% only",
        "an absolute pressure is not above zero",
        "the strokes with the valve shut were not finished",
        "pressure not recorded",
        "the trial is failed",
    ]
    assert not found.estimates


def test_the_line_after_a_trial(run):
    (trial, *_) = run.trials
    numbers, doubts = measure(run, trial, None, Quick())
    assert doubts == []
    assert numbers[0].value == pytest.approx(true_volume(0.036), rel=2e-3)


def test_the_curve_in_closed_form():
    eps = np.linspace(-0.03, 0.2, 12)
    V = volume_at(eps, 0.3, 0.03, radians(23), 2.2)
    assert fit_volume(eps, V, 0.3) == pytest.approx((0.03, radians(23), 2.2), rel=1e-6)
    assert volume_at(np.zeros(1), 0.3, 0.03, radians(23), 2.2)[0] == pytest.approx(pi / 4 * 0.03**2 * 0.3)
    assert fit_volume(eps[:3], V[:3], 0.3) is None
    assert fit_volume(eps, V[::-1], 0.3) is None


def test_three_diameters_as_the_library_has_them():
    """Row 38: sum of (pi/4)(d - 2 t)^2 h."""
    reported = Diameters(
        diameters=("24 mm", "26 mm", "23 mm"), heights=("50 mm", "90 mm", "40 mm"), thickness="1.5 mm",
        uncertainty="0.1 mm",
    )  # fmt: skip
    by_hand = pi / 4 * (21**2 * 50 + 23**2 * 90 + 20**2 * 40) * 1e-9
    assert reported.volume() == pytest.approx(by_hand, rel=1e-12)
    assert reported.half() == pytest.approx(pi / 2 * (21 * 50 + 23 * 90 + 20 * 40) * 0.1 * 1e-9, rel=1e-12)
    names = {f"diameter_{i}": d for i, d in ((1, 0.024), (2, 0.026), (3, 0.023))} | {"thickness": 0.0015}
    names |= {f"height_{i}": h for i, h in ((1, 0.05), (2, 0.09), (3, 0.04))}
    assert MODELS["three-cylinder-volume"].evaluate(names)["volume"] == pytest.approx(by_hand, rel=1e-12)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (("trial.room", "{pressure: 0 kPa, uncertainty: 1 kPa}"), "never with gauge pressure"),
        (("trial.to", "0 mm"), "never be pushed together"),
        (("trial.to", "50 mm"), "above the limit for commanded displacement"),
        (("sweep.matrix.pressure", "[0 bar]"), "must be above zero"),
        (("sweep.matrix.pressure", "[1 bar]"), "below that of the room"),
        (("trial.rest", "0 s"), "must be above zero"),
        (("trial.speed", "2 m/s"), "the actuator at most at"),
        (("trial.reference", "{volume: 60 cm3}"), "uncertainty"),
        (("trial.reference", "{volume: 0 cm3, uncertainty: 0 cm3}"), "a volume above zero"),
        (("trial.dead.volume", "-1 cm3"), "not below zero"),
        (("trial.every", "1 um"), "two to a thousand"),
    ],
)
def test_what_a_closed_volume_cannot_be(change, says):
    with pytest.raises(InvalidFile, match=says):
        planned("closed-volume", "mock-daerden-closed", "daerden-20-200", change)


def test_a_bench_without_the_valve_is_refused():
    with pytest.raises(InvalidFile, match="isolation valve that is switched"):
        planned("closed-volume", "mock-daerden", "daerden-20-200")


def test_a_limit_while_the_air_is_shut_in_still_lets_it_out(tmp_path):
    """The valve shuts in the safe state too: the dump valve at the muscle takes the pressure off."""
    outcome, found = held(tmp_path, bench_with(errors={"displacement": {"offset": 0.04, "at": 18}}))
    assert outcome.exit_code != 0
    assert "contraction" in outcome.why or "displacement" in outcome.why
    last = found.trials[-1]
    shut = [c for c in last.commands if c.phase == "closed"]
    assert shut
    assert not last.found, "it was under way with the valve shut"
    (vent,) = (e for e in found.events if e.kind == "vent")
    assert vent.data["result"] == "confirmed"
    assert "close isolation_valve: sent" in vent.data["actions"]


def test_strokes_that_take_too_long_end_the_run_and_let_the_air_out(tmp_path):
    """Nothing goes on from a place where the plan does not believe the end to be, with air shut in."""
    mounted = bench_with()
    plan = make_plan(ROOT / "protocols" / "closed-volume.yaml", mounted, SHORT)[0]
    steps = tuple(replace(s, limit=12.0) if isinstance(s, Seek) else s for s in plan.steps)
    outcome = run_plan(replace(plan, steps=steps), mounted, ConfirmedBeforehand(), out=tmp_path)
    assert outcome.exit_code == 5
    assert "isolation_valve shut took longer than 12 s" in outcome.why
    (vent,) = (e for e in open_run(outcome.folder).events if e.kind == "vent")
    assert vent.data["result"] == "confirmed"


def moved(run, off, scale=0.0):
    """The run with a gauge that reads so much more [m], and by another scale."""
    trials = (
        replace(one, channels={**one.channels, "displacement": off + (1 + scale) * one.channels["displacement"]})
        for one in run.trials
    )
    return replace(run, trials=tuple(trials))


@pytest.mark.parametrize(("off", "scale"), [(2e-4, 0.0), (-2e-4, 0.0), (0.0, 0.02)])
def test_a_gauge_that_is_off_the_drive_is_in_the_intervals(run, off, scale):
    """0.2 mm are 1 % of the volume at the start, which is given: it came out changed with +- 0.5 %."""
    found = reduce([moved(run, off, scale)])
    for e in (e for e in volumes(found) if not e.withheld):
        assert e.ci95[0] <= true_volume(e.at["contraction"]) <= e.ci95[1]
    assert not [e for e in volumes(found) if e.withheld]
    D_0 = next(e for e in found.estimates if e.symbol == "D_0")
    assert D_0.ci95[0] <= 0.02 <= D_0.ci95[1]


@pytest.mark.parametrize(("off", "scale"), [(2e-4, 0.0), (0.0, 0.01)])
def test_what_the_calibration_of_the_gauge_leaves_open_is_in_the_budget(run, off, scale):
    """Truly a reading is x + offset + gain x: the volume is off by that times dV/dx of the muscle's closed form."""
    gauge = replace(run.channels["displacement"], offset_uncertainty=off, gain_uncertainty=scale)
    only = replace(run, channels={**run.channels, "displacement": gauge, "pressure": unknown(run.channels["pressure"])})
    for e in volumes(reduce([only])):
        x = e.at["contraction"]
        slope = (true_volume(x + 1e-6) - true_volume(x - 1e-6)) / 2e-6
        assert e.parts.calibration == pytest.approx(slope * (off + scale * x), rel=0.05, abs=1e-12)


def unknown(channel):
    return replace(channel, offset_uncertainty=0.0, gain_uncertainty=0.0)


def test_a_gauge_that_is_half_a_millimetre_off_gives_no_volume(run):
    found = reduce([moved(run, 5e-4)])
    assert all(e.withheld for e in found.estimates)
    assert "not where the drive was sent" in volumes(found)[0].note


def test_a_pressure_that_comes_back_higher_may_be_heat_or_the_gauge(run):
    rising = (
        replace(one, channels={**one.channels, "pressure": one.channels["pressure"] + 200.0 * (one.t - one.t[0])})
        for one in run.trials
    )
    found = reduce([replace(run, trials=tuple(rising))])
    (said, *_) = [f.text for f in found.findings if "comes back" in f.text]
    assert "the air or the room warms, or the gauge drifts" in said
