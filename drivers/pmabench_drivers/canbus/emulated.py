"""An emulated CAN bus in front of the plant: drives, transducers and sensors behind any number of slcan adapters.

All adapters are behind one TCP port of this machine, the nodes in this process.
"""

from __future__ import annotations

import contextlib
import selectors
import socket
import threading
from collections.abc import Callable
from queue import SimpleQueue
from time import monotonic
from typing import Any

from pmabench.base.errors import UsageError
from pmabench.bench.interface import ChannelRecord, DeviceRecord, OutputRecord, Scale
from pmabench_drivers.canbus import frames as f
from pmabench_drivers.canbus import node as t
from pmabench_drivers.canbus.emulated_drive import STATUS, STEP, VELOCITY, EmulatedDrive, encoder_objects
from pmabench_drivers.canbus.emulated_node import EmulatedNode
from pmabench_drivers.canbus.frames import Frame
from pmabench_drivers.canbus.link import TCP, line_of, read_line
from pmabench_drivers.canbus.options import Message, Options, read_options
from pmabench_drivers.emulator import faults as wire_faults
from pmabench_drivers.emulator.plant import RealPlant
from pmabench_drivers.emulator.ports import hang_up, listen
from pmabench_drivers.shared.options import options_of

TICK = 0.002
"""Interval at which the nodes act [s]."""
LONGEST = 64
"""Longest unfinished line that is kept [bytes]."""
SERIAL = b"NSIM0\r"
"""Serial number of the emulated adapters."""
GARBAGE = b"t1zz8\x00\xff\r\x07T0000\r"
"""Invalid frames that look similar to valid ones."""
COMMANDS = (b"C", b"L", b"O", b"S", b"s", b"F", b"X", b"Z", b"V", b"N")
PREFIX = f"slcan:{TCP}"
CAN = {
    "emergency": wire_faults.Kind(
        "the drive stops with a fault, or a transducer has an error, and the emergency has this code", "number", 0x5000
    ),
    "restart": wire_faults.Kind("the nodes start again, as after a dip of their supply"),
    "disabled": wire_faults.Kind("the drive's enable input is off: it does not go on to operation"),
}
"""Faults of the nodes of a bus."""
CYCLE = 0.01
"""Sending interval of a message without a cycle time in its DBC file [s]."""


