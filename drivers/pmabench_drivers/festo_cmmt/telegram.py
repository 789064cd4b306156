"""PROFIdrive telegram 111 as a CMMT takes and gives it over Modbus TCP: registers, words, bits, reasons.

Knows no connection; standard library only. Registers, bits and parameter numbers: Festo's own client library
festo-edcon 1.0, read as a description of the wire. Words stand in registers as they are, those of 32 bits low word
first.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil

from pmabench_drivers.modbus.registers import Register, decode, encode

PROCESS_OUT, PROCESS_IN = 0, 100
"""First register of what is sent to the drive, and of what it tells."""
SIZE, SENT = 28, 11
"""Registers of each of them, and those that telegram 111 takes of what is sent."""
TIMEOUT = Register("watchdog time", "holding", 400, "uint32", low_word_first=True)
"""Milliseconds without communication after which the drive acts by itself."""
SHORTEST, LONGEST = 0.1, 65.535
"""What the time-out can be [s]."""

NUMBER, SUBINDEX, ELEMENTS, EXECUTE, LENGTH, DATA = 500, 501, 502, 503, 504, 510
"""Mailbox of parameters (PNU)."""
READ, FAILED, DONE = 1, 3, 0x10
"""What is written to `EXECUTE`, and what it holds afterwards."""
TELEGRAM, TARGET, POSITION_PREFIX, VELOCITY_PREFIX, SERIAL = 3490, 34, 11724, 11725, 2076
TELEGRAM_111 = 111
"""Parameters: the selected telegram (it must be 111), MDI_TARPOS as the drive holds it, decimal exponents of its user
units, serial number of its control unit (a text)."""
LONGEST_TEXT = 50
"""No parameter that is read here is longer [bytes]."""

ON, NO_COAST_STOP, NO_QUICK_STOP, ENABLE = 1 << 0, 1 << 1, 1 << 2, 1 << 3
KEEP_TASK, NO_INTERMEDIATE_STOP, TASK, ACKNOWLEDGE, BY_PLC = 1 << 4, 1 << 5, 1 << 6, 1 << 7, 1 << 10
"""Bits of STW1. Without `KEEP_TASK` the drive brakes as hard as it may, and holds the place."""
ABSOLUTE, CONTINUOUS, MDI = 1 << 8, 1 << 12, 1 << 15
"""Bits of POS_STW1: positions are absolute; set-points are taken over while it moves; set-points come with it."""
READY, ENABLED, FAULT, INHIBITED = 1 << 0, 1 << 2, 1 << 3, 1 << 6
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
"""Codes of the drive that a motion under load is likely to meet; its manual has them all."""


@dataclass(frozen=True)
class Command:
    """What is sent to the drive in each cycle: bits, target [user units], velocity [user units] times override."""

    on: bool = False
    task: bool = False
    """A motion to `target` is under way or done; its rising edge starts one."""
    stop: bool = False
    """The motion is given up and the place is held."""
    acknowledge: bool = False
    target: int = 0
    velocity: int = 0
    override: int = FULL

    def words(self) -> list[int]:
        """The registers from `PROCESS_OUT` on."""
        control = NO_COAST_STOP | NO_QUICK_STOP | ENABLE | NO_INTERMEDIATE_STOP | BY_PLC
        control |= self.on * ON | self.task * TASK | self.acknowledge * ACKNOWLEDGE | (not self.stop) * KEEP_TASK
        target = encode(Register("", "holding", 0, "int32", low_word_first=True), self.target)
        velocity = encode(Register("", "holding", 0, "uint32", low_word_first=True), self.velocity)
        return [control, ABSOLUTE | CONTINUOUS | MDI, 0, 0, self.override, *target, *velocity, FULL, FULL]


NOTHING = [0] * SENT
"""What is sent at last: switched off, no control."""


@dataclass(frozen=True)
class Status:
    """What the drive tells in each cycle."""

    word: int
    """ZSW1."""
    position: int
    """XIST_A [user units]."""
    fault: int
    """FAULT_CODE; 0 where there is none."""

    @classmethod
    def of(cls, words: Sequence[int]) -> Status:
        """From the registers from `PROCESS_IN` on."""
        place = Register("", "holding", 0, "int32", low_word_first=True)
        return cls(words[0], int(decode(place, words[5:7])), words[9])

    def has(self, bit: int) -> bool:
        """Whether a bit of ZSW1 is set."""
        return bool(self.word & bit)

    def refusal(self) -> str:
        """Why it cannot be switched on or moved, in words; empty where nothing is known to forbid it."""
        if self.has(FAULT):
            return (
                f"reports fault {self.fault}: {FAULTS.get(self.fault, 'its display and its manual say what that is')}"
            )
        if not self.has(CONTROL):
            return "gives no control to the network: another program holds it, or it is operated by hand"
        if not self.has(HOMED):
            return "is not homed, and its positions mean nothing: home it first"
        return ""


def speed(wanted: float) -> tuple[int, int]:
    """MDI_VELOCITY and OVERRIDE that together make the `wanted` velocity [velocity units, above 0] to 0.01 %."""
    velocity = max(1, ceil(wanted - 1e-9))
    return velocity, min(FULL, max(1, round(FULL * wanted / velocity)))
