"""CANopen nodes: access to their object dictionary, PDOs, heartbeat and emergencies; and one kind, the transducer.

Requests are sent one at a time, each with a time limit; no write is repeated. A CiA 406 linear transducer such as the
Temposonics E-Series sends position, velocity and status in one PDO, of which the position is read. Its step is read
from the device, in units of 0.001 um (object 6005h:1; without it 6501h). Source: E-Series CANopen manual; CiA 406.
"""

from __future__ import annotations

import struct
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from functools import partial
from queue import Empty, SimpleQueue
from time import monotonic, sleep
from typing import TypeVar

from pmabench.base.errors import DeviceError
from pmabench_drivers.canbus import frames as f
from pmabench_drivers.shared.link import Unanswered, turn

ANSWER = 0.15
"""Longest wait for a node's answer [s]."""
LONGEST = 256
"""Longest object that is read here [bytes]."""

T = TypeVar("T")
BEAT = 0.1
"""Heartbeat interval of every node [s]."""
SILENT = 5 * BEAT
"""A node without a heartbeat for this time is lost [s]."""
EVERY_SYNC = 1
"""Transmission type of a PDO that is sent at each SYNC."""
STARTS = 0.5
"""Time limit for a node to become operational [s]."""
Send = Callable[[int, bytes], None]
POSITIONS = (f.mapping(0x6020, 1, 32), f.mapping(0x6004, 0, 32))
"""Possible mappings of the position: of one of several magnets, or of the only one."""
STEPS, MEASURING_STEP, ALARMS = 0x6005, 0x6501, 0x6503
NO_MAGNET = 1


class Refused(DeviceError):
    """The node has aborted the transfer."""

    def __init__(self, device: str, message: str, channel: str, code: int) -> None:
        super().__init__(device, message, channel)
        self.code = code


