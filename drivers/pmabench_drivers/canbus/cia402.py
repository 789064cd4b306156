"""The state machine of a CiA 402 drive: states out of the statusword, the way to operation, words for people.

Pure functions. Source: CiA 402-2 (IEC 61800-7-201), power drive system state machine.
"""

from __future__ import annotations

from enum import Enum

CONTROLWORD, STATUSWORD, MODE, MODE_SHOWN = 0x6040, 0x6041, 0x6060, 0x6061
TARGET, ACTUAL, DEMAND = 0x607A, 0x6064, 0x6062
PROFILE_VELOCITY, LIMITS, SUPPORTED = 0x6081, 0x607D, 0x6502
ABORT_OPTION, QUICK_STOP_OPTION, ERROR_CODE = 0x6007, 0x605A, 0x603F
PERIOD = 0x60C2
WINDOW, WINDOW_TIME = 0x6065, 0x6066

PROFILE, CYCLIC = 1, 8
"""Modes of operation: profile position, cyclic synchronous position."""
MODES = {PROFILE: "profile position", CYCLIC: "cyclic synchronous position"}
QUICK_STOP_ON_LOSS = 3
"""Abort connection option code: quick stop where the heartbeat is lost."""
STAY_STOPPED = 6
"""Quick stop option code: slow down on the quick stop ramp and stay in quick stop active, with torque."""

SHUTDOWN, SWITCH_ON, ENABLE, QUICK_STOP, FAULT_RESET = 0x06, 0x07, 0x0F, 0x02, 0x80
NEW_SET_POINT, AT_ONCE = 0x10, 0x20
"""Bits of the controlword in profile position: a new target is valid; it replaces the one under way."""
TARGET_REACHED, INTERNAL_LIMIT, ACKNOWLEDGE = 1 << 10, 1 << 11, 1 << 12


class State(Enum):
    """States of the power drive system, as people call them."""

    NOT_READY = "not ready to switch on"
    DISABLED = "switch on disabled"
    READY = "ready to switch on"
    ON = "switched on"
    ENABLED = "operation enabled"
    STOPPED = "quick stop active"
    REACTING = "fault reaction active"
    FAULT = "fault"


STATES = (
    (0x4F, 0x00, State.NOT_READY),
    (0x4F, 0x40, State.DISABLED),
    (0x6F, 0x21, State.READY),
    (0x6F, 0x23, State.ON),
    (0x6F, 0x27, State.ENABLED),
    (0x6F, 0x07, State.STOPPED),
    (0x4F, 0x0F, State.REACTING),
    (0x4F, 0x08, State.FAULT),
)
"""Mask, value, state."""
NEXT = {
    State.DISABLED: (SHUTDOWN, State.READY),
    State.READY: (SWITCH_ON, State.ON),
    State.ON: (ENABLE, State.ENABLED),
    State.STOPPED: (ENABLE, State.ENABLED),
}
"""State -> the controlword that leads on towards operation, and the state that follows."""


def state_of(status: int) -> State | None:
    """The state that a statusword tells; None for a word that CiA 402 does not know."""
    return next((state for mask, value, state in STATES if status & mask == value), None)


def supports(modes: int, mode: int) -> bool:
    """Whether the bits of object 6502h have a mode."""
    return bool(modes >> (mode - 1) & 1)


def why_not(state: State, status: int) -> str:
    """Why a drive may stay where it is, for people at the rig."""
    if state is State.NOT_READY:
        return "it is still starting"
    if state is State.DISABLED:
        return "voltage of the power stage, safe torque off or an enable input may be missing"
    if state in {State.READY, State.ON}:
        power = "" if status & 0x10 else "its power stage has no voltage; "
        return f"{power}an enable input or the brake may hold it back"
    return "look at the drive's own display"
