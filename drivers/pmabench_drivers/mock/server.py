"""The simulated plant as a separate process, in real time, behind a loopback socket: the server of `mock-realtime`.

    python -m pmabench_drivers.mock.server --address 127.0.0.1:47807 < device.json

serves one device (the JSON of a `DeviceRecord` on standard input) to any number of connections on this machine.
The plant outlives its clients as compressed air does: after `idle` seconds without one the server vents and ends.

Framing: `pmabench_drivers.mock.client`. First request of each connection:
`{"do": "hello", "role": "client", "pid": 12, "zero": 99.5, "device": {...}}` with the client's bench time 0 on
CLOCK_MONOTONIC [s] and its device record; answered by the identity, or refused if another device is served.
Role `rescue` is a client's second connection to the outputs. Then, as in the driver interface, in device units:
`write` and `rescue` (`output`, `value`), `read_back`, `halt`, `is_on` (`output`), `follow` (`output`, `segment` on the
client's bench time), `switch` (`output`, `on`), `level` (`name`), `place` (`force`, `mass`), `start` (`rate`), `stop`,
`collect`, `arm` (`seconds`), `feed`, `disarm`, `held`. The result is in `value`. `collect` answers
`{"rows": r, "columns": [names]}` and as raw bytes the r times (int64, ns on the client's bench time), then each column
(float64, all little-endian). A pressure set-point beyond 0 to 1000 kPa is taken as the end of that range.

Watchdog: once armed, and without a request on any connection for its time, it de-energises the valves and sets the
set-points to their safe values; after that only safe commands are accepted, until it is armed or disarmed.

Role `control` is for tests: `inject` (a fault of `pmabench_drivers.mock.options`, errors of sensors, or an event:
`restart`, `watchdog-off`, `setpoint` with its `value` in device units), `state`, `end`.
It is answered despite faults of the link, and does not feed the watchdog.

The log (option `log`) has one JSON object per line: `t` [s, CLOCK_MONOTONIC], `do`, the decoded values in SI, the
`pressure` in the muscle [Pa] at that moment, and `from`, `role`, `pid` of the connection.
"""

from __future__ import annotations

import argparse
import json
import os
import selectors
import socket
import sys
import time
from contextlib import suppress
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from pmabench.base.clock import RealClock
from pmabench.base.errors import DeviceError, PmaError, invalid
from pmabench.base.system import ENGINE, real_time
from pmabench.bench.interface import DeviceRecord, device_from
from pmabench_drivers.mock.client import LONGEST_LINE, decode, encode, parse_address

if TYPE_CHECKING:
    from pmabench_drivers.mock.served import Asker

TICK = 0.004
"""Interval for advancing the plant without requests [s]: short enough for single steps, which cost least."""
LAST_WAIT = 10.0
"""Longest wait at the server's end until the muscle is empty [s]."""


class _Connection:
    """One socket: received bytes, and bytes that could not be sent yet."""

    def __init__(self, link: socket.socket, asker: Asker) -> None:
        self.link, self.asker = link, asker
        self.inbox, self.out = b"", bytearray()


