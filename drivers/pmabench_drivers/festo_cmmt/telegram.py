"""PROFIdrive telegram 111 of a CMMT, the wanted position over time, and the driver's options.

Uses no connection; standard library only. Registers, bits and parameter numbers: Festo's own client library
festo-edcon 1.0, read as a description of the protocol. Words are unchanged in registers, those of 32 bits low word
first.

A sine is streamed. In each cycle the drive gets the velocity that brings it to the sine's value at the end of the
cycle, and a target beyond that in the same direction: so it never brakes for a target on the way, and goes on smoothly
where a cycle comes late. The target is never outside the sine's own crests, and after a stall it catches up no faster
than `HURRY` and the actuator allow. What the drive loses by its acceleration is seen in where it is, and made up
slowly.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import ceil, inf

from pmabench.bench.interface import DeviceRecord, Segment
from pmabench_drivers.modbus.registers import Register, decode, encode
from pmabench_drivers.shared.device import HURRY, stepped
from pmabench_drivers.shared.options import Reader, option

PROCESS_OUT, PROCESS_IN = 0, 100
"""First register of the words sent to the drive, and of those it reports."""
SIZE, SENT = 28, 11
"""Registers of each direction, and those of the sent ones that telegram 111 uses."""
TIMEOUT = Register("watchdog time", "holding", 400, "uint32", low_word_first=True)
"""Milliseconds without communication after which the drive acts by itself."""
SHORTEST, LONGEST = 0.1, 65.535
"""Limits of the time-out [s]."""

NUMBER, SUBINDEX, ELEMENTS, EXECUTE, LENGTH, DATA = 500, 501, 502, 503, 504, 510
"""Mailbox of parameters (PNU)."""
READ, FAILED, DONE = 1, 3, 0x10
"""Value written to `EXECUTE`, and its values afterwards."""
TELEGRAM, TARGET, POSITION_PREFIX, VELOCITY_PREFIX, SERIAL = 3490, 34, 11724, 11725, 2076
TELEGRAM_111 = 111
"""Parameters: the selected telegram (must be 111), MDI_TARPOS as the drive holds it, decimal exponents of its user
units, serial number of its control unit (a text).
"""
LONGEST_TEXT = 50
"""Largest size of a parameter that is read here [bytes]."""

ON, NO_COAST_STOP, NO_QUICK_STOP, ENABLE = 1 << 0, 1 << 1, 1 << 2, 1 << 3
KEEP_TASK, NO_INTERMEDIATE_STOP, TASK, ACKNOWLEDGE, BY_PLC = 1 << 4, 1 << 5, 1 << 6, 1 << 7, 1 << 10
"""Bits of STW1. Without `KEEP_TASK` the drive brakes at its limit and holds its position."""
ABSOLUTE, CONTINUOUS, MDI = 1 << 8, 1 << 12, 1 << 15
"""Bits of POS_STW1: positions are absolute; set-points are taken over while it moves; set-points come with it."""
READY, ENABLED, FAULT = 1 << 0, 1 << 2, 1 << 3
CONTROL, REACHED, HOMED, TAKEN, STOPPED = 1 << 9, 1 << 10, 1 << 11, 1 << 12, 1 << 13
"""Bits of ZSW1."""
FULL = 0x4000
"""100 % of override, acceleration and deceleration."""


FAULTS = {
    109: "it came to its negative software limit",
    110: "it came to its positive software limit",
    126: "it could not follow: the load is too heavy, or something is in its way",
    294: "it is not controlled over the network",
}
"""Codes of the drive that are likely for a motion under load; its manual has them all."""
NOTHING = [0] * SENT
"""Last words sent: switched off, no control."""
CATCH_UP = 0.02
"""Fraction of the drive's deviation from its profile that is corrected per cycle: slow against delays of the link."""
HERE = ("options",)
POSITION, SET_POINT = "position", "set_point"
"""Recordable values: the drive's position, and its present set-point. `POSITION` is also the output."""
WHOLE = 2**31
SIGNED, UNSIGNED = (Register("", "holding", 0, kind, low_word_first=True) for kind in ("int32", "uint32"))
"""Formats of 32-bit words."""


@dataclass(frozen=True)
class Command:
    """Command sent to the drive in each cycle: bits, target [user units], velocity [user units] times override."""

    on: bool = False
    task: bool = False
    """A motion to `target` is in progress or done; its rising edge starts one."""
    stop: bool = False
    """The motion is given up and the place is held; with power off it is braked until it stands."""
    acknowledge: bool = False
    target: int = 0
    velocity: int = 0
    override: int = FULL

    def words(self) -> list[int]:
        """The registers from `PROCESS_OUT` on."""
        control = NO_COAST_STOP | ENABLE | NO_INTERMEDIATE_STOP | BY_PLC | (self.on or not self.stop) * NO_QUICK_STOP
        control |= self.on * ON | self.task * TASK | self.acknowledge * ACKNOWLEDGE | (not self.stop) * KEEP_TASK
        numbers = [*encode(SIGNED, self.target), *encode(UNSIGNED, self.velocity)]
        return [control, ABSOLUTE | CONTINUOUS | MDI, 0, 0, self.override, *numbers, FULL, FULL]


