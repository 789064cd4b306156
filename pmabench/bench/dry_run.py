"""A lab's own bench with the simulated plant in place of its devices, for `check --simulate`; opens nothing.

The muscle is simulated from expected coefficients, else from its type, else from its braid. Coefficients give straight
lines of force over contraction; a type or a braid gives a surface (`pmabench.model.real`), with assumed friction and
damping. `factors` covers the uncertainty of its force: a dry run is made with each of them.

Scales, counts, ranges, limits, trips and the safe state remain those of the bench file. What a plant does not have
(other sensors, interlocks, watchdogs, response times of devices) is left out and listed.

Several muscles, on a joint or a platform, are those of paper 3 (modified Daerden) with the specimen's diameter, length
and braid angle; the rest is as the bench file describes it.
"""

from __future__ import annotations

import datetime
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pmabench.base.errors import UsageError
from pmabench.base.quantities import show, without_number
from pmabench.bench.compile import Mounted
from pmabench.bench.driver_options import driver_class
from pmabench.bench.files.specimen import ExpectedFile, ExpectedPoint, SpecimenFile
from pmabench.bench.interface import CompiledBench, DeviceRecord, ValveRecord
from pmabench.model.published_muscles import USUAL_ANGLE as BRAID_ANGLE
from pmabench.model.published_muscles import braid_surface, find_type
from pmabench.model.real.muscle import Surface

LAG, DEAD_TIME = 0.1, 0.02
"""First-order lag and dead time of the simulated regulator [s]: proportional valves on small muscles."""
TYPE_FACTORS = (1.0, 0.8, 1.2)
"""Factors on the force of a type: muscles of one type differ, and those of 100 mm pull a fifth less than long ones."""
BRAID_FACTORS = (0.75, 0.5, 1.0)
"""Factors on the force of a braid: catalogue points of DMSP-20 and DMSP-40 are mostly between half and all of it."""
FRICTION = 0.03
"""Half width of the hysteresis loop, and friction, as a fraction of F_ce."""
TIME_CONSTANT = 0.25
"""Time constant B / K [s]."""
MIDDLE = 0.1
"""Contraction at which K is taken for the damping [1]."""
STRETCHED = -0.03
WIDTHS, WEIGHTS = (0.8e-3, 3.2e-3, 10e-3, 32e-3), (0.2, 0.3, 0.3, 0.2)
"""Widths [fraction of the length] and weights of the hysteresis over contraction: those of the plant `real`."""
STEEPNESS = np.geomspace(5.0, 80.0, 60)
"""Trial values for the exponent of a surface [1]."""
BAR = 1e-5
"""Scales pressures to numbers near 1 [1/Pa]."""
POINTS = 9
"""Number of pressures at which coefficients are computed from a surface."""


@dataclass(frozen=True)
class PredictedMuscle:
    """A muscle as numbers of a plant (without sensor noise), with its source."""

    numbers: dict[str, Any]
    expected: ExpectedFile | None
    """Its coefficients, to predict what it can lift; None if not known."""
    source: str
    """Origin and uncertainty, in words."""
    factors: tuple[float, ...] = (1.0,)
    """Factors on the force to try; the most likely one first."""

    def times(self, factor: float) -> PredictedMuscle:
        """The same muscle with its force multiplied by `factor`."""
        if (expected := self.expected) is not None:
            points = [
                point.model_copy(update={name: factor * getattr(point, name) for name in ("F_ce", "K", "B_c", "B_r")})
                for point in expected.points
            ]
            expected = expected.model_copy(update={"points": points, "F_c": factor * expected.F_c})
        numbers = dict(self.numbers)
        if "surface" in numbers:
            linear = ("A", "A_P", "C", "D", "E")
            numbers["surface"] = {
                key: factor * value if key in linear else value for key, value in numbers["surface"].items()
            }
        return replace(self, numbers=numbers, expected=expected)

    def contraction(self, pressure: float, load: float) -> float | None:
        """Equilibrium contraction [m] under a load [N] at a pressure [Pa], without friction; None if not known."""
        if "surface" in self.numbers:
            eps = np.linspace(self.numbers["reach"][1], 0.0, 201)
            force = Surface(**self.numbers["surface"]).force(eps, np.full(eps.shape, pressure))
            return float(np.interp(load, force, eps)) * float(self.numbers["length"])
        if self.expected is None:
            return None
        points = sorted(self.expected.points, key=lambda point: point.pressure)
        at = [point.pressure for point in points]
        F_ce, K = (float(np.interp(pressure, at, [getattr(p, name) for p in points])) for name in ("F_ce", "K"))
        return min(max(0.0, (F_ce - load) / K), float(self.numbers["stop"]))


