"""Common parts of tests with a driven end: limits of the actuator, expected force, and rise of pressure by motion.

A stretched muscle loses volume. Air that its regulator cannot release in time raises the pressure (paper 3, chamber
equation), which is compared with the limits of bench and muscle. It is predicted with the bench's `air: conductance`;
without that, a fast motion counts as one with a closed volume.

For a joint of two muscles also the names of its pressures, the limits of its drive, and the steps of a trial.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import ceil, cos, inf, isclose, pi, sin, tan
from typing import Any

from pmabench.base.quantities import show
from pmabench.bench.files.specimen import ExpectedFile
from pmabench.files.document import Location
from pmabench.protocol.common import Compilation
from pmabench.protocol.plan import Hold, Ramp, Record, Set, Step

ARRIVED = 1.0
"""Rest after the approach [s]."""
VENT_HOLD = 3.0
"""Time after the last vent [s]."""


@dataclass(frozen=True)
class Believed:
    """Expected coefficients of a specimen at one pressure: F_ce [N], K [N/m], B_c and B_r [N.s/m], F_c [N]."""

    F_ce: float
    K: float
    B_c: float
    B_r: float
    F_c: float

    def force(self, x: float, v: float) -> float:
        """F_ce - K x - B x' - F_c sign(x') [N] at contraction x [m] and its rate v [m/s] (paper 0)."""
        return self.F_ce - self.K * x - (self.B_c if v > 0 else self.B_r) * v - (self.F_c if v > 0 else -self.F_c)


def believed(expected: ExpectedFile, pressure: float) -> Believed:
    """The specimen's expected coefficients at a pressure [Pa], linearly interpolated; constant beyond the points."""
    points = sorted(expected.points, key=lambda point: point.pressure)
    below = max((p for p in points if p.pressure <= pressure), key=lambda p: p.pressure, default=points[0])
    above = min((p for p in points if p.pressure >= pressure), key=lambda p: p.pressure, default=points[-1])
    span = above.pressure - below.pressure
    share = (pressure - below.pressure) / span if span > 0 else 0.0
    f_ce, k, b_c, b_r = (
        getattr(below, name) + share * (getattr(above, name) - getattr(below, name))
        for name in ("F_ce", "K", "B_c", "B_r")
    )
    return Believed(f_ce, k, b_c, b_r, expected.F_c)


def along_sine(mean: float, amplitude: float, frequency: float) -> list[tuple[float, float]]:
    """Contractions [m] and their rates [m/s] over one period."""
    phases = [2 * pi * step / 720 for step in range(720)]
    return [(mean + amplitude * sin(p), 2 * pi * frequency * amplitude * cos(p)) for p in phases]


def predicted_force(
    expected: ExpectedFile, pressure: float, mean: float, amplitude: float, frequency: float
) -> tuple[float, float]:
    """Lowest and highest force [N] over one period of a sine (paper 0)."""
    muscle = believed(expected, pressure)
    forces = [muscle.force(x, v) for x, v in along_sine(mean, amplitude, frequency)]
    return min(forces), max(forces)


def not_too_fast(c: Compilation, speed: float, where: Location, what: str) -> None:
    """Check a speed [m/s] against the actuator's."""
    actuator = c.mounted.bench_file.actuator
    if actuator is not None and speed > actuator.speed * (1 + 1e-9):
        c.fault(where, f"{what} at {show(speed, 'speed')}; the actuator at most at {show(actuator.speed, 'speed')}")


def bearable(c: Compilation, pressure: float, path: Iterable[tuple[float, float]], where: Location, lower: str) -> None:
    """Check the force predicted along `path` (contraction [m], rate [m/s]) against slack and the actuator's force.

    `lower` names the setting to reduce, for the message. No check without expected values in the specimen file.
    """
    actuator, expected = c.mounted.bench_file.actuator, c.mounted.specimen_file.expected
    if actuator is None or expected is None:
        return
    muscle = believed(expected, pressure)
    forces = [muscle.force(x, v) for x, v in path]
    if min(forces) < c.mounted.bench.slack_below:
        c.fault(
            where,
            f"at {show(pressure, 'pressure')} the force is predicted to fall to {min(forces):.0f} N: the specimen goes "
            f"slack (raise the pressure, or lower {lower})",
        )
    if max(forces) > actuator.force:
        c.fault(
            where, f"the force is predicted to reach {max(forces):.0f} N; the actuator bears {actuator.force:.0f} N"
        )


