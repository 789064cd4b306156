"""Ultimate gain and period of simulated loops against the phase equation; limit cycles are refused."""

from __future__ import annotations

import json
import random
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from math import atan, pi, sqrt
from typing import Any

import numpy as np
import pytest

from pmabench.engine.laws.gain_steps import GainSteps
from pmabench.kinds.ultimate_gain.reduction import reduce
from pmabench.model.plant import Plant
from pmabench.model.presets import Overrides, preset
from pmabench.model.regulator import constant
from pmabench.store.analyses.results import Analysis, Estimate
from pmabench.store.records import TrialData
from tests.analysis.loop_rig import TS, B_c_of, B_r_of, K_of, LinearPlant, Plant51, as_run, as_trial, close_loop


def theory(k_g: float, L: float, *lags: float) -> tuple[float, float]:
    """K_u and T_u from omega L + sum atan(omega T_i) = pi, by bisection."""
    low, high = 1e-3, pi / L
    for _ in range(100):
        w = (low + high) / 2
        low, high = (w, high) if w * L + sum(atan(w * T) for T in lags) < pi else (low, w)
    return float(np.prod([sqrt(1 + (low * T) ** 2) for T in lags])) / k_g, 2 * pi / low


def at(x: float, plant: Plant51, mean_B: bool) -> tuple[float, float, float]:
    """Pressure, K_u and T_u of plant 5.1 at contraction x: dead time 40 ms and half a sample."""
    P = replace(plant).rest_at(x)
    k_g = (1.08e-3 - (1e-3 + 2 * 9.7e-9 * P) * x) / K_of(P)
    B = (B_c_of(P) + B_r_of(P)) / 2 if mean_B else B_c_of(P)
    return P, *theory(k_g, plant.dead_time + TS / 2, plant.regulator_lag, B / K_of(P))


def search(plant: Any, x: float, P: float, start: float, **change: Any) -> GainSteps:
    low, high = P - 2e5, P + 2e5
    return GainSteps(setpoint=x, bias=P + 5e3, start=start, low=low, high=high, noise=2e-6, **change)


def trial_of(plant: Plant51, x: float, mean_B: bool = False, index: int = 0) -> tuple[TrialData, float, float]:
    P, K_u, T_u = at(x, plant, mean_B)
    plant.rest_at(x)
    law = search(plant, x, P, 0.6 * K_u)
    samples = close_loop(plant, law, 200.0)
    return as_trial(samples, {"ultimate-gain": law.result()}, index, setpoint=x, load=0.0), K_u, T_u


@cache
def clean(T_r: float = 0.0955) -> tuple[TrialData, float, float]:
    return trial_of(Plant51(regulator_lag=T_r), 0.03)


def pair(analysis: Analysis) -> tuple[Estimate, Estimate]:
    return (
        next(e for e in analysis.estimates if e.symbol == "K_u"),
        next(e for e in analysis.estimates if e.symbol == "T_u"),
    )


def texts(analysis: Analysis, level: str) -> str:
    return "\n".join(f.text for f in analysis.findings if f.level == level)


@pytest.mark.parametrize("T_r", [0.0955, 0.22])
def test_like_damping_gives_the_phase_equations_values(T_r: float) -> None:
    trial, K_u, T_u = clean(T_r)
    gain, period = pair(reduce([as_run("ultimate-gain", [trial])]))
    assert gain.value == pytest.approx(K_u, rel=0.02)
    assert period.value == pytest.approx(T_u, rel=0.01)
    for estimate, truth in ((gain, K_u), (period, T_u)):
        assert estimate.ci95 is not None
        assert estimate.ci95[0] < truth < estimate.ci95[1]
        assert estimate.parts.repeats is not None
        assert estimate.parts.method is not None
    assert (gain.unit, period.unit) == ("Pa/m", "s")


@pytest.mark.parametrize("x", [0.01, 0.06])
def test_unlike_damping_gives_the_value_of_the_mean(x: float) -> None:
    trial, K_u, T_u = trial_of(Plant51(same_B=False), x, mean_B=True)
    gain, period = pair(reduce([as_run("ultimate-gain", [trial])]))
    assert gain.value == pytest.approx(K_u, rel=0.06)
    assert period.value == pytest.approx(T_u, rel=0.02)


