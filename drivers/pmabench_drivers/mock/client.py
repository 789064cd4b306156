"""The driver `mock-realtime`: the device interface to the plant's own process, and their protocol.

A message is one line of JSON, ended by a line feed, followed by as many raw bytes as its key `bytes` says (none
without it). The client sends `{"n": 7, "by": 1234.5, "do": "write", "output": "pressure", "value": 3276.0}`: `n`
counts its requests, `by` is the moment on CLOCK_MONOTONIC [s] after which it stops waiting, so that the server must
no longer carry it out. The server answers `{"n": 7, ...}`, or `{"n": 7, "error": "sentence", "channel": ""}`.
Answers to older requests are ignored. `pmabench_drivers.mock.server` lists the requests. Standard library only.
"""

from __future__ import annotations

import json
import os
import socket
import sys
import time
from array import array
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, TypeVar

from pmabench.base.clock import Clock, RealClock
from pmabench.base.errors import DeviceError
from pmabench.bench.interface import Block, DeviceRecord, Identity, Load, Segment
from pmabench_drivers.mock.options import Options, output_of, read_realtime
from pmabench_drivers.shared.device import Driver

LONGEST_LINE, LONGEST = 1 << 20, 1 << 26
"""Longest line, and most raw bytes after it."""
Message = tuple[dict[str, Any], bytes]
Answer = TypeVar("Answer")
PATIENCE = 0.18
"""Longest wait for an answer [s]: a little less than the caller waits for a call."""
OPEN_WITHIN = 1.5
"""The same for `open`: its process may just have started."""
START_WITHIN = 5.0
"""Longest time until a new process answers [s]."""


def encode(message: Mapping[str, Any], payload: bytes = b"") -> bytes:
    """One message as bytes."""
    head = {**message, "bytes": len(payload)} if payload else message
    return json.dumps(head, separators=(",", ":")).encode() + b"\n" + payload


def decode(line: bytes) -> dict[str, Any]:
    """The JSON object of one message; raises ValueError for anything else."""
    message = json.loads(line)
    if not isinstance(message, dict):
        raise ValueError("a message is no JSON object")
    size = message.get("bytes", 0)
    if not isinstance(size, int) or not 0 <= size <= LONGEST:
        raise ValueError(f"a message of {size} bytes")
    return message


def parse_address(device: str, address: str) -> tuple[str, int]:
    """Host and port of `127.0.0.1:PORT`; only addresses of this machine are allowed."""
    host, _, port = address.rpartition(":")
    if host not in {"127.0.0.1", "localhost"} or not port.isdigit() or not 0 < int(port) < 65536:
        raise DeviceError(device, f'address "{address}": 127.0.0.1:PORT is expected, with a port from 1 to 65535')
    return "127.0.0.1", int(port)


class Link:
    """One connection to the server at `address`; raises OSError if none listens there within `timeout` [s]."""

    def __init__(self, device: str, address: tuple[str, int], timeout: float) -> None:
        self._device = device
        self._socket = socket.create_connection(address, timeout)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._bytes = bytearray()
        self._number = 0

    def ask(self, do: str, by: float, **fields: Any) -> Message:
        """Send one request and wait for its answer until the moment `by` [s, CLOCK_MONOTONIC].

        Raises
        ------
        DeviceError
            If the request was refused; the connection can still be used.
        OSError, ValueError
            If no answer came in time (TimeoutError) or the connection was lost; it must be closed.
        """
        self._number += 1
        self._socket.settimeout(max(by - time.monotonic(), 1e-3))
        self._socket.sendall(encode({"n": self._number, "by": by, "do": do, **fields}))
        answer: dict[str, Any] = {}
        while answer.get("n") != self._number:
            while (end := self._bytes.find(b"\n") + 1) == 0:
                self._receive(by)
            answer = decode(bytes(self._bytes[:end]))
            size = answer.get("bytes", 0)
            while len(self._bytes) < end + size:
                self._receive(by)
            payload = bytes(self._bytes[end : end + size])
            del self._bytes[: end + size]
        if "error" in answer:
            raise DeviceError(self._device, str(answer["error"]), str(answer.get("channel", "")))
        return answer, payload

    def _receive(self, by: float) -> None:
        if (left := by - time.monotonic()) <= 0:
            raise TimeoutError
        if len(self._bytes) > LONGEST_LINE + LONGEST:
            raise ValueError("a message is longer than any that is sent")
        self._socket.settimeout(left)
        if not (piece := self._socket.recv(1 << 18)):
            raise ConnectionResetError("the other side has closed the connection")
        self._bytes += piece

    def close(self) -> None:
        """Close the connection; may be called again, also from another thread."""
        with suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()


