"""The session of a bench file in SI, and the loads that its stack of weights can make."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

from pmabench.base.quantities import in_words, show
from pmabench.bench.compilation import Compilation
from pmabench.bench.files.session import SelfTestFile, SessionFile
from pmabench.files.document import Location

TOLERANCE = 1e-3
"""Difference within which a load counts as made [kg]."""
MOST_SUMS = 200_000
"""Largest number of different stacks that are considered."""
_GRID = 1e-4
"""Resolution of masses [kg]; stacks closer together count as equal."""


@dataclass(frozen=True)
class Stack:
    """A hanger and its plates."""

    hanger: float
    """Mass of the hanger [kg]."""
    plates: Sequence[tuple[int, float]]
    """Count and mass [kg] of each kind of plate; empty: not known, any load from the hanger upwards is accepted."""

    @cached_property
    def _sums(self) -> dict[int, tuple[int, int]]:
        """Mass of plates in units of `_GRID` -> mass without the last plate, and index of that plate.

        Plates are added from the heaviest on; each mass keeps its first combination, so no plate is used too often.
        """
        sums = {0: (0, -1)}
        for number, (count, each) in enumerate(self._heaviest_first):
            step = round(each / _GRID)
            edge = list(sums) if step > 0 else []
            for _ in range(count):
                edge = [mass for mass in edge if mass + step not in sums]
                sums.update((mass + step, (mass, number)) for mass in edge)
                edge = [mass + step for mass in edge]
                if not edge or len(sums) > MOST_SUMS:
                    break
            if len(sums) > MOST_SUMS:
                break
        return sums

    @cached_property
    def _heaviest_first(self) -> list[tuple[int, float]]:
        return sorted(self.plates, key=lambda plate: -plate[1])

    @cached_property
    def loads(self) -> list[float]:
        """All loads that can be made [kg], ascending: nothing, the hanger, the hanger with plates."""
        return sorted({0.0, *(self.hanger + mass * _GRID for mass in self._sums)})

    def around(self, mass: float) -> list[float]:
        """Nearest possible loads [kg] below and above `mass`; a single one if `mass` itself is possible."""
        if not self.plates:
            return [mass] if mass == 0 or mass >= self.hanger - TOLERANCE else [0.0, self.hanger]
        place = bisect_left(self.loads, mass)
        near = self.loads[max(place - 1, 0) : place + 1]
        return [load for load in near if abs(load - mass) <= TOLERANCE][:1] or near

    def can_make(self, mass: float) -> bool:
        """Whether `mass` [kg] is one of the loads."""
        near = self.around(mass)
        return len(near) == 1 and abs(near[0] - mass) <= TOLERANCE

    def why_not(self, mass: float, shown: Callable[[float], str] = "{:g} kg".format) -> str:
        """Why a load cannot be made, with the nearest ones, formatted by `shown`; empty if it can."""
        if self.can_make(mass):
            return ""
        near = " or ".join(shown(load) for load in self.around(mass))
        return f"{shown(mass)} cannot be made with the weights of this bench ({self}); nearest: {near}"

    def text(self, mass: float) -> str:
        """Parts of a possible load, for instance `hanger 1 kg + 1 x 5 kg + 1 x 2.5 kg = 8.5 kg`."""
        if mass <= 0 or not self.plates:
            return ""
        left = min(self._sums, key=lambda plates: abs(self.hanger + plates * _GRID - mass))
        used: dict[int, int] = {}
        while left:
            left, number = self._sums[left]
            used[number] = used.get(number, 0) + 1
        chosen = [f"{used[number]} x {self._heaviest_first[number][1]:g} kg" for number in sorted(used)]
        return " + ".join([f"hanger {self.hanger:g} kg", *chosen]) + (f" = {mass:g} kg" if chosen else " alone")

    def __str__(self) -> str:
        """The stack in words."""
        plates = " + ".join(f"{count} x {each:g} kg" for count, each in self._heaviest_first)
        return f"hanger {self.hanger:g} kg" + (f" and plates {plates}" if plates else "")


WARM_UP = 600.0
"""Shortest warm-up that counts as complete [s] (10 min, paper 0, static study)."""
NOISE = 0.005
"""Largest rms noise of a channel as a fraction of its range, if not given in the bench file [1]."""


@dataclass(frozen=True)
class WarmUp:
    """Cycles between zero and `pressure` [Pa] with `period` [s], for `duration` [s]."""

    duration: float
    pressure: float
    period: float


@dataclass(frozen=True)
class Zero:
    """Zero of one channel: at most `most` [SI] from the calibration's; `load` [kg] puts the free end there."""

    most: float
    at: str = ""
    load: float | None = None


@dataclass(frozen=True)
class SelfTest:
    """The start check; pressures in Pa, times in s, `load` in kg, `noise` in SI by channel, `leak` in Pa/s."""

    points: tuple[float, ...]
    settle: float
    load: float | None
    noise: Mapping[str, float]
    linearity: float
    alignment: float
    leak: float