def check_motion(c: Compilation, trial: Any, *names: str) -> None:
    """Check entries of a trial that must be above zero, its speed of approach, and that cycles are left to evaluate."""
    c.positives(trial, ("trial",), "approach", *names)
    not_too_fast(c, trial.approach, ("trial", "approach"), "it approaches")
    if getattr(trial, "discard", 0) >= getattr(trial, "cycles", inf):
        c.fault(("trial", "discard"), f"leaves nothing of {trial.cycles} cycles")


@dataclass
class Held:
    """The driven end in a compilation: the pressure [Pa] and the place [m] at which it is held; None at first."""

    c: Compilation
    settle: float
    approach: float
    at: tuple[float, float] | None = None

    def go(self, pressure: float, place: float) -> None:
        """Add the steps to a pressure, by way of contraction 0, and to a place; none where it is held there."""
        if self.at is not None and isclose(self.at[0], pressure, abs_tol=1e-6) and self.at[1] == place:
            return
        back = [] if self.at is None else [Ramp("return", "displacement", self.at[1], 0.0, self.approach)]
        self.c.steps += [
            *back,
            Set("pressurise", "pressure", pressure),
            Hold("pressurise", self.settle),
            Ramp("approach", "displacement", 0.0, place, self.approach),
            Hold("approach", ARRIVED),
        ]
        self.at = pressure, place

    def leave(self) -> None:
        """Add the steps back to contraction 0 and to pressure 0."""
        self.c.steps += leave(0.0 if self.at is None else self.at[1], self.approach)


def leave(back_from: float, approach: float) -> list[Step]:
    """Steps back to contraction 0 [m] and to pressure 0."""
    back: Sequence[Step] = [Ramp("return", "displacement", back_from, 0.0, approach)] if approach > 0 else []
    return [*back, Set("vent", "pressure", 0.0), Hold("vent", VENT_HOLD)]


def minor_loop(minor: Any, output: str, start: float, rate: float) -> list[Step]:
    """Ramps at a `rate` [SI/s] through the cycles of a small loop, from `start` [SI] and back; none without a loop."""
    if minor is None:
        return []
    places = [start, *(minor.upper, minor.lower) * minor.cycles, minor.upper, start]
    return [Ramp("minor", output, begin, end, rate) for begin, end in pairwise(places)]


R_AIR, ROOM = 287.0, 293.0
"""Gas constant of air [J/(kg K)] (paper 3) and its temperature [K]."""
POLYTROPIC = 1.4
"""Adiabatic, the highest exponent of paper 3: the safe side."""
ALPHA = 2.6
"""Exponent of the volume; above the 2 of an ideal braid the volume changes more, which is the safe side."""
SLOW = 10.0
"""With an unknown conductance, a motion with at least this period [s] counts as slow for any regulator."""
STEPS = 360
PERIODS = 4


@dataclass(frozen=True)
class Tube:
    """A muscle's size: free diameter and length [m], braid angle [rad]."""

    diameter: float
    length: float
    braid_angle: float

    def volume(self, x: float) -> float:
        """V [m3] at contraction x [m] (paper 3, volume of the muscle); 0 where x is longer than the muscle."""
        left = max(0.0, 1.0 - x / self.length)
        size = pi / 4 * self.diameter**2 * self.length
        return float(size * (1 / sin(self.braid_angle) ** 2 - left**ALPHA / tan(self.braid_angle) ** 2) * left)


@dataclass(frozen=True)
class Supply:
    """Conductances of the regulator while filling and venting [kg/s/Pa], and the room's pressure [Pa absolute]."""

    fill: float
    vent: float
    atmosphere: float


def peak(
    pressure: float, path: Sequence[float], period: float, tube: Tube, supply: Supply | None, room: float
) -> float:
    """Highest gauge pressure [Pa] at a set `pressure` [Pa] during a motion through the contractions `path` [m].

    `path`: contractions at equal times of one `period` [s], which repeats. Without a `supply`
    no air flows between the largest and the smallest volume; `room` is the ambient pressure [Pa absolute].
    """
    volumes = [tube.volume(x) for x in path]
    if min(volumes) <= 0:
        return inf
    if supply is None:
        return float((pressure + room) * (max(volumes) / min(volumes)) ** POLYTROPIC - room)
    dt = period / len(volumes)
    P, highest = pressure, pressure
    for _ in range(PERIODS):
        for i, volume in enumerate(volumes):
            grow = (volume - volumes[i - 1]) / dt
            conductance = supply.fill if pressure > P else supply.vent
            flow = POLYTROPIC * R_AIR * ROOM * conductance
            # backward Euler, linear in P: stable however large the conductance
            P = (P + dt * (flow * pressure - POLYTROPIC * room * grow) / volume) / (
                1 + dt * (flow + POLYTROPIC * grow) / volume
            )
            highest = max(highest, P)
    return highest


