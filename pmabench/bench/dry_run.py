"""A lab's own bench with the simulated plant in place of its devices, for `check --simulate`; opens nothing.

Scales, counts, ranges, limits, trips and the safe state stay as the bench file has them. What has no place in a plant
(other sensors, interlocks, watchdogs, the time that devices need) is left out and named.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from pmabench.base.errors import UsageError
from pmabench.bench.compile import Mounted
from pmabench.bench.interface import CompiledBench, DeviceRecord, TripRecord
from pmabench.bench.predicted_muscle import PredictedMuscle
from pmabench.bench.registry import driver_class

PLANT = "plant"
"""Name of the only device."""
INPUTS = {
    "pressure": "pressure",
    "displacement": "displacement",
    "force": "force",
    "supply": "supply",
    "pressure_command": "pressure_set",
    "displacement_command": "displacement_set",
}
"""Channel of a bench -> input of the simulated one."""
NOISE = 2e-4
"""Of each channel, as a share of its range."""


@dataclass(frozen=True)
class DryRun:
    """A bench that can be run in virtual time."""

    mounted: Mounted
    muscle: str
    """Where the simulated muscle comes from."""
    left_out: tuple[str, ...]
    """What is not simulated, a sentence each."""


def dry_run(mounted: Mounted, options: Mapping[str, Any], muscle: str) -> DryRun:
    """The bench with a simulated plant by `options` of the mock driver; `muscle` says where these are from."""
    bench = mounted.bench
    if mounted.bench_file.muscles:
        raise UsageError(
            f'"{bench.name}" has several muscles, and the simulated plant that takes the place of devices has one: '
            "check without --simulate, which still checks limits and times of the plan, or simulate with the shipped "
            "benches mock-joint, mock-joint-free or mock-platform, whose muscles are others"
        )
    channels = [channel for channel in bench.channels if channel.name in INPUTS]
    if bench.free_end != "actuator":
        channels = [channel for channel in channels if channel.name != "displacement_command"]
    valves = [valve for valve in bench.valves if valve.safe == "open" or valve.energised == "open"]
    device = DeviceRecord(
        PLANT,
        driver_class("mock"),
        options={"preset": "bench", "free_end": "actuator" if bench.free_end == "actuator" else "weights", **options},
        channels=tuple(replace(channel, device=PLANT, input=INPUTS[channel.name]) for channel in channels),
        outputs=tuple(replace(output, device=PLANT, output=output.name) for output in bench.outputs),
        valves=tuple(
            replace(valve, device=PLANT, output="dump_valve" if valve.safe == "open" else "isolation_valve")
            for valve in valves
        ),
    )
    names = {channel.name for channel in channels}
    made = replace(
        bench,
        simulated=True,
        realtime=False,
        devices=(device,),
        trips=tuple(_kept(bench, names)),
    )
    return DryRun(replace(mounted, bench=made, session=None), muscle, tuple(_left_out(bench, names)))


def _kept(bench: CompiledBench, names: set[str]) -> Iterator[TripRecord]:
    """The trips on what is simulated."""
    return (trip for trip in bench.trips if trip.channel in names or trip.channel == "contraction")


def _left_out(bench: CompiledBench, names: set[str]) -> Iterator[str]:
    others = sorted(channel.name for channel in bench.channels if channel.name not in names)
    if others:
        yield f"channels {', '.join(others)} are not simulated, nor are limits on them"
    if any(device.interlocks for device in bench.devices):
        yield "interlocks count as closed"
    yield "faults of devices, times of their answers and clocks that differ are not simulated"


def options_of(muscle: PredictedMuscle, mounted: Mounted) -> dict[str, Any]:
    """Options of the mock driver for a predicted muscle, with sensors as noisy as the channels' ranges are wide."""
    noise = {
        channel.name: NOISE * (channel.high - channel.low)
        for channel in mounted.bench.channels
        if channel.name in ("pressure", "displacement", "force")
    }
    numbers = {
        **muscle.numbers,
        "noise": {name: noise.get(name, 0.0) for name in ("pressure", "displacement", "force")},
    }
    return {"plant": numbers, "carriage": mounted.bench.carriage or 0.5}


def highest_pressure(mounted: Mounted) -> float:
    """Highest pressure that the bench may command [Pa]."""
    return max((o.high for o in mounted.bench.outputs if o.quantity == "pressure"), default=0.0)
