"""Process data of an emulated CMMT and its motion: PROFIdrive telegrams 1, 9, 102 and 111, and one axis.

Written separately from the driver's `telegram`, so that each checks the other. Source: PROFIdrive profile (words of
telegrams 1, 9 and 102 in order) and telegram 111, whose words Festo and Siemens share; names as in both.
The axis's profile has no acceleration. Places are metres of contraction; positions are user units from the place where
it was homed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from time import monotonic
from typing import Any

from pmabench.bench.interface import Scale
from pmabench_drivers.emulator.plant import RealPlant

SIZE = 28
"""Registers of process data in each direction."""
LONG = frozenset({"NSOLL_B", "NIST_B", "MDI_TARPOS", "MDI_VELOCITY", "XIST_A", "G1_XIST1", "G1_XIST2"})
"""Words of 32 bits, low register first."""
POSITION = ("STW1", "POS_STW1", "POS_STW2", "STW2", "OVERRIDE", "MDI_TARPOS", "MDI_VELOCITY", "MDI_ACC", "MDI_DEC")
SENT: Mapping[int, Sequence[str]] = {
    1: ("STW1", "NSOLL_A"),
    9: ("STW1", "SATZANW", "STW2", "MDI_TARPOS", "MDI_VELOCITY", "MDI_ACC", "MDI_DEC", "MDI_MOD"),
    102: ("STW1", "NSOLL_B", "STW2", "MOMRED", "G1_STW"),
    111: POSITION,
}
"""Telegram -> words sent to the drive."""
GIVEN: Mapping[int, Sequence[str]] = {
    1: ("ZSW1", "NIST_A"),
    9: ("ZSW1", "AKTSATZ", "ZSW2", "XIST_A"),
    102: ("ZSW1", "NIST_B", "ZSW2", "MELDW", "G1_ZSW", "G1_XIST1", "G1_XIST2"),
    111: ("ZSW1", "POS_ZSW1", "POS_ZSW2", "ZSW2", "MELDW", "XIST_A", "NIST_B", "FAULT_CODE", "WARN_CODE"),
}
"""Telegram -> words sent by the drive."""
BY_SPEED = frozenset({1, 102})
"""Telegrams whose set-point is a velocity."""

REJECT, GO_ON, TASK, ACKNOWLEDGE, JOG_1, JOG_2, BY_PLC, HOME = (1 << bit for bit in (4, 5, 6, 7, 8, 9, 10, 11))
"""Bits of STW1; if one of the first two is 0, the task is rejected or the motion interrupted."""
ABSOLUTE, FORWARD, CONTINUOUS, SET_UP, MDI = (1 << bit for bit in (8, 9, 12, 14, 15))
"""Bits of POS_STW1, whose lowest seven are the number of a record."""
SET_REFERENCE, BY_STEPS = 1 << 1, 1 << 5
"""Bits of POS_STW2: the present position is the reference; jogging goes by steps."""
RECORD = 0x7F
FULL_SPEED = {"NSOLL_A": 1 << 14, "NIST_A": 1 << 14, "NSOLL_B": 1 << 30, "NIST_B": 1 << 30}
"""Number in a word that stands for the base value of the velocity."""

ZSW1 = (
    "ready to switch on", "ready to operate", "enabled", "fault", "no coast stop", "no quick stop", "inhibited",
    "warning", "follows", "control", "reached", "homed", "taken", "stopped", "accelerates", "decelerates",
)  # fmt: skip
"""Bits in order of their position."""
POS_ZSW1 = {"jogging": 10, "homing": 11, "by record": 13, "set up": 14, "mdi": 15}
POS_ZSW2 = {"forwards": 4, "backwards": 5, "at negative limit": 6, "at positive limit": 7, "task active": 15}
STROKE = (-0.01, 0.09)
"""Software limits [m of contraction]."""
HOMING, LEAST = 0.02, 0.3
"""Speed towards the reference mark, which is at a contraction of 0 [m/s]; shortest duration of homing [s]."""
JOGGING, STEP = 0.005, 0.001
"""Speed of jogging [m/s], and length of one step [m]."""
RECORDS = {1: (0.005, 0.02), 2: (0.010, 0.02)}
"""Record table: number -> place [m of contraction] and speed [m/s]."""


def length(telegram: int) -> int:
    """Number of registers sent to the drive."""
    return sum(2 if name in LONG else 1 for name in SENT[telegram])


def split(telegram: int, words: Sequence[int]) -> dict[str, int]:
    """Values sent, by name; words of 32 bits and velocity set-points are signed, the others unsigned."""
    found, at = {}, 0
    for name in SENT[telegram]:
        size = 2 if name in LONG else 1
        value = sum(word << 16 * i for i, word in enumerate(words[at : at + size]))
        if (name in LONG or name in FULL_SPEED) and value >> 16 * size - 1:
            value -= 1 << 16 * size
        found[name], at = value, at + size
    return found


def join(telegram: int, values: Mapping[str, int]) -> list[int]:
    """Registers that hold `values`; 0 if a value is missing."""
    words: list[int] = []
    for name in GIVEN[telegram]:
        value = values.get(name, 0)
        words += [value >> 16 * i & 0xFFFF for i in range(2 if name in LONG else 1)]
    return words + [0] * (SIZE - len(words))


def bits(places: Sequence[str] | Mapping[str, int], true: Mapping[str, bool]) -> int:
    """A status word: the bits at their `places` that are `true`."""
    at = places if isinstance(places, Mapping) else {name: bit for bit, name in enumerate(places)}
    return sum(true.get(name, False) << bit for name, bit in at.items())


@dataclass
class _Way:
    """Path from `origin` to `target` [m of contraction] at `pace` [m/s] since `begun` [s, monotonic]."""

    origin: float = 0.0
    target: float = 0.0
    pace: float = 0.0
    begun: float = 0.0

    def at(self, now: float) -> float:
        """Place on the path."""
        left, way = self.target - self.origin, self.pace * (now - self.begun)
        return self.target if way >= abs(left) else self.origin + (way if left > 0 else -way)


class Motion:
    """One axis. `note` is called with its actions."""

    def __init__(self, plant: RealPlant, scale: Scale, note: Callable[..., Any]) -> None:
        self._plant, self._scale, self._note = plant, scale, note
        self._way = _Way()
        self._rest: _Way | None = None
        """Rest of an interrupted motion."""
        self._zero = 0
        """User units at a contraction of 0 where it was last homed."""
        self._at_mark = False
        """Whether it is homing to the reference mark, or at its present position."""
        self._homing = 0.0
        """Earliest end of homing [s, monotonic]; 0: it is not homing."""
        self.homed = True
        self.jogging = False

    # -- where it is --------------------------------------------------------------------------------------------------

    def position(self) -> int:
        """Its position [user units]."""
        return self._units(self.place())

    def _units(self, place: float) -> int:
        return min(max(round(float(self._scale.to_raw(place))) - self._zero, -(2**31)), 2**31 - 1)

    def place(self) -> float:
        """Its place [m of contraction]."""
        return self._plant.quantities()["displacement"]

    def off(self, now: float) -> float:
        """Distance from its profile [m]."""
        return abs(self.place() - self._way.at(now))

    def rests(self, now: float) -> bool:
        """Whether it has reached its target."""
        return self._way.at(now) == self._way.target

    def velocity(self, now: float) -> float:
        """Its velocity [m/s of contraction]."""
        if self.rests(now):
            return 0.0
        return self._way.pace if self._way.target > self._way.origin else -self._way.pace

    def forwards(self, now: float) -> int:
        """1 if its position increases, -1 if it decreases, 0 at rest."""
        moves = self.velocity(now) * self._scale.slope
        return (moves > 0) - (moves < 0)

    @property
    def homing(self) -> bool:
        """Whether it is homing."""
        return self._homing > 0

    # -- motions ------------------------------------------------------------------------------------------------------

    def target(self, position: int, *, absolute: bool) -> float:
        """Place of a target [user units], which counts from the present position if it is not `absolute`."""
        start = 0 if absolute else self._units(self._way.at(monotonic()))
        return float(self._scale.to_si(position + start + self._zero))

    def go(self, place: float, pace: float) -> None:
        """Move to a place [m of contraction] at `pace` [m/s]."""
        now = monotonic()
        self._rest, self._way = None, _Way(self._way.at(now), place, pace, now)
        self._note("move", si=place, speed=pace)
        if pace > 0:
            self._plant.drive(place, pace, self._way.origin)

    def run(self, forwards: float, pace: float) -> None:
        """Move to the software limit in a direction of its positions."""
        self.go(STROKE[(forwards > 0) == (self._scale.slope > 0)], pace)

    def jog(self, forwards: int, *, by_steps: bool) -> None:
        """Jog in a direction, or stop jogging with 0."""
        if not forwards:
            if self.jogging:
                self.stop()
            return
        self.jogging = True
        if by_steps:
            step = STEP if (forwards > 0) == (self._scale.slope > 0) else -STEP
            self.go(min(max(self._way.at(monotonic()) + step, STROKE[0]), STROKE[1]), JOGGING)
        else:
            self.run(forwards, JOGGING)

    def stop(self) -> None:
        """Stop, hold the place, and drop the present motion."""
        place = self._plant.stop_drive()
        self._way, self._rest, self.jogging, self._homing = _Way(place, place), None, False, 0.0

    def interrupt(self) -> None:
        """Stop, and keep the rest of the motion."""
        if self._rest is None:
            way = self._way
            self.stop()
            self._rest = way

    def go_on(self) -> None:
        """Continue the interrupted motion."""
        if self._rest is not None:
            self.go(self._rest.target, self._rest.pace)

    # -- homing -------------------------------------------------------------------------------------------------------

    def home(self) -> None:
        """Move to the reference mark, which becomes position 0."""
        self.homed, self._at_mark = False, True
        self.go(0.0, HOMING)
        self._homing = monotonic() + LEAST

    def home_here(self) -> None:
        """Make the present place position 0."""
        self._zero += self._units(self._way.at(monotonic()))
        self.homed, self._at_mark = False, False
        self._homing = monotonic() + LEAST

    def give_up_homing(self) -> None:
        """Stop homing if in progress; it then has no reference."""
        if self.homing:
            self.stop()

    def settle(self, now: float) -> None:
        """Finish homing if it is over."""
        if self.homing and now >= self._homing and self.rests(now):
            if self._at_mark:
                self._zero = round(float(self._scale.to_raw(0.0)))
            self._homing, self.homed = 0.0, True
            self._note("homed", si=self._way.target)
