"""The load check compares the last half second of a wait with the plates, however the samples arrive."""

import numpy as np
import pytest

from pmabench.base.clock import VirtualClock
from pmabench.engine import run as run_module
from pmabench.engine.acquire import Samples
from pmabench.engine.bench_checks import LoadCheck
from pmabench.engine.operator import ConfirmedBeforehand
from tests.engine.benches import STEPS, mounted, one_trial

LOAD, RATE, LONG = 58.86, 500, 1.5


@pytest.mark.parametrize("sizes", [[750], [500, 250], [499, 1, 250], [50] * 15, [1] * 750, [700, 49, 1]])
def test_the_window_does_not_depend_on_the_blocks(sizes):
    check = LoadCheck(mounted().bench)
    check.put_on(LOAD, "put it on", {"displacement": 0.0, "pressure": 0.0})
    watch = check.watch()
    t = np.arange(1, round(LONG * RATE) + 1) / RATE
    late = t > LONG - 0.5
    cell = np.where(late, 60.0 + t, 0.0)  # 250 samples, evenly spaced: the mean is that of the first and the last one
    x = np.where(late, 0.02, 0.5 * t)
    first = 0
    for size in sizes:
        rows = slice(first, first + size)
        watch(Samples(t[rows], {"force": cell[rows], "displacement": x[rows], "pressure": 3e5 + 0 * t[rows]}))
        first += size
    assert first == len(t)
    verdict = check.verdict()
    assert verdict is not None
    assert verdict.measured == pytest.approx(60.0 + (LONG - 0.5 + 1 / RATE + LONG) / 2, rel=1e-9)
    assert verdict.contraction == pytest.approx(0.02, rel=1e-9)


def test_a_hold_is_computed_in_one_piece_although_its_load_is_looked_at(monkeypatch):
    announced = []

    class Noted(VirtualClock):
        def set_quiet_until(self, moment):
            announced.append(moment - self.now())
            super().set_quiet_until(moment)

    monkeypatch.setattr(run_module, "VirtualClock", Noted)
    outcome = run_module.run_plan(one_trial(*STEPS["hold"]), mounted(), ConfirmedBeforehand(), out=None)
    assert [data["ok"] for kind, _, data in outcome.events if kind == "load-check"] == [True]
    assert STEPS["hold"][1].duration == pytest.approx(max(announced))
