"""One device under test: its emulator, the relays before it, the driver; outcomes of its calls.

Also the actual state of plant and device, from the emulator, without the driver under test.
"""

from __future__ import annotations

import os
import re
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

from pmabench.base.clock import RealClock
from pmabench.base.errors import DeviceError, UsageError
from pmabench.base.system import registered
from pmabench.bench import interface as b
from pmabench.bench.interface import DeviceRecord, Identity, Truth, ValveRecord
from pmabench.conformance.relay import Relay, SerialRelay, TcpRelay
from pmabench.guard.owner import PATIENCE, Call, Owner

PASSED, FAILED, NOT_APPLICABLE, NOT_CHECKED = "pass", "fail", "does not apply", "not checked"
OPENS_WITHIN = 2.0
"""Longest time that `open` may take [s]."""
COLLECTS_WITHIN = 0.5
"""Longest time that `start`, `collect` and `stop` may take [s]."""
HUNG = 10.0
"""A call that has not returned after this time counts as hanging [s]."""
CALLS_WITHIN = PATIENCE
"""Longest time that a command or a question may take [s]."""
_PLACE = re.compile(r"(.*://)?((?:[A-Za-z0-9._-]+|\[[0-9A-Fa-f:.]+\]):\d{1,5})")
"""HOST:PORT, also after a prefix such as `slcan:socket://`."""
SLACK = 0.1
"""Extra time for every call [s], in addition to three times the lag of this computer."""
SPEED = 0.2
"""Speed of an actuator on its way to another position [m/s]."""
MASS = 5.0
"""Mass that moves with a load [kg]."""


@dataclass(frozen=True)
class Result:
    """One line of the suite: the check, its promise, its verdict, and the reason in a sentence."""

    check: str
    promise: str
    verdict: str
    why: str


class Failed(Exception):
    """The driver breaks the promise; the text states how and what to do."""


class Late(Failed):
    """Something was late, possibly because the computer is busy; it counts only if it happens in every attempt."""


class NotChecked(Exception):
    """Something had no independent reference; the text states what, why, and what was compared."""


@dataclass(frozen=True)
class Outcome:
    """Value or error of a call, and its duration."""

    what: str
    value: Any
    error: BaseException | None
    seconds: float
    lag: float
    """Largest delay of this computer's scheduling during the call [s], caused by other programs."""

    def nothing(self, within: float = CALLS_WITHIN) -> None:
        """As `good`, for a call that returns nothing."""
        if (value := self.good(within)) is not None:
            raise Failed(f"{self.what} returned {value!r}; by the interface it returns None")

    def judged(self, within: float = CALLS_WITHIN) -> Any:
        """The value, or the DeviceError; raises Failed if the call took too long or raised anything else."""
        if self.seconds > within + SLACK + 3 * self.lag:
            raise Late(f"{self.what} took {self.seconds:.2f} s; at most {within:g} s is allowed")
        if self.error is not None and not isinstance(self.error, DeviceError):
            kind = type(self.error).__name__
            raise Failed(f"{self.what} raised {kind}: {self.error}; a DeviceError with a sentence is expected")
        return self.value if self.error is None else self.error

    def good(self, within: float = CALLS_WITHIN) -> Any:
        """The value; a DeviceError also raises Failed."""
        value = self.judged(within)
        if isinstance(value, DeviceError):
            raise Late(f"{self.what} failed on a good wire: {value}")  # a busy computer's emulator may answer too late
        return value


class _Lag:
    """Measures by how much a sleeping thread wakes up late: time taken by the computer, not the driver."""

    def __init__(self) -> None:
        self.worst = 0.0
        self._ended = threading.Event()
        threading.Thread(target=self._watch, name="conformance lag", daemon=True).start()

    def close(self) -> None:
        """Stop the thread."""
        self._ended.set()

    def _watch(self) -> None:
        before = time.monotonic()
        while not self._ended.wait(0.01):
            now = time.monotonic()
            self.worst = max(self.worst, now - before - 0.01)
            before = now


@dataclass(frozen=True)
class State:
    """A state of the plant that is set independently of the driver."""

    pressure: float
    """Pressure [Pa]."""
    position: float
    """Contraction set by an actuator [m]."""
    force: float
    """Load on a free end [N]."""
    supply: bool = True


