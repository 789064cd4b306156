"""How the guard calls the devices of a bench, each from its own thread; decides nothing."""
# mypy: disable-error-code="type-abstract"

from __future__ import annotations

import threading
import time
from array import array
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from importlib import import_module
from math import inf
from typing import Any, TypeVar

from pmabench.base.clock import Clock
from pmabench.base.errors import DeviceError
from pmabench.bench.interface import (
    Block,
    CompiledBench,
    Device,
    DeviceRecord,
    Follower,
    Hands,
    Identity,
    Load,
    Motion,
    OpensToVent,
    OutputRecord,
    Pulses,
    Rescue,
    Segment,
    SetPoint,
    Stream,
    Switch,
    ValveRecord,
    Watchdog,
)
from pmabench.guard.limits import to_device
from pmabench.guard.owner import PATIENCE, Call, Direct, Owner

OPENS_WITHIN = 8.0
"""Longest time that a device may take to be opened [s]."""

ARMS_WITHIN = 1.0
"""Longest time for arming a watchdog, which takes several requests; nothing is pressurised yet [s]."""
BRIEF = 0.02
"""Longest wait for samples of a busy device [s]."""
OPENS_AGAIN = 0.5
"""Interval between attempts to open a device [s]."""

Act = Callable[[], Any]
"""A call of a device, to be made in the thread that owns it."""
Capability = TypeVar("Capability")


def load_driver(record: DeviceRecord, clock: Clock) -> Device:
    """Driver instance of a device, from `module:Class`; nothing is opened. Raises DeviceError."""
    module, _, name = record.driver.partition(":")
    try:
        made = getattr(import_module(module), name)(record, clock)
    except (ImportError, AttributeError) as error:
        raise DeviceError(record.name, f"its driver {record.driver} cannot be loaded: {error}") from error
    if not isinstance(made, Device):
        raise DeviceError(record.name, f"{record.driver} does not implement the device interface")
    return made