class Objects:
    """Objects of one node. `kind` is a format of `struct`: `B`, `b`, `H`, `h`, `I`, `i`."""

    def __init__(self, device: str, name: str, node: int, send: Callable[[int, bytes], None]) -> None:
        self._device, self._name, self._node, self._send = device, name, node, send
        self._answers: SimpleQueue[bytes] = SimpleQueue()
        self._lock = threading.Lock()
        self._owed = False

    def take(self, data: bytes) -> None:
        """Take an SDO answer of this node."""
        self._answers.put(data)

    def read(self, index: int, sub: int, kind: str, deadline: float) -> int:
        """Read a number."""
        data = self.read_bytes(index, sub, deadline)
        if len(data) != struct.calcsize(f"<{kind}"):
            raise self._error(index, sub, f"has {len(data)} bytes where {struct.calcsize(f'<{kind}')} are expected")
        [value] = struct.unpack(f"<{kind}", data)
        return int(value)

    def read_if_there(self, index: int, sub: int, kind: str, deadline: float) -> int | None:
        """Read a number; None if the node has no such object."""
        try:
            return self.read(index, sub, kind, deadline)
        except Refused as error:
            if error.code in f.NO_OBJECT:
                return None
            raise

    def write(self, index: int, sub: int, kind: str, value: int, deadline: float) -> None:
        """Write a number once."""
        try:
            data = struct.pack(f"<{kind}", value)
        except struct.error:
            raise self._error(index, sub, f"cannot be set to {value}") from None
        with self._turn(deadline):
            self._ask(index, sub, f.download(index, sub, data), deadline, written=True)

    def set(self, index: int, sub: int, kind: str, value: int, deadline: float) -> None:
        """Write a number, unless the node already holds it, and read it back."""
        if self.read(index, sub, kind, deadline) == value:
            return
        self.write(index, sub, kind, value, deadline)
        if (held := self.read(index, sub, kind, deadline)) != value:
            raise self._error(index, sub, f"holds {held} after {value} was written")

    def read_bytes(self, index: int, sub: int, deadline: float) -> bytes:
        """Read all bytes of an object."""
        with self._turn(deadline):
            answer = self._ask(index, sub, f.upload(index, sub), deadline, written=False)
            if not answer.segmented:
                return answer.data
            data, toggle, over = b"", 0, False
            while not over and len(data) <= LONGEST:
                self._put(f.next_segment(toggle))
                piece, over, code = self._wait(partial(f.read_segment, toggle=toggle), index, sub, deadline)
                if code:
                    raise self._refused(index, sub, code)
                data, toggle = data + piece, toggle ^ 1
            return data

    # -- one request at a time ----------------------------------------------------------------------------------------

    def _turn(self, deadline: float) -> AbstractContextManager[None]:
        busy = f"{self._name} is still busy with what was asked before"
        return turn(self._lock, deadline, self._device, self._name, busy)

    def _ask(self, index: int, sub: int, question: bytes, deadline: float, *, written: bool) -> f.Answer:
        if self._owed:
            self._flush(deadline)
        self._drain()
        self._put(question)
        answer = self._wait(lambda raw: f.read_answer(raw, index, sub, written=written), index, sub, deadline)
        if answer.abort:
            raise self._refused(index, sub, answer.abort)
        return answer

    def _flush(self, deadline: float) -> None:
        """Read another object first, so that a late answer cannot belong to the next request."""
        self._drain()
        self._put(f.upload(f.DEVICE_TYPE, 0))
        self._wait(lambda raw: f.read_answer(raw, f.DEVICE_TYPE, 0, written=False), f.DEVICE_TYPE, 0, deadline)
        self._owed = False

    def _drain(self) -> None:
        while not self._answers.empty():
            self._answers.get()

    def _put(self, data: bytes) -> None:
        self._send(f.SDO_QUESTION + self._node, data)

    def _wait(self, read: Callable[[bytes], T], index: int, sub: int, deadline: float) -> T:
        until = min(deadline, monotonic() + ANSWER)
        while (left := until - monotonic()) > 0:
            try:
                return read(self._answers.get(timeout=left))
            except f.NoAnswer:
                continue
            except Empty:
                break
        self._owed = True
        asked = f"object {index:04X}h:{sub}; is node {self._node} on, and the bit rate right?"
        what = f"did not answer within {ANSWER:g} s about {asked}"
        raise Unanswered(self._device, f"{self._name} {what}", self._name)

    def _refused(self, index: int, sub: int, code: int) -> Refused:
        reason = f.ABORTS.get(code, "no reason that is known")
        message = f"{self._name} refuses object {index:04X}h:{sub}: {reason} (abort code {code:08X}h)"
        return Refused(self._device, message, self._name, code)

    def _error(self, index: int, sub: int, message: str) -> DeviceError:
        return DeviceError(self._device, f"{self._name}: object {index:04X}h:{sub} {message}", self._name)


