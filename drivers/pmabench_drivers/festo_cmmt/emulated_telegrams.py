"""The words of PROFIdrive telegrams 1, 9, 102 and 111 as a CMMT exchanges them, and the bits of its status; no drive.

Written apart from the driver's `telegram`, so that each is a check of the other. Source: PROFIdrive profile (words of
telegrams 1, 9 and 102 in their order) and telegram 111, whose words Festo and Siemens share; names as in both.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

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
"""Telegram -> what the drive gets."""
TOLD: Mapping[int, Sequence[str]] = {
    1: ("ZSW1", "NIST_A"),
    9: ("ZSW1", "AKTSATZ", "ZSW2", "XIST_A"),
    102: ("ZSW1", "NIST_B", "ZSW2", "MELDW", "G1_ZSW", "G1_XIST1", "G1_XIST2"),
    111: ("ZSW1", "POS_ZSW1", "POS_ZSW2", "ZSW2", "MELDW", "XIST_A", "NIST_B", "FAULT_CODE", "WARN_CODE"),
}
"""Telegram -> what the drive gives."""
BY_SPEED = frozenset({1, 102})
"""Telegrams whose set-point is a velocity."""

REJECT, GO_ON, TASK, ACKNOWLEDGE, JOG_1, JOG_2, BY_PLC, HOME = (1 << bit for bit in (4, 5, 6, 7, 8, 9, 10, 11))
"""Bits of STW1; a task is rejected, and a motion is interrupted, where the first two are 0."""
ABSOLUTE, FORWARD, BACKWARD, CONTINUOUS, SET_UP, MDI = (1 << bit for bit in (8, 9, 10, 12, 14, 15))
"""Bits of POS_STW1, whose lowest seven are the number of a record."""
SET_REFERENCE, BY_STEPS = 1 << 1, 1 << 5
"""Bits of POS_STW2: where it is is the reference; jogging goes by steps."""
RECORD = 0x7F
FULL_SPEED = {"NSOLL_A": 1 << 14, "NIST_A": 1 << 14, "NSOLL_B": 1 << 30, "NIST_B": 1 << 30}
"""What is the base value of the velocity in a word."""

ZSW1 = (
    "ready to switch on", "ready to operate", "enabled", "fault", "no coast stop", "no quick stop", "inhibited",
    "warning", "follows", "control", "reached", "homed", "taken", "stopped", "accelerates", "decelerates",
)  # fmt: skip
"""Bits in the order of their places."""
POS_ZSW1 = {"jogging": 10, "homing": 11, "by record": 13, "set up": 14, "mdi": 15}
POS_ZSW2 = {"forwards": 4, "backwards": 5, "at negative limit": 6, "at positive limit": 7, "task active": 15}


def length(telegram: int) -> int:
    """How many registers are sent to the drive."""
    return sum(2 if name in LONG else 1 for name in SENT[telegram])


def split(telegram: int, words: Sequence[int]) -> dict[str, int]:
    """What was sent, by name; words of 32 bits and set-points of velocity are signed, the others not."""
    found, at = {}, 0
    for name in SENT[telegram]:
        size = 2 if name in LONG else 1
        value = sum(word << 16 * i for i, word in enumerate(words[at : at + size]))
        if (name in LONG or name in FULL_SPEED) and value >> 16 * size - 1:
            value -= 1 << 16 * size
        found[name], at = value, at + size
    return found


def join(telegram: int, values: Mapping[str, int]) -> list[int]:
    """The registers that tell `values`; 0 where nothing is given."""
    words: list[int] = []
    for name in TOLD[telegram]:
        value = values.get(name, 0)
        words += [value >> 16 * i & 0xFFFF for i in range(2 if name in LONG else 1)]
    return words + [0] * (SIZE - len(words))


def bits(places: Sequence[str] | Mapping[str, int], true: Mapping[str, bool]) -> int:
    """A status word: the bits at their `places` that are `true`."""
    at = places if isinstance(places, Mapping) else {name: bit for bit, name in enumerate(places)}
    return sum(true.get(name, False) << bit for name, bit in at.items())
