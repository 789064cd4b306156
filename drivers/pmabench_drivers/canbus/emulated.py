"""An emulated bus in front of the plant: drives, transducers and DBC-described sensors behind one slcan port."""

from __future__ import annotations

from collections.abc import Callable
from queue import SimpleQueue
from time import monotonic
from typing import Any

from pmabench.base.errors import UsageError
from pmabench.bench.interface import ChannelRecord, DeviceRecord, OutputRecord, Scale
from pmabench_drivers.canbus import cia402 as c
from pmabench_drivers.canbus import frames as f
from pmabench_drivers.canbus import transducer as t
from pmabench_drivers.canbus.dbc import Message
from pmabench_drivers.canbus.emulated_drive import EmulatedDrive
from pmabench_drivers.canbus.emulated_encoder import STEP, encoder_objects
from pmabench_drivers.canbus.emulated_node import EmulatedNode
from pmabench_drivers.canbus.frames import Frame
from pmabench_drivers.canbus.hub import Hub
from pmabench_drivers.canbus.options import Options, read_options
from pmabench_drivers.emulator.faults import EXPIRY, LINK, SETPOINT, STUCK, WATCHDOG_OFF, Faults, Kind
from pmabench_drivers.emulator.log import CommandLog
from pmabench_drivers.emulator.plant import RealPlant
from pmabench_drivers.shared.options import options_of

CAN = {
    "emergency": Kind(
        "the drive stops with a fault, or a transducer has an error, and the emergency has this code", "number", 0x5000
    ),
    "restart": Kind("the nodes start again, as after a dip of their supply"),
    "disabled": Kind("the drive's enable input is off: it does not go on to operation"),
}
"""What can happen to the nodes of a bus."""
CYCLE = 0.01
"""A message without a cycle time in its DBC file is sent so often [s]."""


def serve(device: DeviceRecord, plant: RealPlant, log: CommandLog) -> EmulatedBus:
    """The bus that the driver of `device` talks to."""
    options = options_of(device, read_options)
    return EmulatedBus(device, options, plant, log)


class EmulatedBus:
    """One bus: its faults are those of the adapter's line, and `CAN`."""

    def __init__(self, device: DeviceRecord, options: Options, plant: RealPlant, log: CommandLog) -> None:
        self._device, self._plant, self._log = device, plant, log
        self._events: SimpleQueue[str] = SimpleQueue()
        """What is to happen in the hub's thread."""
        self.faults = Faults(LINK, STUCK, EXPIRY, WATCHDOG_OFF, SETPOINT, CAN)
        self._hub = Hub(device.name, device.address, self._take, self._turn, self.faults, log.tap(device.name))
        self.address = self._hub.address
        self.nodes: dict[str, EmulatedNode] = {}
        for name, node in options.nodes.items():
            self.nodes[name] = self._drive(name, node.number) if node.profile == 402 else self._gauge(name, node.number)
        self._messages: list[_Sender] = []
        for message in options.messages.values():
            channels = {c.input.partition(".")[2]: c for c in device.channels if c.input.startswith(f"{message.name}.")}
            if channels:
                self._messages.append(_Sender(message, channels, plant, self._hub.send))
        self._booted = False

    def start(self) -> None:
        """Begin to serve."""
        self._hub.start()

    def close(self) -> None:
        """Hang up."""
        self._hub.close()

    def expire_watchdog(self) -> bool:
        """Let the drives miss the program's heartbeat; whether one waited for it."""
        return sum(node.expire_heartbeat() for node in self.nodes.values()) > 0

    def restart(self) -> None:
        """Let every node start again."""
        self._events.put("restart")

    def switch_off_watchdog(self) -> bool:
        """Let every drive wait for no heartbeat, as another program may; whether one waited."""
        waited = [drive for drive in self._drives() if drive.get(f.CONSUMER, 1)]
        for drive in waited:
            drive.put(f.CONSUMER, 1, bytes(4))
        return bool(waited)

    def change_set_point(self, value: float) -> bool:
        """Let the first drive hold another target [count], as by another program; whether there is a drive."""
        for drive in self._drives()[:1]:
            drive.put(c.TARGET, 0, round(value).to_bytes(4, "little", signed=True))
        return bool(self._drives())

    def _drives(self) -> list[EmulatedDrive]:
        return [node for node in self.nodes.values() if isinstance(node, EmulatedDrive)]

    def _drive(self, name: str, number: int) -> EmulatedDrive:
        output = next((o for o in self._device.outputs if o.output == f"{name}.position"), None)
        channel = next((c for c in self._device.channels if c.input == f"{name}.position"), None)
        if output is None and channel is None:
            raise UsageError(
                f"{self._device.name}: nothing on the bench uses {name}.position, so its counts are unknown"
            )
        scale = output.scale if output is not None else (channel.calibrated if channel is not None else Scale())
        stroke = _stroke(output, scale)
        quantities = self._plant.quantities()
        if "displacement_command" not in quantities:
            raise UsageError(f"{self._device.name}: no output drives the free end, so {name} has nothing to move")

        def note(kind: str, **data: Any) -> None:
            shown = {"output": output.name} if output is not None else {}
            self._log.note(kind, self._device.name, node=name, **shown, **data)

        model = self._plant.model("CiA 402 drive")
        return EmulatedDrive(number, model, self._hub.send, self._plant, scale, stroke, note)

    def _gauge(self, name: str, number: int) -> EmulatedNode:
        channel = next((c for c in self._device.channels if c.input == f"{name}.position"), None)
        node = EmulatedNode(number, 406, self._plant.model("CiA 406 transducer"), self._hub.send)

        def position() -> int:
            if channel is None:
                return 0
            place = self._plant.at(node.now).get(channel.name, 0.0)
            return round(float(channel.calibrated.to_raw(place)) * 1000 / STEP)

        node.objects |= encoder_objects(node, position)
        for sub, entry in enumerate((t.POSITIONS[0], t.VELOCITY, t.STATUS), 1):
            node.preset(f.TPDO_MAPPING, sub, entry)
        node.preset(f.TPDO_MAPPING, 0, 3)
        node.preset(f.TPDO_PARAMETER, 1, f.TPDO[0] + number)
        node.preset(f.TPDO_PARAMETER, 5, 1)
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
            self._hub.hang_up()
        for node in self.nodes.values():
            if kind != "emergency":
                node.reset()
            elif isinstance(node, EmulatedDrive):
                node.fault(value)
            else:
                node.emergency(value)


class _Sender:
    """Sends one message of a DBC file, its signals from the plant."""

    def __init__(
        self, message: Message, channels: dict[str, ChannelRecord], plant: RealPlant, send: Callable[[Frame], None]
    ) -> None:
        self._message, self._channels, self._plant, self._send = message, channels, plant, send
        self._due = 0.0

    def turn(self, now: float) -> None:
        """Send it when it is due."""
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
    """Software limits a little outside of what the bench may command [count]; 0, 0 for none."""
    if output is None:
        return 0, 0
    low, high = sorted(round(float(scale.to_raw(value))) for value in (output.low, output.high))
    room = max(1, (high - low) // 50)
    return low - room, high + room