class Rig:
    """The device of one record; `wiring` is the content of its truth file, if it has one.

    `relays`: where bytes can be damaged.
    """

    def __init__(self, record: DeviceRecord, folder: Path, wiring: Truth | None = None) -> None:
        self._folder, self._wiring = folder, wiring
        self.bench_clock = RealClock()
        self.asked = record
        self.relays: list[Relay] = []
        self._lag = _Lag()
        self._owner = Owner(record.name)
        self.device: Any = None
        self.identity: Any = None
        """Result of the last `open`."""
        self._armed = False
        self._served = served = _rewritten(record, lambda _: f"127.0.0.1:{free_port()}", lambda _: self._far())
        self._emulator: Any = None
        self._unserved = ""
        try:
            self._emulator = _emulator(served, wiring)
        except UsageError as error:
            self._unserved = str(error)
        try:
            self.record = served if self._emulator is None else _rewritten(served, self._tcp, self._serial)
        except BaseException:
            self.close()
            raise

    # -- setting up -----------------------------------------------------------------------------------------------

    def _tcp(self, far: str) -> str:
        """Put a relay in front of HOST:PORT; returns its address."""
        self.relays.append(TcpRelay(far))
        return self.relays[-1].address

    def _serial(self, far: str) -> str:
        """Put a relay in front of a serial port; returns its path."""
        self.relays.append(SerialRelay(self._folder / self.asked.name, far))
        return self.relays[-1].address

    def _far(self) -> str:
        """Serial port of the emulator."""
        return str(self._folder / f"{self.asked.name}-far")

    def renew_wire(self) -> None:
        """Restore a serial line that was cut."""
        for index, relay in enumerate(self.relays):
            if isinstance(relay, SerialRelay):
                relay.close()
                self.relays[index] = SerialRelay(Path(relay.address), self._far())

    def close(self) -> None:
        """Close driver, relays and emulator."""
        with suppress(Exception):
            self.shut()
        for relay in self.relays:
            relay.close()
        if self._emulator is not None:
            self._emulator.close()
        self._lag.close()

    @property
    def emulator(self) -> Any:
        """The emulator; raises Failed without one."""
        if self._emulator is None:
            why = f"nothing else is tried (docs/drivers.md): {self._unserved}"
            raise Failed(f"{self.record.driver} has no emulator, and {why}")
        return self._emulator

    @property
    def server(self) -> Any:
        """The emulated device."""
        return self.emulator.devices[self.record.name]

    # -- without the driver ---------------------------------------------------------------------------------------

    @property
    def plant(self) -> Any:
        """The emulated plant; its quantities are SI, by channel name."""
        return self.emulator.plant

    def coil(self, valve: ValveRecord) -> bool | None:
        """Last command to a valve: True if energised; None without one."""
        entries = [entry for entry in self.logged("switch") if entry.get("valve") == valve.name]
        return bool(entries[-1]["on"]) if entries else None

    def bring(self, state: State) -> None:
        """Bring the plant to a state."""
        plant = self.plant
        if self.record.valves:
            plant.switch(on=True)
        plant.fail("supply_lost_at", over=state.supply)
        plant.command(state.pressure)
        if any(output.quantity == "length" for output in self.record.outputs):
            return  # the device's own drive moves the end, and would trip if it were moved otherwise
        if "displacement_command" in plant.quantities():
            plant.drive(state.position, SPEED)
        else:
            plant.load(state.force, MASS)

    def by_hand(self, output: str, value: float) -> bool:
        """Change an output by the device's keys or by a second driver; whether that is possible."""
        own = getattr(self.server, "by_hand", None)
        if own is not None:
            own(output, value)
            return True
        if not issubclass(self.driver(), b.Rescue):
            return False
        try:
            self.build(self.record).rescue(output, value)
        except DeviceError:
            return False
        return True

    def restart(self) -> None:
        """Switch the emulated device off and on: its state is lost, the connection stays."""
        self.emulator.close()
        self._emulator = _emulator(self._served, self._wiring)
        self.renew_wire()

    def switch_off_watchdog(self) -> bool:
        """Switch the watchdog off at the emulated device itself; whether that is possible."""
        return bool(getattr(self.server, "switch_off_watchdog", bool)())

    # -- the driver -----------------------------------------------------------------------------------------------

    def driver(self) -> type:
        """Driver class; raises Failed if it cannot be loaded."""
        module, _, name = self.record.driver.partition(":")
        try:
            found = getattr(import_module(module), name)
        except (ImportError, AttributeError) as error:
            raise Failed(f"{self.record.driver} cannot be loaded: {error}") from error
        if not isinstance(found, type):
            raise Failed(f"{self.record.driver} is no class")
        return found

    def build(self, record: DeviceRecord) -> Any:
        """A new driver, not open; raises Failed if it refuses its record."""
        try:
            return self.driver()(record, self.bench_clock)
        except Exception as error:
            raise Failed(f"it cannot be built from the bench's record: {type(error).__name__}: {error}") from error

    def open(self, *, armed: bool = True) -> Identity:
        """Open a new driver in front of its emulator on a good connection, and arm its watchdog as the guard does."""
        _ = self.emulator  # nothing else is ever opened
        self.well()
        self.bench_clock = RealClock()
        self.device = self.build(self.record)
        before = self._heard()
        identity = self.identity = self.call("open()", self.device.open, hung=HUNG).good(OPENS_WITHIN)
        if not isinstance(identity, Identity):
            raise Failed(f"open() gave {identity!r}; an Identity is expected")
        if not identity.simulated and self._heard() == before:
            device, self.device = self.device, None
            self.call("close()", device.close).judged(COLLECTS_WITHIN)
            past = f"{identity.model or 'a device'} past the emulator, with which nothing was exchanged"
            why = "it gives simulated=False: it may drive a muscle, and nothing is commanded"
            raise Failed(f"open() reached {past}; {why}. Let the driver open only the address of its record")
        if armed and self.record.watchdog and isinstance(self.device, b.Watchdog):
            self.call("arm_watchdog()", self.device.arm_watchdog, self.record.watchdog).good()
            self._armed = True
        return identity

    def _heard(self) -> int:
        """How many pieces have passed so far: from the driver if it commands, as an emulator may send by itself."""
        commands = bool(self.record.outputs or self.record.valves)
        return sum(from_device != commands for relay in self.relays for from_device, _ in relay.heard)

    def shut(self) -> None:
        """Close the driver, if there is one, and disarm its watchdog."""
        device: b.Device | None = self.device
        self.device = None
        if device is not None:
            if self._armed and isinstance(device, b.Watchdog):
                self._armed = False
                self.call("disarm_watchdog()", device.disarm_watchdog).judged()
            self.call("close()", device.close).judged(COLLECTS_WITHIN)

    @contextmanager
    def opened(self, *, armed: bool = True, rate: float = 0.0) -> Iterator[Any]:
        """Context with the driver open, sampling at `rate` [Hz] if given and possible; closed at the end."""
        self.open(armed=armed)
        try:
            if rate and self.streams():
                self.call("start()", self.device.start, rate).good(COLLECTS_WITHIN)
            yield self.device
        finally:
            self.well()
            self.shut()

    def call(self, what: str, act: Callable[..., Any], *arguments: Any, hung: float = HUNG, **keywords: Any) -> Outcome:
        """Make a call from the device's only thread; raises Failed if it hangs."""
        self._lag.worst = 0.0
        began = time.monotonic()
        call: Call = self._owner.submit(partial(act, *arguments, **keywords))
        if not call.done.wait(hung):
            self._owner = Owner(self.record.name)
            raise Failed(f"{what} hangs: it is not back after {hung:g} s; give every wait of the driver a time-out")
        return Outcome(what, call.result, call.error, time.monotonic() - began, self._lag.worst)

    def questions(self, device: Any) -> list[tuple[str, Callable[[], Any]]]:
        """All calls that change nothing: name and call."""
        record = self.record
        asked: list[tuple[str, Callable[[], Any]]] = []
        asked += [("read_back()", partial(device.read_back, output.output)) for output in record.outputs]
        asked += [("is_on()", partial(device.is_on, valve.output)) for valve in record.valves]
        asked += [("level()", partial(device.level, lock.input)) for lock in record.interlocks]
        asked += [("held()", device.held)] if isinstance(device, b.Supervised) else []
        return asked + ([("collect()", device.collect)] if self.streams() else [])

    def pass_time(self, seconds: float) -> None:
        """Let bench time pass, feeding the watchdog."""
        end = self.bench_clock.now() + seconds
        while (left := end - self.bench_clock.now()) > 1e-9:
            self.feed()
            self.wait(min(left, 0.1))

    def feed(self) -> None:
        """Feed the watchdog if it is armed."""
        if self._armed and self.device is not None:
            self.call("feed_watchdog()", self.device.feed_watchdog).judged()

    # -- the connection -------------------------------------------------------------------------------------------

    def damage(self, how: Any) -> None:
        """Damage everything that the device sends from now on."""
        for relay in self.relays:
            relay.damage = how

    def well(self) -> None:
        """End the damage."""
        self.damage(None)

    def wait(self, seconds: float) -> None:
        """Let bench time pass without feeding the watchdog."""
        self.bench_clock.wait_until(self.bench_clock.now() + seconds)

    def logged(self, kind: str) -> list[dict[str, Any]]:
        """Commands of one kind in the emulator's log."""
        return list(self.emulator.log.of(kind, self.record.name))

    def streams(self) -> bool:
        """Whether the device has channels that it samples."""
        return bool(self.record.channels) and issubclass(self.driver(), b.Stream)


