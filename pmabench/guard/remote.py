"""The engine's side of a guard in another process: the same methods as `Guard`, over a loopback socket.

Also the safe state without a guard process: for when there is none, or it does not answer.
"""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from array import array
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import IO, Any

from pmabench.base import errors
from pmabench.base.clock import RealClock
from pmabench.base.errors import DeviceError, Interrupted, LimitTripped, PmaError, RecordError
from pmabench.base.system import try_lock, user_name
from pmabench.bench.interface import Block, CompiledBench, Identity, Load
from pmabench.guard.guard import Guard, Measure, State
from pmabench.guard.limits import to_device
from pmabench.guard.safe import LINGERS, Vent
from pmabench.guard.station import UNCLEAN, Station
from pmabench.guard.wire import Message, Messages, encode, keys

RATE = 50.0
"""Sampling rate of pressures while a vent is confirmed [Hz]."""
MEASURED_FIRST = 0.5
"""Longest wait for a first measured value before a safe ramp begins [s]."""


def vent_directly(
    bench: CompiledBench,
    station: Station,
    why: str,
    doubted: Sequence[str] = (),
    hurried: Callable[[], int] = lambda: 0,
) -> Vent:
    """Open the guarded devices here, run the safe state, write its result into the bench's state folder.

    Devices that cannot be opened are left out, the others are vented. The bench is latched if it was armed or tripped
    before, or is not confirmed to be safe now. `doubted`, and the levels of `hurried`, are as in `Guard.begin_safe`.
    """
    guard = _opened(bench)
    if any(record.guarded and record.name not in guard.devices for record in bench.devices) and _killed(station):
        guard.close()
        guard = _opened(bench)
    unclean = station.read("state").get("what") == "armed"
    if unclean:
        guard.unanswered = guard.clock.now()  # the last command of the guard that has gone is not known

    def measure() -> Mapping[str, float]:
        guard.latest.clear()
        if hurry := hurried():
            guard.begin_safe(hurry=hurry, doubted=doubted)
        guard.attend(guard.clock.now(), RATE)  # each time: late samples may still confirm the vent
        guard.clock.wait_until(guard.clock.now() + 0.05)
        for name in list(guard.devices):
            with suppress(PmaError):
                guard.collect(name)
        return guard.latest

    try:
        until = guard.clock.now() + MEASURED_FIRST
        while any(a.do == "ramp" for a in bench.safe_state) and not measure() and guard.clock.now() < until:
            pass  # a ramp must not begin above the measured value
        guard.begin_safe(doubted=doubted)
        vent = guard.safe_state(measure)
    finally:
        guard.close()
    latched = bool(station.latched()) or not vent.confirmed or guard.state is State.TRIPPED
    why = f"{UNCLEAN} ({why})" if unclean else why
    why = "; ".join([why, *(guard.faults() if vent.confirmed else [f"safe state {vent.result}"])])
    with suppress(RecordError):
        station.note("tripped" if latched else "safe", why=why, vent=vars(vent))
    return vent


def _opened(bench: CompiledBench) -> Guard:
    guard = Guard(bench, RealClock(), threads=True, forgiving=True)
    guard.open()
    return guard


def _killed(station: Station) -> bool:
    """Kill a guard that holds the lock but does not answer, to free its lines; returns whether there was one."""
    there, deadline = station.read("guard").get("pid"), time.monotonic() + ANSWERS_WITHIN
    if not isinstance(there, int) or not _held(station):
        return False
    with suppress(OSError):
        os.kill(there, getattr(signal, "SIGKILL", signal.SIGTERM))
    while _held(station) and time.monotonic() < deadline:
        time.sleep(0.01)
    return True


def _held(station: Station) -> bool:
    lock = try_lock(station.folder / "lock")
    if lock is not None:
        os.close(lock)
    return lock is None


ANSWERS_WITHIN = 1.0
"""A guard that does not answer within this time [s] is lost."""
OPENS_WITHIN = 10.0
ENDS_WITHIN = 5.0
"""Time limits of the guard for opening the bench, and for ending after the run [s]."""


def exchange(link: socket.socket, message: Mapping[str, Any], token: str, within: float) -> Message:
    """Send a message and wait for one answer; raises OSError (a time-out is one) or ValueError."""
    link.settimeout(within)
    asking, answering = keys(token)
    link.sendall(encode(message, asking))
    messages = Messages(answering)
    while True:
        piece = link.recv(1 << 20)
        if not piece:
            raise ConnectionResetError("the other side has gone")
        for answer in messages.feed(piece):
            return answer


