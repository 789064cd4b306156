"""The device interface in front of a serial indicator: one thread reads lines, polled or as they come."""

from __future__ import annotations

from time import monotonic

from pmabench.base.clock import Clock
from pmabench.base.errors import DeviceError
from pmabench.bench.interface import COMPUTER, EMULATED, Block, DeviceRecord, Identity
from pmabench_drivers.serial_ascii.lines import LineReader, Options, read_options
from pmabench_drivers.shared.device import Polled
from pmabench_drivers.shared.link import opened
from pmabench_drivers.shared.polling import JOIN
from pmabench_drivers.shared.serial_port import LONGEST_LINE, PIECE, SerialPort, Splitter, Unreadable, Wrong, readable

OPEN = 1.5
"""How long `open` waits for a first line that can be read [s]."""
PATIENCE = 0.5
"""So long [s], and at least three lines, nothing readable may come before `collect` says so."""


class SerialIndicator(Polled):
    """An indicator that sends text: `options` give the poll string (or none), the pattern of a line, and the rate.

    Each named group of the pattern is an input; `unit` and `status` are checked in every line.
    """

    emulator = "pmabench_drivers.serial_ascii.emulator"
    read_options = staticmethod(read_options)
    _options: Options

    def __init__(self, device: DeviceRecord, clock: Clock) -> None:
        super().__init__(device, clock)
        self._reader = LineReader(self._options, device.channels)
        self._port: SerialPort | None = None
        self._splitter = Splitter(self._options.terminator)
        self._heard = 0.0
        self._late_until = 0.0
        self._rate = self._options.rate
        self._problem = ""
        self._failure: DeviceError | None = None

    def open(self) -> Identity:
        """Open the port for this program alone and wait for one line that can be read."""
        self.close()
        options = self._options
        settings = {"bytesize": options.data_bits, "parity": options.parity, "stopbits": options.stop_bits}
        self._port = SerialPort(self._device.name, self._device.address, options.baud, self._clock, **settings)
        with self._closed_on_error():
            model = self._ask_identity()
            self._first_line()
        simulated = model.startswith(EMULATED)
        return Identity("", model or "serial ASCII indicator", "", "", simulated=simulated, clock=COMPUTER)

    def close(self) -> None:
        """End reading and let go of the port."""
        self._cycle.stop(JOIN)
        port, self._port = self._port, None
        if port is not None:
            port.close()

    def start(self, rate: float) -> float:
        """Poll at `rate` [Hz] or the highest that the options allow; one that sends by itself keeps its own rate."""
        self._refuse_rate(rate)
        port = self._opened()
        self.stop()
        self._samples.take()
        self._failure, self._problem, self._heard = None, "", monotonic()
        if self._options.poll:
            self._rate = min(rate, self._options.rate)
            self._cycle.start(self._rate)
        else:
            self._rate, self._splitter = self._options.rate, Splitter(self._options.terminator)
            port.listen(self._listen)
        return self._rate

    def collect(self) -> Block:
        """What came since the last call; an error for a wrong unit, a fault that it reports, or silence."""
        port = self._opened()
        if self._failure is not None:
            raise self._failure
        if port.gone:
            raise self._error(port.gone)
        if (self._cycle.running or port.listening) and monotonic() - self._heard > max(PATIENCE, 3 / self._rate):
            last = f"; the last thing heard was {self._problem}" if self._problem else ""
            raise self._error(f"no line that can be read for {PATIENCE:g} s{last}")
        return super().collect()

    def stop(self) -> None:
        """End reading; two threads would take each other's bytes."""
        self._cycle.stop(JOIN)
        if self._port is not None:
            self._port.hush()

    # -- polled ---------------------------------------------------------------------------------------------------

    def _tick(self) -> None:
        """Ask once and take the one line that answers; after a lost answer nothing is asked until it cannot come."""
        if self._failure is not None:
            return
        try:
            if self._opened().drain() and self._late_until:
                self._late_until = 0.0  # the late answer has come, and is dropped
            if monotonic() < self._late_until:
                return
            asked = self._clock.now()
            lines, rest = self._exchange(self._options.poll, self._options.timeout)
        except DeviceError as error:
            self._failure = error
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
        """Send, and collect until a line is whole: the lines, and what is behind them."""
        port, terminator = self._opened(), self._options.terminator
        port.send(question)
        data = port.receive(lambda got: terminator in got or len(got) > LONGEST_LINE, timeout)
        *lines, rest = data.split(terminator)
        return lines, rest

    # -- as they come ---------------------------------------------------------------------------------------------

    def _listen(self, data: bytes, now: float) -> None:
        """Bytes that came at `now` [s, bench time], on the port's thread."""
        if self._failure is not None:
            return
        wire, lines = 10.0 / self._options.baud, self._splitter.feed(data)
        for index, line in enumerate(lines):
            waiting = (len(lines) - 1 - index) / self._rate  # it has waited in a buffer for the ones after it
            self._take(line, now - waiting - len(line) * wire, now)

    # -- both -----------------------------------------------------------------------------------------------------

    def _take(self, line: bytes, time: float, host: float) -> None:
        try:
            values = self._reader.values(line)
        except Wrong as error:
            self._failure = self._error(str(error))
            return
        except Unreadable as error:
            self._problem = str(error)
            return
        self._heard = monotonic()
        self._samples.append(round(time * 1e9), values, round(host * 1e9))

    def _ask_identity(self) -> str:
        if not self._options.ask_identity:
            return ""
        self._opened().drain()
        lines, _rest = self._exchange(self._options.ask_identity, OPEN / 3)
        if not lines:
            raise self._error("did not answer who it is")
        return readable(lines[0]).strip()

    def _first_line(self) -> None:
        """Prove that a line can be read; its sample is dropped."""
        options, port, deadline, last = self._options, self._opened(), monotonic() + OPEN, ""
        splitter = Splitter(options.terminator)
        try:
            while monotonic() < deadline:
                if options.poll:
                    port.drain()
                    lines, rest = self._exchange(options.poll, options.timeout)
                else:
                    rest = port.receive(bool, PIECE)
                    lines = splitter.feed(rest)
                last = f'; it sent "{readable(rest)}"' if rest and not lines else last
                for line in lines:
                    try:
                        self._reader.values(line)
                        return
                    except Unreadable:
                        last = f'; it sent "{readable(line)}", which is not what the pattern says'
        except Wrong as error:
            raise self._error(str(error)) from None
        raise self._error(f"sent no line that can be read within {OPEN:g} s{last}")

    def _opened(self) -> SerialPort:
        return opened(self._port, self._device.name)