def as_expected(expected: ExpectedFile, specimen: SpecimenFile, highest: float, source: str) -> PredictedMuscle:
    """Muscle from coefficients, interpolated linearly between their points, up to `highest` [Pa].

    F_ce is extrapolated linearly below the lowest point, down to 0; the others stay as at the nearest point.
    """
    points = sorted(expected.points, key=lambda point: point.pressure)
    highest = max(points[-1].pressure, highest)
    low = [(0.0, points[0])] if points[0].pressure > 0 else []
    high = [(highest, points[-1])] if highest > points[-1].pressure else []
    at = [*low, *((point.pressure, point) for point in points), *high]
    numbers = {
        **_common(specimen, highest, "expected"),
        "law": "three-element",
        "stop": specimen.limits.contraction * specimen.nominal_length * 1.2,
        "F_ce": {"points": _force(points, highest)},
        **{symbol: {"points": [[P, getattr(point, symbol)] for P, point in at]} for symbol in ("K", "B_c", "B_r")},
        "friction": {"F_s": 1.5 * expected.F_c, "F_c": expected.F_c, "speed": 1e-3},
        "diameter": 0.0,
        "braid_angle": 0.0,
        "flow": None,
    }
    return PredictedMuscle(numbers, expected, source)


def of_specimen(specimen: SpecimenFile, highest: float) -> PredictedMuscle:
    """Muscle from the specimen's type in the library, else from its braid, up to `highest` [Pa]."""
    known = find_type(specimen.make, specimen.type)
    if known is not None and known.surface is not None:
        surface, factors = known.surface, TYPE_FACTORS
        source = f"type {known.name} of the library ({known.source}), force +-20 %, friction and damping assumed"
    else:
        angle, braid = _braid(specimen)
        surface, factors = braid_surface(specimen.inner_diameter, angle), BRAID_FACTORS
        force = "of which a muscle has between half and all of the force"
        source = f"a braid of {braid}, {force}; friction and damping assumed"
    return by_surface(surface, specimen, highest, source, factors)


def _braid(specimen: SpecimenFile) -> tuple[float, str]:
    """Angle of a specimen's braid [rad], and the braid in words."""
    angle = specimen.braid_angle if specimen.braid_angle is not None else BRAID_ANGLE
    assumed = "" if specimen.braid_angle is not None else " (assumed)"
    return angle, f"{show(specimen.inner_diameter, 'length')} and {show(angle, 'angle')}{assumed}"


def by_surface(
    surface: Surface, specimen: SpecimenFile, highest: float, source: str, factors: tuple[float, ...] = (1.0,)
) -> PredictedMuscle:
    """Muscle from a force surface, up to `highest` [Pa], with friction and damping assumed."""
    numbers = {
        **_common(specimen, highest, "surface"),
        "law": "real",
        "reach": [STRETCHED, min(0.45, 1.2 * specimen.limits.contraction)],
        "surface": vars(surface),
        **_damping(surface, specimen.nominal_length, highest),
        "over_x": {
            "widths": [width * specimen.nominal_length for width in WIDTHS],
            "weights": list(WEIGHTS),
            "height": 0.0,
            "per_pressure": FRICTION * (surface.A_P + surface.D),
        },
        "over_P": {"widths": [], "weights": [], "height": 0.0},
        "creep": {"share": 0.0, "times": []},
    }
    found = PredictedMuscle(numbers, _coefficients(surface, specimen, highest, source), source, factors)
    return found.times(factors[0])