def not_pushed_together(
    c: Compilation,
    pressure: float,
    motion: Callable[[float], tuple[Sequence[float], float]],
    size: tuple[float, str, str],
    pace: tuple[float, str, str],
    where: Location,
) -> None:
    """Check that the pressure during a motion stays below the pressure trip and the specimen's `never_above`.

    `motion(share)` returns the contractions over one period and the period [s] for a motion of `share` times the wanted
    size. `size` is that size and `pace` the speed or frequency, each with its quantity and name. No check for a
    specimen file without a braid angle.
    """
    specimen, bench = c.mounted.specimen_file, c.mounted.bench
    if specimen.braid_angle is None or pressure <= 0:
        return
    tube = Tube(specimen.inner_diameter, specimen.nominal_length, specimen.braid_angle)
    air = c.mounted.bench_file.air
    conductance = air.conductance
    supply = None if conductance is None else Supply(conductance.fill, conductance.vent, air.atmosphere)
    if supply is None and motion(1.0)[1] >= SLOW:
        return
    limit, source = specimen.limits.pressure.never_above, "never_above of the specimen"
    for trip in bench.trips:
        if trip.channel == "pressure" and trip.kind == "range" and trip.action != "warn" and trip.high is not None:
            limit, source = min((limit, source), (trip.high, f"trip of measured pressure, {trip.source}"))

    def reached(P: float, share: float, slower: float = 1.0) -> float:
        path, period = motion(share)
        return peak(P, path, period / slower, tube, supply, air.atmosphere)

    high = reached(pressure, 1.0)
    if high <= limit:
        return
    shares = (
        (*size, _largest(lambda s: reached(pressure, s) <= limit)),
        (*pace, _largest(lambda s: reached(pressure, 1.0, s) <= limit) if supply is not None else 0.0),
        (pressure, "pressure", "pressure", _largest(lambda s: reached(pressure * s, 1.0) <= limit)),
    )
    allowed = [
        f"{name} up to {show(_down(share * value), quantity, 3)}"
        for value, quantity, name, share in shares
        if share > 0.01
    ]
    how = (
        "with the bench's air conductance"
        if supply is not None
        else "as a closed volume, for the bench file has no air: {conductance: {fill, vent}}"
    )
    options = " or ".join(allowed) or "slower motions"
    c.fault(
        where,
        f"the motion pushes the air together to {show(high, 'pressure', 3)} at a set {show(pressure, 'pressure')} "
        f"({how}); the cap is {show(limit, 'pressure')} ({source}); allowed are {options}",
    )


def _largest(allowed: Callable[[float], bool]) -> float:
    """The largest fraction below 1 that is allowed, found by bisection; 0 where none is."""
    low, high = 0.0, 1.0
    for _ in range(12):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if allowed(middle) else (low, middle)
    return low


def _down(value: float) -> float:
    """A number rounded down to two digits, so that the value reported as allowed is allowed."""
    if value <= 0:
        return 0.0
    digit = 10.0 ** (len(f"{int(value * 1e9)}") - 11)
    return (ceil(value / digit) - 1) * digit


MUSCLES = ("pressure_1", "pressure_2")


def at_pressures(
    pressures: Mapping[str, float], settle: float, lowest: float, speed: float, index: int, cycles: Iterable[Step]
) -> list[Step]:
    """Steps of a joint's trial: pressurise both muscles at angle 0, move to the lowest angle, `cycles`, back to 0."""
    return [
        *(Set("pressurise", name, pressures[name]) for name in MUSCLES),
        Hold("pressurise", settle),
        Ramp("approach", "angle", 0.0, lowest, speed),
        Record("rise", True, index),
        *cycles,
        Record("fall", False, index),
        Ramp("return", "angle", lowest, 0.0, speed),
    ]


def vented() -> list[Step]:
    """Steps that vent both muscles together, and a rest."""
    return [*(Set("vent", name, 0.0) for name in MUSCLES), Hold("vent", VENT_HOLD)]


def not_faster(c: Compilation, speed: float, place: Location) -> None:
    """Note a problem where a speed [rad/s] is not above 0, or above what the drive of the joint can do."""
    c.positive(speed, place)
    output = next((o for o in c.mounted.bench.outputs if o.name == "angle"), None)
    if output is not None and output.rate and speed > output.rate * (1 + 1e-9):
        most = show(output.rate, "angular speed")
        c.fault(place, f"{show(speed, 'angular speed')} is faster than the drive of the joint, {most}")
