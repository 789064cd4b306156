"""CANopen on the wire: identifiers, object indices, SDO frames; and the state machine of a CiA 402 drive.

Pure functions; standard library only. Source: CiA 301 (identifiers, SDO, NMT, heartbeat, emergency), CiA 402 and
CiA 406 (objects of drives and transducers); CiA 402-2 (IEC 61800-7-201), power drive system state machine.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import Enum

NMT, SYNC, EMCY, SDO_ANSWER, SDO_QUESTION, HEARTBEAT = 0x000, 0x080, 0x080, 0x580, 0x600, 0x700
"""Identifiers; the node's number is added to the last four."""
TPDO, RPDO = (0x180, 0x280), (0x200, 0x300)
"""Default identifiers of the first PDOs of a node."""
START, STOP, PREOPERATIONAL, RESET_NODE = 0x01, 0x02, 0x80, 0x81
BOOT, STOPPED, OPERATIONAL, PREOP = 0x00, 0x04, 0x05, 0x7F
"""States of a node in its heartbeat."""
NODE_STATES = {BOOT: "starting", STOPPED: "stopped", OPERATIONAL: "operational", PREOP: "pre-operational"}

DEVICE_TYPE, ERROR_REGISTER, DEVICE_NAME, SOFTWARE = 0x1000, 0x1001, 0x1008, 0x100A
CONSUMER, PRODUCER, IDENTITY = 0x1016, 0x1017, 0x1018
COMMUNICATION_ERROR = 1 << 4
"""Bit of the error register."""
RPDO_PARAMETER, RPDO_MAPPING, TPDO_PARAMETER, TPDO_MAPPING = 0x1400, 0x1600, 0x1800, 0x1A00
INVALID, NO_REMOTE = 1 << 31, 1 << 30
"""Bits of a PDO's identifier: not used; not sent on request."""

ABORTS = {
    0x05030000: "toggle bit not alternated",
    0x05040000: "its own time for the question ran out",
    0x05040001: "it does not know this kind of question",
    0x06010000: "this object cannot be accessed so",
    0x06010001: "this object can only be written",
    0x06010002: "this object can only be read",
    0x06020000: "it has no such object",
    0x06040041: "this object cannot be mapped into a PDO",
    0x06040042: "the mapped objects are longer than a PDO",
    0x06040043: "parameters do not fit together",
    0x06060000: "its hardware failed",
    0x06070010: "length or type does not fit",
    0x06070012: "the value is too long",
    0x06070013: "the value is too short",
    0x06090011: "it has no such sub-index",
    0x06090030: "the value is not allowed",
    0x06090031: "the value is too high",
    0x06090032: "the value is too low",
    0x08000000: "general error",
    0x08000020: "it cannot store this",
    0x08000021: "it is under local control",
    0x08000022: "its present state does not allow it",
}
"""SDO abort codes (CiA 301)."""
NO_OBJECT = frozenset({0x06020000, 0x06090011})

EMERGENCIES = (
    (0x2300, 0xFF00, "current at its output"),
    (0x2000, 0xF000, "current"),
    (0x3000, 0xF000, "voltage"),
    (0x4000, 0xF000, "temperature"),
    (0x5000, 0xF000, "its hardware"),
    (0x6000, 0xF000, "its software"),
    (0x7300, 0xFF00, "its sensor"),
    (0x7000, 0xF000, "an additional module"),
    (0x8130, 0xFFFF, "it heard no heartbeat any more"),
    (0x8100, 0xFF00, "communication"),
    (0x8200, 0xFF00, "protocol"),
    (0x8611, 0xFFFF, "following error: it cannot be where it should"),
    (0x8000, 0xF000, "monitoring"),
    (0x9000, 0xF000, "an external error"),
    (0xF000, 0xF000, "a code of its maker"),
)
"""Error code, mask, meaning (CiA 301, CiA 402)."""
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
"""Abort connection option code: quick stop after a lost heartbeat."""
STAY_STOPPED = 6
"""Quick stop option code: slow down on the quick stop ramp and stay in quick stop active, with torque."""
SHUTDOWN, SWITCH_ON, ENABLE, QUICK_STOP, FAULT_RESET = 0x06, 0x07, 0x0F, 0x02, 0x80
NEW_SET_POINT, AT_ONCE = 0x10, 0x20
"""Bits of the controlword in profile position: a new target is valid; it replaces the present one."""
TARGET_REACHED, INTERNAL_LIMIT, ACKNOWLEDGE = 1 << 10, 1 << 11, 1 << 12


