"""Checks beside the residual: repeats by hand, and muscles that are not what the fit takes them for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pmabench.analysis.verdict.checks import (
    Check,
    Repeats,
    checks_of,
    drift,
    first_repeat,
    spread,
    trial_checks,
    with_checks,
)
from pmabench.kinds.contraction_relaxation import reduction as contraction
from pmabench.kinds.registry import all_kinds, kind_of
from pmabench.store.analyses.results import Analysis
from tests.analysis.loop_rig import as_run
from tests.analysis.simulate import contraction_run, rig
from tests.analysis.sine_rig import Muscle51

CELLS = [(load, P) for load in (58.86, 156.96, 255.06) for P in (3e5, 4e5, 5e5)]


def repeats(cell, repeat, value, t=None):
    t = np.arange(len(cell), dtype=float) if t is None else t
    return Repeats("stroke", *(np.array(row, dtype=float) for row in (cell, repeat, t, value)))


def test_the_spread_is_the_pooled_standard_deviation():
    found = spread(repeats([0, 0, 1, 1], [0, 1, 0, 1], [9.0, 11.0, 20.0, 20.0]))
    assert found.value == pytest.approx(0.1)  # sqrt((0.1^2 + 0.1^2) / 2)
    assert found.level == "doubt"
    assert "10 % of the stroke (2 degrees" in found.text
    assert spread(repeats([0, 1, 2], [0, 0, 0], [1.0, 2.0, 3.0])) is None


@pytest.mark.parametrize(
    ("firsts", "mean", "level"),
    [
        ((1.01, 1.02, 1.03), 0.02, "note"),
        ((1.019, 1.02, 1.021), 0.02, "doubt"),
        ((1.0019, 1.002, 1.0021), 0.002, "note"),
    ],
)
def test_a_first_repeat_that_differs_is_reported_by_students_t(firsts, mean, level):
    """t(0.975, 2) = 4.303: 2 +- 2.5 % is no difference, 2 +- 0.25 % is one."""
    values = [v for first in firsts for v in (10 * first, 9.0, 11.0)]
    found = first_repeat(repeats(np.repeat([0, 1, 2], 3), [0, 1, 2] * 3, values))
    assert found.value == pytest.approx(mean)
    assert found.level == level
    assert ("differs" in found.text) == (firsts[0] != 1.01)
    two = repeats([0, 0, 1, 1], [0, 1, 0, 1], [1.0, 1.1, 1.0, 1.1])
    assert first_repeat(two) is None


def test_a_drift_is_found_with_its_size_and_none_where_there_is_none():
    t = np.linspace(0.0, 900.0, 30)
    cell = np.tile(np.arange(10), 3)
    level = 5.0 + cell
    noise = np.random.default_rng(3).normal(0.0, 0.001, 30)
    drifts = drift(repeats(cell, np.repeat([0, 1, 2], 10), level * (1 + 0.04 * (t / 900 - 0.5) + noise), t))
    assert drifts.value == pytest.approx(0.04, abs=0.002)
    assert drifts.level == "doubt"
    steady = drift(repeats(cell, np.repeat([0, 1, 2], 10), level * (1 + noise), t))
    assert abs(steady.value) < 0.002
    assert "no drift" in steady.text
    adjacent = drift(repeats(np.repeat(np.arange(10), 3), [0, 1, 2] * 10, level * (1 + noise), t))
    assert adjacent is None  # repeats within a tenth of the time say nothing of the whole of it


def test_reference_trials_show_drift_and_are_no_first_repeats():
    run = contraction_run(rig(), CELLS[:2], repeats=4, seed=5)
    trials = [replace(trial, reference=trial.point["pressure"] == 3e5) for trial in run.trials]
    names = {
        check.name for check in trial_checks(kind_of("contraction-relaxation"), [replace(run, trials=tuple(trials))])
    }
    assert names == {"repeat_spread", "drift"}
    assert trial_checks(kind_of("ultimate-gain"), [run]) == []


@pytest.mark.parametrize("kind", [name for name, kind in all_kinds().items() if kind.repeated])
def test_trials_that_lack_what_is_needed_are_no_repeats(kind):
    """Of every kind: without channels, without commands, without a usable sample, with nothing found."""
    run = contraction_run(rig(), CELLS[:1], repeats=2, seed=5)
    bare = [
        lambda t: replace(t, channels={}),
        lambda t: replace(t, commands=(), found={}),
        lambda t: replace(t, flags=np.full(len(t.t), 8, dtype=np.uint16)),
        lambda t: replace(t, channels={name: np.full(len(t.t), np.nan) for name in t.channels}),
        lambda t: replace(t, t=t.t[:1], flags=t.flags[:1], channels={n: v[:1] for n, v in t.channels.items()}),
    ]
    for change in bare:
        changed = replace(run, kind=kind, trials=tuple(change(trial) for trial in run.trials))
        assert trial_checks(kind_of(kind), [changed]) == []


def test_sines_that_stiffen_from_repeat_to_repeat():
    """K 1 % below, at and above: s = 1 %, and 0.01 in 400 s is 0.0275 over the 1100 s of twelve trials."""
    trials = [Muscle51(K=K).trials(3)[i] for i, K in enumerate(np.repeat([0.99, 1.0, 1.01], 4) * 6773.0)]
    run = as_run("sinusoidal-displacement", trials)
    found = {check.name: check for check in trial_checks(kind_of("sinusoidal-displacement"), [run])}
    assert found["repeat_spread"].value == pytest.approx(0.01, rel=1e-3)
    assert found["drift"].value == pytest.approx(0.0275, rel=1e-3)
    assert found["first_repeat"].value == pytest.approx(0.99 / 1.005 - 1, rel=1e-3)
    assert {found[name].level for name in ("drift", "first_repeat")} == {"doubt"}
    once = as_run("sinusoidal-displacement", trials[:4])
    assert trial_checks(kind_of("sinusoidal-displacement"), [once]) == []


def fitted(change=lambda trial: trial, kind="bench"):
    run = contraction_run(rig("paper0", kind), CELLS, 1, 1)
    run = replace(run, trials=tuple(change(trial) for trial in run.trials))
    return {check["name"]: check for check in contraction.reduce([run], {"replays": 2}).facts["checks"]}


def moved(trial, x):
    return replace(trial, channels={**trial.channels, "displacement": x})


def test_a_muscle_of_the_models_form_passes():
    found = fitted()
    assert {check["level"] for check in found.values()} == {"note"}
    assert found["held_out"]["value"] < 2e-3
    assert found["other_direction"]["value"] < 2e-3
    assert "friction is seen" in found["friction"]["text"]
    assert "friction is hardly seen" in fitted(kind="ideal")["friction"]["text"]


def test_a_spring_that_is_not_straight_does_not_carry_over_to_other_loads():
    def bent(trial):
        x = trial.channels["displacement"]
        return moved(trial, x + 8.0 * x**2)

    found = fitted(bent)["held_out"]
    assert found["level"] == "doubt"
    assert "does not carry over" in found["text"]


def test_a_muscle_that_is_softer_on_the_way_back_is_reported():
    def hysteresis(trial):
        x = trial.channels["displacement"].copy()
        back = next(c.t for c in trial.commands if c.phase in ("relax", "vent"))
        x[trial.t > back] *= 1.06
        return moved(trial, x)

    found = fitted(hysteresis)["other_direction"]
    assert found["level"] == "doubt"
    assert "do not have one K" in found["text"]


def test_checks_become_findings_and_survive_a_file_that_anybody_wrote():
    run = contraction_run(rig(), CELLS[:3], repeats=2, seed=5)
    reported = {"name": "held_out", "value": 0.5, "quantity": "ratio", "level": "doubt", "text": "far"}
    analysis = Analysis("contraction-relaxation", ("r1",), True, facts={"checks": [reported], "a": 1})
    analysis = with_checks(analysis, kind_of("contraction-relaxation"), [run])
    assert [check.name for check in checks_of(analysis)] == ["held_out", "repeat_spread", "first_repeat"]
    assert next(f.text for f in analysis.findings) == "far"
    assert analysis.facts["a"] == 1
    odd = [
        {**reported, "value": "x"},
        {**reported, "quantity": "nonsense"},
        {"name": "x"},
        7,
        None,
        {**reported, "more": 1},
        reported,
    ]
    assert checks_of(replace(analysis, facts={"checks": odd})) == (Check(**reported),)
    assert checks_of(replace(analysis, facts={"checks": "x"})) == ()
