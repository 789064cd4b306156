"""What a reduction with intervals costs over decoding the rows and a bare fit of the same campaign. `make bench`.

The bare fit knows nothing of ours and gives values without an interval: one regression over means of 40 ms where the
muscle moves, by numpy, for stiffness, damping and friction; and what paper 0 does, an exponential through each stroke,
by scipy's curve_fit. The reduction has both, too.
"""

import os
import warnings
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.optimize import OptimizeWarning, curve_fit

from pmabench.cli.prepare import prepare
from pmabench.engine.operator import ConfirmedBeforehand
from pmabench.engine.run import run_plan
from pmabench.kinds.reduce import reduce_runs
from pmabench.store.reader import open_run
from tests.benchmarks.least import least

SHORT = [("sweep.matrix.load", "[6 kg, 31 kg]"), ("sweep.matrix.pressure.step", "175 kPa")]
"""A campaign of six trials, where nothing is timed."""
MOST = 4.0
ROWS = 20
"""Rows of a segment: 40 ms at 500 Hz."""
SLOWEST = 5e-3
"""A segment counts where the muscle is faster [m/s]."""
BAR = 1e5


def stiffness(P):
    """K [N/m] of the simulated muscle of paper 0 at a pressure [Pa]."""
    return 5600.0 + 1e-3 * P + 9.7e-9 * P**2


def means(values):
    """Means of segments, shape (n // ROWS,)."""
    return values[: len(values) // ROWS * ROWS].reshape(-1, ROWS).mean(axis=1)


def regression(run):
    """By least squares F = F_ce + f P - (K + k P + l P^2) x - (B + b P) v - F_c sign(v), in SI but for P [bar]."""
    designs, sides = [], []
    for trial in run.trials:
        x, P, F = (trial.channels[name] for name in ("displacement", "pressure", "force"))
        v = (x[ROWS - 1 :: ROWS] - x[::ROWS][: len(x[ROWS - 1 :: ROWS])]) / ((ROWS - 1) * 0.002)
        x, P, F = means(x), means(P) / BAR, means(F)
        moves = np.abs(v) > SLOWEST
        x, P, F, v = x[moves], P[moves], F[moves], v[moves]
        up = v > 0
        columns = [
            np.ones(len(x)),
            P,
            -x,
            -P * x,
            -P * P * x,
            -v * up,
            -P * v * up,
            -v * ~up,
            -P * v * ~up,
            -np.sign(v),
        ]
        designs.append(np.column_stack(columns))
        sides.append(F)
    return np.linalg.lstsq(np.concatenate(designs), np.concatenate(sides), rcond=None)[0]


def rising(t, start, end, tau, begun):
    """An exponential from `start` to `end` [m] that begins at `begun` [s]."""
    return start + (end - start) * (1 - np.exp(-np.maximum(t - begun, 0.0) / tau))


def exponentials(run):
    """Time constant [s] of each stroke, shape (strokes,)."""
    found = []
    warnings.simplefilter("ignore", OptimizeWarning)  # of the covariance, which nobody looks at here
    for trial in run.trials:
        times = [*(command.t for command in trial.commands), trial.t[-1]]
        for begin, end in pairwise(time for time in times if trial.t[0] <= time):
            rows = slice(*np.searchsorted(trial.t, (begin, end)))
            t, x = trial.t[rows] - begin, trial.channels["displacement"][rows]
            if len(x) and abs(x[-1] - x[0]) > 5e-3:
                found.append(curve_fit(rising, t, x, (x[0], x[-1], 0.25, 0.05))[0][2])
    return np.array(found)


def test_a_reduction_with_intervals_over_decoding_and_a_bare_fit(tmp_path, request):
    timed = request.config.getoption("benchmark_enable")
    changes = [("sweep.repeat.count", os.environ.get("PMABENCH_REPEATS", "1"))] + ([] if timed else SHORT)
    prepared = prepare("contraction-relaxation", "mock", "mas-20-250-paper0", changes)
    folder = run_plan(prepared.plan, prepared.mounted, ConfirmedBeforehand(), out=tmp_path).folder
    if timed:  # what is imported at the first time is no part of it
        once = open_run(folder)
        reduce_runs([replace(once, trials=once.trials[:2])])
    times = 3 if timed else 1
    decoding, run = least(lambda: open_run(folder), times)
    one, theta = least(lambda: regression(run), times)
    strokes, taus = least(lambda: exponentials(run), times)
    bare = one + strokes
    reducing, (analysis,) = least(lambda: reduce_runs([run]), times)
    ratio = reducing / (decoding + bare)
    print(
        f"\n{len(run.trials)} trials, processor time: decoding {decoding:.2f} s, one regression {one:.3f} s,"
        f" {len(taus)} exponentials {strokes:.2f} s; reduction with intervals {reducing:.2f} s: {ratio:.1f} times all,"
        f" at most {MOST}; {reducing / (decoding + one):.1f} times decoding and the regression alone"
    )
    primary = [e for e in analysis.estimates if e.symbol == "K" and e.method == "measured-pressure" and e.value]
    assert primary
    assert np.median(taus) == pytest.approx(0.35, rel=0.3), "0.25 s of the muscle, and the regulator's"
    for e in primary:
        P = e.at["pressure"]
        bare_K = theta[2:5] @ (1.0, P / BAR, (P / BAR) ** 2)
        assert e.ci95 is not None
        assert [e.value, bare_K] == pytest.approx([stiffness(P)] * 2, rel=0.05 if timed else 0.1), (
            "both fit this muscle"
        )
    if timed:
        assert ratio < MOST