@dataclass(frozen=True)
class Status:
    """State that the drive reports in each cycle."""

    word: int
    """ZSW1."""
    position: int
    """XIST_A [user units]."""
    fault: int
    """FAULT_CODE; 0 if there is none."""

    @classmethod
    def of(cls, words: Sequence[int]) -> Status:
        """From the registers from `PROCESS_IN` on."""
        return cls(words[0], int(decode(SIGNED, words[5:7])), words[9])

    def has(self, bit: int) -> bool:
        """Whether a bit of ZSW1 is set."""
        return bool(self.word & bit)

    def refusal(self) -> str:
        """Why it cannot be switched on or moved; empty if nothing known prevents it."""
        if self.has(FAULT):
            cause = FAULTS.get(self.fault, "its display and its manual say what that is")
            return f"reports fault {self.fault}: {cause}"
        if not self.has(CONTROL):
            return "gives no control to the network: another program holds it, or it is operated by hand"
        if not self.has(HOMED):
            return "is not homed, and its positions mean nothing: home it first"
        return ""


def speed(wanted: float) -> tuple[int, int]:
    """MDI_VELOCITY and OVERRIDE that together give the `wanted` velocity [velocity units, above 0] to 0.01 %."""
    velocity = max(1, ceil(wanted - 1e-9))
    return velocity, min(FULL, max(1, round(FULL * wanted / velocity)))


class Path:
    """Positions in user units of the drive; `clock` gives bench time [s], `fastest` is the actuator's speed [1/s]."""

    def __init__(self, clock: Callable[[], float], fastest: float = inf) -> None:
        self._clock, self._fastest = clock, fastest
        self._segment: Segment | None = None
        self._since, self._from, self._to, self._velocity = 0.0, 0.0, 0.0, 0.0
        self._off = 0.0

    def rest_at(self, position: float) -> None:
        """Start from rest at a position."""
        self.end()
        self._from = self._to = position

    def go(self, target: float, velocity: float) -> None:
        """Start a motion to `target` at `velocity` [1/s] from the present set-point."""
        self.end()
        self._leave(target, velocity)

    def follow(self, segment: Segment) -> None:
        """Follow a segment."""
        self._segment, self._off = segment, 0.0

    def end(self) -> None:
        """Drop the present segment."""
        self._segment = None

    def now(self) -> float:
        """Present set-point."""
        now = self._clock()
        if self._segment is not None:
            value, _ = stepped(self._segment, now)
            if value is not None:
                return value
        return self._profile(now)

    def seen(self, position: float, at: float) -> None:
        """Take a measured position at a bench time `at` [s]; ignored if older than the last target."""
        if self._segment is not None and at >= self._since:
            self._off += CATCH_UP * (position - self._profile(at) - self._off)

    def next(self, cycle: float) -> tuple[float, float] | None:
        """Target and velocity [1/s] for the next `cycle` [s]; None if nothing new is to be sent."""
        segment, now = self._segment, self._clock()
        if segment is None or now < segment.start:
            return None
        if segment.kind == "ramp":
            self.end()
            self._leave(segment.target, segment.rate)
            return segment.target, segment.rate
        value, over = stepped(segment, now + cycle)
        if value is None:
            return None
        reach = value - self._profile(now) - self._off
        target = value
        swing = abs(segment.amplitude)
        own = 2 * math.pi * segment.frequency * swing
        velocity = min(abs(reach) / cycle, HURRY * own, self._fastest)
        if over:
            self.end()
            velocity = max(velocity, own)  # whatever it lags by, it arrives
        else:
            target = min(max(value + math.copysign(abs(reach), reach), segment.origin - swing), segment.origin + swing)
        self._leave(target, velocity)
        return target, velocity

    def _leave(self, target: float, velocity: float) -> None:
        now = self._clock()
        self._since, self._from, self._to, self._velocity = now, self._profile(now), target, velocity

    def _profile(self, now: float) -> float:
        """The drive's own motion, without its acceleration."""
        way = self._velocity * max(now - self._since, 0.0)
        left = self._to - self._from
        return self._to if way >= abs(left) else self._from + math.copysign(way, left)


@dataclass(frozen=True)
class CmmtOptions:
    """Options of the driver `festo-cmmt` for a drive."""

    rate: float = option(Reader.quantity, "frequency", 100.0, 1.0, 200.0)
    """Cycles of process data [Hz]."""
    speed: float = option(Reader.quantity, "speed", 0.02, 1e-4, 1.0)
    """Speed of motions to a set-point other than ramps [m/s]."""
    acknowledge_faults: bool = option(Reader.flag, default=False)


def read_options(device: DeviceRecord, reader: Reader) -> CmmtOptions:
    """Options of a device; also checks the names that its channels and outputs use."""
    options, _ = reader.options(CmmtOptions, device.options, HERE)
    reader.host(device, "192.168.1.2:502")
    for channel in device.channels:
        place = ("channels", channel.name, "input")
        has = f"; it has {POSITION} and {SET_POINT}"
        if (
            reader.known(place, "a CMMT has no", channel.input, [POSITION, SET_POINT], has)
            and channel.raw_type != "int32"
        ):
            reader.fault(place, "gives counts: its calibration goes from count to the quantity")
    for output in device.outputs:
        at = ("outputs", output.name, "output")
        if output.output != POSITION:
            reader.fault(at, f'a CMMT has no output "{output.output}"; it has {POSITION}')
        if output.quantity != "length":
            reader.fault(at, f"a CMMT moves, and {output.quantity} is no length")
        elif any(abs(float(output.scale.to_raw(value))) >= WHOLE for value in (output.low, output.high)):
            reader.fault(at, "cannot be commanded over its whole range: positions have 32 bits")
    if device.outputs and not device.watchdog:
        reader.fault((), f'a drive that moves needs "watchdog", {SHORTEST:g} s to {LONGEST:g} s')
    reader.watchdog(device, "a CMMT", SHORTEST, LONGEST)
    return options