def open_files() -> int:
    """Number of open files and sockets; 0 if the system does not report it."""
    try:
        return len(os.listdir("/proc/self/fd"))  # noqa: PTH208
    except OSError:
        return 0


def free_port() -> int:
    """A TCP port of this machine that is free now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _emulator(record: DeviceRecord, wiring: Truth | None) -> Any:
    """The project's emulator with this device in it; UsageError without one."""
    found = [point for point in registered("pmabench.emulators") if point.name == "plant"]
    if not found:
        raise UsageError("no emulator is installed")
    return found[0].load()([record], preset="ideal", truth=wiring)


def _rewritten(record: DeviceRecord, tcp: Callable[[str], str], serial: Callable[[str], str]) -> DeviceRecord:
    """The record with its network addresses and serial ports replaced, in address and options."""

    def moved(value: Any) -> Any:
        found = _PLACE.fullmatch(value) if isinstance(value, str) else None
        return f"{found[1] or ''}{tcp(found[2])}" if found else value

    address = serial(record.address) if record.address.startswith("/") else moved(record.address)
    options = {
        name: int(tcp(f"127.0.0.1:{value}").rpartition(":")[2])
        if name.endswith("port") and type(value) is int
        else moved(value)
        for name, value in record.options.items()
    }
    return replace(record, address=address, options=options)