@dataclass(frozen=True)
class Frame:
    """A data frame."""

    identifier: int
    data: bytes = b""
    extended: bool = False


@dataclass(frozen=True)
class Answer:
    """Answer of a node on one object: data, an abort code, or that segments follow."""

    data: bytes = b""
    abort: int = 0
    segmented: bool = False


class NoAnswer(ValueError):
    """The frame is no answer to the request."""


def emergency_text(code: int) -> str:
    """Meaning of an emergency error code."""
    return next((text for value, mask, text in EMERGENCIES if code & mask == value), "an error")


def download(index: int, sub: int, data: bytes) -> bytes:
    """Frame that writes 1 to 4 bytes into an object."""
    return struct.pack("<BHB", 0x23 | (4 - len(data)) << 2, index, sub) + data.ljust(4, b"\0")


def upload(index: int, sub: int) -> bytes:
    """Frame that reads an object."""
    return struct.pack("<BHB4x", 0x40, index, sub)


def next_segment(toggle: int) -> bytes:
    """Frame that requests the next segment of a long object; `toggle` alternates from 0."""
    return bytes([0x60 | toggle << 4]) + bytes(7)


def abort(index: int, sub: int, code: int) -> bytes:
    """Frame that aborts a transfer."""
    return struct.pack("<BHBI", 0x80, index, sub, code)


def read_answer(data: bytes, index: int, sub: int, *, written: bool) -> Answer:
    """The answer to `download` (`written`) or `upload`; raises NoAnswer for any other frame."""
    if len(data) != 8:
        raise NoAnswer(f"{len(data)} bytes where 8 are expected")
    command, at, at_sub = struct.unpack_from("<BHB", data)
    if (at, at_sub) != (index, sub):
        raise NoAnswer(f"an answer about {at:04X}h:{at_sub}")
    if command == 0x80:
        return Answer(abort=int.from_bytes(data[4:], "little") or 0x08000000)
    if written and command == 0x60:
        return Answer()
    if written or command >> 5 != 2:
        raise NoAnswer(f"command {command:02X}h")
    expedited, sized = command & 2, command & 1
    if not expedited:
        return Answer(segmented=True)
    return Answer(data[4 : 8 - (command >> 2 & 3)] if sized else data[4:])


def read_segment(data: bytes, toggle: int) -> tuple[bytes, bool, int]:
    """Bytes of a segment, whether it is the last one, and an abort code or 0; raises NoAnswer."""
    if len(data) != 8:
        raise NoAnswer(f"{len(data)} bytes where 8 are expected")
    if (command := data[0]) == 0x80:
        return b"", True, int.from_bytes(data[4:], "little") or 0x08000000
    if command >> 5 != 0 or (command >> 4 & 1) != toggle:
        raise NoAnswer(f"command {command:02X}h")
    return data[1 : 8 - (command >> 1 & 7)], bool(command & 1), 0


def mapping(index: int, sub: int, bits: int) -> int:
    """Entry of a PDO mapping."""
    return index << 16 | sub << 8 | bits


class State(Enum):
    """States of the power drive system, by their common names."""

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
"""State -> controlword for the next step towards operation, and the state that follows."""


def state_of(status: int) -> State | None:
    """State in a statusword; None for a word that CiA 402 does not define."""
    return next((state for mask, value, state in STATES if status & mask == value), None)


def supports(modes: int, mode: int) -> bool:
    """Whether the bits of object 6502h include a mode."""
    return bool(modes >> (mode - 1) & 1)


def why_not(state: State, status: int) -> str:
    """Possible reason why a drive stays in a state, for people at the rig."""
    if state is State.NOT_READY:
        return "it is still starting"
    if state is State.DISABLED:
        return "voltage of the power stage, safe torque off or an enable input may be missing"
    if state in {State.READY, State.ON}:
        power = "" if status & 0x10 else "its power stage has no voltage; "
        return f"{power}an enable input or the brake may hold it back"
    return "look at the drive's own display"
