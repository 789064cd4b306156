"""Relay tests of simulated loops against the phase equation; friction is seen, and is not seen where there is none."""

from __future__ import annotations

import random
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from pmabench.engine.laws.relay import Relay
from pmabench.kinds.ultimate_gain.reduction import reduce
from pmabench.kinds.ultimate_gain.relay import examine
from pmabench.kinds.ultimate_gain.ways import findings as ways
from pmabench.store.analyses.results import Analysis
from pmabench.store.records import TrialData
from tests.analysis.loop_plants import Case
from tests.analysis.loop_rig import LinearPlant, Plant51, as_run, as_trial, close_loop
from tests.analysis.test_ultimate_gain import at, clean, texts, theory
from tests.test_characterisation import analysed

CASES = [(0.03, 0.0955, True), (0.03, 0.22, True), (0.01, 0.0955, False), (0.06, 0.0955, False)]


def swing(plant: Any, x: float, P: float, index: int = 0, **change: Any) -> TrialData:
    given: dict[str, Any] = {
        "amplitudes": [2e4, 4e4], "hysteresis": [1e-4, 2e-4], "periods": 9, "level_time": 20.0, "settle": 2.0,
        "window": 8e-3,
    }  # fmt: skip
    law = Relay(setpoint=x, bias=P, low=P - 2e5, high=P + 2e5, **{**given, **change})
    samples = close_loop(plant, law, 100.0)
    return as_trial(samples, {"ultimate-gain": law.result()}, index, setpoint=x, load=0.0)


def muscle(seed: int = 7, x: float = 0.03, friction: float = 0.0, **change: Any) -> TrialData:
    """At 60 mm a command moves the muscle a third as far, and must be larger to get it past its friction."""
    plant = Plant51(F_s=friction, F_c=0.6 * friction, **change)
    plant.random = random.Random(seed)
    return swing(plant, x, plant.rest_at(x), amplitudes=[2e4, 4e4] if x < 0.05 else [6e4, 12e4])


def values(analysis: Analysis) -> dict[tuple[str, str], float | None]:
    return {(e.symbol, e.method): e.value for e in analysis.estimates}


@pytest.mark.parametrize(("x", "T_r", "same_B"), CASES)
def test_the_fitted_loop_gives_the_phase_equations_values(x: float, T_r: float, same_B: bool) -> None:
    _, K_u, T_u = at(x, Plant51(regulator_lag=T_r, same_B=same_B), mean_B=not same_B)
    found = reduce([as_run("ultimate-gain", [muscle(x=x, regulator_lag=T_r, same_B=same_B)])])
    reported = values(found)
    assert reported["K_u", "relay-fit"] == pytest.approx(K_u, rel=0.03)
    assert reported["T_u", "relay-fit"] == pytest.approx(T_u, rel=0.01)
    for estimate, truth in zip(found.estimates[:2], (K_u, T_u), strict=True):
        assert estimate.ci95 is not None
        assert estimate.ci95[0] < truth < estimate.ci95[1]
    (loop,) = found.facts["loops"]
    assert loop["dead_time"] == pytest.approx(0.041, abs=5e-4)
    assert loop["lags"][0] == pytest.approx(T_r, rel=0.02)
    assert "stiction" not in texts(found, "fault")


def test_the_describing_function_is_what_its_equation_gives_for_a_linear_loop() -> None:
    """Gain and period of 4 d/(pi sqrt(a^2 - h^2)) on a loop with so much lag that harmonics hardly pass."""
    plant = LinearPlant(1.466e-7, 0.04, (0.0955, 0.247))
    trial = swing(plant, 0.0, 0.0, hysteresis=[1e-5, 2e-5])
    level = examine(as_run("ultimate-gain", [trial]), trial, trial.found["ultimate-gain"]).best
    K_u, T_u = theory(1.466e-7, 0.041, 0.0955, 0.247)
    assert level.described == pytest.approx(K_u, rel=0.10)
    assert level.period == pytest.approx(T_u, rel=0.05)


def seen_as_stiction(trial: TrialData) -> bool:
    found = reduce([as_run("ultimate-gain", [trial])])
    refused = "limit cycle with stiction" in texts(found, "fault")
    assert refused == (values(found)["K_u", "relay-fit"] is None)
    assert refused == (found.facts["tuning"] == [])
    return refused


def test_stiction_is_distinguished_from_a_linear_loop() -> None:
    assert seen_as_stiction(muscle(1, friction=10.0))
    assert not seen_as_stiction(muscle(1, same_B=False))


