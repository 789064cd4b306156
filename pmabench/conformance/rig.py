"""One device of a driver for the checks: its emulator, the relays before it, the driver; what came of its calls."""

from __future__ import annotations

import os
import re
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from importlib import import_module
from pathlib import Path
from typing import Any

from pmabench.base.clock import Clock, RealClock, VirtualClock
from pmabench.base.errors import DeviceError, UsageError
from pmabench.base.system import registered
from pmabench.bench.interface import Device, DeviceRecord, Identity, Rescue, Stream, Supervised, Watchdog
from pmabench.bench.interface import Truth as Wiring
from pmabench.conformance.relay import Relay, SerialRelay, TcpRelay
from pmabench.conformance.truth import Behind, Emulated, Inside, Truth
from pmabench.guard.owner import PATIENCE, Call, Owner

PASSED, FAILED, NOT_APPLICABLE, NOT_CHECKED = "pass", "fail", "does not apply", "not checked"
OPENS_WITHIN = 2.0
"""Longest time that `open` may take [s]."""
STARTS_WITHIN = 8.0
"""And that of a simulation without a wire, which may start another process [s]: so long the guard waits."""
COLLECTS_WITHIN = 0.5
"""Longest time that `start`, `collect` and `stop` may take [s]."""
HUNG = 10.0
"""A call that is not back after so long counts as hanging [s]."""
CALLS_WITHIN = PATIENCE
"""Longest time that a command or a question may take [s]."""
_PLACE = re.compile(r"(.*://)?((?:[A-Za-z0-9._-]+|\[[0-9A-Fa-f:.]+\]):\d{1,5})")
"""HOST:PORT, also behind the beginning of an address like `slcan:socket://`."""
SLACK = 0.1
"""What every call is given besides [s], and three times what this computer was late meanwhile."""


@dataclass(frozen=True)
class Result:
    """One line of the suite: the check, its verdict, and a sentence that says why."""

    check: str
    promise: str
    verdict: str
    why: str


class Failed(Exception):
    """The driver breaks the promise; the text says how and what to do."""


class Late(Failed):
    """Something came too late, for which a busy computer can be the reason: it must happen again to count."""


class NotApplicable(Exception):
    """The device has nothing of the kind; the text says what is missing."""


class NotChecked(Exception):
    """Something could not be compared with an independent reference; the text says what, why, and what was compared."""


@dataclass(frozen=True)
class Outcome:
    """Value or error of a call, and how long it took."""

    what: str
    value: Any
    error: BaseException | None
    seconds: float
    lag: float
    """By how much this computer was late meanwhile [s]: other programs want it too."""

    def nothing(self, within: float = CALLS_WITHIN) -> None:
        """As `good`, for a call that returns nothing."""
        if (value := self.good(within)) is not None:
            raise Failed(f"{self.what} returned {value!r}; by the interface it returns None")

    def judged(self, within: float = CALLS_WITHIN) -> Any:
        """Its value, or the DeviceError; raises Failed where it took too long or raised anything else."""
        if self.seconds > within + SLACK + 3 * self.lag:
            raise Late(f"{self.what} took {self.seconds:.2f} s; at most {within:g} s is allowed")
        if self.error is not None and not isinstance(self.error, DeviceError):
            kind = type(self.error).__name__
            raise Failed(f"{self.what} raised {kind}: {self.error}; a DeviceError with a sentence is expected")
        return self.value if self.error is None else self.error

    def good(self, within: float = CALLS_WITHIN) -> Any:
        """Its value; raises Failed also where it is a DeviceError."""
        value = self.judged(within)
        if isinstance(value, DeviceError):
            raise Late(f"{self.what} failed on a good wire: {value}")  # a busy computer's emulator may answer too late
        return value


class _Lag:
    """Notes by how much a thread that sleeps is woken too late: what the computer takes, not the driver."""

    def __init__(self) -> None:
        self.worst = 0.0
        self._ended = threading.Event()
        threading.Thread(target=self._watch, name="conformance lag", daemon=True).start()

    def close(self) -> None:
        """End."""
        self._ended.set()

    def _watch(self) -> None:
        before = time.monotonic()
        while not self._ended.wait(0.01):
            now = time.monotonic()
            self.worst = max(self.worst, now - before - 0.01)
            before = now


