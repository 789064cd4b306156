"""A lab's own bench with the simulated plant in place of its devices, for `check --simulate`; opens nothing.

Scales, counts, ranges, limits, trips and the safe state stay as the bench file has them. What has no place in a plant
(other sensors, interlocks, watchdogs, the time that devices need) is left out and named.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from pmabench.base.quantities import show
from pmabench.bench.compile import Mounted
from pmabench.bench.files.specimen import ExpectedFile
from pmabench.bench.interface import CompiledBench, DeviceRecord, TripRecord
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
LAG, DEAD_TIME = 0.1, 0.02
"""Of the simulated regulator [s]: those of proportional valves on small muscles."""
NOISE = 2e-4
"""Of each channel, as a share of its range."""
ALWAYS = {"plant", "preset"}


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


def options_of(expected: ExpectedFile, mounted: Mounted) -> dict[str, Any]:
    """Options of the mock driver for the muscle that the specimen file expects, on straight lines between its points.

    F_ce goes on straight below the lowest point, down to 0; all else stays as at the nearest point.
    """
    points = sorted(expected.points, key=lambda point: point.pressure)
    highest = max([points[-1].pressure, *(o.high for o in mounted.bench.outputs if o.quantity == "pressure")])
    curves: dict[str, Any] = {}
    for symbol in ("K", "B_c", "B_r"):
        values = [[point.pressure, getattr(point, symbol)] for point in points]
        curves[symbol] = {"points": _to(0.0, values) + _to(highest, values)}
    curves["F_ce"] = {"points": _force(points, highest)}
    specimen = mounted.specimen_file
    noise = {
        channel.name: NOISE * (channel.high - channel.low)
        for channel in mounted.bench.channels
        if channel.name in ("pressure", "displacement", "force")
    }
    numbers = {
        "law": "three-element",
        "name": f"{specimen.make} {specimen.type}, as expected",
        "file": "expected",
        "length": specimen.nominal_length,
        "stop": specimen.limits.contraction * specimen.nominal_length * 1.2,
        "highest_pressure": highest,
        **curves,
        "friction": {"F_s": 1.5 * expected.F_c, "F_c": expected.F_c, "speed": 1e-3},
        "regulator": {"dead_time": DEAD_TIME, "lag": LAG},
        "noise": {name: noise.get(name, 0.0) for name in ("pressure", "displacement", "force")},
        "follow_lag": 0.005,
        "diameter": 0.0,
        "braid_angle": 0.0,
        "flow": None,
    }
    return {"plant": numbers, "carriage": mounted.bench.carriage or 0.5}


def _to(end: float, values: list[list[float]]) -> list[list[float]]:
    """For an end of the range beyond the points: that end with the value of the nearest; the points with the upper."""
    if end <= values[0][0]:
        return [[end, values[0][1]]] if end < values[0][0] else []
    return [*values, *([[end, values[-1][1]]] if end > values[-1][0] else [])]


def _force(points: list[Any], highest: float) -> list[list[float]]:
    """F_ce [N] over pressure [Pa], straight on beyond the points and never below 0."""
    known = [[point.pressure, point.F_ce] for point in points]
    if len(known) > 1:
        (P0, F0), (P1, F1) = known[:2]
        slope = (F1 - F0) / (P1 - P0)
        zero = P0 - F0 / slope if slope > 0 else 0.0
        (P8, F8), (P9, F9) = known[-2:]
        top = F9 + (F9 - F8) / (P9 - P8) * (highest - P9)
    else:
        zero, top = 0.0, known[0][1] * highest / max(known[0][0], 1.0)
    low = [[0.0, 0.0], [zero, 0.0]] if 1.0 < zero < known[0][0] - 1.0 else [[0.0, 0.0]] if known[0][0] > 0 else []
    high = [[highest, top]] if highest > known[-1][0] + 1.0 else []
    return [*low, *known, *high]


def wants(mounted: Mounted) -> str:
    """What a specimen file lacks for a dry run; empty where nothing."""
    if mounted.specimen_file.expected is not None:
        return ""
    highest = max((o.high for o in mounted.bench.outputs if o.quantity == "pressure"), default=0.0)
    return (
        "the specimen file says nothing of the coefficients that are expected: write `expected` into it, with F_ce, K,"
        f" B_c and B_r at pressures up to {show(highest, 'pressure')}, from an earlier analysis or the data sheet"
    )