@pytest.mark.parametrize(("T_r", "same_B"), [(0.0955, True), (0.22, False)])
def test_stiction_is_refused_as_a_limit_cycle(T_r: float, same_B: bool) -> None:
    trial, _, _ = trial_of(Plant51(regulator_lag=T_r, same_B=same_B, F_s=10.0, F_c=6.0), 0.03)
    found = reduce([as_run("ultimate-gain", [trial])])
    gain, period = pair(found)
    assert gain.value is None
    assert period.value is None
    assert "limit cycle with stiction" in gain.note
    assert "limit cycle with stiction" in texts(found, "fault")
    assert found.dropped[0].trial == "r1/1"
    assert found.facts["tuning"] == []


def test_a_little_friction_is_refused_or_doubted() -> None:
    trial, _, _ = trial_of(Plant51(F_s=1.0, F_c=0.6), 0.03)
    found = reduce([as_run("ultimate-gain", [trial])])
    assert "friction" in texts(found, "doubt") or "stiction" in texts(found, "fault")


def test_paper_0s_numbers_come_out_of_the_plant_that_has_them() -> None:
    ts = 0.02
    plant = LinearPlant(0.5174157, 2.4313531 - ts / 2, (0.22, 5.0), noise=(1e-3, 0.0), ts=ts)
    law = GainSteps(
        setpoint=0.0, bias=0.0, start=4.5, low=-50.0, high=50.0, factor=1.06, kick=1.0, noise=1e-3,
        settle=30.0, trim=0.0, level_time=60.0, window=20.0,
    )  # fmt: skip
    samples = close_loop(plant, law, 1500.0, ts=ts)
    gain, period = pair(reduce([as_run("ultimate-gain", [as_trial(samples, {"seek": law.result()}, setpoint=0.0)])]))
    assert gain.value == pytest.approx(7.1, rel=0.02)
    assert period.value == pytest.approx(9.0, rel=0.01)


def test_settings_of_every_rule_are_next_to_it() -> None:
    trial, K_u, T_u = clean()
    settings = reduce([as_run("ultimate-gain", [trial])]).facts["tuning"]
    chosen = next(s for s in settings if s["rule"] == "Ziegler-Nichols PI")
    assert chosen["gains"]["K_p"]["value"] == pytest.approx(0.45 * K_u, rel=0.02)
    assert chosen["gains"]["T_i"]["value"] == pytest.approx(T_u / 1.2, rel=0.01)
    assert chosen["at"]["setpoint"] == 0.03


def test_repeats_are_pooled_and_calibration_counts() -> None:
    trials = []
    for index in range(3):
        plant = Plant51()
        plant.random = random.Random(index)
        trial, K_u, _ = trial_of(plant, 0.03, index=index)
        trials.append(trial)
    gain, period = pair(reduce([as_run("ultimate-gain", trials, gain_uncertainty=0.01)]))
    assert gain.n == 3
    assert gain.trials == ("r1/1", "r1/2", "r1/3")
    assert gain.value == pytest.approx(K_u, rel=0.01)
    assert gain.parts.calibration == pytest.approx(sqrt(2) * 0.01 * (gain.value or 0.0))
    assert period.parts.calibration == 0.0


def test_a_search_that_stopped_too_early_gives_no_number() -> None:
    trial, _, _ = clean()
    found = dict(trial.found["ultimate-gain"])
    for missing in (2, 3, 6):
        early = {**found, "levels": found["levels"][:-missing], "ended": "saturated"}
        analysis = reduce([as_run("ultimate-gain", [replace(trial, found={"ultimate-gain": early})])])
        assert pair(analysis)[0].value is None
        assert "never high enough" in texts(analysis, "fault") or missing == 6
        assert "ended by saturated" in texts(analysis, "fault")


def test_a_saturated_command_is_refused() -> None:
    trial, _, _ = clean()
    found = dict(trial.found["ultimate-gain"])
    last = trial.channels["pressure_command"][-500:]
    narrow = {**found, "low": float(last.min()) + 5e3, "high": float(last.max()) - 5e3}
    analysis = reduce([as_run("ultimate-gain", [replace(trial, found={"ultimate-gain": narrow})])])
    assert "saturated" in texts(analysis, "fault")
    assert pair(analysis)[0].value is None


