"""The fitted muscle run freely through whole trials: NRMSE by its definition, by direction, and what does not follow."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pmabench.kinds.contraction_relaxation import reduction as contraction
from pmabench.kinds.contraction_relaxation.checks import FreeRun, nrmse, rms
from tests.analysis.simulate import contraction_run, rig

CELLS = [(load, P) for load in (58.86, 156.96, 255.06) for P in (3e5, 4e5, 5e5)]


def reduced(change=lambda x: x, kind="bench"):
    run = contraction_run(rig("paper0", kind), CELLS, 1, 1)
    trials = [
        replace(t, channels={**t.channels, "displacement": change(t.channels["displacement"])}) for t in run.trials
    ]
    return contraction.reduce([replace(run, trials=tuple(trials))], {"replays": 2})


def check_of(analysis):
    return next(check for check in analysis.facts["checks"] if check["name"] == "free_run")


def free_run(x, off, way):
    n = len(x)
    return FreeRun(0, np.arange(n), np.zeros(n), x, x + off, np.ones(n, bool), np.asarray(way))


def test_nrmse_is_the_error_by_the_spread_of_what_was_measured():
    """x is 0 and 2 about its mean 1, so ||x - mean|| = sqrt(n): an error of 0.1 everywhere is 10 %."""
    x = np.tile([0.0, 2.0], 50)
    off = np.full(100, 0.1)
    off[50:] = 0.3
    one = free_run(x, off, np.repeat([1, -1], 50))
    assert nrmse([one], "contraction") == pytest.approx(0.1)
    assert nrmse([one], "relaxation") == pytest.approx(0.3)
    assert nrmse([one]) == pytest.approx(np.sqrt((0.1**2 + 0.3**2) / 2)) == rms([one])
    twice = free_run(10 * x, 0 * off, np.zeros(100, int))
    assert nrmse([one, twice]) == pytest.approx(np.sqrt((0.1**2 + 0.3**2) * 50 / (100 + 100 * 100)))
    assert nrmse([twice], "contraction") is None
    still = free_run(np.zeros(5), np.zeros(5), np.ones(5, int))
    assert nrmse([still]) is None
    assert nrmse([]) is None


def test_a_phase_that_hardly_moves_counts_by_the_stroke_of_its_trial():
    """An error of 0.1 while it moves by 0.01: not 1000 %, but a tenth of the standard deviation of the trial."""
    x = np.concatenate((np.tile([0.0, 2.0], 50), np.tile([0.99, 1.01], 50)))
    one = free_run(x, np.full(200, 0.1), np.repeat([1, -1], 100))
    assert nrmse([one], "relaxation") == pytest.approx(0.1 / np.std(x))
    assert nrmse([one], "contraction") == pytest.approx(0.1 / np.std(x))
    assert nrmse([one]) == pytest.approx(0.1 / np.std(x))


def test_a_muscle_of_the_models_form_follows_its_trials():
    analysis = reduced(kind="ideal")
    check = check_of(analysis)
    assert check["value"] < 0.01
    assert check["level"] == "note"
    assert "over 9 trials: NRMSE" in check["text"]
    assert "contraction 0." in check["text"]
    assert [(row["trials"], round(row["load"])) for row in analysis.facts["free_run"]] == [
        (1, load) for _ in range(3) for load in (59, 157, 255)
    ]


def test_the_table_is_what_the_drawn_curves_say():
    """NRMSE of each drawn trial, from the numbers of its figure, which are every third of those that count."""
    analysis = reduced(lambda x: x + 8.0 * x**2)
    reported = {(row["pressure"], round(row["load"])): row["nrmse"] for row in analysis.facts["free_run"]}
    for trace in analysis.traces:
        x, model, P = (trace.columns[name] for name in ("displacement", "model", "pressure"))
        ok = np.isfinite(model) & (P >= analysis.facts["knots"][0])
        expected = np.linalg.norm((x - model)[ok]) / np.linalg.norm(x[ok] - x[ok].mean())
        assert reported[trace.marks["pressure"], round(trace.marks["load"])] == pytest.approx(expected, rel=0.03)


def test_a_muscle_that_lags_behind_its_pressure_is_doubted():
    late = check_of(reduced(lambda x: np.concatenate((np.full(400, x[0]), x[:-400]))))  # 0.8 s
    assert late["value"] > 0.1
    assert late["level"] == "doubt"
    assert late["text"].endswith("does not follow its own trials")
