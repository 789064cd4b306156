"""Steps of displacement against the simulated muscles' own coefficients, and against the chamber's closed form."""

from dataclasses import replace
from math import pi, radians, sin, tan

import numpy as np
import pytest

from pmabench.base.errors import InvalidFile
from pmabench.kinds.step_displacement.reduction import reduce
from pmabench.kinds.step_displacement.step import recovery
from pmabench.store.records import Flag
from tests.analysis.driven_runs import planned, recorded
from tests.analysis.test_honesty import unexplained

SHORT = (("trial.cycles", "3"), ("trial.hold", "0.6 s"), ("prepare.precondition.cycles", "0"))


def one(analysis, symbol, method, coordinate="", **at):
    found = [
        e
        for e in analysis.estimates
        if (e.symbol, e.method, e.coordinate) == (symbol, method, coordinate)
        and all(e.at[name] == pytest.approx(value) for name, value in at.items())
    ]
    assert len(found) == 1, (symbol, method, at)
    return found[0]


@pytest.fixture(scope="module")
def mas(tmp_path_factory):
    """Plant 5.1 without friction at 300 kPa: F_ce 275 N, K 6.773 N/mm, B_c 1.68, B_r 2.12 N.s/mm."""
    return recorded(
        tmp_path_factory.mktemp("mas"), "step-displacement", "mock-actuator-ideal", "mas-20-250-paper0", *SHORT,
        ("sweep.matrix.pressure", "[300 kPa]"), ("sweep.matrix.step", "[5 mm]"), ("sweep.matrix.speed", "[20 mm/s]"),
    )  # fmt: skip


@pytest.fixture(scope="module")
def paper3(tmp_path_factory):
    """Plant 5.5 behind its regulator."""
    return recorded(
        tmp_path_factory.mktemp("paper3"), "step-displacement", "mock-daerden", "daerden-20-200", *SHORT,
        ("sweep.matrix.pressure", "[400 kPa]"), ("sweep.matrix.step", "[10 mm]"), ("sweep.matrix.speed", "[400 mm/s]"),
    )  # fmt: skip


@pytest.mark.parametrize(("step", "B", "before"), [(5e-3, 1680.0, 10e-3), (-5e-3, 2120.0, 15e-3)])
def test_three_elements_give_K_at_rest_and_K_with_damping_at_the_peak(mas, step, B, before):
    found = reduce([mas])
    K, x = 6773.0, before
    assert one(found, "K", "step, relaxed", step=step).value == pytest.approx(K, rel=1e-3)
    # the peak comes where it moves and is furthest: K x + B v at the end of the ramp
    assert one(found, "K", "step, peak", step=step).value == pytest.approx(K + B * 0.02 / 5e-3, rel=0.01)
    assert one(found, "F", "step, relaxed", "before", step=step).value == pytest.approx(275 - K * x, abs=0.1)
    assert one(found, "F", "step, relaxed", "relaxed", step=step).value == pytest.approx(275 - K * (x + step), abs=0.1)
    assert one(found, "tau_F", "step, recovery", step=step).value is None, "without a tail there is no time constant"


@pytest.mark.parametrize(("step", "x", "conductance"), [(10e-3, 20e-3, 1e-7), (-10e-3, 10e-3, 0.5e-7)])
def test_the_pressure_comes_back_as_the_chamber_does(paper3, step, x, conductance):
    """tau = V/(k r T C), k = 1.2: air comes in after a contraction and goes out, slower, after a stretch."""
    eps, theta = x / 0.2, radians(25.0)
    V = pi / 4 * 0.02**2 * 0.2 * (1 / sin(theta) ** 2 - (1 - eps) ** 2.6 / tan(theta) ** 2) * (1 - eps)
    found = reduce([paper3])
    reported = one(found, "tau_p", "step, recovery", step=step)
    tau = V / (1.2 * 287.0 * 293.0 * conductance)
    assert reported.value == pytest.approx(tau, rel=0.12)
    assert reported.ci95[0] <= tau <= reported.ci95[1]
    assert one(found, "tau_F", "step, recovery", step=step).value == pytest.approx(tau, rel=0.15)
    assert one(found, "P_err", "step, peak", step=step).value * step < 0, "it falls while contracting"
    stiff = one(found, "K", "step, peak", step=step).value
    assert stiff > 1.1 * one(found, "K", "step, relaxed", step=step).value


