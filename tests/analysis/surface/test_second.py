"""The surface against a muscle of other families: braid and rubber, Bouc-Wen hysteresis, creep by a power of time."""

from functools import cache

import numpy as np
import pytest

from pmabench.analysis.shared.calibration import Scales
from pmabench.analysis.surface.fit import Data, choose
from pmabench.analysis.surface.trials import Record, rows_of
from pmabench.kinds.surface.reduction import estimates
from tests.analysis.surface.straight import straight_form
from tests.judge.second.campaign import REAL
from tests.judge.second.driven import session
from tests.judge.second.muscle import DAMPING

FULL = 1395.0


def record(number, test):
    rows = rows_of(test.t, test.pressure, test.displacement, test.force, np.ones(len(test.t), dtype=bool))
    names = ("displacement",) if test.kind == "isometric-pressurisation" else ("pressure", "displacement")
    group = ", ".join([test.kind, *(f"{name} {test.point[name]:.4g}" for name in names if name in test.point)])
    return Record(f"session/{number}", group, *rows, rows[3] > 0.02 * FULL)


@cache
def judged(seed):
    tests, motions = session(REAL, seed)
    known, others = ([record(number, test) for number, test in enumerate(many)] for many in (tests, motions))
    choice = choose(Data.of(known))

    def rms(F, one):
        return np.sqrt(np.mean((F - one.F)[one.used] ** 2)) / FULL

    own = [rms(choice.muscle.force([one]), one) for one in others]
    return choice, own, [rms(F, one) for F, one in zip(straight_form(known, others), others, strict=True)]


def check(seed):
    choice, own, straight = judged(seed)
    assert max(own) <= 0.01
    assert min(straight) >= 1.3 * max(own)
    P, x = (grid.ravel() for grid in np.meshgrid([250e3, 350e3, 450e3], [8e-3, 15e-3, 25e-3]))
    assert choice.muscle.stiffness(P, x) == pytest.approx(REAL.tangent(x, P), rel=0.05)
    intervals(choice)


def intervals(choice):
    """F within the mean of both branches and what creeps in the 30 s of a test, K of the tangent, B as it is."""
    inside = []
    for e in estimates(choice, Scales({}, {})):
        half = e.parts.combined
        if e.value is None or e.symbol not in ("F", "K", "B_c", "B_r"):
            continue
        P, x = np.array([e.at["pressure"]]), np.array([e.at.get("contraction", 0.0)])
        true = {"F": REAL.mean(x, P)[0], "K": REAL.tangent(x, P)[0]}
        true |= {symbol: a + b * P[0] for symbol, (a, b) in zip(("B_c", "B_r"), DAMPING.values(), strict=True)}
        crept = REAL.crept(np.array(30.0), e.value) * x[0] * true["K"] if e.symbol == "F" else 0.0
        off = max(0.0, true[e.symbol] - e.value, e.value - true[e.symbol] - crept)
        assert off <= 2 * half, (e.symbol, dict(e.at), e.value, half)
        inside.append(off <= half)
    assert len(inside) >= 40
    assert np.mean(inside) >= 0.93


def test_motion_at_random_is_predicted_to_a_percent():
    check(0)


@pytest.mark.study
@pytest.mark.parametrize("seed", range(1, 6))
def test_study_five_sessions(seed):
    check(seed)
