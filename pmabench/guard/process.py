"""The guard process, in its own session: serves one engine over a loopback socket, and outlives it.

The engine's requests are its heartbeat. When they stop, when the engine's end of the socket closes, when an interlock
opens, when a device has changed by itself, when the guard or the computer was stopped for a while, or on request,
the guard runs the safe state by itself.
Messages are those of `pmabench.guard.wire`; each request names its action as `do`, each answer has `state` and `ended`.
"""

from __future__ import annotations

import json
import os
import selectors
import signal
import socket
import sys
import threading
import time
import traceback
from array import array
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from types import FrameType
from typing import Any

from pmabench.base.clock import RealClock
from pmabench.base.errors import DeviceError, LimitRefused, LimitTripped, PmaError, RecordError
from pmabench.base.system import GUARD, keep_in_memory, real_time
from pmabench.bench.interface import Block, CompiledBench, Load, Stream, place
from pmabench.guard.guard import Guard, State
from pmabench.guard.safe import Vent
from pmabench.guard.station import Station
from pmabench.guard.supervision import LOOK
from pmabench.guard.wire import Messages, encode, keys

SILENCE = 0.25
"""The engine is lost after this time without a request from it while the bench is armed [s]."""
LOST_TIME = 0.25
"""A guard that was paused for longer than this [s] does not know what happened meanwhile, and ends the run."""
STRANGERS = 32
"""Largest number of connections without a valid key; above it the oldest is closed."""
TICK = 0.005
CONNECTS_WITHIN = 5.0
"""An engine that does not connect within this time [s] is not waited for."""
ACTIVE = (State.SETUP, State.RUNNING)
COMMANDS = ("arm", "release", "set", "ramp", "sine", "valves", "steer")
PASSED_ON: Mapping[str, Callable[..., Any]] = {
    "release": Guard.release,
    "set": Guard.set,
    "ramp": Guard.ramp,
    "sine": Guard.sine,
    "valves": Guard.valves,
    "steer": Guard.steer,
    "stream": lambda guard, name, rate: guard.links.stream(name, rate),
    "place": lambda guard, force, mass: guard.place(Load(force, mass)),
}
"""Requests that only call a method of the guard; its result is the answer's `value`."""
STALE = 0.5
"""A command sent longer ago than this [s] is not carried out: its sender has given up on a paused guard."""


class _Peer:
    def __init__(self, link: socket.socket, key: bytes) -> None:
        self.link = link
        self.messages = Messages(key)
        self.known = False
        """Whether it has sent the key."""
        self.waits = False
        """Whether it waits for the end of the safe state."""


class Pulse:
    """Notices time that this process lost: stopped, starved, or asleep with the computer (S12)."""

    def __init__(self) -> None:
        self.lost = 0.0
        """Longest time between two checks [s]; a thread checks every `4 * TICK`."""
        self.over = False
        self._looked = _since_boot()
        threading.Thread(target=self._look_on, name="pulse", daemon=True).start()

    def look(self) -> None:
        """Note the time since the last check."""
        before, self._looked = self._looked, _since_boot()
        self.lost = max(self.lost, self._looked - before)

    def _look_on(self) -> None:
        while not self.over:
            time.sleep(4 * TICK)
            self.look()