def nearest_surface(places: Sequence[tuple[float, float, float]]) -> Surface:
    """Least-squares fit of a surface to places (pressure [Pa], contraction over length [1], force [N])."""
    P, eps, F = np.array(places).T
    bar = P * BAR
    best: tuple[float, Surface] | None = None
    for s in STEEPNESS.tolist():
        bent = np.exp(-s * eps)
        columns = np.stack([bent, bent * bar, eps * bar, bar, np.ones(len(P))], axis=1)
        factors = np.linalg.lstsq(columns, F, rcond=None)[0]
        rms = float(np.sqrt(np.mean((columns @ factors - F) ** 2)))
        if best is None or rms < best[0]:
            A, A_P, C, D, E = factors.tolist()
            best = rms, Surface(A, A_P * BAR, s, C * BAR, D * BAR, E)
    assert best is not None  # noqa: S101  (there are exponents to try)
    return best[1]


def _common(specimen: SpecimenFile, highest: float, file: str) -> dict[str, Any]:
    return {
        "name": f"{specimen.make} {specimen.type}, as expected"[:80],
        "file": file,
        "length": specimen.nominal_length,
        "highest_pressure": highest,
        "regulator": {"dead_time": DEAD_TIME, "lag": LAG},
        "follow_lag": 0.005,
    }


def _damping(surface: Surface, length: float, highest: float) -> dict[str, Any]:
    """B_c and B_r over pressure: the time constant times the stiffness at `MIDDLE`."""
    P = np.linspace(0.0, highest, POINTS)
    B = TIME_CONSTANT * np.maximum(surface.slope(np.full(POINTS, MIDDLE), P), 1.0) / length
    points = {"points": np.stack([P, B], axis=1).tolist()}
    return {"B_c": points, "B_r": points}


def _coefficients(surface: Surface, specimen: SpecimenFile, highest: float, source: str) -> ExpectedFile:
    """F_ce of the surface, and K as its mean slope up to `MIDDLE`, at `POINTS` pressures."""
    P = np.linspace(0.1 * highest, highest, POINTS)
    force = np.maximum(surface.force(np.zeros(POINTS), P), 0.0)
    there = surface.force(np.full(POINTS, MIDDLE), P)
    K = np.maximum(force - there, 1.0) / (MIDDLE * specimen.nominal_length)
    points = [
        ExpectedPoint.model_construct(pressure=p, F_ce=f, K=k, B_c=TIME_CONSTANT * k, B_r=TIME_CONSTANT * k)
        for p, f, k in zip(P.tolist(), force.tolist(), K.tolist(), strict=True)
    ]
    return ExpectedFile.model_construct(source=source, F_c=FRICTION * float(np.median(force)), points=points)


def _force(points: list[Any], highest: float) -> list[list[float]]:
    """F_ce [N] over pressure [Pa], extrapolated linearly beyond the points and never below 0."""
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


