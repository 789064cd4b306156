"""What closed loops cost in virtual time, from the plan to the closed record, over the plant alone in a loop at 500 Hz.

A relay keeps its command for many samples and is given them in blocks; a position loop commands at every sample.
"""

import pytest

from pmabench.cli.prepare import prepare
from pmabench.engine.operator import ConfirmedBeforehand
from pmabench.engine.run import run_plan
from pmabench.store.reader import open_run
from tests.benchmarks.least import least
from tests.benchmarks.test_plant_speed import closed_loop

CASES = {
    "relay": ("ultimate-gain-relay", 9, (("sweep.repeat.count", "4"),)),
    "position loop": ("positioning-pi", 30, (("sweep.matrix.setpoint", "[30 mm]"),)),
}
"""Protocol, how many times the processor time of the plant alone at most, settings."""


@pytest.mark.parametrize("case", CASES)
def test_a_loop_costs_some_times_the_plant_alone(case, benchmark, tmp_path):
    protocol, most, settings = CASES[case]
    few = [*settings, ("prepare.precondition.cycles", "0")]
    if benchmark.disabled:
        few.append(("sweep.repeat.count", "1") if case == "relay" else ("trial.hold", "4 s"))
        few += [("trial.window", "[1 s, 4 s]")] if case != "relay" else []
    prepared = prepare(protocol, "mock-linear", "mas-20-250-paper0", few)

    def run():
        return run_plan(prepared.plan, prepared.mounted, ConfirmedBeforehand(), out=tmp_path)

    took, outcome = least(run, 1 if benchmark.disabled else 5)
    alone = least(closed_loop)[0] / 20
    assert outcome.status == "finished"
    seconds = sum(float(trial.t[-1] - trial.t[0]) for trial in open_run(outcome.folder).trials)
    times = took / (alone * seconds)
    print(
        f"\n{case}: {took:.2f} s for {seconds:.0f} s recorded at 500 Hz, {times:.1f} times the plant alone, at most {most}"
    )
    benchmark.pedantic(lambda: None, rounds=1)
    assert times < most