class Service:
    """Serves the socket until the bench is safe and the engine has gone."""

    def __init__(self, guard: Guard, station: Station, listener: socket.socket, token: str) -> None:
        self.guard, self.station = guard, station
        self._asks, self._answers = keys(token)
        self._selector = selectors.DefaultSelector()
        self._selector.register(listener, selectors.EVENT_READ)
        self._listener = listener
        self._engine: _Peer | None = None
        self._peers: list[_Peer] = []
        self._heard = self._looked = time.monotonic()
        self._collected: dict[str, float] = {}
        """When the samples of each device were last collected [s]."""
        self._pulse = Pulse()
        self._ended: dict[str, str] = {}
        self._vent: Vent | None = None
        self._kept: dict[str, list[Block]] = {}
        self._served = self._asked_to_end = False

    def serve(self) -> None:
        """Serve until the bench is safe and the engine has gone; then close all connections."""
        signal.signal(signal.SIGTERM, self._note_signal)
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        while not self._over():
            self.turn()
        for key in list(self._selector.get_map().values()):
            self._selector.unregister(key.fileobj)
            key.fileobj.close()  # type: ignore[union-attr]
        self._selector.close()
        self._pulse.over = True

    def turn(self) -> None:
        """Handle messages that have arrived, then do what is due."""
        try:
            heard = self._selector.select(TICK)
            self._refuse_lost_time()  # before any message: one sent before the pause is no sign of life
            for key, _events in heard:
                if key.fileobj is self._listener:
                    self._accept()
                else:
                    self._hear(key.data)
            self._tick()
        except Exception:  # any error: the bench is made safe by what still works
            _write_down()
            with suppress(Exception):
                self._end("lost", "an error in the guard; see guard.log")

    def _accept(self) -> None:
        with suppress(OSError):
            link = self._listener.accept()[0]
            link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._peers.append(_Peer(link, self._asks))
            self._selector.register(link, selectors.EVENT_READ, self._peers[-1])
        strangers = [peer for peer in self._peers if not peer.known]
        if len(strangers) > STRANGERS:
            self._hang_up(strangers[0])

    def _over(self) -> bool:
        """Whether the bench is not in use and no engine is left that could command it."""
        here = self._engine is not None or (not self._served and time.monotonic() - self._heard < CONNECTS_WITHIN)
        busy = self.guard.state in {*ACTIVE, State.STOPPING}
        return not busy and (not here or self._asked_to_end)

    def _note_signal(self, number: int, _frame: FrameType | None) -> None:
        self._asked_to_end = True

    def _hear(self, peer: _Peer) -> None:
        if peer not in self._peers:
            return  # closed in this turn already
        try:
            piece = peer.link.recv(1 << 16)
            for message, _payload in peer.messages.feed(piece) if piece else ():
                peer.known = True
                self._answer(peer, message)
        except (OSError, ValueError, RecursionError):  # a broken connection, or bytes that are no valid message
            if peer.known:
                _write_down()
            piece = b""
        if not piece:
            self._hang_up(peer)

    def _hang_up(self, peer: _Peer) -> None:
        self._selector.unregister(peer.link)
        self._peers.remove(peer)
        peer.link.close()
        if peer is self._engine:
            self._engine = None
            if self.guard.state in ACTIVE:
                self._end("lost", "the engine has gone")

    def _answer(self, peer: _Peer, message: dict[str, Any]) -> None:
        payload = b""
        try:
            answer = self._do(peer, message.pop("do", ""), message.pop("at", None), message)
            payload = answer.pop("payload", b"")
        except PmaError as error:
            said = {"type": type(error).__name__, "text": str(error)}
            if isinstance(error, DeviceError):  # the other end does not know a driver's subclasses
                said = {"type": "DeviceError", "device": error.device, "channel": error.channel, "text": error.message}
            answer = {"error": said}
        except Exception as error:  # an engine's mistake: reported to it, and nothing was done
            _write_down()
            answer = {"error": {"type": "PmaError", "text": f"guard: {type(error).__name__}: {error}"}}
        if peer is self._engine:
            self._heard = time.monotonic()  # time that the guard took is no silence of the engine
        self._send(peer, answer, payload)

    def _do(self, peer: _Peer, do: str, sent: float | None, given: dict[str, Any]) -> dict[str, Any]:
        act = getattr(self, f"do_{do}", None)
        if act is None and do not in PASSED_ON:
            raise LimitRefused(f'the guard knows no request "{do}"')
        if do not in {"vent", "status"} and peer is not self._engine:
            if self._served:
                raise LimitRefused("this guard has an engine already")
            self._engine, self._served = peer, True
        if do in COMMANDS and not (sent is not None and abs(time.monotonic() - sent) <= STALE):
            raise LimitRefused(f'"{do}" is not done: it was sent too long ago')
        if act is None:
            return {"value": PASSED_ON[do](self.guard, **given)}
        return act(peer=peer, **given) or {}

    def _send(self, peer: _Peer, answer: dict[str, Any], payload: bytes = b"") -> None:
        vent = vars(self._vent) if self._vent is not None else None
        whole = {"state": self.guard.state.value, "ended": self._ended, "vent": vent, **answer}
        peer.link.settimeout(SILENCE)
        peer.link.sendall(encode(whole, self._answers, payload))

    # -- requests -----------------------------------------------------------------------------------------------

    def do_open(self, peer: _Peer) -> dict[str, Any]:
        """Open the devices; a latched bench is made safe again and refused. From here on `vent` can find the bench."""
        self.station.write("bench", json.loads(self.guard.bench.to_json()))
        if self.guard.devices:
            raise LimitRefused("the bench is open already")
        latched = self.station.latched()
        tripped = (
            f"the bench is tripped: {latched}. Look at it, then: "
            f'pmabench vent "{self.guard.bench.name}" --reset --operator NAME --because TEXT'
        )
        try:
            self.guard.open()
        except DeviceError as error:
            if latched:
                raise LimitRefused(f"{tripped}. Besides, a device cannot be opened: {error}") from error
            raise
        if latched:
            self._end("trip", latched)
            raise LimitRefused(tripped)
        for identity in self.guard.identities.values():
            if identity.serial and not identity.simulated:  # the same device may be in use under another address
                self.station.take_device(f"{identity.maker} {identity.model} serial {identity.serial}")
        return {"identities": self.guard.describe(), "streams": self._streams()}

    def _streams(self) -> list[str]:
        return [name for name, device in list(self.guard.devices.items()) if isinstance(device, Stream)]

    def do_arm(self, peer: _Peer, run: str) -> None:
        """Arm; the state folder records it first, so that an end without a result counts as unclean."""
        if self.guard.state is State.DISARMED:
            self.station.note("armed", run=str(run), why="")
        self.guard.arm(str(run))
        self._pulse.lost = 0.0

    def do_collect(self, peer: _Peer, device: str, seen: dict[str, float]) -> dict[str, Any]:
        """New samples of a device, as raw arrays; `seen` are the newest values that the engine measured itself."""
        self._collected[device] = time.monotonic()
        blocks = [*self._kept.pop(device, []), self.guard.collect(device)]
        blocks = [block for block in blocks if len(block.time)] or blocks[-1:]
        self.guard.latest.update(self._believed(seen))
        columns = list(blocks[0].columns)
        parts: list[array[Any]] = [array("q", block.time) for block in blocks]
        parts += [array("d", block.columns[name]) for name in columns for block in blocks]
        return {
            "payload": b"".join(part.tobytes() for part in parts),
            "rows": sum(len(b.time) for b in blocks),
            "columns": columns,
            "host": blocks[-1].host,
        }

    def _believed(self, seen: dict[str, float]) -> dict[str, float]:
        """Values of the engine that are used: of channels that the guard does not read itself."""
        own = {c.name for d in self.guard.bench.devices if d.name in self.guard.devices for c in d.channels}
        return {name: float(value) for name, value in seen.items() if name not in own}

    def do_safe(self, peer: _Peer, *, tripped: bool, hurry: int, why: str, doubted: Sequence[str] = ()) -> None:
        """The engine ends the run: begin the safe state."""
        self._end("engine", why, tripped=tripped, hurry=hurry, doubted=doubted)

    def do_vent(self, peer: _Peer, who: str) -> dict[str, Any]:
        """Make the bench safe on request; answered at once, and again when it is over."""
        self._end("vent", f"vent by {who}", tripped=False, hurry=True)
        peer.waits = True
        return {"commanded": True}

    def do_status(self, peer: _Peer, seen: dict[str, float] | None = None) -> dict[str, Any]:
        """State of the guard; `seen` as in `do_collect`, for an engine that collects nothing here."""
        self.guard.latest.update(self._believed(seen or {}) if peer is self._engine else {})
        return {"run": self.guard.run}

    def do_bye(self, peer: _Peer) -> None:
        """Accept the end of the engine's run."""
        if self.guard.state in ACTIVE:
            self._end("lost", "the engine left an armed bench")
        self._engine = None

    # -- what the guard does by itself --------------------------------------------------------------------------

    def _tick(self) -> None:
        now = time.monotonic()
        if self.guard.state in ACTIVE:
            if now - self._heard > SILENCE:
                self._end("lost", f"the engine was silent for {now - self._heard:.2f} s")
            elif self._asked_to_end:
                self._end("lost", "the guard was asked to end")
            else:
                try:
                    self.guard.supervision.look(now)
                except PmaError as error:
                    opened = isinstance(error, LimitTripped)
                    how = "trip" if opened or isinstance(error, LimitRefused) else "lost"
                    self._end(how, str(error), hurry=opened)  # whoever opened an interlock must not wait for a ramp
        going_on = self.guard.state is State.STOPPING or (self._vent is not None and self._vent.confirmed)
        if going_on:  # a watchdog must not fire after a good vent
            self.guard.attend(now, 1 / LOOK)
        if going_on and now - self._looked > LOOK:
            self._looked = now
            self.guard.supervision.differences()  # a question that failed is asked again
        if self.guard.state is State.STOPPING:
            self._step(now)

    def _refuse_lost_time(self) -> None:
        self._pulse.look()
        if self._pulse.lost <= LOST_TIME:
            return
        lost, self._pulse.lost = f"{self._pulse.lost:.2f} s", 0.0
        if self.guard.state in ACTIVE:
            why = f"the guard was stopped for {lost}: suspended, starved, or this computer slept"
            self._end("trip", why, hurry=True)  # a watchdog may have emptied it: no ramp
            self.guard.supervision.compare()
        elif self.guard.state is State.STOPPING:
            self.guard.begin_safe(hurry=True)  # another process may have vented meanwhile: no ramp continues

    def _end(self, how: str, why: str, *, tripped: bool = True, hurry: int = 0, doubted: Sequence[str] = ()) -> None:
        """Begin the safe state; the first cause is kept and reported."""
        first = not self._ended
        self._ended = self._ended or {"how": how, "why": why}
        self.guard.begin_safe(tripped=tripped, hurry=hurry, doubted=doubted)
        if first:
            self.guard.latest.clear()
        self._step(time.monotonic())

    def _step(self, now: float) -> None:
        for name in self._streams():
            if now - self._collected.get(name, 0.0) > 2 * LOOK:  # each by itself: the engine may have ended at one
                self._collected[name] = now
                with suppress(PmaError):
                    self._kept.setdefault(name, []).append(self.guard.collect(name))
        vent = self.guard.step_safe(self.guard.latest)
        self.guard.latest.clear()  # each measurement confirms only once
        if vent is None or self._vent is not None:
            return
        self._vent = vent = Vent(vent.result, (*vent.actions, *self.guard.supervision.differences()))
        besides = self.guard.faults() if vent.confirmed else [f"safe state {vent.result}"]
        why = "; ".join([self._ended["why"], *besides])
        latched = self.guard.state is State.TRIPPED or not vent.confirmed
        with suppress(RecordError):
            self.station.note("tripped" if latched else "safe", why=why, vent=vars(vent), run=self.guard.run)
        if self._engine is None and self.guard.run:
            run = Path(self.guard.run)
            about = {"run": run.name, "cause": self._ended["why"], "t": self.guard.clock.now(), "vent": vars(vent)}
            with suppress(OSError, ValueError):  # not into the run: its folder may be sealed at any moment (R12)
                late = run.with_name(f"{run.name}.late")
                late.mkdir(exist_ok=True)
                part = late / ".guard.json.part"
                part.write_text(json.dumps(about), encoding="utf-8")
                part.replace(late / "guard.json")
        for peer in self._peers:
            if peer.waits:
                with suppress(OSError):
                    self._send(peer, {})