@dataclass(frozen=True)
class Session:
    """Steps before the first run, and the time for which they are valid [s]."""

    self_test: SelfTest | None = None
    warm_up: WarmUp | None = None
    zeros: Mapping[str, Zero] = field(default_factory=dict)
    valid: float = 12 * 3600.0
    expected: tuple[str, ...] = ("pressure", "force", "displacement")
    """Channels whose zeros a complete session takes."""

    def shortened(self, *, warm_up: bool = True) -> tuple[str, ...]:
        """Parts that are shorter than papers and good practice recommend, in words; `warm_up`: it is not skipped."""
        found = []
        if self.warm_up is None:
            found.append("no warm-up")
        elif warm_up and self.warm_up.duration < WARM_UP:
            found.append(f"warm-up of {in_words(self.warm_up.duration)} instead of {in_words(WARM_UP)}")
        if self.self_test is None:
            found.append("no self-test")
        if missing := [name for name in self.expected if name not in self.zeros]:
            found.append(f"no zero of {', '.join(missing)}")
        return tuple(found)


def session(c: Compilation, setup: float) -> Session | None:
    """The session that the bench file declares, or None; `setup` is the set-up pressure [Pa]."""
    if (file := c.bench.session) is None:
        return None
    if c.bench.platform is not None:
        what = "self-test, warm-up and zeros need an output that commands the pressure of each muscle"
        remedy = "leave the section out; `check` names what to do by hand"
        c.fault(("session",), f"{what}, and a platform has valves: {remedy}")
        return None
    warm_up = None
    if file.warm_up is not None:
        given = file.warm_up
        _commanded(c, given.pressure, ("session", "warm_up", "pressure"))
        warm_up = WarmUp(given.duration, given.pressure, given.period)
    each = {"expected": (*c.bench.pressures, "angle")} if c.bench.muscles else {}
    return Session(_self_test(c, file, setup), warm_up, _zeros(c, file), file.valid, **each)


def lacks_session(c: Compilation) -> Iterator[str]:
    """A line if a real bench has no session; continues the sentence "this bench has"."""
    if c.bench.time == "real" and c.bench.platform is not None:
        why = "for self-test, warm-up and zeros need outputs that command pressures: wiring and zeros are not looked at"
        remedy = 'before the first run, "pmabench bench read" each channel without pressure, and see by hand'
        yield f"no session, {why}; remedy: {remedy} that each valve moves the pressure of the muscle that it is for"
    elif c.bench.time == "real" and c.bench.session is None:
        first = c.bench.pressures[0] if c.bench.muscles else "pressure"
        parts = f"{{self_test: {{}}, warm_up: {{pressure: 300 kPa}}, zeros: {{{first}: {{most: 5 kPa}}}}}}"
        yield f'no session: no warm-up, no zeros, no self-test before the first pressure; remedy: "session: {parts}"'


def _commanded(c: Compilation, pressure: float, at: Location) -> None:
    for name in [f"pressure_{number}" for number in c.bench.muscles] or ["pressure"]:
        if name not in c.bench.set_points:
            c.fault(at, f"nothing commands the {name} on this bench")
        elif name in c.outputs and pressure > c.outputs[name].high:
            most = f"{show(c.outputs[name].high, 'pressure')} ({c.outputs[name].high_from})"
            c.fault(at, f"{show(pressure, 'pressure')} is above the command limit, {most}")


def _mass(c: Compilation, load: tuple[str, float] | None, at: Location) -> float | None:
    if load is None:
        return None
    if c.bench.weights is None:
        c.fault(at, 'a load needs a bench with "weights"')
        return None
    kind, value = load
    mass = value if kind == "mass" else value / c.bench.weights.g
    if not mass > 0:
        c.fault(at, "a load above zero is expected")
    elif why := Stack(c.bench.weights.hanger, c.bench.weights.plates).why_not(mass):
        c.fault(at, why)
    return mass


def _zeros(c: Compilation, file: SessionFile) -> dict[str, Zero]:
    found: dict[str, Zero] = {}
    for name, zero in file.zeros.items():
        at: Location = ("session", "zeros", name)
        if c.unknown(at, "channel", name, c.bench.channels) or name not in c.channels:
            continue
        if (most := c.si(zero.most, c.channels[name].quantity, (*at, "most"))) <= 0:
            c.fault((*at, "most"), "a value above zero is expected")
        found[name] = Zero(most, zero.at, _mass(c, zero.load, (*at, "load")))
    return found


def _self_test(c: Compilation, file: SessionFile, setup: float) -> SelfTest | None:
    given: SelfTestFile | None = file.self_test
    if given is None:
        return None
    at: Location = ("session", "self_test")
    highest = setup if given.pressure is None else given.pressure
    _commanded(c, highest, at if given.pressure is None else (*at, "pressure"))
    if highest > setup:
        c.fault((*at, "pressure"), f"is above the set-up pressure, {show(setup, 'pressure')}")
    if given.step > highest or highest / given.step > 50:
        c.fault((*at, "step"), f"one to fifty steps up to {show(highest, 'pressure')} are expected")
        return None
    count = max(1, round(highest / given.step))
    noise = {name: NOISE * (channel.high - channel.low) for name, channel in c.channels.items()}
    for name, reading in given.noise.items():
        if not c.unknown((*at, "noise", name), "channel", name, c.bench.channels) and name in c.channels:
            noise[name] = c.si(reading, c.channels[name].quantity, (*at, "noise", name))
    points, load = tuple(highest * (index + 1) / count for index in range(count)), _mass(c, given.load, (*at, "load"))
    same = given.model_dump(include={"settle", "linearity", "alignment", "leak"})
    return SelfTest(points=points, load=load, noise=noise, **same)