class Hub:
    """Frames from one adapter reach all others and the nodes in this process; subclasses define the nodes."""

    def __init__(self, name: str, address: str, faults: wire_faults.Faults, tap: wire_faults.Tap) -> None:
        host, _, port = address.removeprefix(PREFIX).rpartition(":")
        if not address.startswith(PREFIX) or not host or not port.isdecimal():
            raise UsageError(f'{name} is at {address}; an emulator serves a bus at "{PREFIX}127.0.0.1:PORT" only')
        self._listener = listen(name, "127.0.0.1" if host == "localhost" else host, int(port))
        self.address = f"{PREFIX}{host}:{self._listener.getsockname()[1]}"
        self.faults, self._tap = faults, tap
        self._outgoing = wire_faults.Outgoing(GARBAGE)
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._listener, selectors.EVENT_READ)
        self._rests: dict[socket.socket, bytes] = {}
        self._late: list[tuple[float, bytes]] = []
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._serve, name=f"emulated {name}", daemon=True)

    def start(self) -> None:
        """Start serving."""
        self._thread.start()

    def close(self) -> None:
        """Stop serving and close all connections."""
        self._ended.set()
        if self._thread.is_alive() and self._thread is not threading.current_thread():
            self._thread.join(1.0)
        hang_up(self._listener, *self._rests)
        self._rests.clear()

    def send(self, frame: Frame) -> None:
        """Send a frame of a node in this process, subject to the present fault."""
        fault, line = self.faults.next(), line_of(frame)
        if fault.kind in {"hang-up", "reset"}:
            self.hang_up()
        elif fault.kind == "delay":
            self._late.append((monotonic() + fault.value, line))
        else:
            self._out(self._outgoing.of(line, fault))

    def hang_up(self) -> None:
        """Close every connection."""
        for link in list(self._rests):
            self._forget(link)

    def _take(self, frame: Frame) -> None:
        """Called for each frame from an adapter; a subclass passes it to its nodes."""

    def _turn(self, now: float) -> None:
        """Called every `TICK` with the time `now` [s, monotonic]; a subclass lets its nodes act."""

    # -- adapters -----------------------------------------------------------------------------------------------------

    def _serve(self) -> None:
        due = monotonic()
        while not self._ended.is_set():
            for key, _ in self._selector.select(max(0.0, due - monotonic())):
                if key.fileobj is self._listener:
                    self._accept()
                elif isinstance(key.fileobj, socket.socket):
                    self._hear(key.fileobj)
            if (now := monotonic()) >= due:
                due = max(due + TICK, now)
                self._turn(now)
            while self._late and self._late[0][0] <= now:
                self._out(self._late.pop(0)[1])

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            link, _peer = self._listener.accept()
            link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            link.settimeout(0.2)
            self._rests[link] = b""
            self._selector.register(link, selectors.EVENT_READ)

    def _hear(self, link: socket.socket) -> None:
        try:
            piece = link.recv(4096)
        except OSError:
            piece = b""
        if not piece:
            self._forget(link)
            return
        self._tap("received", piece)
        *lines, rest = (self._rests[link] + piece).split(b"\r")
        self._rests[link] = rest[-LONGEST:]
        for line in lines:
            self._obey(link, line)

    def _obey(self, link: socket.socket, line: bytes) -> None:
        if line[:1] in COMMANDS:
            self._write(link, SERIAL if line[:1] == b"N" else b"V1010\r" if line[:1] == b"V" else b"\r")
            return
        if (frame := read_line(line)) is None:
            self._write(link, b"\x07" if line else b"")
            return
        self._write(link, b"Z\r" if frame.extended else b"z\r")
        for other in [other for other in self._rests if other is not link]:
            self._write(other, line_of(frame))
        if self.faults.peek().kind != "silence":
            self._take(frame)

    def _out(self, data: bytes) -> None:
        if not data:
            return
        self._tap("sent", data)
        for link in list(self._rests):
            self._write(link, data)

    def _write(self, link: socket.socket, data: bytes) -> None:
        try:
            link.sendall(data)
        except OSError:
            self._forget(link)

    def _forget(self, link: socket.socket) -> None:
        if self._rests.pop(link, None) is not None:
            self._selector.unregister(link)
            link.close()


def serve(device: DeviceRecord, plant: RealPlant, log: wire_faults.CommandLog) -> EmulatedBus:
    """Emulated bus for the driver of `device`."""
    return EmulatedBus(device, options_of(device, read_options), plant, log)