class Node(ABC):
    """One node of the bus. `mapped` are its TPDOs in use: identifier -> function that takes the data."""

    profile = 0
    """Number of its device profile, as in object 1000h."""

    def __init__(self, device: str, name: str, number: int, send: Send) -> None:
        self.device, self.name, self.number = device, name, number
        self.objects = Objects(device, name, number, send)
        self.mapped: dict[int, Callable[[bytes], bool]] = {}
        self.model = self.serial = self.firmware = ""
        self._send = send
        self._heard, self._state = 0.0, -1
        self.relied: dict[str, tuple[int, int]] = {}
        """Objects that determine the meaning of its numbers: name -> index and sub-index."""
        self.errors = 0
        """Error register (1001h) as last read by `held`."""
        self._starts = 0
        """Number of boot-up messages."""
        self._watched = False
        self._trouble = ""

    def open(self, deadline: float) -> None:
        """Identify it, set up its PDOs and start it; nothing moves."""
        self._trouble, self._watched = "", False
        found = self.objects.read(f.DEVICE_TYPE, 0, "I", deadline) & 0xFFFF
        if found != self.profile:
            raise self.error(f"node {self.number} is a device of profile CiA {found}, and CiA {self.profile} is needed")
        self.model = self._text(f.DEVICE_NAME, deadline)
        self.firmware = self._text(f.SOFTWARE, deadline)
        serial = self.objects.read_if_there(f.IDENTITY, 4, "I", deadline)
        self.serial = "" if serial is None else str(serial)
        self.objects.set(f.PRODUCER, 0, "H", round(BEAT * 1e3), deadline)
        self.set_up(deadline)
        self._send(f.NMT, bytes([f.START, self.number]))
        until = min(deadline, monotonic() + STARTS)
        while self._state != f.OPERATIONAL:
            if monotonic() > until:
                state = f.NODE_STATES.get(self._state, "silent")
                raise self.error(f"does not become operational: its heartbeat says {state}")
            sleep(0.005)
        self._watched = True

    def takers(self) -> dict[int, Callable[[bytes], bool | None]]:
        """Identifier -> function that takes its answers, heartbeats and emergencies."""
        return {
            f.SDO_ANSWER + self.number: self.objects.take,
            f.HEARTBEAT + self.number: self.take_heartbeat,
            f.EMCY + self.number: self.take_emergency,
        }

    @abstractmethod
    def set_up(self, deadline: float) -> None:
        """Set up PDOs and other objects of this kind of node."""

    def error(self, message: str) -> DeviceError:
        """An error of this node."""
        return DeviceError(self.device, f"{self.name}: {message}", self.name)

    def trouble(self) -> str:
        """Error of the node, else empty; it stays until the node is opened again."""
        if not self._trouble and self._watched and monotonic() - self._heard > SILENT:
            self._trouble = f"{self.name}: no heartbeat for {SILENT:g} s; is its supply or its cable off?"
        return self._trouble

    def held(self, deadline: float) -> dict[str, float | str]:
        """What it reports now of itself; state and starts from its last message, at most 0.5 s old."""
        if monotonic() - self._heard > SILENT:
            raise self.error(f"no heartbeat for {SILENT:g} s; is its supply or its cable off?")
        serial = self.objects.read_if_there(f.IDENTITY, 4, "I", deadline)
        self.errors = self.objects.read(f.ERROR_REGISTER, 0, "B", deadline)
        relied = {what: self.objects.read(*at, "I", deadline) for what, at in self.relied.items()}
        return {
            **{what: f"{value:08X}h" if "mapping" in what else float(value) for what, value in relied.items()},
            "state": f.NODE_STATES.get(self._state, str(self._state)),
            "starts": float(self._starts),
            "error register": float(self.errors),
            "serial number": "" if serial is None else str(serial),
        }

    def take_heartbeat(self, data: bytes) -> None:
        """Take a heartbeat or a boot-up message."""
        if len(data) != 1:
            return
        self._heard, self._state = monotonic(), data[0] & 0x7F
        self._starts += self._state == f.BOOT
        if self._watched and self._state != f.OPERATIONAL and not self._trouble:
            state = f.NODE_STATES.get(self._state, f"in state {self._state}")
            self._trouble = f"{self.name}: is {state} all of a sudden; it has started again, or was commanded to stop"

    def take_emergency(self, data: bytes) -> None:
        """Take an emergency; code 0 ends an error in the node, but not in this run."""
        if len(data) < 2 or self._trouble:
            return
        if code := int.from_bytes(data[:2], "little"):
            self._trouble = f"{self.name}: emergency {code:04X}h: {f.emergency_text(code)}"

    # -- process data -------------------------------------------------------------------------------------------------

    def transmit(self, number: int, entries: Sequence[int], take: Callable[[bytes], bool], deadline: float) -> None:
        """Have TPDO `number` (from 0) send `entries` at each SYNC; the present mapping if `entries` is empty."""
        identifier = f.TPDO[number] + self.number
        self._pdo(f.TPDO_PARAMETER + number, f.TPDO_MAPPING + number, identifier, entries, deadline)
        self.mapped[identifier] = take

    def receive(self, number: int, entries: Sequence[int], deadline: float) -> int:
        """Have RPDO `number` (from 0) take `entries`, effective at the next SYNC; returns its identifier."""
        identifier = f.RPDO[number] + self.number
        self._pdo(f.RPDO_PARAMETER + number, f.RPDO_MAPPING + number, identifier, entries, deadline)
        return identifier

    def _pdo(self, parameter: int, mapping: int, identifier: int, entries: Sequence[int], deadline: float) -> None:
        """Disable, set type and mapping, enable, as in CiA 301; nothing is written if the node already holds it."""
        held = self.objects.read(parameter, 1, "I", deadline)
        used = identifier | (held & f.NO_REMOTE)
        same = held == used and self.objects.read(parameter, 2, "B", deadline) == EVERY_SYNC
        if same and (not entries or self._mapping(mapping, deadline) == list(entries)):
            return
        self.objects.write(parameter, 1, "I", used | f.INVALID, deadline)
        self.objects.write(parameter, 2, "B", EVERY_SYNC, deadline)
        if entries:
            self.objects.write(mapping, 0, "B", 0, deadline)
            for sub, entry in enumerate(entries, 1):
                self.objects.write(mapping, sub, "I", entry, deadline)
            self.objects.write(mapping, 0, "B", len(entries), deadline)
        self.objects.write(parameter, 1, "I", used, deadline)
        held = self.objects.read(parameter, 1, "I", deadline)
        if held != used or (entries and self._mapping(mapping, deadline) != list(entries)):
            raise self.error(f"does not hold what was written for the PDO {identifier:03X}h")

    def _mapping(self, index: int, deadline: float) -> list[int]:
        count = self.objects.read(index, 0, "B", deadline)
        return [self.objects.read(index, sub, "I", deadline) for sub in range(1, min(count, 8) + 1)]

    def _text(self, index: int, deadline: float) -> str:
        try:
            data = self.objects.read_bytes(index, 0, deadline)
        except Refused:
            return ""
        text = data.split(b"\0")[0].decode("ascii", "replace")
        return "".join(c if c.isprintable() else "?" for c in text)[:60]


