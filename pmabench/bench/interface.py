"""What every driver implements; standard library only. The compiled bench is in `pmabench.bench.records`.

A driver is a class that is built as `Driver(device, clock)` from a `DeviceRecord` and a clock, imports nothing heavy
before `open`, and implements `Device` and those of the small capabilities below that its device has.
Values that cross this interface are in the device's own units (counts, volts, pascal ...); the scaling to SI is
next to them in the records and is done above the driver. Raises only `pmabench.base.errors.DeviceError`.

In real time each device has one thread that calls it. A call returns within 0.2 s (`open` within 2 s) or raises; no
write is retried; after a time-out the line is drained, so that no answer belongs to an older question. `collect` never
waits for a sample: a polled device has its own thread that polls. A class method `check(device)` may name what is
wrong with the options before anything is opened, others, `fastest(device)` and `lacks(device)`,
how fast it samples at most with them, and what of them may surprise:
`pmabench.bench.driver_options`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from pmabench.bench.records import (
    CalibrationRecord,
    ChannelRecord,
    CompiledBench,
    DeviceRecord,
    InterlockRecord,
    OutputRecord,
    ProofTest,
    SafeAction,
    Scale,
    TripRecord,
    ValveRecord,
)

__all__ = [
    "COMPUTER", "EMULATED", "UNPROVEN", "Block", "CalibrationRecord", "ChannelRecord", "CompiledBench", "Device",
    "DeviceRecord", "Follower", "Hands", "Identity", "Inputs", "InterlockRecord", "Load", "Motion", "OutputRecord",
    "ProofTest", "Rescue", "SafeAction", "Scale", "Segment", "SetPoint", "Stream", "Supervised", "Switch",
    "TripRecord", "ValveRecord", "Watchdog",
]  # fmt: skip


COMPUTER = "computer"
"""`Identity.clock` of a device that has none, whose driver stamps its samples."""
EMULATED = "emulated "
"""How the model name of an emulator begins: what it records is never taken for a real muscle."""
UNPROVEN = f"{EMULATED}unproven "
"""How it begins where the emulator took its wiring and scales from the bench file, so that an error cancels out."""


@dataclass(frozen=True)
class Identity:
    """Who answered when the device was opened."""

    maker: str
    model: str
    serial: str
    firmware: str
    simulated: bool = False
    clock: str = "own"
    """`own`: its samples carry the device's clock. `computer`: they are stamped with bench time by the driver, halfway
    between question and answer, or when a line began to come; half of a poll is then the time from stamp to arrival."""


@dataclass(frozen=True)
class Load:
    """What the operator's hands put on the free end."""

    force: float
    """Dead load F_L [N]."""
    mass: float
    """Mass that moves with it [kg]."""


@dataclass(frozen=True)
class Segment:
    """A command over a stretch of time, as data, so that a device can follow it by itself.

    From `start` [s, bench time] on: `ramp`: from `origin` to `target` at `rate` (then constant); `sine`:
    `origin + amplitude * sin(2 pi frequency (t - start))` for `cycles` whole cycles (then constant at `origin`).
    All values in device units (`rate` per second).
    """

    kind: str
    start: float
    origin: float
    target: float = 0.0
    rate: float = 0.0
    amplitude: float = 0.0
    frequency: float = 0.0
    cycles: float = 0.0


@dataclass(frozen=True)
class Block:
    """Consecutive samples of one stream, all channels of one device, on the device's clock.

    `time` [ns, device clock] and each of `columns` (raw device units, keyed by channel name) have the same length and
    are arrays or lists (`array.array("q")` and `array.array("d")` cost least on their way to the engine).
    """

    time: Sequence[int]
    columns: Mapping[str, Sequence[float]]
    host: int = -1
    """When the newest sample arrived at the computer [ns, bench time]; -1 where nobody noted it."""


@runtime_checkable
class Device(Protocol):
    """What every driver can do."""

    def open(self) -> Identity:
        """Connect and identify; nothing moves and nothing is commanded."""
        ...

    def close(self) -> None:
        """Let go of the link; harmless when repeated."""
        ...


@runtime_checkable
class Stream(Protocol):
    """Samples its channels together on one clock."""

    def start(self, rate: float) -> float:
        """Begin to sample at `rate` [Hz]; returns the rate that the device will really use."""
        ...

    def collect(self) -> Block:
        """Every sample taken since the last call, oldest first; at once, and may be empty."""
        ...

    def stop(self) -> None:
        """End sampling; harmless when repeated."""
        ...


@runtime_checkable
class SetPoint(Protocol):
    """Takes commanded values."""

    def write(self, output: str, value: float) -> None:
        """Command `value` [device units] at once, ending a segment under way; never retried."""
        ...

    def read_back(self, output: str) -> float:
        """The value that the device holds now [device units]."""
        ...


@runtime_checkable
class Follower(Protocol):
    """Follows ramps and sines by itself."""

    def follow(self, output: str, segment: Segment) -> None:
        """Begin the segment; the next `write` or `follow` ends it."""
        ...


@runtime_checkable
class Hands(Protocol):
    """A bench whose operator is part of the device: it is informed of what hands did, as answered at the prompt."""

    def place(self, load: Load) -> None:
        """The free end now carries `load`."""
        ...


@runtime_checkable
class Switch(Protocol):
    """Switches valves."""

    def switch(self, output: str, *, on: bool) -> None:
        """Energise the output or not; never retried."""
        ...

    def is_on(self, output: str) -> bool:
        """What the device holds now."""
        ...


@runtime_checkable
class Motion(Protocol):
    """Can stop a motion by itself, faster than a new set-point would."""

    def halt(self, output: str) -> None:
        """Stop where it is (drive quick stop), and hold."""
        ...


@runtime_checkable
class Inputs(Protocol):
    """Has digital inputs."""

    def level(self, name: str) -> bool:
        """Whether the input is high now."""
        ...


@runtime_checkable
class Watchdog(Protocol):
    """Vents by itself when the program is silent."""

    def arm_watchdog(self, seconds: float) -> float:
        """Arm it; returns the time that the device itself says it will wait [s]."""
        ...

    def feed_watchdog(self) -> None:
        """Show the device that the program is alive."""
        ...

    def disarm_watchdog(self) -> None:
        """End it; outputs stay as they are."""
        ...


@runtime_checkable
class Supervised(Protocol):
    """Reports what it holds apart from its outputs, so that a restart or a changed setting is seen (promise S11)."""

    def held(self) -> Mapping[str, float | str]:
        """What the device itself reports now: read from it at each call, never remembered by the driver.

        `watchdog`: after how long without a sign of life it would vent [s], 0 where it is off or has fired. A device
        that goes on counting after it has fired reports its time: there, outputs that are read back show the vent.
        `uptime`: a number that only grows until the device restarts. Every other entry (serial number, trigger of the
        watchdog, mode, count of restarts) must stay what it was when the bench was armed. The name of an entry is
        printed in the reason of a trip.
        """
        ...


@runtime_checkable
class Rescue(Protocol):
    """Has a second way to its outputs, for when the usual call hangs."""

    def rescue(self, output: str, value: float) -> None:
        """Command `value` [device units; 0 and 1 for a valve] over a separate connection, within 0.2 s, no retry.

        Called from another thread than the one that may be hanging.
        """
        ...