class Rig:
    """The device of one record; `wiring` is what its rig's truth file says, where it has one.

    `emulated`: whether an emulator is behind it; `relays`: where bytes can be damaged.
    Without an emulator a driver is tried only where it is a simulation itself.
    """

    def __init__(
        self, record: DeviceRecord, folder: Path, *, realtime: bool = True, wiring: Wiring | None = None
    ) -> None:
        self._folder, self._realtime, self._wiring = folder, realtime, wiring
        self.bench_clock: Clock = self.clock()
        self.asked = record
        self.relays: list[Relay] = []
        self._lag = _Lag()
        self._owner = Owner(record.name)
        self.device: Any = None
        self.identity: Any = None
        """What the last `open` gave."""
        self._armed = False
        self._served = served = _rewritten(record, lambda _: f"127.0.0.1:{free_port()}", lambda _: self._far())
        try:
            self.emulator: Any = _emulator(served, wiring)
        except UsageError:
            self.emulator = None
            self._served = served = _rewritten(
                record, lambda place: f"127.0.0.1:{_kept_port(place, record.driver)}", lambda path: path
            )
        self.server: Any = None if self.emulator is None else self.emulator.devices[record.name]
        try:
            self.record = served if self.server is None else _rewritten(served, self._tcp, self._serial)
        except BaseException:
            self.close()
            raise

    # -- standing up ----------------------------------------------------------------------------------------------

    def _tcp(self, far: str) -> str:
        """A relay in front of HOST:PORT; where it listens."""
        self.relays.append(TcpRelay(far))
        return self.relays[-1].address

    def _serial(self, far: str) -> str:
        """A relay in front of a serial port; where it is reached."""
        self.relays.append(SerialRelay(self._folder / self.asked.name, far))
        return self.relays[-1].address

    def _far(self) -> str:
        """The serial port of the emulator."""
        return str(self._folder / f"{self.asked.name}-far")

    def renew_wire(self) -> None:
        """Put a serial line that was pulled back in place."""
        for index, relay in enumerate(self.relays):
            if isinstance(relay, SerialRelay):
                relay.close()
                self.relays[index] = SerialRelay(Path(relay.address), self._far())

    def close(self) -> None:
        """End everything."""
        with suppress(Exception):
            self.shut()
        for relay in self.relays:
            relay.close()
        if self.emulator is not None:
            self.emulator.close()
        self._lag.close()

    def restart(self) -> bool:
        """Switch the emulated device off and on; whether there is one. What it held is gone, the wire stays."""
        if self.emulator is None:
            return self._inject("restart")
        self.emulator.close()
        self.emulator = _emulator(self._served, self._wiring)
        self.server = self.emulator.devices[self.record.name]
        self.renew_wire()
        return True

    def switch_off_watchdog(self) -> bool:
        """Switch the watchdog off at the emulated device itself; whether that can be done here."""
        if self.emulator is None:
            return self._inject("watchdog-off")
        return bool(getattr(self.server, "switch_off_watchdog", bool)())

    def _inject(self, fault: str) -> bool:
        """Let it happen to a simulation in another process; whether there is one."""
        if (control := getattr(self.device, "control", None)) is not None:
            control("inject", fault=fault)
        return control is not None

    def truth(self) -> Truth:
        """What plant and device really do; raises NotChecked where nobody but the driver knows."""
        driver = self.driver()
        if self.emulator is not None:
            return Emulated(self.record, lambda: self.emulator, self._another)
        if hasattr(driver, "simulation"):
            return Inside(self.record, lambda: self.device)
        if hasattr(driver, "control"):
            return Behind(self.record, lambda: self.device, self._another)
        raise NotChecked("there is neither an emulator nor a simulation to compare with")

    def _another(self) -> Any:
        """A second driver of the same device, not open, for its `rescue`; None where it has no such call."""
        return self.build(self.record) if issubclass(self.driver(), Rescue) else None

    # -- the driver -----------------------------------------------------------------------------------------------

    def clock(self) -> Clock:
        """A clock as the bench of this device has it."""
        return RealClock() if self._realtime else VirtualClock()

    def driver(self) -> type:
        """The class; raises Failed where it cannot be loaded."""
        module, _, name = self.record.driver.partition(":")
        try:
            found = getattr(import_module(module), name)
        except (ImportError, AttributeError) as error:
            raise Failed(f"{self.record.driver} cannot be loaded: {error}") from error
        if not isinstance(found, type):
            raise Failed(f"{self.record.driver} is no class")
        return found

    def build(self, record: DeviceRecord) -> Any:
        """A new driver, not open; raises Failed where it refuses its record."""
        try:
            return self.driver()(record, self.bench_clock)
        except Exception as error:
            raise Failed(f"it cannot be built from the bench's record: {type(error).__name__}: {error}") from error

    def open(self, *, armed: bool = True) -> Identity:
        """A new driver, open on a good wire, its watchdog armed as the guard arms it before it commands anything.

        Raises Failed, also where no emulator and no simulation answers.
        """
        self.well()
        self.bench_clock = self.clock()
        self.device = self.build(self.record)
        outcome = self.call("open()", self.device.open, hung=HUNG)
        if self.emulator is None and isinstance(outcome.error, DeviceError):
            outcome = self.call("open()", self.device.open, hung=HUNG)  # its process may have needed longer to start
        identity = self.identity = outcome.good(self.opens_within)
        if not isinstance(identity, Identity):
            raise Failed(f"open() gave {identity!r}; an Identity is expected")
        if not identity.simulated and self.emulator is None:
            raise Failed(
                f"{identity.maker} {identity.model} answers as hardware, and nothing is tried on hardware: give the "
                "driver an emulator (docs/drivers.md)"
            )
        if armed and self.record.watchdog and isinstance(self.device, Watchdog):
            self.call("arm_watchdog()", self.device.arm_watchdog, self.record.watchdog).good()
            self._armed = True
        return identity

    def shut(self) -> None:
        """Close the driver, if there is one."""
        device: Device | None = self.device
        self.device = None
        if device is not None:
            if self._armed and isinstance(device, Watchdog):
                self._armed = False
                self.call("disarm_watchdog()", device.disarm_watchdog).judged()
            self.call("close()", device.close).judged(COLLECTS_WITHIN)

    @contextmanager
    def opened(self, *, armed: bool = True, rate: float = 0.0) -> Iterator[Any]:
        """The driver open, and sampling where a `rate` [Hz] is given and it can; closed at the end."""
        self.open(armed=armed)
        try:
            if rate and self.streams():
                self.call("start()", self.device.start, rate).good(COLLECTS_WITHIN)
            yield self.device
        finally:
            self.well()
            self.shut()

    def call(self, what: str, act: Callable[..., Any], *arguments: Any, hung: float = HUNG, **keywords: Any) -> Outcome:
        """Make a call from the device's one thread; raises Failed where it hangs."""
        self._lag.worst = 0.0
        began = time.monotonic()
        call: Call = self._owner.submit(partial(act, *arguments, **keywords))
        if not call.done.wait(hung):
            self._owner = Owner(self.record.name)
            raise Failed(f"{what} hangs: it is not back after {hung:g} s; give every wait of the driver a time-out")
        return Outcome(what, call.result, call.error, time.monotonic() - began, self._lag.worst)

    def questions(self, device: Any) -> list[tuple[str, Callable[[], Any]]]:
        """What can be asked of a device without changing anything: name and call."""
        record = self.record
        asked: list[tuple[str, Callable[[], Any]]] = []
        asked += [("read_back()", partial(device.read_back, output.output)) for output in record.outputs]
        asked += [("is_on()", partial(device.is_on, valve.output)) for valve in record.valves]
        asked += [("level()", partial(device.level, lock.input)) for lock in record.interlocks]
        asked += [("held()", device.held)] if isinstance(device, Supervised) else []
        return asked + ([("collect()", device.collect)] if self.streams() else [])

    def pass_time(self, seconds: float) -> None:
        """Let bench time pass, the watchdog fed."""
        end = self.bench_clock.now() + seconds
        while (left := end - self.bench_clock.now()) > 1e-9:
            self.feed()
            self.wait(min(left, 0.1))

    def feed(self) -> None:
        """Feed the watchdog where it is armed."""
        if self._armed and self.device is not None:
            self.call("feed_watchdog()", self.device.feed_watchdog).judged()

    # -- the wire -------------------------------------------------------------------------------------------------

    def damage(self, how: Any) -> None:
        """Do this to what the device sends from now on."""
        for relay in self.relays:
            relay.damage = how

    def well(self) -> None:
        """No damage any more."""
        self.damage(None)

    def wait(self, seconds: float) -> None:
        """Let bench time pass, and the watchdog run."""
        self.bench_clock.wait_until(self.bench_clock.now() + seconds)

    def logged(self, kind: str) -> list[dict[str, Any]]:
        """What the emulator says was commanded."""
        return [] if self.emulator is None else list(self.emulator.log.of(kind, self.record.name))

    @property
    def opens_within(self) -> float:
        """Longest time that `open` may take here [s]."""
        return OPENS_WITHIN if self.emulator is not None else STARTS_WITHIN

    def streams(self) -> bool:
        """Whether the device has channels that it samples."""
        return bool(self.record.channels) and issubclass(self.driver(), Stream)


def open_files() -> int:
    """How many files and sockets are open; 0 where the system does not say."""
    try:
        return len(os.listdir("/proc/self/fd"))  # noqa: PTH208
    except OSError:
        return 0


def free_port() -> int:
    """A port of this machine that nobody listens at now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@lru_cache
def _kept_port(_place: str, _driver: str) -> int:
    """A free port for a simulation that starts another process: one process for all checks."""
    return free_port()


def _emulator(record: DeviceRecord, wiring: Wiring | None) -> Any:
    """The emulator of the project with this device in it; UsageError where there is none."""
    found = [point for point in registered("pmabench.emulators") if point.name == "plant"]
    if not found:
        raise UsageError("no emulator is installed")
    return found[0].load()([record], preset="ideal", truth=wiring)


def _rewritten(record: DeviceRecord, tcp: Callable[[str], str], serial: Callable[[str], str]) -> DeviceRecord:
    """The record with every place on the network or at a serial port put elsewhere: its address, and options."""

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