def test_trials_without_levels_or_excluded_are_dropped_with_a_reason() -> None:
    trial, _, _ = clean()
    others = [replace(trial, index=1, status="excluded"), replace(trial, index=2, found={})]
    analysis = reduce([as_run("ultimate-gain", [trial, *others])])
    assert {d.trial: d.reason for d in analysis.dropped} == {
        "r1/2": "the trial is excluded",
        "r1/3": "no levels of gain are recorded",
    }
    assert analysis.facts["trials"] == 1


def test_unlike_set_points_are_kept_apart() -> None:
    far = trial_of(Plant51(), 0.06, index=1)
    analysis = reduce([as_run("ultimate-gain", [clean()[0], far[0]])])
    values = {e.at["setpoint"]: e.value for e in analysis.estimates if e.symbol == "K_u"}
    assert values[0.06] / values[0.03] == pytest.approx(far[1] / clean()[1], rel=0.04)


def test_traces_and_json() -> None:
    trial, _, _ = clean()
    analysis = reduce([as_run("ultimate-gain", [trial])])
    figures = {trace.figure: trace for trace in analysis.traces}
    assert set(figures) == {"oscillation", "growth"}
    for trace in analysis.traces:
        assert set(trace.columns) == set(trace.quantities)
        assert len({len(column) for column in trace.columns.values()}) == 1
        assert len(next(iter(trace.columns.values()))) <= 1500
    growth = figures["growth"]
    K_u = growth.marks["K_u"]
    assert np.interp(K_u, growth.columns["gain"], growth.columns["fit"]) == pytest.approx(0.0, abs=0.01)
    assert json.loads(json.dumps(analysis.to_dict(), allow_nan=False))["kind"] == "ultimate-gain"


def test_neither_command_nor_pressure_need_be_recorded() -> None:
    trial, _, _ = clean()
    blind = {name: column for name, column in trial.channels.items() if not name.startswith("pressure")}
    gain, _ = pair(reduce([as_run("ultimate-gain", [replace(trial, channels=blind)])]))
    assert gain.value == pytest.approx(clean()[1], rel=0.03)


def on_the_plant(
    overrides: Overrides, mass: float, factor: float
) -> tuple[Analysis, Callable[[float], tuple[float, float]]]:
    """The same search on the project's own plant at 30 mm, stepped every sample."""
    setup = preset("paper0", "bench", overrides)
    noise = random.Random(3)
    P = Plant51().rest_at(0.03)
    plant = Plant(setup.muscle, setup.regulator, mass=mass)
    plant.command(constant(0.0, P))
    plant.advance(10.0)
    law = search(plant, 0.03, P, 4e7, factor=factor)
    rows, t = [], plant.time
    for k in range(1, 75_000):
        pressure = float(plant.supply.piece(plant.time)[0].value(plant.time))
        values = {"displacement": plant.x + noise.gauss(0, 2e-6), "pressure": pressure + noise.gauss(0, 500.0)}
        command = law.update(t, values)
        rows.append((t, values["displacement"], values["pressure"], command))
        if law.done:
            break
        plant.command(constant(t, command))
        t = 10.0 + TS * k
        plant.reach(t, t - plant.time)
    columns = dict(zip(("t", "displacement", "pressure", "pressure_command"), np.array(rows).T, strict=True))
    trial = as_trial(columns, {"ultimate-gain": law.result()}, setpoint=0.03, mass=mass)
    k_g = (1.08e-3 - (1e-3 + 2 * 9.7e-9 * P) * 0.03) / K_of(P)

    def expected(B: float) -> tuple[float, float]:
        return theory(k_g, 0.041, setup.regulator.lag, B / K_of(P), mass / B)

    return reduce([as_run("ultimate-gain", [trial])]), expected


def test_the_projects_own_plant_without_stiction() -> None:
    found, expected = on_the_plant(Overrides(friction=0.0), mass=2.0, factor=1.08)
    P = Plant51().rest_at(0.03)
    K_u, T_u = expected((B_c_of(P) + B_r_of(P)) / 2)
    gain, period = pair(found)
    assert gain.value == pytest.approx(K_u, rel=0.03)
    assert period.value == pytest.approx(T_u, rel=0.01)


def test_the_projects_own_plant_with_stiction_is_refused() -> None:
    found, _ = on_the_plant(Overrides(), mass=2.0, factor=1.08)
    assert pair(found)[0].value is None
    assert "stiction" in texts(found, "fault")
