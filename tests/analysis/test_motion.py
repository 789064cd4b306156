"""Nothing moved: `process` says so, as the display does while the run lasts."""

import numpy as np
import pytest

from pmabench.analysis.shared.samples import with_motion
from pmabench.kinds.reduce import reduce_runs
from pmabench.store.analyses.results import Analysis, Estimate
from pmabench.store.reader import open_run
from pmabench.store.records import RunData, TrialData
from tests.display.recorded import Recorded

NOISE, T = 1e-4 * np.random.default_rng(1).normal(0.0, 1.0, 2000), np.arange(2000) / 500.0
STEP = np.where(T > 2.0, 2e-3, 0.0)


def doubts(points, *, moved=(), kind="contraction-relaxation", estimates=()):
    """What is doubted of trials at `points`, of which those in `moved` moved by 2 mm."""
    trials = tuple(
        TrialData("run", i, point, 0, False, "finished", T, {"displacement": NOISE + (STEP if i in moved else 0.0)},
                  np.zeros(2000, np.uint16), (), {})
        for i, point in enumerate(points)
    )  # fmt: skip
    run = RunData("run", "run", kind, "finished", True, {}, {}, (), {}, 500.0, trials)
    analysis = Analysis(kind, ("run",), True, tuple(estimates))
    return [
        finding.text for finding in with_motion(analysis, [run], "displacement").findings if finding.level == "doubt"
    ]


def measured(*, friction=10.0, **pulls):
    """F_ce at P100 = 100 kPa and so on, and F_c [N]."""
    F = [Estimate("F_ce", pull, "N", "force", "m", {"pressure": 1e3 * float(at[1:])}) for at, pull in pulls.items()]
    return [*F, Estimate("F_c", friction, "N", "force", "m")]


def up(pressure, load):
    return {"from": 0.0, "pressure": pressure, "load": load}


def test_a_trial_in_which_nothing_moved_is_named():
    points = [up(3e5, 100.0), up(3e5, 100.0), up(4e5, 100.0)]
    [text] = doubts(points, moved=(0, 2), estimates=measured(P300=200.0, P400=300.0))
    assert text.startswith("nothing moved in 1 of 3 trials (run/2): displacement changed by less than its noise")


def test_many_are_counted_and_few_are_named():
    [text] = doubts([up(3e5, 10.0)] * 9)
    assert text.startswith("nothing moved in 9 of 9 trials (run/1, run/2, run/3 ...)")


@pytest.mark.parametrize("moved", [(0,), (0, 1)])
def test_nothing_is_said_where_all_moved_that_should(moved):
    """At 300 kPa the muscle pulls 200 N: 190 N are held by a friction of 10 N, and it need not move."""
    assert not doubts([up(3e5, 100.0), up(3e5, 190.0)], moved=moved, estimates=measured(P300=200.0))


def test_the_pull_at_a_higher_pressure_bounds_that_at_a_lower_one():
    """Measured at 300 kPa only: 250 N are not lifted at 200 kPa either; at 400 kPa they may be."""
    known = measured(P300=200.0)
    assert not doubts([up(2e5, 250.0)], estimates=known)
    assert doubts([up(4e5, 250.0)], estimates=known)


def test_a_driven_end_moves_whatever_hangs_on_it():
    assert doubts([{"pressure": 0.0, "frequency": 1.0}], kind="sinusoidal-displacement")
    assert not doubts([{"pressure": 0.0}], kind="free-contraction")


def test_process_says_it_of_a_recorded_run(tmp_path):
    run = Recorded(tmp_path, [(58.86, 3e5), (107.91, 3e5)])
    run.trial(0)
    run.trial(1, factor=0.0)
    [analysis] = reduce_runs([open_run(run.close())])
    [text] = [finding.text for finding in analysis.findings if "nothing moved" in finding.text]
    assert "in 1 of 2 trials" in text