def plant_text(muscle: PredictedMuscle, day: datetime.date) -> str:
    """Plant file of a muscle from a surface, for a bench that has no devices yet."""
    numbers = muscle.numbers
    s, stops = numbers["surface"], numbers["over_x"]
    damping = ", ".join(
        f"[{show(P, 'pressure')}, {B * 1e-3:.4g} N.s/mm]" for P, B in numbers["B_c"]["points"]
    )  # fmt: skip
    kilo = {name: f"{1e3 * s[name]:.6g} N/kPa" for name in ("A_P", "C", "D")}
    widths = ", ".join(f"{1e3 * width:.4g} mm" for width in stops["widths"])
    reach = ", ".join(show(ratio, "ratio") for ratio in numbers["reach"])
    return f"""\
# yaml-language-server: $schema=schemas/plant.schema.json
# A guess of {day.isoformat()}, for the simulated bench only: replace it by an analysis of your muscle.
schema: pmabench.plant/1
name: "{numbers["name"]}"
source: "{muscle.source}"
law: real
length: {show(numbers["length"], "length")}
reach: [{reach}]
highest_pressure: {show(numbers["highest_pressure"], "pressure")}
surface: {{A: {s["A"]:.6g} N, A_P: {kilo["A_P"]}, s: {s["s"]:.6g}, C: {kilo["C"]}, D: {kilo["D"]}, E: {s["E"]:.6g} N}}
B_c: {{points: [{damping}]}}
B_r: {{points: [{damping}]}}
hysteresis: {{height: 0 N, per_pressure: {1e3 * stops["per_pressure"]:.4g} N/kPa, widths: [{widths}],
             weights: {list(stops["weights"])}}}
regulator: {{dead_time: {show(DEAD_TIME, "time")}, lag: {show(LAG, "time")}}}
noise: {{pressure: 200 Pa, displacement: 5 um, force: 0.3 N}}
follow_lag: 5 ms
"""


PLANT = "plant"
"""Name of the only device."""
INPUTS = {name: name for name in ("pressure", "displacement", "force", "supply")}
INPUTS |= {f"{name}_command": f"{name}_set" for name in ("pressure", "displacement")}
"""Channel of a bench -> input of the simulated one."""
NOISE = 2e-4
"""Standard deviation of the noise of each channel, as a fraction of its range."""


@dataclass(frozen=True)
class DryRun:
    """A bench that can be run in virtual time."""

    mounted: Mounted
    muscle: str
    """Origin of the simulated muscle."""
    left_out: tuple[str, ...]
    """Sentences on what is not simulated."""


def dry_run(mounted: Mounted, options: Mapping[str, Any], muscle: str) -> DryRun:
    """The bench with a simulated plant from `options` of the mock driver; `muscle` states their origin."""
    bench, many = mounted.bench, bool(mounted.bench_file.muscles)
    known = inputs(mounted) if many else INPUTS
    channels = [channel for channel in bench.channels if channel.name in known]
    if bench.free_end != "actuator":
        channels = [channel for channel in channels if channel.name != "displacement_command"]
    valves = [valve for valve in bench.valves if many or valve.safe == "open" or valve.energised == "open"]
    output_of = valve_output if many else _valve_output
    device = DeviceRecord(
        PLANT,
        driver_class("mock"),
        options={"preset": "bench", "free_end": "actuator" if bench.free_end == "actuator" else "weights", **options},
        channels=tuple(replace(channel, device=PLANT, input=known[channel.name]) for channel in channels),
        outputs=tuple(replace(output, device=PLANT, output=output.name) for output in bench.outputs),
        valves=tuple(replace(valve, device=PLANT, output=output_of(valve)) for valve in valves),
    )
    names = {channel.name for channel in channels}
    made = replace(
        bench,
        simulated=True,
        realtime=False,
        devices=(device,),
        trips=tuple(trip for trip in bench.trips if trip.channel in {*names, "contraction"}),
    )
    return DryRun(replace(mounted, bench=made, session=None), muscle, tuple(_left_out(bench, names)))


def _valve_output(valve: ValveRecord) -> str:
    return "dump_valve" if valve.safe == "open" else "isolation_valve"


def _left_out(bench: CompiledBench, names: set[str]) -> Iterator[str]:
    others = sorted(channel.name for channel in bench.channels if channel.name not in names)
    if others:
        yield f"channels {', '.join(others)} are not simulated, nor are limits on them"
    if any(device.interlocks for device in bench.devices):
        yield "interlocks count as closed"
    yield "faults of devices, times of their answers and clocks that differ are not simulated"