class EmulatedBus(Hub):
    """One bus, with the faults of an adapter's line and those in `CAN`."""

    def __init__(self, device: DeviceRecord, options: Options, plant: RealPlant, log: wire_faults.CommandLog) -> None:
        self._device, self._plant, self._log = device, plant, log
        self._events: SimpleQueue[str] = SimpleQueue()
        """Events to be carried out in the hub's thread."""
        faults = wire_faults.Faults(
            wire_faults.LINK, wire_faults.STUCK, wire_faults.EXPIRY, wire_faults.WATCHDOG_OFF, wire_faults.SETPOINT, CAN
        )
        super().__init__(device.name, device.address, faults, log.tap(device.name))
        self.nodes: dict[str, EmulatedNode] = {}
        for name, node in options.nodes.items():
            self.nodes[name] = self._drive(name, node.number) if node.profile == 402 else self._gauge(name, node.number)
        self._messages: list[_Sender] = []
        for message in options.messages.values():
            channels = {c.input.partition(".")[2]: c for c in device.channels if c.input.startswith(f"{message.name}.")}
            if channels:
                self._messages.append(_Sender(message, channels, plant, self.send))
        self._booted = False

    def expire_watchdog(self) -> bool:
        """Make the drives miss the program's heartbeat; returns whether one was monitoring it."""
        return sum(node.expire_heartbeat() for node in self.nodes.values()) > 0

    def restart(self) -> None:
        """Restart every node."""
        self._events.put("restart")

    def switch_off_watchdog(self) -> bool:
        """Switch off the heartbeat monitoring of every drive, as another program may; whether one was monitoring."""
        waited = [drive for drive in self._drives() if drive.get(f.CONSUMER, 1)]
        for drive in waited:
            drive.put(f.CONSUMER, 1, bytes(4))
        return bool(waited)

    def change_set_point(self, value: float) -> bool:
        """Change the target of the first drive [count], as another program may; whether there is a drive."""
        for drive in self._drives()[:1]:
            drive.put(f.TARGET, 0, round(value).to_bytes(4, "little", signed=True))
        return bool(self._drives())

    def _drives(self) -> list[EmulatedDrive]:
        return [node for node in self.nodes.values() if isinstance(node, EmulatedDrive)]

    def _drive(self, name: str, number: int) -> EmulatedDrive:
        output = next((o for o in self._device.outputs if o.output == f"{name}.position"), None)
        channel = next((c for c in self._device.channels if c.input == f"{name}.position"), None)
        if output is None and channel is None:
            why = f"nothing on the bench uses {name}.position, so its counts are unknown"
            raise UsageError(f"{self._device.name}: {why}")
        scale = output.scale if output is not None else (channel.calibrated if channel is not None else Scale())
        stroke = _stroke(output, scale)
        quantities = self._plant.quantities()
        if "displacement_command" not in quantities:
            raise UsageError(f"{self._device.name}: no output drives the free end, so {name} has nothing to move")

        def note(kind: str, **data: Any) -> None:
            shown = {"output": output.name} if output is not None else {}
            self._log.note(kind, self._device.name, node=name, **shown, **data)

        model = self._plant.model("CiA 402 drive")
        return EmulatedDrive(number, model, self.send, self._plant, scale, stroke, note)

    def _gauge(self, name: str, number: int) -> EmulatedNode:
        channel = next((c for c in self._device.channels if c.input == f"{name}.position"), None)
        node = EmulatedNode(number, 406, self._plant.model("CiA 406 transducer"), self.send)

        def position() -> int:
            if channel is None:
                return 0
            place = self._plant.at(node.now).get(channel.name, 0.0)
            return round(float(channel.calibrated.to_raw(place)) * 1000 / STEP)

        node.objects |= encoder_objects(node, position)
        for sub, entry in enumerate((t.POSITIONS[0], VELOCITY, STATUS), 1):
            node.preset(f.TPDO_MAPPING, sub, entry)
        node.preset(f.TPDO_MAPPING, 0, 3)
        node.preset(f.TPDO_PARAMETER, 1, f.TPDO[0] + number)
        return node

    # -- the hub's thread ---------------------------------------------------------------------------------------------

    def _take(self, frame: Frame) -> None:
        now = monotonic()
        for node in self.nodes.values():
            node.take(frame, now)

    def _turn(self, now: float) -> None:
        fault = self.faults.peek()
        while not self._events.empty():
            self._befall(self._events.get(), 0)
        if fault.kind in {"emergency", "restart", "reset"}:
            self.faults.set("clear")
            self._befall(fault.kind, int(fault.value))
        for node in self.nodes.values():
            if isinstance(node, EmulatedDrive):
                node.obeys = fault.kind != "disabled"
            if not self._booted:
                node.boot()
            node.turn(now)
        self._booted = True
        for message in self._messages:
            message.turn(now)

    def _befall(self, kind: str, value: int) -> None:
        if kind == "reset":
            self.hang_up()
        for node in self.nodes.values():
            if kind != "emergency":
                node.reset()
            elif isinstance(node, EmulatedDrive):
                node.fault(value)
            else:
                node.emergency(value)


class _Sender:
    """Sends one message of a DBC file with signals from the plant."""

    def __init__(
        self, message: Message, channels: dict[str, ChannelRecord], plant: RealPlant, send: Callable[[Frame], None]
    ) -> None:
        self._message, self._channels, self._plant, self._send = message, channels, plant, send
        self._due = 0.0

    def turn(self, now: float) -> None:
        """Send it if it is due."""
        if now < self._due:
            return
        period = self._message.cycle or CYCLE
        self._due = max(self._due + period, now)
        quantities, data = self._plant.quantities(), bytes(self._message.length)
        for name, channel in self._channels.items():
            value = float(channel.calibrated.to_raw(quantities.get(channel.name, 0.0)))
            data = self._message.signals[name].put(data, value)
        self._send(Frame(self._message.identifier, data, self._message.extended))


def _stroke(output: OutputRecord | None, scale: Scale) -> tuple[int, int]:
    """Software limits slightly outside the bench's command range [count]; 0, 0 without an output."""
    if output is None:
        return 0, 0
    low, high = sorted(round(float(scale.to_raw(value))) for value in (output.low, output.high))
    room = max(1, (high - low) // 50)
    return low - room, high + room
