"""Driven sines of a muscle that creeps: B and F_c hold the truth, whose creep is that of the second judge."""

from __future__ import annotations

import numpy as np
import pytest

from pmabench.kinds.sinusoidal_displacement.reduction import reduce
from pmabench.store.analyses.results import Analysis
from pmabench.store.records import TrialData
from tests.analysis.judged_forms import as_run
from tests.judge.second.driven import FINE, SAMPLED, follow
from tests.judge.second.muscle import DAMPING, FRICTION, Muscle

P, MEAN, AMPLITUDE = 300e3, 10e-3, 5e-3
RATE = SAMPLED * FINE
NOISE = {"pressure": 500.0, "displacement": 2e-6, "force": 0.3}
BOTH = sum(a + b * P for a, b in DAMPING.values()) / 2


def reduced(of: Muscle, frequencies: tuple[float, ...], seed: int, repeats: int = 1) -> Analysis:
    chance, asked = np.random.default_rng(seed), [f for f in frequencies for _ in range(repeats)]
    times = [np.arange(round(max(4 / f, 8.0) * RATE)) / RATE for f in asked]
    ways = [MEAN + AMPLITUDE * np.sin(2 * np.pi * f * t) for f, t in zip(asked, times, strict=True)]
    forces = follow(of, [np.full(len(t), P) for t in times], ways, RATE)
    trials = []
    for index, (f, t, x, F) in enumerate(zip(asked, times, ways, forces, strict=True)):
        true = {"pressure": np.full(len(t), P), "displacement": x, "force": F}
        read = {name: values + NOISE[name] * chance.standard_normal(len(t)) for name, values in true.items()}
        point = {"pressure": P, "mean": MEAN, "amplitude": AMPLITUDE, "frequency": f}
        flags = np.zeros(len(t), dtype=np.uint16)
        trials.append(TrialData("s", index, point, index % repeats, False, "finished", t, read, flags, (), {}))
    return reduce([as_run("sinusoidal-displacement", trials, RATE, {"discard": 1, "time_skew": 1e-7})])


def off(analysis: Analysis) -> dict[str, tuple[float, float]]:
    """Symbol -> error over its half width, half width."""
    truth = {"B": BOTH, "F_c": FRICTION}
    return {
        e.symbol: ((e.value - truth[e.symbol]) / e.parts.combined, e.parts.combined)
        for e in analysis.estimates
        if e.symbol in truth and e.method == "sine-harmonic" and e.value is not None and e.parts.combined
    }


@pytest.mark.parametrize("frequencies", [(0.5, 3.0), (0.3, 1.0, 3.0)])
def test_the_loss_of_creep_is_in_the_intervals_of_b_and_f_c(frequencies: tuple[float, ...]):
    found = off(reduced(Muscle(creep=0.008), frequencies, 1))
    assert set(found) == {"B", "F_c"}
    for symbol, (error, _) in found.items():
        assert abs(error) < 1.0, symbol


def test_where_the_stiffness_is_the_same_at_all_frequencies_there_is_no_creep_to_speak_of():
    """B would be 0.5 % wide with a creep of 1 % a decade."""
    error, half = off(reduced(Muscle(), (0.3, 1.0, 3.0), 1, repeats=2))["B"]
    assert abs(error) < 1.0
    assert half < 0.006 * BOTH


@pytest.mark.study
def test_b_and_f_c_of_sines_with_creep_of_many_seeds():
    print()
    for creep in (0.0, 0.004, 0.008, 0.016):
        for frequencies in ((0.1, 3.0), (0.5, 3.0), (0.3, 1.0, 3.0), (0.1, 0.5, 1.0, 3.0)):
            found = [off(reduced(Muscle(creep=creep), frequencies, seed, repeats=2)) for seed in range(5)]
            for symbol in ("B", "F_c"):
                pairs = [one[symbol] for one in found if symbol in one]
                worst, half = max((abs(error) for error, _ in pairs), default=0.0), [h for _, h in pairs]
                print(f"creep {creep}, {frequencies} Hz, {symbol}: {len(pairs)} values, worst {worst:.2f} half widths of "
                      f"{np.median(half) if half else np.nan:.3g}")  # fmt: skip
                assert worst < 1.5