@pytest.mark.study
def test_stiction_is_reported_in_20_of_20_and_in_none_of_20_without() -> None:
    places = (0.01, 0.02, 0.03, 0.04, 0.06)
    sticky = [muscle(seed, places[seed % 5], friction=10.0, same_B=seed % 2 == 0) for seed in range(20)]
    free = [muscle(seed, places[seed % 5], same_B=seed % 2 == 0) for seed in range(20)]
    assert sum(seen_as_stiction(trial) for trial in sticky) == 20
    assert sum(seen_as_stiction(trial) for trial in free) == 0


def test_a_kink_within_the_swing_is_not_called_stiction() -> None:
    """The stiffness of plant 5.2 falls up to 314 kPa and rises above, and with it the gain halves; no friction."""
    case = next(c for c in (Case(seed, 0.0, "serres2009", 0.042) for seed in range(50)) if c.mass == 2.0)
    assert case.P == pytest.approx(311e3, abs=5e3)
    found = case.relay(2e4)
    assert "bends within the swing" in texts(found, "fault")
    assert "stiction" not in texts(found, "fault")
    assert values(found)["K_u", "relay-fit"] is None


def test_the_mass_that_hangs_is_in_the_fitted_loop() -> None:
    case = next(c for c in (Case(seed, 0.0, "paper0", 0.02) for seed in range(50)) if c.mass == 12.0)
    found = case.relay(2e4)
    reported = values(found)
    assert reported["K_u", "relay-fit"] == pytest.approx(case.K_u, rel=0.03)
    assert reported["T_u", "relay-fit"] == pytest.approx(case.T_u, rel=0.015)
    (loop,) = found.facts["loops"]
    assert len(loop["lags"]) == 3


def test_ways_that_disagree_are_doubted() -> None:
    case = Case(3, 0.0, "paper0", 0.03)
    steps, relay = case.stepped(), case.relay(2e4)
    reported = [*steps.estimates, *relay.estimates]
    assert [f.level for f in ways(reported)] == ["note"] * 2
    off = [replace(e, value=e.value * 1.4) if e.method == "relay-fit" else e for e in reported]
    assert "stiction" in next(f.text for f in ways(off) if f.level == "doubt" and f.text.startswith("K_u at 30 mm"))


def test_both_ways_of_one_set_point_stand_side_by_side() -> None:
    stepped, K_u, _ = clean()
    found = reduce([as_run("ultimate-gain", [stepped, muscle()])])
    reported = values(found)
    assert reported["K_u", "gain-steps"] == pytest.approx(K_u, rel=0.02)
    assert reported["K_u", "relay-fit"] == pytest.approx(K_u, rel=0.03)
    assert len({entry["rule"] for entry in found.facts["tuning"]}) == len(found.facts["tuning"])
    assert "gain-steps), " in texts(found, "note")


def test_what_cannot_be_used_is_dropped_with_its_reason() -> None:
    trial = muscle()
    search = trial.found["ultimate-gain"]
    ended = {**search, "found": False, "ended": "pressure", "reason": "the measured pressure left its window"}
    short = {**search, "relay": [{**level, "switches": level["switches"][:6]} for level in search["relay"]]}
    one = {**search, "relay": search["relay"][1:]}
    for changed, reason in ((ended, "the measured pressure left"), (short, "fewer than 4 whole periods")):
        found = reduce([as_run("ultimate-gain", [replace(trial, found={"ultimate-gain": changed})])])
        assert reason in found.dropped[0].reason
        assert set(values(found).values()) == {None}
    found = reduce([as_run("ultimate-gain", [replace(trial, found={"ultimate-gain": one})])])
    assert "needed to see friction" in texts(found, "doubt")
    blind = {name: column for name, column in trial.channels.items() if name != "pressure"}
    found = reduce([as_run("ultimate-gain", [replace(trial, channels=blind)])])
    assert (found.dropped[0].reason, found.estimates) == ("the pressure is not recorded", ())


def test_the_shipped_protocol_on_the_simulated_bench_without_friction(tmp_path: Path) -> None:
    """docs/papers.md, row 13: mass over damping is a lag of 1.3 ms beside dead time, regulator and tau."""
    K_u, T_u = theory(0.1466e-6, 0.041, 0.0955, 0.247, 0.0013)
    found = analysed(tmp_path, "ultimate-gain-relay", "mock-linear", settings=[("sweep.repeat.count", "1")])
    reported = values(found)
    assert reported["K_u", "relay-fit"] == pytest.approx(K_u, rel=0.02)
    assert reported["T_u", "relay-fit"] == pytest.approx(T_u, rel=0.01)
    assert {trace.figure for trace in found.traces} == {"relay"}


def test_the_shipped_protocol_on_the_simulated_bench_with_stiction(tmp_path: Path) -> None:
    found = analysed(tmp_path, "ultimate-gain-relay", "mock", settings=[("sweep.repeat.count", "1")])
    assert "limit cycle with stiction" in texts(found, "fault")
    assert set(values(found).values()) == {None}
