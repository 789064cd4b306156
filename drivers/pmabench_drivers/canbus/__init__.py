"""A CAN bus: CiA 402 drives, CiA 406 transducers and sensors described by a DBC file.

`frames`: CANopen's frames and the state machine of a drive; `link`: adapters, and assembling samples from received
frames; `node`: common to all nodes, and a transducer; `drive`: one drive; `options`: the options in the bench file, and
the DBC file; here: the device interface. `emulated*` are the other end of the bus.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from time import monotonic

from pmabench.base.clock import Clock
from pmabench.base.errors import DeviceError
from pmabench.bench.interface import COMPUTER, EMULATED, UNPROVEN, Block, DeviceRecord, Identity, OutputRecord, Segment
from pmabench_drivers.canbus import frames as f
from pmabench_drivers.canbus.drive import Drive
from pmabench_drivers.canbus.link import Link, Rows, Signals, open_adapter
from pmabench_drivers.canbus.node import Node, Transducer
from pmabench_drivers.canbus.options import READY, Options, read_options
from pmabench_drivers.shared.device import HURRY, Driver, refuse_nonsense, stepped
from pmabench_drivers.shared.link import JOIN, Cycle, Samples
from pmabench_drivers.shared.options import Reader

CALL = 0.18
"""Time limit of a call [s]."""
OPEN = 1.9
PATIENCE = 0.25
"""So long [s] SYNCs may go unanswered before `collect` says so; what is lost till then is a gap in the samples."""
EMULATED_ADAPTER = "SIM0"
"""Serial number of an emulated adapter: its data are never taken for those of a real muscle."""
ROOM = 0.02
"""Largest distance of a drive from the start of a cyclic motion, as time at its highest speed [s]."""


class CanBus(Driver[Link]):
    """Drives, transducers and DBC-described sensors on one bus, which only one program uses.

    Inputs are `NODE.position` (drive: count; transducer: um), `NODE.demand` (drive, count) and `MESSAGE.SIGNAL` (in the
    unit of the DBC file); outputs `NODE.position` of drives (count).
    """

    verified = "emulator only"
    emulator = "pmabench_drivers.canbus.emulated"
    read_options = staticmethod(read_options)
    _options: Options

    def __init__(self, device: DeviceRecord, clock: Clock) -> None:
        super().__init__(device, clock)
        self._samples = Samples([channel.name for channel in device.channels])
        self._cycle = Cycle(f"sync {device.name}", self._tick, clock)
        self._nodes: dict[str, Node] = {}
        self._signals = Signals(self._options, [channel.input for channel in device.channels])
        self._takers: dict[int, Callable[[bytes], bool | None]] = {}
        self._following: dict[str, Segment] = {}
        self._rows = Rows((), self._row, 0)
        self._every, self._count = 0, 0
        self._armed = False
        for name, node in self._options.nodes.items():
            made = (Drive if node.profile == 402 else Transducer)(device.name, name, node.number, self._send)
            self._nodes[name] = made
            if isinstance(made, Drive):
                made.wants_demand = any(channel.input == f"{name}.demand" for channel in device.channels)
                made.period = self._options.sync
        self._reads = [self._reading(channel.input) for channel in device.channels]

    @classmethod
    def fastest(cls, device: DeviceRecord) -> float:
        """Highest rate that the options allow [Hz]: one sample at each SYNC."""
        return 1 / read_options(device, Reader()).sync

    def _reading(self, name: str) -> Callable[[], float]:
        """Function that returns the newest value of an input."""
        node_name, _, what = name.partition(".")
        node = self._nodes.get(node_name)
        return (lambda: self._signals.value(name)) if node is None else (lambda: float(getattr(node, what)))

    # -- life -----------------------------------------------------------------------------------------------------

    def open(self) -> Identity:
        """Open the adapter, find every node, set up its PDOs and start it; nothing moves, and no power is on."""
        self.close()
        deadline = monotonic() + OPEN
        self._takers = {identifier: take for node in self._nodes.values() for identifier, take in node.takers().items()}
        device, bitrate = self._device, self._options.bitrate
        ask = not self._nodes  # sensors that only send cannot be identified
        adapter = partial(open_adapter, device.address, bitrate, ask=ask)
        self._link = Link(device.name, device.address, adapter, self._clock, self._take)
        with self._closed_on_error():
            wanted: set[int] = set()
            for node in self._nodes.values():
                node.open(deadline)
                self._takers |= node.mapped
                wanted |= set(node.mapped)
            self._rows = Rows(wanted, self._row, round(self._options.sync / 2 * 1e9))
            self._refuse_narrow_limits(deadline)
            return self._identity()

    def close(self) -> None:
        """Stop SYNC and close the adapter; drives stay in their state."""
        self._following.clear()
        self._every, self._armed = 0, False
        self._cycle.stop(JOIN)
        self._hang_up()

    def _identity(self) -> Identity:
        nodes = list(self._nodes.values())
        models = [node.model for node in nodes]
        unproven = any(model.startswith(UNPROVEN) for model in models)
        begins = UNPROVEN if unproven else EMULATED
        if nodes:
            simulated = any(model.startswith(EMULATED) for model in models)
        else:
            simulated = self._opened().serial == EMULATED_ADAPTER
            models = ["CAN adapter"]
        names = ", ".join(model.removeprefix(begins) for model in models)
        serial, firmware = (", ".join(filter(None, (getattr(n, k) for n in nodes))) for k in ("serial", "firmware"))
        model = f"{begins if simulated else ''}{names}"
        return Identity("CAN", model, serial, firmware, simulated=simulated, clock=COMPUTER)

    def _refuse_narrow_limits(self, deadline: float) -> None:
        """Raise DeviceError if a drive's own limits are inside those of the bench: it would not reach its targets."""
        for output in self._outputs.values():
            drive = self._drive(output.output)
            limits = drive.limits(deadline)
            ends = sorted(float(output.scale.to_raw(value)) for value in (output.low, output.high))
            if limits is not None and (ends[0] < limits[0] or ends[1] > limits[1]):
                own = f"its software limits (607Dh) are {limits[0]} to {limits[1]} counts"
                raise drive.error(f"{own}, and the bench may send it to {ends[0]:g} to {ends[1]:g}: change one of them")

    # -- received frames ------------------------------------------------------------------------------------------

    def _take(self, frame: f.Frame, when: float) -> None:
        """Process one frame, in the link's thread."""
        take = None if frame.extended else self._takers.get(frame.identifier)
        if take is not None and take(frame.data):
            self._rows.arrived(frame.identifier, round(when * 1e9))
        self._signals.take(frame)

    def _row(self, time: int, host: int) -> None:
        """Take a sample: all nodes have answered to the SYNC of `time`, the first one at `host` [ns, bench time]."""
        if not self._every:
            return
        self._count += 1
        if self._count % self._every == 0 and self._signals.fresh():
            self._samples.append(time, [read() for read in self._reads], host)

    # -- samples --------------------------------------------------------------------------------------------------

    def start(self, rate: float) -> float:
        """Sample all inputs at each SYNC, or each n-th; returns the actual rate [Hz]."""
        self._refuse_rate(rate)
        self._opened()
        syncs = 1 / self._options.sync
        self._samples.take()
        self._count = 0
        self._cycle.note(None)
        self._every = max(1, math.floor(syncs / rate + 1e-6))
        self._signals.begin()
        if not self._cycle.running:
            self._cycle.start(syncs)
        return syncs / self._every

    def collect(self) -> Block:
        """Samples since the last call; raises DeviceError if a node has an error or leaves SYNCs unanswered."""
        self._refuse_trouble()
        return self._samples.take()

    def stop(self) -> None:
        """Stop sampling; a sine in progress continues."""
        self._every = 0
        if not self._following:
            self._cycle.stop()

    @property
    def missed(self) -> int:
        """SYNCs that were not answered, or not sent because the computer was late."""
        return self._rows.lost + self._cycle.missed

    def _refuse_trouble(self) -> None:
        """Raise DeviceError with the first error, if there is one."""
        if gone := self._opened().gone:
            raise self._error(gone)
        for node in self._nodes.values():
            if trouble := node.trouble():
                raise self._error(trouble, node.name)
        self._cycle.refuse(self._device.name, "sending")
        if self._rows.in_a_row * self._options.sync * 3 > PATIENCE:
            silent = [node.name for node in self._nodes.values() if self._rows.missing() & set(node.mapped)]
            raise self._error(f"no answer to SYNC from {', '.join(silent) or 'a node'} for {PATIENCE:g} s")
        if self._every and (stale := self._signals.stale()):
            raise self._error(f"{stale} did not come for {self._options.slowest:g} s; is its sensor on?", stale)

    # -- the sending thread ---------------------------------------------------------------------------------------

    def _tick(self) -> None:
        """Send the next targets, then SYNC; neither while an answer to the last SYNC may still arrive."""
        try:
            if self._rows.may_sync():
                self._lead()
                self._rows.begin(round(self._clock.now() * 1e9))
                self._send(f.SYNC)
            self._cycle.note(None)
        except DeviceError as error:
            self._cycle.note(error)

    def _lead(self) -> None:
        """Send every drive on a sine its position for the SYNC after this one; the drive interpolates until then."""
        for name, segment in list(self._following.items()):
            value, over = stepped(segment, self._clock.now() + self._options.sync)
            output, drive = self._outputs[name], self._drive(name)
            if value is None:
                continue
            own = 2 * math.pi * segment.frequency * abs(segment.amplitude)
            drive.lead_to(value, min(HURRY * own, output.rate / abs(output.scale.slope)) * self._options.sync)
            if over and round(drive.lead) == round(value) and self._following.get(name) is segment:
                self._following.pop(name, None)

    # -- commands -------------------------------------------------------------------------------------------------

    def write(self, output: str, value: float) -> None:
        """Go to a position at the drive's speed `approach`; enables operation first if necessary."""
        record, drive = self._output(output), self._drive(output)
        if not math.isfinite(value):
            raise self._error(f"cannot be commanded to {value}", output)
        self._following.pop(output, None)
        self._refuse_trouble_of(drive)
        speed = self._options.nodes[drive.name].approach / abs(record.scale.slope)
        drive.go(round(value), round(speed), monotonic() + CALL)

    def read_back(self, output: str) -> float:
        """Target that the drive holds."""
        self._output(output)
        return float(self._drive(output).target(monotonic() + CALL))

    def follow(self, output: str, segment: Segment) -> None:
        """Start a ramp in profile position, by the drive itself, or a sine in cyclic synchronous position."""
        record, drive = self._output(output), self._drive(output)
        refuse_nonsense(self._device.name, output, segment)
        deadline = monotonic() + CALL
        self._following.pop(output, None)
        self._refuse_trouble_of(drive)
        if segment.kind == "ramp":
            drive.go(round(segment.target), round(segment.rate), deadline)
            return
        room = max(1, math.ceil(record.rate / abs(record.scale.slope) * ROOM))
        drive.begin_cyclic(round(segment.origin), room, deadline)
        self._following[output] = segment
        if not self._cycle.running:
            self._cycle.start(1 / self._options.sync)

    def halt(self, output: str) -> None:
        """Quick stop, then hold."""
        self._output(output)
        self._following.pop(output, None)
        self._drive(output).halt(monotonic() + CALL)

    def level(self, name: str) -> bool:
        """`NODE.ready`: whether the drive has no fault; raises DeviceError if it is silent or has sent an emergency."""
        known = [f"{drive}.{READY}" for drive, node in self._nodes.items() if isinstance(node, Drive)]
        self._known("digital input", name, known)
        return self._drive(name).ready(monotonic() + CALL)

    # -- the drives' own watchdog ---------------------------------------------------------------------------------

    def arm_watchdog(self, seconds: float) -> float:
        """Make each drive stop without this program's heartbeat; returns the longest time-out that one holds [s]."""
        deadline = monotonic() + CALL
        if not 0.001 <= seconds <= 65:
            raise self._error(f"a watchdog of {seconds:g} s cannot be set", "watchdog")
        held = 0.0
        for output in self._outputs:
            drive = self._drive(output)
            held = max(held, drive.arm(self._options.own_node, seconds, deadline))
            drive.prepare(deadline)
        self._armed = True
        self._beat()  # a drive only misses heartbeats after a first one
        return held

    def feed_watchdog(self) -> None:
        """Send the program's heartbeat; raises DeviceError if a node has an error."""
        self._beat()
        self._refuse_trouble()

    def disarm_watchdog(self) -> None:
        """Stop the drives' monitoring of the heartbeat; they stay where they are."""
        self._armed = False
        for output in self._outputs:
            self._drive(output).disarm(monotonic() + CALL)

    def held(self) -> dict[str, float | str]:
        """State, number of starts, error register and serial number of each node; of drives the watchdog.

        `watchdog`: shortest time [s] until a drive stops without this program's heartbeat; 0 if one monitors another
        node or none, or reports that it missed the heartbeat.
        """
        deadline = monotonic() + CALL
        found: dict[str, float | str] = {}
        for node in self._nodes.values():
            found |= {f"{node.name} {what}": value for what, value in node.held(deadline).items()}
        if self._outputs:
            own, drives = self._options.own_node, {self._drive(output) for output in self._outputs}
            found["watchdog"] = min(drive.waits_for(own, deadline) for drive in drives)
        return found

    def _beat(self) -> None:
        self._send(f.HEARTBEAT + self._options.own_node, bytes([f.OPERATIONAL]))

    # -- helpers --------------------------------------------------------------------------------------------------

    def _send(self, identifier: int, data: bytes = b"") -> None:
        self._opened().send(identifier, data)

    def _output(self, output: str) -> OutputRecord:
        record = super()._output(output)
        self._opened()
        return record

    def _drive(self, output: str) -> Drive:
        node = self._nodes[output.partition(".")[0]]
        assert isinstance(node, Drive)  # noqa: S101  (the options were checked)
        return node

    def _refuse_trouble_of(self, drive: Drive) -> None:
        if trouble := drive.trouble():
            raise self._error(f"{trouble}; it is not moved", drive.name)