class Links:
    """The open devices, by name. `threads`: each is called from its own thread."""

    patience, hands_over = PATIENCE, 2 * PATIENCE
    """Longest time for a call, and for handing over samples, as another request may be in progress [s]."""

    def __init__(self, bench: CompiledBench, clock: Clock, *, threads: bool) -> None:
        self.devices: dict[str, Device] = {}
        self.identities: dict[str, Identity] = {}
        self._bench, self._clock = bench, clock
        self._owner = Owner if threads else Direct
        self._owners: dict[str, Direct | Owner] = {}
        self.opening: dict[str, Call] = {}
        """Last attempt to open each device; holds the reason if it is not open."""
        self._collecting: dict[str, Call] = {}
        self._able: dict[tuple[str, type[Any]], Any] = {}
        """Capabilities of each device, cached because checking takes longer than most commands."""
        self.sampling: dict[str, float] = {}
        """Requested sampling rate of each device that samples [Hz]."""
        self._back: dict[str, float] = {}
        """When a device that is closed is opened again [s, clock]."""

    def open(self, records: list[DeviceRecord], first: Callable[[str], list[Act]], *, forgiving: bool) -> None:
        """Open the devices in parallel, and on each make the calls of `first` for its name as soon as it is open.

        With `forgiving`, devices that cannot be opened are left out; otherwise a failure closes those already open.
        """
        passed = (Exception,) if forgiving else ()
        try:
            for record in records:
                self._owners[record.name] = self._owner(record.name)
                self.opening[record.name] = self.submit(record.name, partial(self._open, record, first, forgiving))
            until = time.monotonic() + OPENS_WITHIN
            for name, call in self.opening.items():
                with suppress(*passed):
                    self._owners[name].wait(call, max(0.0, until - time.monotonic()))
            self._back = {record.name: 0.0 for record in records if record.name not in self.devices}
        except BaseException:
            self.close(disarm=False)
            raise

    def _open(self, record: DeviceRecord, first: Callable[[str], list[Act]], to_vent: bool) -> None:
        name, device = record.name, load_driver(record, self._clock)
        self.identities[name] = (device.open_to_vent if to_vent and isinstance(device, OpensToVent) else device.open)()
        self.devices[name] = device
        if name in self.sampling and isinstance(device, Stream):
            device.start(self.sampling[name])
        for act in first(name):
            with suppress(Exception):  # it is sent again, and its failure reported, when the safe state runs
                act()

    def close(self, *, disarm: bool) -> None:
        """Close all devices, with `disarm` their watchdogs first; may be called again."""
        for name, device in list(self.devices.items()):
            with suppress(DeviceError):
                if disarm and isinstance(device, Watchdog):
                    self.call(name, device.disarm_watchdog)
                self.call(name, device.close)
        self.devices.clear()

    def hang_up(self, name: str, rest: float) -> None:
        """Close the line of a device; it is opened again after `rest` [s]."""
        if name in self.devices:
            self.submit(name, self.devices.pop(name).close)
            self._back[name] = self._clock.now() + rest

    def open_again(self, first: Callable[[str], list[Act]]) -> None:
        """Open closed devices that are due, with the calls of `first`; a failure is tried again after `OPENS_AGAIN`."""
        for record in self._bench.devices:
            due = self._back.get(record.name, inf) <= self._clock.now() and record.name not in self.devices
            if due and self.free(record.name):
                self._back[record.name] = self._clock.now() + OPENS_AGAIN
                self.opening[record.name] = self.submit(record.name, partial(self._open, record, first, True))

    def call(self, name: str, act: Act) -> Any:
        """Call a device and return the result; raises DeviceError if it fails or takes too long."""
        return self._owners[name].call(act, self.patience)

    def submit(self, name: str, act: Act) -> Call:
        """Queue a call of a device without waiting; the result appears in the returned call."""
        return self._owners[name].submit(act)

    def need(self, name: str, capability: type[Capability], lacks: str, channel: str = "") -> Capability:
        """Device with this capability; raises DeviceError with the text `lacks` if it has not got it."""
        device = self.devices.get(name)
        if self._able.get((name, capability), self) is not device:
            if not isinstance(device, capability):
                raise DeviceError(name, lacks, channel)
            self._able[name, capability] = device
        able: Capability = self._able[name, capability]
        return able

    # -- calls that command something, not made yet ---------------------------------------------------------------

    def writing(self, output: OutputRecord, value: float) -> Act:
        """Call that commands `value` [SI], rounded to the safe side."""
        device = self.need(output.device, SetPoint, "takes no set-points", output.output)
        return partial(device.write, output.output, to_device(output, value))

    def following(self, output: OutputRecord, segment: Segment) -> Act:
        """Call that starts a ramp or a sine."""
        device = self.need(output.device, Follower, "cannot follow a ramp or a sine by itself", output.output)
        return partial(device.follow, output.output, segment)

    def switching(self, valve: ValveRecord, *, closed: bool) -> Act:
        """Call that closes or opens a valve."""
        device = self.need(valve.device, Switch, "switches no valves", valve.output)
        return partial(device.switch, valve.output, on=closed == (valve.energised == "closed"))

    def pulsing(self, valve: ValveRecord, seconds: float) -> Act:
        """Call that opens a valve for a time [s]."""
        device = self.need(valve.device, Pulses, "opens no valve for a time that it keeps by itself", valve.output)
        return partial(device.pulse, valve.output, seconds)

    def halting(self, output: OutputRecord) -> Act:
        """Call that stops a motion at its present position."""
        device = self.need(output.device, Motion, "cannot stop a motion by itself", output.output)
        return partial(device.halt, output.output)

    def rescue(self, target: OutputRecord | ValveRecord, raw: float) -> Call | None:
        """Command a raw value over the device's second connection, in a thread that may hang; None without one."""
        device = self.devices.get(target.device)
        if not isinstance(device, Rescue):
            return None
        call = Call(partial(device.rescue, target.output, raw))
        threading.Thread(target=call.run, daemon=True).start()
        return call

    # -- calls that wait for their result -------------------------------------------------------------------------

    def refuse_other_read_back(self, output: OutputRecord) -> None:
        """Raise DeviceError if a device does not hold the safe value that was sent."""
        held = self.call(output.device, partial(self.read_back, output))
        if abs(held - to_device(output, output.safe)) > max(output.resolution, 1e-6 * abs(held)):
            raise DeviceError(output.device, f"holds {held:g} after {output.safe:g} was sent", output.output)

    def read_back(self, output: OutputRecord) -> float:
        """Set-point that a device holds [device units]; called from the thread that owns it."""
        return self.need(output.device, SetPoint, "takes no set-points", output.output).read_back(output.output)

    def is_closed(self, valve: ValveRecord) -> bool:
        """Whether a device holds a valve closed; called from the thread that owns it."""
        device = self.need(valve.device, Switch, "switches no valves", valve.output)
        return device.is_on(valve.output) == (valve.energised == "closed")

    def arm_watchdogs(self) -> None:
        """Arm the watchdogs that the bench file lists; raises DeviceError if a device does not confirm the time."""
        for record in self._bench.devices:
            if record.watchdog:
                device = self.need(record.name, Watchdog, "has no watchdog, and the bench file says that it has")
                armed = self._owners[record.name].call(partial(device.arm_watchdog, record.watchdog), ARMS_WITHIN)
                if not 0 < armed <= record.watchdog * 1.01:
                    asked = f"{record.watchdog:g} s was asked for"
                    raise DeviceError(record.name, f"its watchdog says {armed:g} s where {asked}")

    def free(self, name: str) -> bool:
        """Whether a device has no call pending."""
        return self._owners[name].idle

    def place(self, load: Load) -> None:
        """Report to simulated devices, which contain an operator, what was attached by hand."""
        for name, device in list(self.devices.items()):
            if isinstance(device, Hands):
                self.call(name, partial(device.place, load))

    def stream(self, name: str, rate: float) -> float:
        """Start sampling at `rate` [Hz], or stop it with 0; returns the actual rate."""
        device = self.need(name, Stream, "takes no samples")
        self.sampling.pop(name, None)
        used = float(self.call(name, partial(device.start, rate) if rate else device.stop) or 0.0)
        self.sampling |= {name: rate} if rate else {}
        return used

    def collect(self, name: str) -> Block:
        """New samples of one device; none while it is busy with another call."""
        device = self.need(name, Stream, "takes no samples")
        call = self._collecting.pop(name, None) or self.submit(name, device.collect)
        if not call.done.wait(BRIEF) and time.monotonic() - call.asked < self.hands_over:
            self._collecting[name] = call
            return Block(array("q"), {}, -1)
        block: Block = self._owners[name].wait(call, 0.0)
        return block
