"""Static loads under a gauge that reads in steps: F_ce = 1.08 N/kPa (P - 45.37 kPa), no friction, no noise."""

import numpy as np
import pytest

from pmabench.kinds.static_load.reduction import reduce
from pmabench.store.records import TrialData
from tests.analysis.judged_forms import as_run

SLOPE, START = 1.08e-3, 45.37e3
LOADS = (108.0, 255.0, 402.0)


def found(step, place, repeats=2):
    """F_ce by the means at multiples of 50 kPa, of a gauge whose steps [Pa] begin at `place` of one."""

    def read(P):
        return step * (np.round(P / step - place) + place) if step else P

    trials = []
    for i, load in enumerate(LOADS * repeats):
        P = np.concatenate([up := 500e3 * np.linspace(0.0, 1.0, 1250) ** 1.1, up[::-1]])
        crossed = float(read(np.array(load / SLOPE + START)))
        searches = {phase: {"found": True, "t": t, "pressure": crossed, "displacement": 0.0}
                    for phase, t in (("lift", 5.0), ("set-down", 20.0))}  # fmt: skip
        t = 100.0 * i + 0.01 * np.arange(len(P))
        trials.append(TrialData("l", i, {"load": load}, i // len(LOADS), False, "finished", t, {"pressure": read(P)},
                                np.zeros(len(t), dtype=np.uint16), (), searches))  # fmt: skip
    analysis = reduce([as_run("static-load", trials, 100.0, {})])
    return [e for e in analysis.estimates if e.symbol == "F_ce" and e.method == "static-mean" and e.at]


@pytest.mark.parametrize("bits", [8, 10])
def test_steps_of_the_gauge_are_in_the_interval(bits):
    """Lift and set-down of all repeats meet the same step of 10 bar / 2^bits: intervals were 1e-12 N."""
    off = []
    for place in np.linspace(0.0, 1.0, 20, endpoint=False):
        for e in found(1e6 / 2**bits, place):
            off.append(abs(e.value - SLOPE * (e.at["pressure"] - START)) / e.parts.combined)
            assert e.parts.combined > 0.25 * SLOPE * 1e6 / 2**bits
    assert np.mean(np.array(off) <= 1) >= 0.93
    assert max(off) < 2


def test_without_steps_nothing_is_added():
    assert all(e.parts.combined < 1e-3 for e in found(0.0, 0.0))
