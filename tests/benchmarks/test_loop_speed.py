"""How fast closed loops run in virtual time, from the plan to the closed record: real-time factors, printed. `make bench`.

A relay keeps its command for many samples and is given them in blocks; a position loop commands at every sample.
"""

import shutil
import time

import pytest

from pmabench.cli.prepare import prepare
from pmabench.engine.operator import ConfirmedBeforehand
from pmabench.engine.run import run_plan
from pmabench.store.reader import open_run

CASES = {
    "relay": ("ultimate-gain-relay", 100.0, (("sweep.repeat.count", "4"),)),
    "position loop": ("positioning-pi", 15.0, (("sweep.matrix.setpoint", "[30 mm]"),)),
}
"""Protocol, the factor that is asserted, settings."""


@pytest.mark.parametrize("case", CASES)
def test_real_time_factor_of_a_loop(case, benchmark, tmp_path):
    protocol, least, settings = CASES[case]
    few = [*settings, ("prepare.precondition.cycles", "0")]
    if benchmark.disabled:
        few.append(("sweep.repeat.count", "1") if case == "relay" else ("trial.hold", "4 s"))
        few += [("trial.window", "[1 s, 4 s]")] if case != "relay" else []
    prepared = prepare(protocol, "mock-linear", "mas-20-250-paper0", few)
    best, seconds = float("inf"), 0.0
    for _ in range(1 if benchmark.disabled else 5):
        begun = time.process_time()
        outcome = run_plan(prepared.plan, prepared.mounted, ConfirmedBeforehand(), out=tmp_path)
        best = min(best, time.process_time() - begun)
        assert outcome.status == "finished"
        seconds = sum(float(trial.t[-1] - trial.t[0]) for trial in open_run(outcome.folder).trials)
        shutil.rmtree(outcome.folder)
    print(f"\n{case}: {best:.2f} s for {seconds:.0f} s recorded at 500 Hz, {seconds / best:.0f} times real time")
    benchmark.pedantic(lambda: None, rounds=1)
    if not benchmark.disabled:
        assert seconds / best >= least