class Server:
    """The loop: accepts connections, answers requests, and advances the plant in between."""

    def __init__(self, listener: socket.socket, device: DeviceRecord) -> None:
        from pmabench_drivers.mock import served

        self._served, self._asker = served.Served, served.Asker
        self._empty = served.EMPTY
        self._plant = self._served(device, RealClock())
        self._selector = selectors.DefaultSelector()
        self._listener = listener
        listener.setblocking(False)
        self._selector.register(listener, selectors.EVENT_READ)
        self._connections: list[_Connection] = []
        self._count = 0
        self._used = time.monotonic()
        self._ended: float | None = None
        self._plant.log.write("serve", pid=os.getpid(), device=device.name)

    def serve(self) -> None:
        """Serve until the plant is idle or has to end."""
        tick = time.monotonic()
        while not self._over():
            ready = self._selector.select(max(0.0, tick - time.monotonic()))
            for key, events in ready:
                if key.data is None:
                    self._accept()
                    continue
                if events & selectors.EVENT_WRITE:
                    self._send(key.data)
                if events & selectors.EVENT_READ:
                    self._receive(key.data)
            if (now := time.monotonic()) >= tick:
                self._plant.advance(now)
                self._watch_links(now)
                tick = max(tick + TICK, now)
        self._plant.log.write("end", pressure=self._plant.pressure)

    def _over(self) -> bool:
        if self._ended is None:
            return False
        return self._plant.pressure < self._empty or time.monotonic() - self._ended > LAST_WAIT

    def _end(self, why: str) -> None:
        if self._ended is None:
            self._plant.vent(why)
            self._ended = time.monotonic()

    def _watch_links(self, now: float) -> None:
        if self._due("lost"):
            for connection in [c for c in self._connections if c.asker.role != "control"]:
                self._drop(connection)
        if any(connection.asker.role == "client" for connection in self._connections):
            self._used = now
        elif now - self._used > self._plant.service.idle:
            self._end("idle")

    def _due(self, fault: str) -> bool:
        at = getattr(self._plant.faults, f"{fault}_at")
        return at is not None and at <= self._plant.now

    # -- connections ----------------------------------------------------------------------------------------------

    def _accept(self) -> None:
        with suppress(OSError):
            link, _ = self._listener.accept()
            link.setblocking(False)
            link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._count += 1
            connection = _Connection(link, self._asker(self._count))
            self._connections.append(connection)
            self._selector.register(link, selectors.EVENT_READ, connection)

    def _drop(self, connection: _Connection) -> None:
        if connection in self._connections:
            self._connections.remove(connection)
            self._selector.unregister(connection.link)
            connection.link.close()
            if connection.asker.role:
                self._plant.log.write("disconnect", **{"from": connection.asker.number, "pid": connection.asker.pid})

    def _receive(self, connection: _Connection) -> None:
        try:
            if not (piece := connection.link.recv(1 << 18)):
                self._drop(connection)
                return
            *lines, connection.inbox = (connection.inbox + piece).split(b"\n")
            for line in lines:
                self._hear(connection, decode(line))
            if len(connection.inbox) > LONGEST_LINE:
                self._drop(connection)
        except BlockingIOError:
            return
        except (OSError, ValueError):
            self._drop(connection)

    def _hear(self, connection: _Connection, question: dict[str, Any]) -> None:
        """Answer one request, unless a fault of the link is set or the request is past its time."""
        asker, payload, now = connection.asker, b"", time.monotonic()
        control = asker.role == "control" or question.get("role") == "control"
        if not control and self._due("lost"):
            self._drop(connection)
            return
        if not control and (
            self._due("dead") or (self._due("hang") and (asker.role or question.get("role")) == "client")
        ):
            return
        if not control:
            self._plant.hear(now)
        by = question.get("by")
        if isinstance(by, int | float) and now > by:
            self._plant.log.write("late", asked=question.get("do"), **{"from": asker.number, "pid": asker.pid})
            return
        self._plant.advance(now)
        try:
            answer, payload = self._answer(connection, question)
        except DeviceError as error:
            where = f"{error.device}.{error.channel}: " if error.channel else f"{error.device}: "
            answer = {"error": str(error).removeprefix(where), "channel": error.channel}
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            answer = {"error": f"cannot read the question {question.get('do')}: {type(error).__name__} {error}"}
        if control or not self._due("mute"):
            connection.out += encode({"n": question.get("n"), **answer}, payload)
            self._send(connection)

    def _send(self, connection: _Connection) -> None:
        try:
            sent = connection.link.send(connection.out)
            del connection.out[:sent]
        except BlockingIOError:
            pass
        except OSError:
            self._drop(connection)
            return
        if connection in self._connections:
            writes = selectors.EVENT_WRITE if connection.out else 0
            self._selector.modify(connection.link, selectors.EVENT_READ | writes, connection)

    # -- questions ------------------------------------------------------------------------------------------------

    def _answer(self, connection: _Connection, question: dict[str, Any]) -> tuple[dict[str, Any], bytes]:
        asker, do = connection.asker, question.get("do")
        name = self._plant.device.name
        if do == "hello":
            return self._hello(connection, question), b""
        if not asker.role:
            raise DeviceError(name, "the first question must be hello")
        if asker.role != "control":
            return self._plant.answer(asker, question)
        if do == "inject":
            self._plant.inject(question)
        elif do == "end":
            self._end("ended")
        elif do != "state":
            raise DeviceError(name, f'control takes inject, state and end, not "{do}"')
        return self._plant.state(), b""

    def _hello(self, connection: _Connection, question: dict[str, Any]) -> dict[str, Any]:
        asker, role = connection.asker, question.get("role")
        if role not in {"client", "rescue", "control"}:
            raise DeviceError(self._plant.device.name, f'role "{role}" is none of client, rescue, control')
        if self._ended is not None:
            raise DeviceError(self._plant.device.name, "the simulated plant is just ending; try again in a moment")
        if role != "control":
            self._serve_device(connection, question["device"])
            asker.zero = float(question["zero"])
        asker.role, asker.pid = role, int(question.get("pid", 0))
        self._used = time.monotonic()
        self._plant.log.write("connect", role=role, **{"from": asker.number, "pid": asker.pid})
        return {"identity": asdict(self._plant.identity)}

    def _serve_device(self, connection: _Connection, given: dict[str, Any]) -> None:
        """Take the client's device if it is a different one, no other client is connected and the muscle is empty."""
        plant = self._plant
        if given == json.loads(json.dumps(asdict(plant.device))):
            return
        others = any(c.asker.role in {"client", "rescue"} for c in self._connections if c is not connection)
        if others or plant.pressure > self._empty:
            why = "somebody uses it" if others else "its muscle is under pressure"
            other = f"another simulated bench is served at this address and {why}"
            raise DeviceError(plant.device.name, f"{other}; end that run, or give this bench another address")
        new = self._served(device_from(given), RealClock())
        plant.log.close()
        self._plant = new
        new.log.write("serve", pid=os.getpid(), device=new.device.name)