def test_static_stiffness_is_that_of_the_muscle_and_its_hysteresis(paper3):
    """Daerden at 4 bar from 5 to 10 %, each way after a turn: the chord of the loop, 60 N (1 - exp) less."""
    found = reduce([paper3])
    there, back = (one(found, "K", "step, relaxed", step=step).value for step in (10e-3, -10e-3))
    assert there == pytest.approx(back, rel=1e-2)
    S = [
        pi / 4 * 0.02**2 * (3 * (1 - e) ** 2.6 / tan(radians(25)) ** 2 - 1 / sin(radians(25)) ** 2) for e in (0.05, 0.1)
    ]
    rubber = [800 * e * (e - 0.22) / (e + 0.04) for e in (0.05, 0.1)]
    chord = (S[0] - S[1]) * 4e5 + rubber[0] - rubber[1]
    E = np.exp(-10e-3 / 1.2e-3)
    assert there == pytest.approx((chord + 2 * 30 * (1 - E) / (1 + E)) / 10e-3, rel=0.01)


def test_a_recovery_in_closed_form():
    t = np.arange(0.0, 1.0, 1e-3)
    y = 300.0 - 40.0 * np.exp(-t / 0.03)
    found = recovery(t, y)
    assert (found.size, found.tau) == pytest.approx((-40.0, 0.03), rel=1e-4)
    noise = np.random.default_rng(2).normal(0, 1.0, len(t))
    assert recovery(t, y + noise).tau == pytest.approx(0.03, rel=0.1)
    assert recovery(t, 300.0 + noise) is None
    assert recovery(t, np.full(len(t), 300.0)) is None


def test_a_way_back_of_two_exponentials_shows_in_its_later_part():
    t = np.arange(0.0, 1.0, 1e-3)
    one = recovery(t, 300.0 - 40.0 * np.exp(-t / 0.03))
    assert one.apart < 1e-3 * one.tau
    two = recovery(t, 300.0 - 20.0 * np.exp(-t / 0.02) - 20.0 * np.exp(-t / 0.1))
    assert two.apart > 0.15 * two.tau


def test_what_cannot_be_measured_is_dropped_with_its_reason(mas):
    (trial,) = mas.trials
    bad = [
        replace(trial, status="failed"),
        replace(trial, channels={k: v for k, v in trial.channels.items() if k != "force"}),
        replace(trial, flags=np.full(len(trial.t), Flag.STALE, dtype=np.uint16)),
        replace(trial, commands=()),
        replace(trial, channels={**trial.channels, "displacement": np.zeros(len(trial.t))}),
    ]
    found = reduce([replace(mas, trials=tuple(bad))])
    assert [d.reason for d in found.dropped] == [
        "the trial is failed", "force not recorded", "100% of the samples are flagged", "it holds no step",
        "the displacement does not move above its noise",
    ]  # fmt: skip
    upside_down = replace(trial, channels={**trial.channels, "force": -trial.channels["force"]})
    assert any(f.level == "fault" for f in reduce([replace(mas, trials=(upside_down,))]).findings)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (("sweep.matrix.step", "[0 mm]"), "a step goes somewhere"),
        (("sweep.matrix.step", "[35 mm]"), "above the limit for commanded displacement"),
        (("sweep.matrix.speed", "[2 m/s]"), "the actuator at most at 1000 mm/s"),
        (("sweep.matrix.step", "[-16 mm, 30 mm]"), "pushes the air together"),
        (("trial.hold", "0 s"), "must be above zero"),
        (("trial.discard", "4"), "leaves nothing of 4 cycles"),
    ],
)
def test_what_a_step_cannot_be(change, says):
    fast = () if change[0].endswith("speed") else (("sweep.matrix.speed", "[900 mm/s]"),)
    with pytest.raises(InvalidFile, match=says):
        planned(
            "step-displacement", "mock-daerden", "daerden-20-200", ("sweep.matrix.pressure", "[550 kPa]"), *fast, change
        )


def test_every_missing_part_has_its_reason(mas, paper3):
    assert unexplained(reduce([mas])) == []
    assert unexplained(reduce([paper3])) == []