def _write_down() -> None:
    """Print the current exception into guard.log; a full disk is ignored."""
    with suppress(OSError):
        traceback.print_exc()


def _since_boot() -> float:
    """Clock that also advances while the computer sleeps [s], where the system has one."""
    clock = getattr(time, "CLOCK_BOOTTIME", None)
    return time.clock_gettime(clock) if clock is not None else time.monotonic()


def main() -> None:
    """Read the compiled bench from stdin, print port and key to stdout, and serve."""
    given = json.loads(sys.stdin.readline())
    bench = CompiledBench.from_json(json.dumps(given["bench"]))
    station = Station(bench.name)
    try:
        station.take()
        for where in filter(None, (place(device.address, device.options) for device in bench.devices)):
            station.take_device(where)  # refused where two devices of this bench are one
    except PmaError as error:
        sys.stdout.write(json.dumps({"busy": str(error)}) + "\n")
        return
    listener = socket.create_server(("127.0.0.1", 0))
    token = os.urandom(32).hex()
    here = {"port": listener.getsockname()[1], "token": token, "pid": os.getpid(), "user": given.get("user", "")}
    station.write("guard", {**here, "since": time.strftime("%H:%M:%S")})
    sys.stdout.write(json.dumps(here) + "\n")
    sys.stdout.close()
    real_time(GUARD)
    keep_in_memory()
    guard = Guard(bench, RealClock(given["start"]), threads=True)
    try:
        Service(guard, station, listener, token).serve()
    finally:
        guard.close()
        station.remove("guard")
