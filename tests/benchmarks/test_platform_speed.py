"""How fast pair and platform go in virtual time at 500 Hz, in processor time: plants alone; with law, watch and record."""

import math

from pmabench.engine.operator import ConfirmedBeforehand
from pmabench.engine.run import run_plan
from pmabench.model.many.joint import Joint, JointPlant
from pmabench.model.many.platform import PlatformPlant
from pmabench.model.regulator import constant
from tests.benchmarks.least import least
from tests.engine.platform_rig import SHIPPED
from tests.kinds.test_joint_step import bench, compiled
from tests.kinds.test_platform import steps

LEAST_RUN, LEAST_PLANT = 4.0, 8.0
"""Times real time that are asked for of the platform ..."""
LEAST_PAIR, LEAST_JOINT = 20.0, 50.0
"""... and of the pair."""
ALONE = 4.0
"""Bench time of the plant alone [s]."""


def alone():
    """Samples of a platform that 3 pulses a second and muscle turn, as many as a run has."""
    plant = PlatformPlant()
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
    benchmark.pedantic(lambda: None, rounds=1)
    compare(outcome.bench_seconds / spent, LEAST_RUN, ALONE / by_plant, LEAST_PLANT, measured=benchmark.enabled)


def compare(whole, least_whole, plant, least_plant, *, measured):
    """On a busy computer, where nothing is `measured`, half of what is asked for is enough."""
    print(
        f"\nthrough the executor {whole:.1f} times real time (asked {least_whole:g}), "
        f"plant alone {plant:.1f} ({least_plant:g})"
    )
    assert whole > (1.0 if measured else 0.5) * least_whole
    assert plant > (1.0 if measured else 0.5) * least_plant


def pair_alone():
    """A joint whose pressures change in opposite ways at each sample, as a law changes them."""
    plant = JointPlant(Joint(), (3e5, 3e5))
    for number in range(1, round(ALONE * 500) + 1):
        turn = 0.5e5 * math.sin(2 * math.pi * number / 500)
        for muscle, P in enumerate((3e5 + turn, 3e5 - turn)):
            plant.command(muscle, constant(plant.time, P))
        plant.advance(number * 0.002)
    return plant.torque()


def test_a_pair_goes_faster_than_the_clock(benchmark, tmp_path):
    made = bench()
    plan, times = compiled(("sweep.repeat.count", "1" if benchmark.disabled else "3"), made=made), 2
    spent, outcome = least(lambda: run_plan(plan, made, ConfirmedBeforehand(), out=tmp_path), times)
    by_plant, torque = least(pair_alone, times)
    assert outcome.status == "finished"
    assert math.isfinite(torque)
    benchmark.pedantic(lambda: None, rounds=1)
    compare(outcome.bench_seconds / spent, LEAST_PAIR, ALONE / by_plant, LEAST_JOINT, measured=benchmark.enabled)
