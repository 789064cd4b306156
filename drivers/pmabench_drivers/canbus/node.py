"""What all CANopen nodes have in common: who they are, their PDOs, their heartbeat and their emergencies."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from time import monotonic, sleep

from pmabench.base.errors import DeviceError
from pmabench_drivers.canbus import frames as f
from pmabench_drivers.canbus.sdo import Objects, Refused

BEAT = 0.1
"""Every node sends its heartbeat so often [s]."""
SILENT = 5 * BEAT
"""A node that was not heard for so long is lost [s]."""
EVERY_SYNC = 1
"""Transmission type of a PDO that answers to each SYNC."""
STARTS = 0.5
"""How long a node is given to become operational [s]."""

Send = Callable[[int, bytes], None]


class Node(ABC):
    """One node of the bus. `mapped` are its TPDOs in use: identifier -> what takes the data."""

    profile = 0
    """Number of its device profile, as object 1000h tells it."""

    def __init__(self, device: str, name: str, number: int, send: Send) -> None:
        self.device, self.name, self.number = device, name, number
        self.objects = Objects(device, name, number, send)
        self.mapped: dict[int, Callable[[bytes], bool]] = {}
        self.model = self.serial = self.firmware = ""
        self._send = send
        self._heard, self._state = 0.0, -1
        self.errors = 0
        """The error register (1001h) when `held` read it last."""
        self._starts = 0
        """How often it said that it has started."""
        self._watched = False
        self._trouble = ""

    def open(self, deadline: float) -> None:
        """Find out who it is, set up its PDOs and let it start; nothing moves."""
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
                state = f.STATES.get(self._state, "silent")
                raise self.error(f"does not become operational: its heartbeat says {state}")
            sleep(0.005)
        self._watched = True

    @abstractmethod
    def set_up(self, deadline: float) -> None:
        """Whatever the kind of node needs, PDOs first of all."""

    def error(self, message: str) -> DeviceError:
        """An error of this node."""
        return DeviceError(self.device, f"{self.name}: {message}", self.name)

    def trouble(self) -> str:
        """What is wrong with the node, if anything is; what was wrong once stays until it is opened again."""
        if not self._trouble and self._watched and monotonic() - self._heard > SILENT:
            self._trouble = f"{self.name}: no heartbeat for {SILENT:g} s; is its supply or its cable off?"
        return self._trouble

    def held(self, deadline: float) -> dict[str, float | str]:
        """What it reports now of itself; state and starts as its last message had them, at most 0.5 s ago."""
        if monotonic() - self._heard > SILENT:
            raise self.error(f"no heartbeat for {SILENT:g} s; is its supply or its cable off?")
        serial = self.objects.read_if_there(f.IDENTITY, 4, "I", deadline)
        self.errors = self.objects.read(f.ERROR_REGISTER, 0, "B", deadline)
        return {
            "state": f.STATES.get(self._state, str(self._state)),
            "starts": float(self._starts),
            "error register": float(self.errors),
            "serial number": "" if serial is None else str(serial),
        }

    def take_heartbeat(self, data: bytes) -> None:
        """A heartbeat, or the word that it has started, has come."""
        if len(data) != 1:
            return
        self._heard, self._state = monotonic(), data[0] & 0x7F
        self._starts += self._state == f.BOOT
        if self._watched and self._state != f.OPERATIONAL and not self._trouble:
            state = f.STATES.get(self._state, f"in state {self._state}")
            self._trouble = f"{self.name}: is {state} all of a sudden; it has started again, or was commanded to stop"

    def take_emergency(self, data: bytes) -> None:
        """An emergency has come; code 0 says that an error is over, which ends no run's doubt."""
        if len(data) < 2 or self._trouble:
            return
        code = int.from_bytes(data[:2], "little")
        if code:
            self._trouble = f"{self.name}: emergency {code:04X}h: {f.emergency_text(code)}"

    # -- process data -------------------------------------------------------------------------------------------------

    def transmit(self, number: int, entries: Sequence[int], take: Callable[[bytes], bool], deadline: float) -> None:
        """Let TPDO `number` (from 0) send `entries` at each SYNC, or what is mapped where there are none."""
        identifier = f.TPDO[number] + self.number
        self._pdo(f.TPDO_PARAMETER + number, f.TPDO_MAPPING + number, identifier, entries, deadline)
        self.mapped[identifier] = take

    def receive(self, number: int, entries: Sequence[int], deadline: float) -> int:
        """Let RPDO `number` (from 0) take the `entries`, valid from the next SYNC on; its identifier."""
        identifier = f.RPDO[number] + self.number
        self._pdo(f.RPDO_PARAMETER + number, f.RPDO_MAPPING + number, identifier, entries, deadline)
        return identifier

    def _pdo(self, parameter: int, mapping: int, identifier: int, entries: Sequence[int], deadline: float) -> None:
        """Off, type, mapping, on, as CiA 301 has it; nothing is written where the node holds it already."""
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
