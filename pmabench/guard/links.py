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
"""The same for its watchdog, which takes several questions; nothing is under pressure yet [s]."""
BRIEF = 0.02
"""Samples are waited for so long [s] where their device is busy."""
OPENS_AGAIN = 0.5
"""A device that could not be opened is tried again after so long [s]."""

Act = Callable[[], Any]
"""A call of a device, ready to be made in the thread that owns it."""
Capability = TypeVar("Capability")


def load_driver(record: DeviceRecord, clock: Clock) -> Device:
    """The driver of a device, made from `module:Class`; nothing is opened."""
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
    """How long a call may take [s], and handing over samples, for a question may be under way."""

    def __init__(self, bench: CompiledBench, clock: Clock, *, threads: bool) -> None:
        self.devices: dict[str, Device] = {}
        self.identities: dict[str, Identity] = {}
        self._bench, self._clock = bench, clock
        self._owner = Owner if threads else Direct
        self._owners: dict[str, Direct | Owner] = {}
        self.opening: dict[str, Call] = {}
        """The last attempt to open each device: why it is not open."""
        self._collecting: dict[str, Call] = {}
        self._able: dict[tuple[str, type[Any]], Any] = {}
        """Capabilities of each device, kept because asking takes longer than most commands."""
        self.sampling: dict[str, float] = {}
        """At what rate devices sample [Hz]."""
        self._back: dict[str, float] = {}
        """When a device whose line was closed is opened again [s, clock]."""

    def open(self, records: list[DeviceRecord], first: Callable[[str], list[Act]], *, forgiving: bool) -> None:
        """Open the devices in parallel, and make the calls that `first` names on each as soon as it is open.

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
            with suppress(Exception):  # it is sent again, and counted, when the safe state runs
                act()

    def close(self, *, disarm: bool) -> None:
        """Let go of every device, its watchdog off where that is wanted; harmless when repeated."""
        for name, device in list(self.devices.items()):
            with suppress(DeviceError):
                if disarm and isinstance(device, Watchdog):
                    self.call(name, device.disarm_watchdog)
                self.call(name, device.close)
        self.devices.clear()

    def hang_up(self, name: str, rest: float) -> None:
        """Close the line of a device; it is opened again after so long [s]."""
        if name in self.devices:
            self.submit(name, self.devices.pop(name).close)
            self._back[name] = self._clock.now() + rest

    def open_again(self, first: Callable[[str], list[Act]]) -> None:
        """Open the devices again that are due, with the calls of `first`; what fails is tried again a little later."""
        for record in self._bench.devices:
            due = self._back.get(record.name, inf) <= self._clock.now() and record.name not in self.devices
            if due and self.free(record.name):
                self._back[record.name] = self._clock.now() + OPENS_AGAIN
                self.opening[record.name] = self.submit(record.name, partial(self._open, record, first, True))

    def call(self, name: str, act: Act) -> Any:
        """Make a call of a device and wait for it."""
        return self._owners[name].call(act, self.patience)

    def submit(self, name: str, act: Act) -> Call:
        """Have a call of a device made; what comes of it shows later."""
        return self._owners[name].submit(act)

    def need(self, name: str, capability: type[Capability], lacks: str, channel: str = "") -> Capability:
        """The device, as one that can do this; raises DeviceError with what it `lacks`."""
        device = self.devices.get(name)
        if self._able.get((name, capability), self) is not device:
            if not isinstance(device, capability):
                raise DeviceError(name, lacks, channel)
            self._able[name, capability] = device
        able: Capability = self._able[name, capability]
        return able

    # -- calls that command something, ready to be made -----------------------------------------------------------

    def writing(self, output: OutputRecord, value: float) -> Act:
        """Command `value` [SI], rounded to the safe side."""
        device = self.need(output.device, SetPoint, "takes no set-points", output.output)
        return partial(device.write, output.output, to_device(output, value))

    def following(self, output: OutputRecord, segment: Segment) -> Act:
        """Follow a ramp or a sine."""
        device = self.need(output.device, Follower, "cannot follow a ramp or a sine by itself", output.output)
        return partial(device.follow, output.output, segment)

    def switching(self, valve: ValveRecord, *, closed: bool) -> Act:
        """Close a valve, or open it."""
        device = self.need(valve.device, Switch, "switches no valves", valve.output)
        return partial(device.switch, valve.output, on=closed == (valve.energised == "closed"))

    def pulsing(self, valve: ValveRecord, seconds: float) -> Act:
        """Open a valve for a time [s]."""
        device = self.need(valve.device, Pulses, "opens no valve for a time that it keeps by itself", valve.output)
        return partial(device.pulse, valve.output, seconds)

    def halting(self, output: OutputRecord) -> Act:
        """Stop a motion where it is."""
        device = self.need(output.device, Motion, "cannot stop a motion by itself", output.output)
        return partial(device.halt, output.output)

    def rescue(self, target: OutputRecord | ValveRecord, raw: float) -> Call | None:
        """Command a raw value over the device's second way, from a thread that hangs alone; None where it has none."""
        device = self.devices.get(target.device)
        if not isinstance(device, Rescue):
            return None
        call = Call(partial(device.rescue, target.output, raw))
        threading.Thread(target=call.run, daemon=True).start()
        return call

    # -- calls that are waited for --------------------------------------------------------------------------------

    def refuse_other_read_back(self, output: OutputRecord) -> None:
        """Raise DeviceError where a device does not hold the safe value that was sent."""
        held = self.call(output.device, partial(self.read_back, output))
        if abs(held - to_device(output, output.safe)) > max(output.resolution, 1e-6 * abs(held)):
            raise DeviceError(output.device, f"holds {held:g} after {output.safe:g} was sent", output.output)

    def read_back(self, output: OutputRecord) -> float:
        """What a device holds [device units]; called from the thread that owns it."""
        return self.need(output.device, SetPoint, "takes no set-points", output.output).read_back(output.output)

    def is_closed(self, valve: ValveRecord) -> bool:
        """Whether a device holds a valve closed; called from the thread that owns it."""
        device = self.need(valve.device, Switch, "switches no valves", valve.output)
        return device.is_on(valve.output) == (valve.energised == "closed")

    def arm_watchdogs(self) -> None:
        """Arm the watchdog of each device that the bench says has one, and hear from it that it is armed."""
        for record in self._bench.devices:
            if record.watchdog:
                device = self.need(record.name, Watchdog, "has no watchdog, and the bench file says that it has")
                armed = self._owners[record.name].call(partial(device.arm_watchdog, record.watchdog), ARMS_WITHIN)
                if not 0 < armed <= record.watchdog * 1.01:
                    asked = f"{record.watchdog:g} s was asked for"
                    raise DeviceError(record.name, f"its watchdog says {armed:g} s where {asked}")

    def free(self, name: str) -> bool:
        """Whether a device has answered all that it was asked."""
        return self._owners[name].idle

    def place(self, load: Load) -> None:
        """Report what hands did to the devices that have an operator inside."""
        for name, device in list(self.devices.items()):
            if isinstance(device, Hands):
                self.call(name, partial(device.place, load))

    def stream(self, name: str, rate: float) -> float:
        """Let a device sample at `rate` [Hz], or end it with 0; the rate that it really uses."""
        device = self.need(name, Stream, "takes no samples")
        self.sampling.pop(name, None)
        used = float(self.call(name, partial(device.start, rate) if rate else device.stop) or 0.0)
        self.sampling |= {name: rate} if rate else {}
        return used

    def collect(self, name: str) -> Block:
        """The new samples of one device; none yet while it answers something else."""
        device = self.need(name, Stream, "takes no samples")
        call = self._collecting.pop(name, None) or self.submit(name, device.collect)
        if not call.done.wait(BRIEF) and time.monotonic() - call.asked < self.hands_over:
            self._collecting[name] = call
            return Block(array("q"), {}, -1)
        block: Block = self._owners[name].wait(call, 0.0)
        return block
