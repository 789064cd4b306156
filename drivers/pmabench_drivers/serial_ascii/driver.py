"""The device interface in front of a serial indicator: one thread reads lines, polled or as they come."""

from __future__ import annotations

import math
import threading
from collections.abc import Iterable
from time import monotonic
from typing import TYPE_CHECKING, Any

from pmabench.base.clock import Clock
from pmabench.base.errors import DeviceError
from pmabench.bench.interface import COMPUTER, EMULATED, Block, DeviceRecord, Identity
from pmabench_drivers.options import Place, Reader
from pmabench_drivers.polling import JOIN, Cycle, Samples
from pmabench_drivers.serial_ascii.lines import LineReader, Splitter, Unreadable, Wrong
from pmabench_drivers.serial_ascii.options import read_options
from pmabench_drivers.serial_ascii.pattern import LONGEST_LINE, readable
from pmabench_drivers.serial_port import hand_over

if TYPE_CHECKING:
    from serial import Serial

PIECE = 0.02
"""Longest single wait for bytes [s]."""
OPEN = 1.5
"""How long `open` waits for a first line that can be read [s]."""
PATIENCE = 0.5
"""So long [s], and at least three lines, nothing readable may come before `collect` says so."""


class SerialIndicator:
    """An indicator that sends text: `options` give the poll string (or none), the pattern of a line, and the rate.

    Each named group of the pattern is an input; `unit` and `status` are checked in every line.
    """

    emulator = "pmabench_drivers.emulator.indicator"

    def __init__(self, device: DeviceRecord, clock: Clock) -> None:
        reader = Reader()
        self._options = read_options(device, reader)
        reader.refuse(device.name)
        self._device, self._clock = device, clock
        self._reader = LineReader(self._options, device.channels)
        self._samples = Samples([channel.name for channel in device.channels])
        self._cycle = Cycle(f"serial {device.name}", self._poll, clock)
        self._halt = threading.Event()
        self._thread: threading.Thread | None = None
        self._port: Serial | None = None
        self._heard = 0.0
        self._late_until = 0.0
        self._rate = self._options.rate
        self._problem = ""
        self._failure: DeviceError | None = None

    @classmethod
    def check(cls, device: DeviceRecord) -> Iterable[tuple[Place, str]]:
        """What is wrong with the options, each with its place; touches no device."""
        reader = Reader()
        read_options(device, reader)
        return reader.problems

    @classmethod
    def fastest(cls, device: DeviceRecord) -> float:
        """Highest rate at which it is polled, or the one at which it sends by itself [Hz]."""
        return read_options(device, Reader()).rate

    def open(self) -> Identity:
        """Open the port for this program alone and wait for one line that can be read."""
        self.close()
        import serial

        options = self._options
        try:
            self._port = serial.Serial(
                self._device.address,
                baudrate=options.baud,
                bytesize=options.data_bits,
                parity=options.parity,
                stopbits=options.stop_bits,
                timeout=PIECE,
                exclusive=True,
            )
        except (OSError, ValueError) as error:
            busy = "temporarily unavailable" in str(error) or "exclusively lock" in str(error)
            why = "another program has it open" if busy else getattr(error, "strerror", None) or str(error)
            raise DeviceError(self._device.name, f"cannot open {self._device.address}: {why}") from None
        try:
            model = self._ask_identity()
            self._first_line()
        except DeviceError:
            self.close()
            raise
        return Identity(
            "", model or "serial ASCII indicator", "", "", simulated=model.startswith(EMULATED), clock=COMPUTER
        )

    def close(self) -> None:
        """End reading and let go of the port."""
        self.stop()
        port, self._port = self._port, None
        if port is not None:
            port.close()

    def start(self, rate: float) -> float:
        """Poll at `rate` [Hz] or the highest that the options allow; one that sends by itself keeps its own rate."""
        if not 0 < rate < math.inf:
            raise DeviceError(self._device.name, f"cannot sample at {rate} Hz")
        self._opened()
        self.stop()
        self._samples.take()
        self._failure, self._problem, self._heard = None, "", monotonic()
        if self._options.poll:
            self._rate = min(rate, self._options.rate)
            self._cycle.start(self._rate)
        else:
            self._rate, self._halt = self._options.rate, threading.Event()
            name = f"serial {self._device.name}"
            self._thread = threading.Thread(target=self._listen, args=(self._halt,), name=name, daemon=True)
            self._thread.start()
        return self._rate

    def collect(self) -> Block:
        """What came since the last call; an error for a wrong unit, a fault that the indicator tells, or silence."""
        if self._failure is not None:
            raise self._failure
        if self._cycle.broken is not None:
            raise DeviceError(self._device.name, f"polling broke off: {self._cycle.broken}")
        if self._streaming and monotonic() - self._heard > max(PATIENCE, 3 / self._rate):
            last = f"; the last thing heard was {self._problem}" if self._problem else ""
            raise DeviceError(self._device.name, f"no line that can be read for {PATIENCE:g} s{last}")
        return self._samples.take()

    def stop(self) -> None:
        """End reading; two threads would take each other's bytes."""
        self._cycle.stop(JOIN)
        self._halt.set()
        thread, self._thread = self._thread, None
        if thread is not None:
            thread.join(JOIN)

    @property
    def missed(self) -> int:
        """Polls that fell out because the indicator or the machine was late."""
        return self._cycle.missed

    @property
    def _streaming(self) -> bool:
        return self._cycle.running or self._thread is not None

    # -- polled ---------------------------------------------------------------------------------------------------

    def _poll(self) -> None:
        """Ask once and take the one line that answers; after a lost answer nothing is asked until it cannot come."""
        if self._failure is not None:
            return
        try:
            if self._drain() and self._late_until:
                self._late_until = 0.0  # the late answer has come, and is dropped
            if monotonic() < self._late_until:
                return
            asked = self._clock.now()
            lines, rest = self._exchange(self._options.poll, self._options.timeout)
        except (OSError, TypeError) as error:
            self._lose(error)
            return
        answered = self._clock.now()
        if not lines:
            self._late_until = monotonic() + self._options.slowest
            self._problem = f'"{readable(rest)}" without its end' if rest else "silence"
        elif len(lines) > 1 or rest:
            self._problem = f'more than one answer at a time, from "{readable(lines[0])}" on'
        else:
            self._take(lines[0], (asked + answered) / 2, answered)

    def _exchange(self, question: bytes, timeout: float) -> tuple[list[bytes], bytes]:
        """Send, and collect until a line is whole: the lines, and what stands behind them."""
        port, terminator = self._opened(), self._options.terminator
        deadline = monotonic() + timeout
        hand_over(port, question, timeout)
        data = b""
        while terminator not in data and len(data) <= LONGEST_LINE and monotonic() < deadline:
            data += port.read(1)
            data += port.read(port.in_waiting)
        *lines, rest = data.split(terminator)
        return lines, rest

    def _drain(self) -> bytes:
        port = self._opened()
        waiting = port.in_waiting
        return bytes(port.read(waiting)) if waiting else b""

    # -- as they come ---------------------------------------------------------------------------------------------

    def _listen(self, halt: threading.Event) -> None:
        splitter, wire = Splitter(self._options.terminator), 10.0 / self._options.baud
        while not halt.is_set() and self._failure is None:
            try:
                port = self._opened()
                data = port.read(1)
                data += port.read(port.in_waiting)
            except (OSError, TypeError, DeviceError) as error:
                if not halt.is_set():
                    self._lose(error)
                return
            now = self._clock.now()
            lines = splitter.feed(data)
            for index, line in enumerate(lines):
                waiting = (len(lines) - 1 - index) / self._rate  # it has waited in a buffer for the ones after it
                self._take(line, now - waiting - len(line) * wire, now)

    # -- both -----------------------------------------------------------------------------------------------------

    def _take(self, line: bytes, time: float, host: float) -> None:
        try:
            values = self._reader.values(line)
        except Wrong as error:
            self._failure = DeviceError(self._device.name, str(error))
            return
        except Unreadable as error:
            self._problem = str(error)
            return
        self._heard = monotonic()
        self._samples.append(round(time * 1e9), values, round(host * 1e9))

    def _lose(self, error: Exception) -> None:
        if "timeout" in str(error).lower():
            self._problem = "a port that takes nothing"
            return
        self._failure = DeviceError(self._device.name, f"lost {self._device.address}: {_strerror(error)}")

    def _ask_identity(self) -> str:
        if not self._options.ask_identity:
            return ""
        try:
            self._drain()
            lines, _rest = self._exchange(self._options.ask_identity, OPEN / 3)
        except (OSError, TypeError) as error:
            raise DeviceError(self._device.name, f"lost {self._device.address}: {_strerror(error)}") from None
        if not lines:
            raise DeviceError(self._device.name, "did not answer who it is")
        return readable(lines[0]).strip()

    def _first_line(self) -> None:
        """Prove that a line can be read; its sample is dropped."""
        options, deadline, last = self._options, monotonic() + OPEN, ""
        splitter = Splitter(options.terminator)
        try:
            while monotonic() < deadline:
                if options.poll:
                    self._drain()
                    lines, rest = self._exchange(options.poll, options.timeout)
                    last = f'; it sent "{readable(rest)}"' if rest else last
                else:
                    port = self._opened()
                    data = port.read(1) + port.read(port.in_waiting)
                    lines = splitter.feed(data)
                    last = f'; it sent "{readable(data)}"' if data and not lines else last
                for line in lines:
                    try:
                        self._reader.values(line)
                        return
                    except Unreadable:
                        last = f'; it sent "{readable(line)}", which is not what the pattern says'
        except Wrong as error:
            raise DeviceError(self._device.name, str(error)) from None
        except (OSError, TypeError) as error:
            raise DeviceError(self._device.name, f"lost {self._device.address}: {_strerror(error)}") from None
        raise DeviceError(self._device.name, f"sent no line that can be read within {OPEN:g} s{last}")

    def _opened(self) -> Any:
        port = self._port
        if port is None:
            raise DeviceError(self._device.name, "is not open")
        return port


def _strerror(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error)