def main(arguments: list[str] | None = None) -> int:
    """Serve the device of standard input; returns the exit code."""
    parser = argparse.ArgumentParser(prog="pmabench_drivers.mock.server", description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--address", required=True, help="127.0.0.1:PORT")
    parser.add_argument("--detach", action="store_true", help="return when the plant is there; it lives on by itself")
    given = parser.parse_args(arguments)
    real_time(ENGINE)  # a real device does not wait for other programs either
    try:
        device = _read()
        listener = _listen(device, given.address)
        if given.detach:
            if os.fork():
                os._exit(0)  # the child reports errors on the same standard error, and closes it once it serves
            os.setsid()
        server = Server(listener, device)
        if given.detach:
            _let_go()
        with suppress(KeyboardInterrupt):
            server.serve()
    except PmaError as error:
        sys.stderr.write(f"{error}\n")
        return error.exit_code
    return 0


def _read() -> DeviceRecord:
    try:
        return device_from(json.load(sys.stdin))
    except (ValueError, TypeError, KeyError) as error:
        raise invalid("standard input", f"is no device record in JSON ({type(error).__name__}: {error})") from error


def _listen(device: DeviceRecord, address: str) -> socket.socket:
    listener = socket.socket()
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind(parse_address(device.name, address))
        listener.listen()
    except OSError as error:
        raise DeviceError(device.name, f"cannot serve at {address}: {error.strerror}") from error
    return listener


def _let_go() -> None:
    """Detach from the terminal and pipes of the program that started this one."""
    empty = os.open(os.devnull, os.O_RDWR)
    for descriptor in (0, 1, 2):
        os.dup2(empty, descriptor)
    os.close(empty)
    os.chdir("/")


if __name__ == "__main__":
    sys.exit(main())
