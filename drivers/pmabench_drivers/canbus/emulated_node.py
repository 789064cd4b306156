"""An emulated CANopen node: object dictionary behind SDO, PDOs, NMT, heartbeats, emergencies; without a profile.

SDO abort codes: CiA 301.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from time import monotonic

from pmabench_drivers.canbus import frames as f
from pmabench_drivers.canbus.frames import Frame

TOGGLE, COMMAND = 0x05030000, 0x05040001
READ_ONLY, NO_OBJECT, NO_SUB = 0x06010002, 0x06020000, 0x06090011
UNMAPPABLE, TOO_MUCH = 0x06040041, 0x06040042
LONG, SHORT, VALUE = 0x06070012, 0x06070013, 0x06090030
STATE = 0x08000022
"""SDO abort codes."""
LOST_HEARTBEAT = 0x8130
BOOTING = 0.05
"""Time from a reset to the boot-up message [s]."""
SEGMENT = 7
PDOS = 2


class Abort(Exception):
    """The node refuses a transfer with this abort code."""

    def __init__(self, code: int) -> None:
        super().__init__(f"{code:08X}")
        self.code = code


@dataclass
class Entry:
    """One object: `kind` is a format of `struct`, or `s` for text."""

    kind: str
    value: int | bytes = 0
    writable: bool = False
    read: Callable[[], int] | None = None
    """Function for its present value, if it is not stored."""
    written: Callable[[int], None] | None = None
    """Called with a new value before it is stored; may raise Abort."""

    def __post_init__(self) -> None:
        self.power_on = self.value
        """Its value after a restart."""

    def bytes(self) -> bytes:
        """Value as sent over the wire."""
        value = self.read() if self.read is not None else self.value
        return value if isinstance(value, bytes) else struct.pack(f"<{self.kind}", value)


@dataclass
class _Consumer:
    node: int = 0
    time: float = 0.0
    heard: float = 0.0
    """Last heartbeat [s, monotonic]; 0: none yet, so none can be missed."""
    expired: bool = False
    """Treat the heartbeat as missed at the next turn in any case."""


class EmulatedNode:
    """One node. Subclasses add objects, and define what happens on SYNC, on stop and when a heartbeat is lost."""

    def __init__(self, number: int, profile: int, model: str, send: Callable[[Frame], None]) -> None:
        self.number, self.state = number, f.PREOP
        self._send = send
        self._consumer, self._missed = _Consumer(), False
        self._beat_due, self.now = 0.0, monotonic()
        self._boots = 0.0
        """When it will have restarted [s, monotonic]."""
        self._segments: bytes | None = None
        """Rest of a long object to be sent; None: no upload in progress."""
        self._toggle = 0
        self._waiting: dict[int, bytes] = {}
        self.objects: dict[tuple[int, int], Entry] = {
            (f.DEVICE_TYPE, 0): Entry("I", profile),
            (f.ERROR_REGISTER, 0): Entry("B", 0),
            (f.DEVICE_NAME, 0): Entry("s", model.encode()),
            (f.SOFTWARE, 0): Entry("s", b"1"),
            (f.CONSUMER, 0): Entry("B", 1),
            (f.CONSUMER, 1): Entry("I", 0, writable=True, written=self._consume),
            (f.PRODUCER, 0): Entry("H", 0, writable=True, written=self._produce),
            (f.IDENTITY, 0): Entry("B", 4),
            **{(f.IDENTITY, sub): Entry("I", value) for sub, value in enumerate((0, profile, 1, number), 1)},
        }
        for index in range(PDOS):
            for parameter, identifier in ((f.TPDO_PARAMETER, f.TPDO), (f.RPDO_PARAMETER, f.RPDO)):
                self._add_pdo(parameter + index, identifier[index] + number)

    def _add_pdo(self, parameter: int, identifier: int) -> None:
        at = parameter + 0x200
        used = f.INVALID | identifier | (f.NO_REMOTE if parameter >= f.TPDO_PARAMETER else 0)
        self.objects |= {
            (parameter, 0): Entry("B", 2),
            (parameter, 1): Entry("I", used, writable=True, written=lambda value: self._identify(at, value)),
            (parameter, 2): Entry("B", 254, writable=True),
            (at, 0): Entry("B", 0, writable=True, written=lambda count: self._map(parameter, count)),
        }
        for sub in range(1, 9):
            self.objects[at, sub] = Entry("I", 0, writable=True, written=lambda _value: self._may_map(parameter))

    def boot(self) -> None:
        """Enter pre-operational and send the boot-up message."""
        self.state, self._beat_due = f.PREOP, 0.0
        self._send(Frame(f.HEARTBEAT + self.number, bytes([f.BOOT])))

    def reset(self) -> None:
        """Restart, with power-on values of all objects."""
        for entry in self.objects.values():
            entry.value = entry.power_on
        self._consumer, self._missed, self._segments = _Consumer(), False, None
        self._waiting.clear()
        self.state, self._boots = f.BOOT, self.now + BOOTING

    def preset(self, index: int, sub: int, value: int) -> None:
        """Set the present and power-on value of an object."""
        self.objects[index, sub].value = self.objects[index, sub].power_on = value

    def expire_heartbeat(self) -> bool:
        """Treat the monitored heartbeat as missed; returns whether one was monitored."""
        consumer = self._consumer
        consumer.expired = bool(consumer.time and consumer.heard)
        return consumer.expired

    # -- for subclasses -----------------------------------------------------------------------------------------------

    def synchronised(self) -> None:
        """Called at each SYNC, after the PDOs received before it were applied."""

    def lost_heartbeat(self) -> None:
        """Called when the monitored heartbeat is missing."""

    def stopped(self) -> None:
        """Called when the node enters the state stopped."""

    def well(self) -> bool:
        """Whether it has no error other than that of the communication."""
        return True

    # -- values -------------------------------------------------------------------------------------------------------

    def get(self, index: int, sub: int = 0) -> int:
        """Value of a numeric object."""
        entry = self.objects[index, sub]
        value = entry.read() if entry.read is not None else entry.value
        assert isinstance(value, int)  # noqa: S101  (texts are read as bytes only)
        return value

    def put(self, index: int, sub: int, data: bytes) -> None:
        """Write an object with bytes from the wire; raises Abort."""
        if (entry := self.objects.get((index, sub))) is None:
            raise Abort(NO_SUB if any(key[0] == index for key in self.objects) else NO_OBJECT)
        if not entry.writable:
            raise Abort(READ_ONLY)
        if (surplus := len(data) - struct.calcsize(f"<{entry.kind}")) != 0:
            raise Abort(LONG if surplus > 0 else SHORT)
        [value] = struct.unpack(f"<{entry.kind}", data)
        if entry.written is not None:
            entry.written(value)
        entry.value = value

    def emergency(self, code: int, register: int = 1) -> None:
        """Send an emergency, unless the node is stopped; code 0 ends the error."""
        self.objects[f.ERROR_REGISTER, 0].value = register
        if self.state == f.STOPPED:
            return
        data = code.to_bytes(2, "little") + bytes([register]) + bytes(5)
        self._send(Frame(f.EMCY + self.number, data))

    # -- frames -------------------------------------------------------------------------------------------------------

    def take(self, frame: Frame, now: float) -> None:
        """Process a frame; all nodes receive it at the same time `now` [s, monotonic]."""
        self.now = now
        if frame.extended or self.state == f.BOOT:
            return
        identifier, data = frame.identifier, frame.data
        if identifier == f.NMT and len(data) == 2 and data[1] in {0, self.number}:
            self._manage(data[0])
        elif identifier == f.SYNC:
            self._synchronise()
        elif identifier == f.SDO_QUESTION + self.number and len(data) == 8 and self.state != f.STOPPED:
            if answer := self._answer(data):
                self._send(Frame(f.SDO_ANSWER + self.number, answer))
        elif identifier == f.HEARTBEAT + self._consumer.node and self._consumer.time:
            self._consumer.heard = self.now
            self._forgive()
        elif self.state == f.OPERATIONAL:
            self._receive(identifier, data)

    def turn(self, now: float) -> None:
        """Do what is due at `now` [s, monotonic]: boot, heartbeats, lost heartbeats."""
        self.now = now
        if self.state == f.BOOT:
            if now >= self._boots:
                self.boot()
            return
        period = self.get(f.PRODUCER) * 1e-3
        if period and now >= self._beat_due:
            self._beat_due = now + period
            self._send(Frame(f.HEARTBEAT + self.number, bytes([self.state])))
        consumer = self._consumer
        if consumer.time and consumer.heard and (consumer.expired or now - consumer.heard > consumer.time):
            consumer.heard, consumer.expired, self._missed = 0.0, False, True
            self.emergency(LOST_HEARTBEAT, 0x11)
            self.lost_heartbeat()

    def _manage(self, command: int) -> None:
        known = {f.START: f.OPERATIONAL, f.STOP: f.STOPPED, f.PREOPERATIONAL: f.PREOP}
        if command == f.RESET_NODE:
            self.reset()
        elif command in known:
            before, self.state = self.state, known[command]
            if self.state == f.STOPPED != before:
                self.stopped()
            self._beat_due = 0.0

    # -- SDO ----------------------------------------------------------------------------------------------------------

    def _answer(self, data: bytes) -> bytes:
        """Answer to an SDO request; empty for an abort by the client."""
        command, index, sub = struct.unpack_from("<BHB", data)
        kind = command >> 5
        try:
            if kind == 4:
                self._segments = None
                return b""
            if kind == 1:
                size = 4 - (command >> 2 & 3) if command & 1 else self._size(index, sub)
                if not command & 2:  # no writable object here is longer than 4 bytes
                    self.put(index, sub, bytes(max(5, int.from_bytes(data[4:], "little") & 0xFF)))
                self.put(index, sub, data[4 : 4 + size])
                return struct.pack("<BHB4x", 0x60, index, sub)
            if kind == 2:
                return self._upload(index, sub)
            if kind == 3:
                return self._segment(command >> 4 & 1)
        except Abort as error:
            return f.abort(index, sub, error.code)
        return f.abort(index, sub, COMMAND)

    def _size(self, index: int, sub: int) -> int:
        entry = self.objects.get((index, sub))
        return struct.calcsize(f"<{entry.kind}") if entry is not None and entry.kind != "s" else 4

    def _upload(self, index: int, sub: int) -> bytes:
        entry = self.objects.get((index, sub))
        if entry is None:
            raise Abort(NO_SUB if any(key[0] == index for key in self.objects) else NO_OBJECT)
        data = entry.bytes()
        if entry.kind != "s":
            self._segments = None
            return struct.pack("<BHB", 0x43 | (4 - len(data)) << 2, index, sub) + data.ljust(4, b"\0")
        self._segments, self._toggle = data, 0
        return struct.pack("<BHBI", 0x41, index, sub, len(data))

    def _segment(self, toggle: int) -> bytes:
        if self._segments is None:
            raise Abort(COMMAND)
        if toggle != self._toggle:
            raise Abort(TOGGLE)
        piece, self._segments = self._segments[:SEGMENT], self._segments[SEGMENT:]
        self._toggle ^= 1
        head = toggle << 4 | (SEGMENT - len(piece)) << 1 | (not self._segments)
        self._segments = self._segments or None
        return bytes([head]) + piece.ljust(SEGMENT, b"\0")

    # -- PDO ----------------------------------------------------------------------------------------------------------

    def _identify(self, mapping: int, value: int) -> None:
        if not value & f.INVALID and not self.get(mapping):
            raise Abort(STATE)

    def _may_map(self, parameter: int) -> None:
        if not self.get(parameter, 1) & f.INVALID:
            raise Abort(STATE)

    def _map(self, parameter: int, count: int) -> None:
        self._may_map(parameter)
        if count > 8:
            raise Abort(VALUE)
        entries = [self.get(parameter + 0x200, sub) for sub in range(1, count + 1)]
        for entry in entries:
            target = self.objects.get((entry >> 16, entry >> 8 & 0xFF))
            if target is None or target.kind == "s" or 8 * struct.calcsize(f"<{target.kind}") != entry & 0xFF:
                raise Abort(UNMAPPABLE)
        if sum(entry & 0xFF for entry in entries) > 64:
            raise Abort(TOO_MUCH)

    def _entries(self, mapping: int) -> list[tuple[int, int]]:
        values = (self.get(mapping, sub) for sub in range(1, self.get(mapping) + 1))
        return [(value >> 16, value >> 8 & 0xFF) for value in values]

    def _synchronise(self) -> None:
        if self.state != f.OPERATIONAL:
            return
        for index, data in sorted(self._waiting.items()):
            self._apply(index, data)
        self._waiting.clear()
        self.synchronised()
        for index in range(PDOS):
            if 1 <= self.get(f.TPDO_PARAMETER + index, 2) <= 240:
                self._transmit(index)

    def _transmit(self, index: int) -> None:
        identifier = self.get(f.TPDO_PARAMETER + index, 1)
        if not identifier & f.INVALID:
            content = b"".join(self.objects[key].bytes() for key in self._entries(f.TPDO_MAPPING + index))
            self._send(Frame(identifier & 0x7FF, content))

    def _receive(self, identifier: int, data: bytes) -> None:
        for index in range(PDOS):
            held = self.get(f.RPDO_PARAMETER + index, 1)
            if held & f.INVALID or held & 0x7FF != identifier:
                continue
            if self.get(f.RPDO_PARAMETER + index, 2) <= 240:
                self._waiting[index] = data

    def _apply(self, index: int, data: bytes) -> None:
        at = 0
        for key in self._entries(f.RPDO_MAPPING + index):
            size = struct.calcsize(f"<{self.objects[key].kind}")
            if at + size > len(data):
                self.emergency(0x8210)
                return
            try:
                self.put(*key, data[at : at + size])
            except Abort:
                self.emergency(0x8200)
            at += size

    # -- heartbeats ---------------------------------------------------------------------------------------------------

    def _consume(self, value: int) -> None:
        self._consumer = _Consumer(value >> 16 & 0x7F, (value & 0xFFFF) * 1e-3)
        self._forgive()

    def _forgive(self) -> None:
        """The heartbeat is received again, or no longer monitored."""
        if self._missed:
            self._missed = False
            if self.well():
                self.emergency(0, 0)

    def _produce(self, _value: int) -> None:
        self._beat_due = 0.0