class MockClient(Driver[Link]):
    """A bench whose simulated plant runs in real time in a separate process (`pmabench_drivers.mock.server`).

    Channels, outputs, dump valve, digital input and options are those of the driver `mock`
    (`pmabench_drivers.mock.MockBench`), with `pmabench_drivers.mock.options.Service`. The address is
    `127.0.0.1:PORT`; `open` starts the process if none listens there, unless `start` is false. It has a watchdog
    and a second connection to its outputs. Needs a clock in real time. If an answer is late the connection closes, so
    that it can never be taken for a later one; the next call makes a new one.
    """

    verified = "a simulation"
    read_options = staticmethod(read_realtime)
    _options: Options

    def __init__(self, device: DeviceRecord, clock: Clock) -> None:
        if not isinstance(clock, RealClock):
            raise DeviceError(device.name, 'the driver mock-realtime needs a bench with "time: real"')
        super().__init__(device, clock)
        self._service = self._options.service
        if self._service.log:
            log = str(Path(self._service.log).absolute())
            self._device = replace(device, options={**device.options, "log": log})
        self._address = parse_address(device.name, device.address)
        self._valves = {valve.output for valve in device.valves}
        self._is_open = False

    # -- life -----------------------------------------------------------------------------------------------------

    def open(self) -> Identity:
        """Connect to the plant, and start it first if none listens; commands nothing."""
        self.close()
        try:
            link, identity = self._connect("client", time.monotonic() + OPEN_WITHIN)
        except ConnectionRefusedError as refused:
            if not self._service.start:
                where = ":".join(map(str, self._address))
                raise self._error(f"nobody listens at {where}") from refused
            self._start_process()
            link, identity = self._try(lambda: self._connect("client", time.monotonic() + START_WITHIN))
        except (OSError, ValueError) as error:
            raise self._failure(error) from error
        self._link, self._is_open = link, True
        return identity

    def close(self) -> None:
        """Disconnect from the plant, which stays as it is; may be called again."""
        self._is_open = False
        self._hang_up()

    def _connect(self, role: str, by: float) -> tuple[Link, Identity]:
        link = Link(self._device.name, self._address, max(by - time.monotonic(), 1e-3))
        try:
            zero = self._clock.start if isinstance(self._clock, RealClock) else 0.0
            answer, _ = link.ask("hello", by, role=role, pid=os.getpid(), zero=zero, device=asdict(self._device))
        except BaseException:
            link.close()
            raise
        return link, Identity(**answer["identity"])

    def _start_process(self) -> None:
        """Start the server in a new session; returns once the plant is ready, or raises the server's error."""
        import subprocess

        server = "pmabench_drivers.mock.server"
        command = [sys.executable, "-P", "-m", server, "--address", self._device.address, "--detach"]
        with subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, start_new_session=True
        ) as process:
            try:
                _, said = process.communicate(json.dumps(asdict(self._device)).encode(), START_WITHIN)
            except subprocess.TimeoutExpired as error:
                process.kill()
                raise self._error(f"its process did not start in {START_WITHIN:g} s") from error
        message = said.decode(errors="replace").strip()
        if message and "cannot serve at" not in message:  # another program may have started it at the same moment
            raise self._error(message.splitlines()[-1].removeprefix(f"{self._device.name}: "))

    # -- questions ------------------------------------------------------------------------------------------------

    def _ask(self, do: str, **fields: Any) -> Message:
        if not self._is_open:
            raise self._error("is not open")
        by = time.monotonic() + PATIENCE

        def ask() -> Message:
            if self._link is None:
                self._link, _ = self._connect("client", by)
            return self._link.ask(do, by, **fields)

        try:
            return self._try(ask)
        except DeviceError as error:
            if error.__cause__ is not None:
                self._hang_up()
            raise

    def _try(self, act: Callable[[], Answer]) -> Answer:
        """The result of `act`; a failure of the link is raised as DeviceError with its cause."""
        try:
            return act()
        except (OSError, ValueError) as error:
            raise self._failure(error) from error

    def _failure(self, error: Exception) -> DeviceError:
        if isinstance(error, TimeoutError):
            return self._error("did not answer in time")
        if isinstance(error, OSError):
            return self._error(f"link lost ({error.strerror or error})")
        return self._error(f"answered what cannot be read ({error})")

    def _value(self, do: str, **fields: Any) -> Any:
        return self._ask(do, **fields)[0].get("value")

    # -- stream ---------------------------------------------------------------------------------------------------

    def start(self, rate: float) -> float:
        """Start sampling: sample 0 is taken now, sample k at k / rate later; any rate above 0 [Hz] is kept exactly."""
        return float(self._value("start", rate=rate))

    def collect(self) -> Block:
        """All samples due by now and not yet collected."""
        answer, payload = self._ask("collect")
        host = round(self._clock.now() * 1e9)
        size = 8 * int(answer["rows"])
        parts = [payload[first : first + size] for first in range(0, len(payload), size)] if size else []
        moments = array("q", parts[0] if parts else b"")
        columns = [array("d", part) for part in parts[1:]] or [array("d")] * len(answer["columns"])
        if sys.byteorder == "big":
            moments.byteswap()
            for column in columns:
                column.byteswap()
        return Block(moments, dict(zip(answer["columns"], columns, strict=True)), host)

    def stop(self) -> None:
        """Stop sampling; may be called again."""
        if self._is_open:
            self._ask("stop")

    # -- outputs --------------------------------------------------------------------------------------------------

    def write(self, output: str, value: float) -> None:
        """Command a value [device units] at once; never retried."""
        output_of(self._device, output, value)
        self._ask("write", output=output, value=value)

    def read_back(self, output: str) -> float:
        """Present set-point [device units]."""
        output_of(self._device, output)
        return float(self._value("read_back", output=output))

    def follow(self, output: str, segment: Segment) -> None:
        """Follow a ramp or a sine from its start, or from now if that has passed."""
        output_of(self._device, output, *(value for value in asdict(segment).values() if not isinstance(value, str)))
        self._ask("follow", output=output, segment=asdict(segment))

    def halt(self, output: str) -> None:
        """Stop and hold: the actuator at its place, the regulator at its set-point."""
        output_of(self._device, output)
        self._ask("halt", output=output)

    def place(self, load: Load) -> None:
        """Put `load` on the free end; no effect if an actuator holds it."""
        self._ask("place", force=load.force, mass=load.mass)

    def switch(self, output: str, *, on: bool) -> None:
        """Energise the dump valve, which closes it, or not; never retried."""
        self._ask("switch", output=output, on=on)

    def is_on(self, output: str) -> bool:
        """Whether the dump valve is energised."""
        return bool(self._value("is_on", output=output))

    def level(self, name: str) -> bool:
        """Whether the digital input is high."""
        return bool(self._value("level", name=name))

    # -- watchdog and second way ----------------------------------------------------------------------------------

    def arm_watchdog(self, seconds: float) -> float:
        """Arm it; returns the time that the device will wait [s], in steps of 10 ms."""
        return float(self._value("arm", seconds=seconds))

    def feed_watchdog(self) -> None:
        """Feed the watchdog, as any request does; raises DeviceError if it has already vented."""
        self._ask("feed")

    def disarm_watchdog(self) -> None:
        """Disarm it; outputs stay as they are."""
        self._ask("disarm")

    def held(self) -> Mapping[str, float | str]:
        """Its watchdog [s], 0 if it is off or has vented, and the uptime of the simulated device [s]."""
        return {str(name): value for name, value in self._value("held").items()}

    def rescue(self, output: str, value: float) -> None:
        """Command `value` [device units; 0 and 1 for the valve] over a separate connection; no retry."""
        if output not in self._valves:
            output_of(self._device, output, value)
        by = time.monotonic() + PATIENCE

        def act() -> None:
            link, _ = self._connect("rescue", by)
            try:
                link.ask("rescue", by, output=output, value=value)
            finally:
                link.close()

        self._try(act)
