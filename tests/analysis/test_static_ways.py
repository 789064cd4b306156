"""Static load on the bent curve of plant 5.5: F_ce at x = 0 from the load's own ways, not from K of somewhere else."""

from __future__ import annotations

import numpy as np
import pytest

from pmabench.kinds.static_load.reduction import reduce
from pmabench.store.analyses.results import Analysis
from pmabench.store.records import TrialData
from tests.analysis.judged_forms import as_run
from tests.judge import weights
from tests.judge.daerden import force, stiffness

LOADS = (400.0, 600.0, 800.0, 1000.0)
MOVED = 0.5e-3


def reduced(seed: int, friction: float, slip: float, options: dict[str, object] | None = None) -> Analysis:
    trials = []
    for index, load in enumerate(LOADS):
        one = weights.lift(load, friction, seed, MOVED, slip)
        found = {
            name: {"found": True, "t": t, "pressure": P, "displacement": MOVED}
            for name, (t, P) in (("lift", one.lift), ("set-down", one.set_down))
        }
        flags = np.zeros(len(one.t), dtype=np.uint16)
        point = {"load": load, "mass": load / 9.81}
        trials.append(TrialData("s", index, point, 0, False, "finished", one.t, one.channels, flags, (), found))
    return reduce([as_run("static-load", trials, weights.RATE, {})], options)


def errors(analysis: Analysis) -> dict[float, tuple[float, float]]:
    """Pressure [Pa] -> error of F_ce [N], its half width [N]."""
    found = [e for e in analysis.estimates if e.method == "static-mean" and "pressure" in e.at]
    return {e.at["pressure"]: (e.value - float(force(0.0, e.at["pressure"])), e.parts.combined) for e in found}


@pytest.mark.parametrize(("friction", "slip"), [(0.0, 0.0), (6.0, 0.0), (6.0, 0.2e-3)])
def test_f_ce_is_that_at_x_0_though_lift_and_set_down_are_seen_half_a_millimetre_later(friction: float, slip: float):
    """K near 0 is 30 to 45 N/mm there, so that half a millimetre is worth 15 to 22 N."""
    found = errors(reduced(1, friction, slip))
    assert len(found) >= 4
    for P, (error, half) in found.items():
        assert abs(error) < 0.003 * float(force(0.0, P)) + 0.5
        assert abs(error) < half


def test_k_of_another_place_is_not_used_where_the_ways_show_that_of_x_0():
    """K at 17 mm is a third of that at 0: by it the correction would be 10 N short."""
    away = {
        "stiffness": {"from": "contraction-relaxation", "points": [[P, stiffness(0.017, P), 100.0] for P in (2e5, 5e5)]}
    }
    assert errors(reduced(1, 6.0, 0.0, away)) == errors(reduced(1, 6.0, 0.0))


def test_a_load_that_runs_through_its_ways_leaves_half_of_k_x_in_the_interval():
    """F_ce = 1 N/kPa P, friction 8 N, K 20 N/mm: it breaks loose at x = 0 and at 0.3 mm, where K x is 6 N; 3 N of that are
    in the mean, and no way shows them.
    """
    trials = []
    for index, load in enumerate((100.0, 200.0, 300.0)):
        lift, down, t = 1e3 * (load + 8.0), 1e3 * (load + 6.0 - 8.0), np.arange(0.0, 60.0, 0.01)
        P = np.interp(t, [0.0, 20.0, 25.0, 30.0, 40.0, 60.0], [0.0, lift, lift + 5e3, lift + 5e3, down, 0.0])
        x = np.where((t > 20.0) & (t < 40.0), 12e-3, 0.0)
        found = {
            phase: {"found": True, "t": at, "pressure": of, "displacement": place}
            for phase, at, of, place in (("lift", 20.0, lift, 0.0), ("set-down", 40.0, down, 0.3e-3))
        }
        channels = {"pressure": P, "displacement": x}
        flags = np.zeros(len(t), dtype=np.uint16)
        trials.append(TrialData("s", index, {"load": load}, 0, False, "finished", t, channels, flags, (), found))
    analysis = reduce([as_run("static-load", trials, 100.0, {})])
    values = [e for e in analysis.estimates if e.method == "static-mean" and "pressure" in e.at]
    assert len(values) > 3
    for e in values:
        assert e.value == pytest.approx(1e-3 * e.at["pressure"] - 3.0, abs=0.1)
        assert 3.0 < e.parts.combined < 8.0
    assert any("half of K x there is still in F_ce" in f.text for f in analysis.findings)


@pytest.mark.study
def test_f_ce_of_static_loads_of_many_seeds():
    pairs = [
        pair for seed in range(20) for friction, slip in ((0.0, 0.0), (6.0, 0.0), (6.0, 0.1e-3), (12.0, 0.3e-3))
        for pair in errors(reduced(seed, friction, slip)).values()
    ]  # fmt: skip
    error, half = np.array(pairs).T
    print(f"\nF_ce: {len(pairs)} values, worst {np.abs(error).max():.2f} N, {np.mean(np.abs(error) <= half):.3f} hold the "
          f"truth, worst {np.max(np.abs(error) / half):.2f} half widths", end="")  # fmt: skip
    assert np.mean(np.abs(error) <= half) >= 0.93
    assert np.max(np.abs(error) / half) < 2.0