class RemoteStream:
    """The samples of a device that the guard reads."""

    def __init__(self, guard: RemoteGuard, device: str) -> None:
        self._guard, self._device = guard, device

    def start(self, rate: float) -> float:
        """As `Stream.start`."""
        return float(self._guard.ask("stream", name=self._device, rate=rate)[0]["value"])

    def stop(self) -> None:
        """As `Stream.stop`."""
        self._guard.ask("stream", name=self._device, rate=0.0)

    def collect(self) -> Block:
        """As `Stream.collect`, with 64-bit integers and floats whatever types the device gives."""
        about, payload = self._guard.ask("collect", device=self._device, seen=self._guard.seen)
        size = 8 * about["rows"]
        parts = [payload[start : start + size] for start in range(0, len(payload), size)] if size else []
        time_ns = array("q", parts[0] if parts else b"")
        columns = {name: array("d", parts[1 + n] if parts else b"") for n, name in enumerate(about["columns"])}
        return Block(time_ns, columns, about["host"])


class RemoteGuard:
    """Starts the guard process of a bench and sends it the engine's requests. Any thread may call it."""

    def __init__(self, bench: CompiledBench, clock: RealClock) -> None:
        self.bench = bench
        self.devices: dict[str, RemoteStream] = {}
        self.identities: dict[str, Identity] = {}
        self.seen: dict[str, float] = {}
        """Newest values [SI] of channels that the engine measures itself, for the guard's confirmation."""
        self._clock = clock
        self._outputs = {output.name: output for output in bench.outputs}
        self._lock = threading.Lock()
        self._link: socket.socket | None = None
        self._process: subprocess.Popen[bytes] | None = None
        self._here: dict[str, Any] = {}
        self._safe = False
        self._doubted, self._hurry = tuple[str, ...](), 0
        """As in `begin_safe`, in case the guard is lost."""
        self.hurried: Callable[[], int] = lambda: 0
        """Level of `begin_safe` that the operator has asked for since the last call; for a vent without the guard."""
        self._vent: Vent | None = None
        self._state = "disarmed"

    def open(self) -> None:
        """Start the guard and have it open its devices. Raises DeviceError, or LimitRefused for a latched bench."""
        station = Station(self.bench.name)
        given = {"bench": json.loads(self.bench.to_json()), "start": self._clock.start, "user": user_name()}
        with _log(station) as log:
            process = self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", "pmabench.guard"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                start_new_session=True,
            )
        assert process.stdin is not None and process.stdout is not None  # noqa: S101, PT018
        with process.stdin, process.stdout:
            with suppress(BrokenPipeError):
                process.stdin.write(json.dumps(given).encode() + b"\n")
                process.stdin.flush()
            line = process.stdout.readline()
        if not line:
            self._wait()
            raise DeviceError(self.bench.name, f"its guard did not start; see {station.folder / 'guard.log'}")
        self._here = json.loads(line)
        if "busy" in self._here:
            self._wait()
            raise DeviceError(self.bench.name, self._here["busy"].partition(": ")[2])
        self._link = socket.create_connection(("127.0.0.1", self._here["port"]), timeout=ANSWERS_WITHIN)
        self._link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        answer, _ = self.ask("open", within=OPENS_WITHIN)
        self.identities = {name: Identity(**about) for name, about in answer["identities"].items()}
        self.devices = {name: RemoteStream(self, name) for name in answer["streams"]}

    def ask(self, do: str, within: float = ANSWERS_WITHIN, **data: Any) -> tuple[dict[str, Any], bytes]:
        """Send one request; returns answer and payload.

        Raises the error that the guard reports, or the reason for which it has ended the run.
        """
        with self._lock:
            if self._link is None:
                raise DeviceError("guard", "is not there any more")
            try:
                message = {"do": do, "at": time.monotonic(), **data}
                answer, payload = exchange(self._link, message, self._here["token"], within)
            except (OSError, ValueError) as error:
                self._link.close()
                self._link = None
                raise DeviceError("guard", f"does not answer ({error or type(error).__name__})") from error
        self._state = answer["state"]
        if answer["vent"] is not None:
            self._vent = Vent(answer["vent"]["result"], tuple(answer["vent"]["actions"]))
        if not self._safe and answer["ended"] and do != "open":
            raise _ended(answer["ended"])
        if "error" in answer:
            raise _raised(answer["error"])
        return answer, payload

    def arm(self, run: str = "") -> None:
        """As `Guard.arm`."""
        self.ask("arm", within=OPENS_WITHIN, run=run)

    def beat(self) -> None:
        """Sign of life while nothing is collected or commanded."""
        with suppress(PmaError):
            self.ask("status", seen=self.seen)

    def release(self) -> None:
        """As `Guard.release`."""
        self.ask("release")

    def set(self, name: str, value: float) -> float:
        """As `Guard.set`."""
        return float(self.ask("set", name=name, value=value)[0]["value"])

    def ramp(self, name: str, origin: float, target: float, rate: float) -> None:
        """As `Guard.ramp`."""
        self.ask("ramp", name=name, origin=origin, target=target, rate=rate)

    def sine(self, name: str, mean: float, amplitude: float, frequency: float, cycles: float) -> None:
        """As `Guard.sine`."""
        self.ask("sine", name=name, mean=mean, amplitude=amplitude, frequency=frequency, cycles=cycles)

    def valves(self, *, closed: bool, only: str = "") -> None:
        """As `Guard.valves`."""
        self.ask("valves", closed=closed, only=only)

    def steer(self, aims: Mapping[str, float], pulses: Mapping[str, float]) -> None:
        """As `Guard.steer`."""
        self.ask("steer", aims=dict(aims), pulses=dict(pulses))

    def place(self, load: Load) -> None:
        """As `Guard.place`."""
        self.ask("place", force=load.force, mass=load.mass)

    def value_sent(self, name: str, value: float) -> float:
        """As `Guard.value_sent`."""
        output = self._outputs[name]
        return float(output.scale.to_si(to_device(output, value)))

    def begin_safe(self, *, tripped: bool = False, hurry: int = 0, why: str = "", doubted: Sequence[str] = ()) -> None:
        """Have the guard begin the safe state; from any thread. `safe_state` waits for its end."""
        self._safe, self._doubted, self._hurry = True, (*self._doubted, *doubted), max(self._hurry, hurry)
        with suppress(PmaError):
            self.ask("safe", tripped=tripped, hurry=hurry, why=why, doubted=[*doubted])

    def safe_state(self, measure: Measure, *, tripped: bool = False, why: str = "") -> Vent:
        """As `Guard.safe_state`. If the guard is gone, the engine opens the devices itself."""
        self.begin_safe(tripped=tripped, why=why)
        longest = sum(action.within for action in self.bench.safe_state) + LINGERS + 2.0
        deadline = time.monotonic() + longest
        while self._vent is None and self._link is not None and time.monotonic() < deadline:
            before = time.monotonic()
            with suppress(Exception):  # errors of measuring do not matter: the guard continues by itself
                measure()
            quick = time.monotonic() - before < 0.01
            if quick or not any(device.guarded and device.channels for device in self.bench.devices):
                time.sleep(0.05 if quick else 0.0)
                self.beat()  # sends the measured values when nothing is collected from the guard
        if self._vent is None:
            if self._process is not None:
                self._process.kill()  # its commands must not continue after this vent
            try:
                lost, where = why or "the guard was lost", Station(self.bench.name)
                hurried = lambda: max(self._hurry, self.hurried())  # noqa: E731
                self._vent = vent_directly(self.bench, where, lost, self._doubted, hurried)
            except Exception as error:  # the run is closed in any case
                self._vent = Vent("failed", (f"{type(error).__name__}: {error}",))
        return self._vent

    def close(self) -> None:
        """Have the guard end, and wait for it: it holds the lock of the bench, which the next run needs."""
        with suppress(PmaError):
            self._safe = True
            self.ask("bye")
        if self._link is not None:
            self._link.close()
            self._link = None
        self._wait()

    def _wait(self) -> None:
        """Wait up to `ENDS_WITHIN` for the guard process to end; one that still has to vent outlives the engine."""
        if self._process is not None:
            with suppress(subprocess.TimeoutExpired, KeyboardInterrupt):  # the run is over: nothing to interrupt
                self._process.wait(ENDS_WITHIN)
            self._process.returncode = self._process.returncode or 0  # no warning of a child that is still there
            self._process = None


AnyGuard = Guard | RemoteGuard
"""The guard as used by the engine, in this process or in another."""


def _log(station: Station) -> IO[bytes]:
    """File guard.log for errors of the guard; makes the folder. Raises DeviceError if it cannot."""
    try:
        station.folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        return (station.folder / "guard.log").open("ab")
    except OSError as error:
        raise DeviceError(
            station.name, f"its state cannot be kept in {station.folder}: {error.strerror}; set PMABENCH_STATE"
        ) from error


def _ended(ended: Mapping[str, str]) -> PmaError:
    """The error for a run that was ended by the guard."""
    if ended["how"] == "trip":
        return LimitTripped(ended["why"])
    if ended["how"] == "vent":
        return Interrupted(ended["why"], 130)
    return DeviceError("guard", f"has taken over: {ended['why']}")


def _raised(reported: Mapping[str, str]) -> PmaError:
    """The error that the guard reported."""
    if reported["type"] == "DeviceError":
        return DeviceError(reported["device"], reported["text"], reported["channel"])
    kind = getattr(errors, reported["type"], PmaError)
    error: PmaError = kind(reported["text"])
    return error
