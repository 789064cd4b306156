"""How fast a platform goes in virtual time at 500 Hz, in processor time: its plant alone, and with law, watch and record."""

import math

from pmabench.engine.operator import ConfirmedBeforehand
from pmabench.engine.run import run_plan
from pmabench.model.many.platform import PlatformPlant
from tests.benchmarks.least import least
from tests.engine.platform_rig import SHIPPED
from tests.kinds.test_platform import steps

LEAST_RUN, LEAST_PLANT = 4.0, 8.0
"""Times real time that are asked for."""
ALONE = 4.0
"""Bench time of the plant alone [s]."""


def alone():
    """Samples of a platform that 3 pulses a second and muscle turn, as many as a run has."""
    plant = PlatformPlant(noise=0.0)
    for number in range(1, round(ALONE * 500) + 1):
        if number % 167 == 0:
            plant.pulse("fill" if number % 2 else "exhaust", number % 3, 0.01)
        plant.advance(number * 0.002)
        plant.measure()
    return plant.state


def test_a_platform_goes_faster_than_the_clock(benchmark, tmp_path):
    plan = steps((10, 0), hold=2 if benchmark.disabled else 20, made=SHIPPED)
    times = 2 if benchmark.disabled else 5
    spent, outcome = least(lambda: run_plan(plan, SHIPPED, ConfirmedBeforehand(), out=tmp_path), times)
    by_plant, state = least(alone, times)
    assert outcome.status == "finished"
    assert math.isfinite(state[0])
    whole, plant = outcome.bench_seconds / spent, ALONE / by_plant
    print(
        f"\nthrough the executor {whole:.1f} times real time (asked {LEAST_RUN:g}), plant alone {plant:.1f} ({LEAST_PLANT:g})"
    )
    benchmark.pedantic(lambda: None, rounds=1)
    assert whole > LEAST_RUN
    assert plant > LEAST_PLANT
