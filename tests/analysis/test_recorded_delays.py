"""Recorded steps: B/K whatever the stamps, no K of a mass that does not ring or of loads, dead time to the motion.

The truth is an integrator in tests/judge: `pytest -s -m study tests/analysis/test_recorded_delays.py` prints 20 seeds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from pmabench.kinds.recorded_step.reduction import reduce
from pmabench.store.analyses.results import Analysis, Estimate
from tests.analysis.judged_forms import as_run, as_trials
from tests.judge import plant51, stepped
from tests.judge.record import Trial

K = 6773.0
RATE = 500.0
DEAD = 0.04
LEVELS = [(280e3, 380e3), (380e3, 280e3)]


def reduced(trials: Sequence[Trial], late: tuple[float, float] | None = None) -> Analysis:
    """`late` is the lateness of the pressure that the map states."""
    steps = [
        replace(one, index=n, commands=tuple(replace(c, kind="set") for c in one.commands))
        for n, one in enumerate(as_trials(trials))
    ]
    run = as_run("recorded-step", steps, RATE, {})
    known = {} if late is None else {"late_by": {"pressure": late}}
    return reduce([replace(run, manifest={**run.manifest, "imported": known})])


def only(analysis: Analysis, symbol: str, **of: str) -> Estimate:
    (found,) = [
        e for e in analysis.estimates if e.symbol == symbol and all(getattr(e, name) == v for name, v in of.items())
    ]
    return found


def overdamped(zeta: float, mass: float, late: float, seed: int) -> tuple[Trial, float]:
    """A step up or down of a linear muscle under 90 N whose pressure is stamped `late`, and its B/K."""
    B = 2 * zeta * float(np.sqrt(K * mass))
    levels = ((200e3, 300e3), (300e3, 200e3))[seed % 2]
    return stepped.step(*levels, mass=mass, K=K, B=B, seed=seed, late=late, load=90.0), B / K


def judge_overdamped(zeta: float, mass: float, late: float, seed: int) -> tuple[float, float]:
    """Error of B/K as a share, and in half widths; no K or B may come of the mass."""
    trial, tau = overdamped(zeta, mass, late, seed)
    found = reduced([trial])
    assert all(e.value is None for e in found.estimates if e.symbol in ("K", "B"))
    e = only(found, "tau_c" if seed % 2 == 0 else "tau_r")
    return abs(e.value / tau - 1), abs(e.value - tau) / e.parts.method


@pytest.mark.parametrize(("zeta", "mass", "late", "seed"), [
    (1.6, 10.0, -0.01, 0), (1.6, 28.0, 0.01, 1), (3.0, 10.0, 0.01, 2), (3.0, 28.0, -0.01, 3),
])  # fmt: skip
def test_b_over_k_does_not_depend_on_the_stamps_and_k_is_not_given(zeta: float, mass: float, late: float, seed: int):
    share, half_widths = judge_overdamped(zeta, mass, late, seed)
    assert share < 0.05
    assert half_widths < 1.5


@pytest.mark.study
@pytest.mark.timeout(3600)
def test_b_over_k_within_10_percent_and_never_a_k():
    found = [
        judge_overdamped(zeta, mass, late, seed)
        for zeta in (1.6, 2.2, 3.0) for mass in (10.0, 28.0) for late in (-0.01, 0.0, 0.01) for seed in range(20)
    ]  # fmt: skip
    shares, half_widths = np.array(found).T
    print(
        f"\nB/K: {len(found)} steps, worst {shares.max():.1%}, {np.mean(half_widths <= 1):.3f} hold the truth, ", end=""
    )
    print(f"worst {half_widths.max():.2f} half widths", end="")
    assert shares.max() < 0.10
    assert np.mean(half_widths <= 1) >= 0.93
    assert half_widths.max() < 2.0


def dead_time(before: float, after: float, mass: float, seed: int, tube: float = 0.0) -> tuple[float, float]:
    """Error of the time from command to motion [s], and its half width [s]."""
    found = reduced([plant51.step(before, after, mass, seed, dead=DEAD, tube=tube)], (0.0, 0.0))
    e = only(found, "t_d", coordinate="command-to-motion")
    return e.value - DEAD - tube, e.parts.method


@pytest.mark.parametrize(("before", "after", "mass", "tube"), [
    (200e3, 300e3, 0.0, 0.0), (500e3, 340e3, 8.0, 0.0), (340e3, 500e3, 26.0, 0.01),
])  # fmt: skip
def test_the_time_from_command_to_motion(before: float, after: float, mass: float, tube: float):
    error, half = dead_time(before, after, mass, 1, tube)
    assert abs(error) < 3e-3
    assert abs(error) < half < 11e-3


@pytest.mark.study
@pytest.mark.timeout(3600)
def test_times_from_command_to_motion_of_many_seeds():
    steps = ((200e3, 300e3), (300e3, 500e3), (500e3, 300e3), (340e3, 500e3), (500e3, 340e3))
    for mass in (0.0, 8.0, 26.0):
        lifts = [pair for pair in steps if plant51.pull(min(pair)) > stepped.GRAVITY * mass]
        found = [dead_time(*pair, mass, seed) for pair in lifts for seed in range(20)]
        error, half = np.array(found).T
        print(f"\n{mass:3.0f} kg: {len(found)} steps, driven rms {1e3 * np.sqrt(np.mean(error**2)):.2f} ms, worst "
              f"{1e3 * np.abs(error).max():.2f}; within 3 ms {np.mean(np.abs(error) <= 3e-3):.2f}; held by "
              f"{np.mean(np.abs(error) <= half):.3f}, worst {np.max(np.abs(error) / half):.2f} half widths",
              end="")  # fmt: skip
        assert np.mean(np.abs(error) <= half) >= 0.93
        assert np.max(np.abs(error) / half) < 2.0


def test_one_load_gives_no_stiffness():
    found = reduced([stepped.step(280e3, 380e3, mass=8.0, K=K, B=1700.0, seed=n, repeat=n) for n in range(2)])
    assert [e for e in found.estimates if e.symbol in ("K", "B", "B_c") and e.value is not None] == []


@pytest.mark.parametrize("cell", [False, True])
def test_two_loads_and_a_cell_give_no_stiffness_here_and_name_the_kind_that_takes_them(cell: bool):
    trials = [
        stepped.step(*levels, mass=mass, K=K, B=1700.0, spring=3e3 if cell else 0.0, seed=1, cell=cell)
        for mass in (4.0, 16.0) for levels in LEVELS
    ]  # fmt: skip
    found = reduced(trials, (-0.002, 0.002))
    stiffness = [e for e in found.estimates if e.symbol in ("K", "B")]
    assert len(stiffness) == 8
    assert all(e.value is None and "a map of `kind: contraction-relaxation` gives K" in e.note for e in stiffness)
    taus = [e for e in found.estimates if e.symbol in ("tau_c", "tau_r")]
    assert len(taus) == 4
    assert all(("a spring pulls, too" in e.note) == cell for e in taus)


def test_a_motion_that_rings_gives_no_b_over_k():
    """Dry friction ends a swing as damping does: B/K came out three times too large there."""
    trials = [stepped.step(*LEVELS[0], mass=8.0, K=K, B=60.0, seed=n, repeat=n) for n in range(2)]
    e = only(reduced(trials), "tau_c")
    assert e.value is None
    assert "the motion rings" in e.note


@pytest.mark.parametrize("phase", [40, 85])
def test_a_gauge_that_is_read_less_often_than_it_is_recorded_shows_no_sharp_onset(phase: int) -> None:
    """5 Hz in a file of 500 Hz: tau_P was 0 +- 0.008 s for 0.0955, t_d 0.208 +- 0.038 s for 0.04."""
    trial = stepped.step(280e3, 380e3, mass=6.0, K=K, B=1700.0, seed=1)
    P = trial.channels["pressure"]
    held = P[np.maximum((np.arange(len(P)) + phase) // 100 * 100 - phase, 0)]
    found = reduced([replace(trial, channels={**trial.channels, "pressure": held})], (0.0, 0.0))
    for symbol, truth in (("tau_P", 0.0955), ("t_d", DEAD)):
        for e in (one for one in found.estimates if (one.symbol, one.method) == (symbol, "recorded-step")):
            assert abs(e.value - truth) < e.parts.method, (symbol, e.value, e.parts.method)