class Transducer(Node):
    """A transducer of the bus; `position` [um] is its newest value."""

    profile = 406

    def __init__(self, device: str, name: str, number: int, send: Send) -> None:
        super().__init__(device, name, number, send)
        self.position = self._step = 0.0

    def set_up(self, deadline: float) -> None:
        """Read its resolution, and have it answer to each SYNC."""
        alarms = self.objects.read_if_there(ALARMS, 0, "H", deadline)
        if alarms is not None and alarms & NO_MAGNET:
            raise self.error("says that its magnet is missing")
        self.relied = {"measuring step": (STEPS, 1), "mapping": (f.TPDO_MAPPING, 1)}
        if (step := self.objects.read_if_there(STEPS, 1, "I", deadline)) is None:
            step = self.objects.read_if_there(MEASURING_STEP, 0, "I", deadline)
            self.relied["measuring step"] = (MEASURING_STEP, 0)
        if not step:
            raise self.error("does not report its measuring step (objects 6005h:1 and 6501h)")
        self._step = step * 1e-3
        entries = self._mapping(f.TPDO_MAPPING, deadline)
        if not entries or entries[0] not in POSITIONS:
            shown = f"{entries[0]:08X}h" if entries else "nothing"
            raise self.error(f"its first PDO begins with {shown}, and a position (60200120h or 60040020h) is expected")
        self.mapped.clear()
        self.transmit(0, [], self._take, deadline)

    def _take(self, data: bytes) -> bool:
        if not 4 <= len(data) <= 8:
            return False
        self.position = int.from_bytes(data[:4], "little", signed=True) * self._step
        return True