def options_of(muscle: PredictedMuscle, mounted: Mounted) -> dict[str, Any]:
    """Options of the mock driver for a predicted muscle; sensor noise is in proportion to the channels' ranges."""
    if mounted.bench_file.muscles:
        return muscle.numbers
    spans = {channel.name: channel.high - channel.low for channel in mounted.bench.channels}
    noise = {name: NOISE * spans.get(name, 0.0) for name in ("pressure", "displacement", "force")}
    return {"plant": {**muscle.numbers, "noise": noise}, "carriage": mounted.bench.carriage or 0.5}


def highest_pressure(mounted: Mounted) -> float:
    """Highest pressure that the bench may command [Pa]."""
    return max((o.high for o in mounted.bench.outputs if o.quantity == "pressure"), default=0.0)


DUMP, SUPPLY = "dump_valve", "supply_valve"
SAME = ("angle", "torque", "supply", "acceleration_x", "acceleration_y", "acceleration_z", "turn_x", "turn_y")
"""Channels with the same name as an input of the simulated bench."""


def inputs(mounted: Mounted) -> dict[str, str]:
    """Channel of a bench with several muscles -> input of the simulated one."""
    found = {name: name for name in SAME}
    if driven(mounted):
        found["angle_command"] = "angle_set"
    for number in mounted.bench_file.muscles:
        found[f"pressure_{number}"] = f"pressure_{number}"
        if mounted.bench_file.joint is not None:
            found[f"pressure_command_{number}"] = f"pressure_{number}_set"
    return found


def driven(mounted: Mounted) -> bool:
    """Whether a drive turns the joint."""
    return any(output.name == "angle" for output in mounted.bench.outputs)


def valve_output(valve: ValveRecord) -> str:
    """Valve of the simulated bench that represents it: of the same name, or the one before all muscles."""
    return valve.name if valve.longest or without_number(valve.name)[0] == DUMP else SUPPLY


def several(mounted: Mounted) -> tuple[dict[str, Any], str]:
    """Options of the mock driver, and a text on the origin of the muscles.

    Raises UsageError if the bench file lacks the dimensions of the joint, or has another free end.
    """
    file, specimen = mounted.bench_file, mounted.specimen_file
    angle, braid = _braid(specimen)
    muscle = {
        "diameter": specimen.inner_diameter,
        "length": specimen.mounted.length or specimen.nominal_length,
        "braid_angle": angle,
        "atmosphere": file.air.atmosphere,
    }
    if file.platform is not None:
        options: dict[str, Any] = {"plant": "platform", "built": {**muscle, **mounted.bench.platform}}
    elif file.joint is not None:
        options = {"plant": "joint", "built": {**muscle, **_joint(mounted)}}
    else:
        what = f'"{file.name}" has several muscles that turn neither a joint nor a platform'
        remedy = "check without --simulate, which still checks limits and times of the plan"
        raise UsageError(f"{what}, and nothing else of several muscles can be simulated: {remedy}")
    options["free_end"] = "actuator" if driven(mounted) else "weights"
    source = f"{len(file.muscles)} muscles of paper 3 of {braid}, of whose force a muscle has between half and all"
    return options, f"{source}; hysteresis, damping, inertia, regulators and valves assumed"


def _joint(mounted: Mounted) -> Mapping[str, float]:
    joint = mounted.bench_file.joint
    found = {} if joint is None else {"pulley": joint.pulley, "contraction": joint.contraction}
    numbers = {name: value for name, value in found.items() if value is not None}
    if missing := sorted(set(found) - set(numbers)):
        what = "does not say on which radius its muscles pull and how far they are contracted at angle 0"
        lacks = f"{what} ({' and '.join(missing)} missing), and a joint cannot be simulated without"
        remedy = 'add "pulley: 25 mm, contraction: 10 %" with your numbers to "joint" in the bench file'
        raise UsageError(f'"{mounted.bench.name}" {lacks}: {remedy}')
    return numbers
