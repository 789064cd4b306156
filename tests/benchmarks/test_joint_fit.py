"""How long the pooled fit of a campaign takes, beside scipy's `curve_fit` of each step on the same data, in one run.

24 trials of 10,000 samples; 500 trials. Times are judged by `make bench`, values always.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pmabench.kinds.contraction_relaxation.reduction import estimates_of, pool
from pmabench.kinds.contraction_relaxation.segments import Campaign, gather, strokes
from pmabench.store.records import RunData, TrialData
from tests.analysis.simulate import contraction_run, rig
from tests.analysis.test_contraction import SERRES, SMALL
from tests.benchmarks.least import least

SAMPLES = 10_000


def cut(run: RunData) -> RunData:
    """The trials' first 10,000 samples."""

    def short(trial: TrialData) -> TrialData:
        channels = {name: column[:SAMPLES] for name, column in trial.channels.items()}
        return replace(trial, t=trial.t[:SAMPLES], flags=trial.flags[:SAMPLES], channels=channels)

    return replace(run, trials=tuple(short(trial) for trial in run.trials))


def campaign(repeats: int) -> Campaign:
    found, _ = gather([cut(contraction_run(rig("serres2009"), SMALL, repeats=repeats))])
    assert found is not None
    return found


def exponentials(found: Campaign) -> dict[tuple[str, float], float]:
    """B_c [N.s/m] by pressure: x = x_0 + A (1 - exp(-(t - t_0) / tau)) by `curve_fit` to every step, B = K tau."""
    from scipy.optimize import curve_fit

    def rise(t: Any, x_0: float, A: float, t_0: float, tau: float) -> Any:
        return x_0 + A * (1 - np.exp(-np.maximum(0.0, t - t_0) / tau))

    ends: dict[float, list[tuple[float, float, float]]] = {}
    for samples, trial in zip(found.samples, found.trials, strict=True):
        for number, rows in enumerate(strokes(trial)):
            t, x = samples.t[rows] - samples.t[rows.start], samples.x[rows]
            start = (x[0], x[-1] - x[0], 0.05, 0.2)
            best, _ = curve_fit(rise, t, x, p0=start, bounds=([-1, -1, 0, 1e-3], [1, 1, 1, 5]))
            if number == 0:
                ends.setdefault(trial.point["pressure"], []).append((samples.load, best[0] + best[1], best[3]))
    reported = {}
    for P, steps in ends.items():
        load, x, tau = np.array(steps).T
        reported["B_c", P] = float(-1 / np.polyfit(load, x, 1)[0] * np.median(tau))
    return reported


def test_24_trials_are_fitted_faster_than_one_by_one(benchmark):
    found = campaign(1)
    rounds = 1 if benchmark.disabled else 5
    whole, pooled = least(lambda: pool(found, {}), rounds)
    bare, _ = least(lambda: pool(found, {"replays": 0}), rounds)
    alone, papers = least(lambda: exponentials(found), rounds)
    reported = {(e.symbol, e.at["pressure"]): e.value for e in estimates_of(pooled)[0] if e.at}
    off = [value / SERRES["B_c"](P) - 1 for (_, P), value in papers.items()]
    ours = [reported["B_c", P] / SERRES["B_c"](P) - 1 for _, P in papers]
    print(
        f"\n24 trials of {SAMPLES} samples: fit {1e3 * bare:.0f} ms, with replays and intervals {1e3 * whole:.0f} ms,"
        f" curve_fit of every step {1e3 * alone:.0f} ms; B_c off by {100 * min(off):+.0f} to {100 * max(off):+.0f} %"
        f" by curve_fit, by {100 * min(ours):+.1f} to {100 * max(ours):+.1f} % by the fit"
    )
    assert min(off) > 0.2
    assert np.abs(ours).max() < 0.02
    if not benchmark.disabled:
        assert whole < alone
        assert alone > 2 * bare
    benchmark.pedantic(lambda: pool(found, {"replays": 0}), rounds=rounds)


@pytest.mark.study
def test_500_trials(benchmark):
    found = campaign(21)
    assert len(found.trials) == 504
    assert all(len(trial.t) == SAMPLES for trial in found.trials)
    took, _ = least(lambda: pool(found, {}), 1)
    alone, _ = least(lambda: exponentials(campaign(1)), 1)
    print(f"\n504 trials: {took:.1f} s, {took / alone:.1f} times curve_fit of every step of 24")
    if not benchmark.disabled:
        assert took < 20 * alone
    benchmark.pedantic(lambda: None, rounds=1)
