"""The session of a bench file in SI, checked against channels, outputs and weights of the bench."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from pmabench.base.quantities import in_words, show
from pmabench.bench.compilation import Compilation
from pmabench.bench.files.session import SelfTestFile, SessionFile
from pmabench.bench.interface import ChannelRecord, OutputRecord
from pmabench.bench.loads import Stack
from pmabench.files.document import Location

WARM_UP = 600.0
"""Shortest warm-up that counts as whole (10 min, paper 0, static study) [s]."""
NOISE = 0.005
"""Most rms noise of a channel, of its range, where the bench file says nothing [1]."""


@dataclass(frozen=True)
class WarmUp:
    """Cycles between no pressure and `pressure` [Pa] of `period` [s], for `duration` [s]."""

    duration: float
    pressure: float
    period: float


@dataclass(frozen=True)
class Zero:
    """The zero of one channel: at most `most` [SI] from the calibration's; `load` [kg] brings the free end there."""

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
    """What is done once before the first run, and for how long it counts [s]."""

    self_test: SelfTest | None = None
    warm_up: WarmUp | None = None
    zeros: Mapping[str, Zero] = field(default_factory=dict)
    valid: float = 12 * 3600.0

    def shortened(self) -> tuple[str, ...]:
        """What is less than the papers and good practice ask for, in words."""
        found = []
        if self.warm_up is None:
            found.append("no warm-up")
        elif self.warm_up.duration < WARM_UP:
            found.append(f"warm-up of {in_words(self.warm_up.duration)} instead of {in_words(WARM_UP)}")
        if self.self_test is None:
            found.append("no self-test")
        missing = [name for name in ("pressure", "force", "displacement") if name not in self.zeros]
        if missing:
            found.append(f"no zero of {', '.join(missing)}")
        return tuple(found)


def session(
    c: Compilation, channels: Mapping[str, ChannelRecord], outputs: Mapping[str, OutputRecord], setup: float
) -> Session | None:
    """The session that the bench file declares, or None; `setup` is the set-up pressure [Pa]."""
    file = c.bench.session
    if file is None:
        return None
    warm_up = None
    if file.warm_up is not None:
        given = file.warm_up
        _commanded(c, outputs, given.pressure, ("session", "warm_up", "pressure"))
        warm_up = WarmUp(given.duration, given.pressure, given.period)
    return Session(_self_test(c, file, channels, outputs, setup), warm_up, _zeros(c, file, channels), file.valid)


def lacks_session(c: Compilation) -> Iterator[str]:
    """A line where a real bench has no session; goes on after "this bench has"."""
    if c.bench.time == "real" and c.bench.session is None:
        yield (
            "no session: no warm-up, no zeros, no self-test before the first pressure; remedy: "
            '"session: {self_test: {}, warm_up: {pressure: 300 kPa}, zeros: {pressure: {most: 5 kPa}}}"'
        )


def _commanded(c: Compilation, outputs: Mapping[str, OutputRecord], pressure: float, at: Location) -> None:
    if "pressure" not in c.bench.set_points:
        c.fault(at, "nothing commands the pressure on this bench")
    elif "pressure" in outputs and pressure > outputs["pressure"].high:
        most = f"{show(outputs['pressure'].high, 'pressure')} ({outputs['pressure'].high_from})"
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


def _zeros(c: Compilation, file: SessionFile, channels: Mapping[str, ChannelRecord]) -> dict[str, Zero]:
    found: dict[str, Zero] = {}
    for name, zero in file.zeros.items():
        at: Location = ("session", "zeros", name)
        if c.unknown(at, "channel", name, c.bench.channels) or name not in channels:
            continue
        most = c.si(zero.most, channels[name].quantity, (*at, "most"))
        if most <= 0:
            c.fault((*at, "most"), "a value above zero is expected")
        found[name] = Zero(most, zero.at, _mass(c, zero.load, (*at, "load")))
    return found


def _self_test(
    c: Compilation,
    file: SessionFile,
    channels: Mapping[str, ChannelRecord],
    outputs: Mapping[str, OutputRecord],
    setup: float,
) -> SelfTest | None:
    given: SelfTestFile | None = file.self_test
    if given is None:
        return None
    at: Location = ("session", "self_test")
    highest = setup if given.pressure is None else given.pressure
    _commanded(c, outputs, highest, at if given.pressure is None else (*at, "pressure"))
    if highest > setup:
        c.fault((*at, "pressure"), f"is above the set-up pressure, {show(setup, 'pressure')}")
    if given.step > highest or highest / given.step > 50:
        c.fault((*at, "step"), f"one to fifty steps up to {show(highest, 'pressure')} are expected")
        return None
    count = max(1, round(highest / given.step))
    noise = {name: NOISE * (channel.high - channel.low) for name, channel in channels.items()}
    for name, reading in given.noise.items():
        if not c.unknown((*at, "noise", name), "channel", name, c.bench.channels) and name in channels:
            noise[name] = c.si(reading, channels[name].quantity, (*at, "noise", name))
    return SelfTest(
        points=tuple(highest * (index + 1) / count for index in range(count)),
        settle=given.settle,
        load=_mass(c, given.load, (*at, "load")),
        noise=noise,
        linearity=given.linearity,
        alignment=given.alignment,
        leak=given.leak,
    )
