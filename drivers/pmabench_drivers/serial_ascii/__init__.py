"""Indicators that send text lines over a serial port: load cells, gauges, displays.

Here: options, bounded parsing of a line, the device interface; `emulator`: an indicator on a pseudo-terminal.

A regular expression can take longer than the age of the universe on a line of 100 characters. To keep the work for one
line bounded, a pattern may repeat only single characters and classes, never groups, and only few repetitions may match
the same characters: n of them can divide a run of r characters in about r^n / n! ways.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations
from time import monotonic
from typing import Any

from pmabench.base.clock import Clock
from pmabench.base.errors import DeviceError
from pmabench.bench.interface import COMPUTER, Block, ChannelRecord, DeviceRecord, Identity
from pmabench_drivers.shared import serial_port as sp
from pmabench_drivers.shared.device import Polled
from pmabench_drivers.shared.link import JOIN, Flow, who
from pmabench_drivers.shared.options import BAUDS, PARITIES, Place, Reader, option

LONGEST_PATTERN = 300
MOST_SHARED = 3
"""Four repetitions that match the same characters: 120^4 / 24 steps at worst, some 0.3 s."""
NOT_INPUTS = ("sign", "unit", "status")
"""Named groups that are no measured value."""

_TOKEN = re.compile(
    r"(?P<atom>\\[dDwWsS]|\\[^A-Za-z0-9]|\\[trn]|\[\^?\]?(?:\\.|[^\]\\])*\]|[^\\\[\](){}*+?|^$])"
    r"|(?P<open>\((?:\?:|\?P<[A-Za-z_]\w*>)?(?!\?))"
    r"|(?P<close>\))|(?P<bar>\|)|(?P<anchor>[\^$])"
)
_QUANTIFIER = re.compile(r"(?:[*+?]|\{(\d{0,3})(,?)(\d{0,3})\})\??")
_PRINTABLE = [chr(code) for code in (9, 10, 13, *range(32, 127))]
_NUMBER = re.compile(r"([+-]?)\s*(\d{1,40}(?:\.\d{0,40})?|\.\d{1,40})", re.ASCII)
EMULATED_LINE = "%.3f\r"
_EMULATED = re.compile(r"[^%]*%[+\- 0]*\d{0,2}(?:\.\d{1,2})?f[^%]*")


def pattern_problem(pattern: str) -> str:
    """Why a pattern cannot be used; empty if it can."""
    if len(pattern) > LONGEST_PATTERN:
        return f"is longer than {LONGEST_PATTERN} characters"
    variable: list[frozenset[str]] = []
    position = 0
    while position < len(pattern):
        if (token := _TOKEN.match(pattern, position)) is None:
            known = "characters, [classes], \\d \\w \\s, groups, | and repetitions are understood"
            begins = pattern[position : position + 12]
            return f'cannot be used from "{begins}" on; {known}, references and looks around are not'
        position = token.end()
        if (times := _QUANTIFIER.match(pattern, position)) is None:
            continue
        position = times.end()
        if token["atom"] is None:
            if times[0] == "?" and token["close"]:
                continue
            return f'repeats a group ("{pattern[max(0, token.start() - 8) : position]}"); repeat single characters only'
        if times[0][0] == "{" and not times[2]:
            continue
        atom = re.compile(token["atom"])
        variable.append(frozenset(char for char in _PRINTABLE if atom.fullmatch(char)))
    try:
        compiled = re.compile(pattern)
    except (re.error, OverflowError, RecursionError) as error:
        return f"is no regular expression: {error}"
    if _shared(variable) > MOST_SHARED:
        return "has too many repetitions of the same characters; use narrower classes or fixed numbers, as \\d{3}"
    if not inputs_of(compiled):
        return 'names no value; write "(?P<value>...)" around the number'
    if "sign" in compiled.groupindex and len(inputs_of(compiled)) != 1:
        return 'has a group "sign", which needs exactly one value next to it'
    return ""


def _shared(sets: list[frozenset[str]]) -> int:
    """Number of repetitions that share characters with others, minus one for each set of them."""
    bunch = list(range(len(sets)))
    for a, b in combinations(range(len(sets)), 2):
        if sets[a] & sets[b]:
            bunch = [bunch[a] if item == bunch[b] else item for item in bunch]
    return len(sets) - len(set(bunch))


def inputs_of(pattern: re.Pattern[str]) -> list[str]:
    """Named groups that are measured values."""
    return [name for name in pattern.groupindex if name not in NOT_INPUTS]


def number(text: str, sign: str = "") -> float:
    """A decimal number, spaces after its sign allowed; raises ValueError for anything else."""
    found = _NUMBER.fullmatch(text.strip())
    if found is None or (sign and found[1]):
        raise ValueError(f'"{text[:40]}" is no number')
    return float(f"{sign.strip() or found[1]}{found[2]}")


def _pattern(reader: Reader, given: Mapping[str, Any], key: str, place: Place) -> re.Pattern[str]:
    text = reader.text(given, key, place, longest=1000)
    if problem := pattern_problem(text) if text else "":
        reader.fault((*place, key), problem)
    return re.compile(text if text and not problem else "(?P<value>.*)")


def _bytes(reader: Reader, given: Mapping[str, Any], key: str, place: Place, default: str = "") -> bytes:
    text = reader.text(given, key, place, default, longest=40)
    try:
        return text.encode("ascii")
    except UnicodeEncodeError:
        reader.fault((*place, key), "only ASCII characters go over the wire")
        return b""


def _meanings(reader: Reader, given: Mapping[str, Any], key: str, place: Place) -> Mapping[str, str]:
    items = given.get(key, {})
    if isinstance(items, Mapping) and all(isinstance(item, str) for item in items.values()):
        return dict(items)
    reader.fault((*place, key), "texts and what they mean are expected")
    return {}


def _line(reader: Reader, given: Mapping[str, Any], key: str, place: Place) -> str:
    line = reader.text(given, key, place, EMULATED_LINE)
    if _EMULATED.fullmatch(line):
        return line
    reader.fault((*place, key), 'a line with one number as printf writes it is expected, as "%+8.2f N\\r"')
    return EMULATED_LINE


@dataclass(frozen=True)
class Options:
    """Options of the driver `serial-ascii` for an indicator; times in s, rates in Hz."""

    pattern: re.Pattern[str] = option(_pattern)
    baud: int = option(Reader.one_of, BAUDS, 9600)
    data_bits: int = option(Reader.whole, 7, 8, 8)
    parity: str = option(Reader.mapped, PARITIES, "none")
    stop_bits: int = option(Reader.whole, 1, 2, 1)
    poll: bytes = option(_bytes)
    """Request for one line; empty if the indicator sends by itself."""
    terminator: bytes = option(_bytes, "\r")
    timeout: float = option(Reader.quantity, "time", 0.15, 0.005, 0.18)
    slowest: float = option(Reader.quantity, "time", 0.5, 0.0, 10.0)
    """Longest time after which a requested line may still arrive [s]."""
    rate: float = option(Reader.quantity, "frequency", 10.0, 0.1, 2000.0)
    """Lines a second: highest polling rate, or rate at which it sends by itself."""
    unit: str = option(Reader.text, longest=20)
    """Unit as the indicator writes it; empty: as in the bench."""
    good_status: tuple[str, ...] = option(Reader.texts)
    over_range: tuple[str, ...] = option(Reader.texts, ("OL", "------"))
    errors: Mapping[str, str] = option(_meanings)
    """Lines that report a fault -> meaning."""
    ask_identity: bytes = option(_bytes)
    emulate: str = option(_line)
    """For the emulator: printf format of a line."""


def read_options(device: DeviceRecord, reader: Reader) -> Options:
    """Options of a device; also checks the inputs that its channels use."""
    options, given = reader.options(Options, device.options, ("options",), needed=("pattern", "rate"))
    reader.port(device, "/dev/ttyUSB0")
    if not options.terminator:
        reader.fault(("options", "terminator"), "what ends a line is expected")
    if options.good_status and "status" not in options.pattern.groupindex:
        reader.fault(("options", "good_status"), 'the pattern has no group "status"')
    _channels(device, options, reader, known=options.pattern.pattern == given.get("pattern"))
    return options


def _channels(device: DeviceRecord, options: Options, reader: Reader, *, known: bool) -> None:
    reader.measures_only(device, "an indicator")
    inputs = inputs_of(options.pattern)
    for channel in device.channels:
        if known:
            reader.known(("channels", channel.name, "input"), "the pattern has no group", channel.input, inputs)
    units = {channel.raw_unit for channel in device.channels}
    if "unit" in options.pattern.groupindex and not options.unit and len(units) > 1:
        reader.fault(("options", "pattern"), f"a line has one unit, and the channels have {', '.join(sorted(units))}")


class LineReader:
    """Parses one line for the channels of a device."""

    def __init__(self, options: Options, channels: tuple[ChannelRecord, ...]) -> None:
        self._options, self._channels = options, channels
        raw = channels[0].raw_unit if channels else ""
        self._unit = options.unit or raw
        self._names = [channel.input for channel in channels] or inputs_of(options.pattern)

    def values(self, line: bytes) -> list[float]:
        """The raw value of each channel; NaN if over range, or the highest count of a channel in counts.

        Raises `Wrong` or `Unreadable`.
        """
        options, text = self._options, sp.text_of(line)
        if (bare := text.strip()) in options.errors:
            raise sp.Wrong(f'says "{sp.readable(line)}": {options.errors[bare]}')
        if (found := options.pattern.fullmatch(text)) is None:
            if bare and any(mark in bare for mark in options.over_range):
                return self._over_range()
            raise sp.Unreadable(f'"{sp.readable(line)}"')
        groups = found.groupdict("")
        if "unit" in groups and (unit := groups["unit"].strip()) != self._unit:
            raise sp.Wrong(f'gives "{unit}" and the bench expects "{self._unit}": set the indicator back')
        status = groups.get("status", "").strip()
        if "status" in groups and options.good_status and status not in options.good_status:
            raise sp.Wrong(f'says status "{status}"; good ones are {", ".join(options.good_status)}')
        try:
            return [number(groups[name], groups.get("sign", "")) for name in self._names]
        except ValueError:
            if any(mark in bare for mark in options.over_range):
                return self._over_range()
            raise sp.Unreadable(f'"{sp.readable(line)}"') from None

    def _over_range(self) -> list[float]:
        return [
            float(round(channel.scale.to_raw(channel.high))) if channel.raw_type == "int32" else math.nan
            for channel in self._channels
        ] or [math.nan]


OPEN = 1.5
"""Longest wait at `open` for a first readable line [s]."""
QUICKER = 1.5
"""Lines that come so many times as often as `rate` says are an error: those that wait in a buffer are dated by it."""
PATIENCE = 0.5
"""Time, and at least three lines, without a readable line after which `collect` raises an error [s]."""


class SerialIndicator(Polled[sp.SerialPort]):
    """An indicator that sends text: `options` give the poll string (or none), the pattern of a line, and the rate.

    Each named group of the pattern is an input; `unit` and `status` are checked in every line.
    """

    emulator = "pmabench_drivers.serial_ascii.emulator"
    read_options = staticmethod(read_options)
    _options: Options

    def __init__(self, device: DeviceRecord, clock: Clock) -> None:
        super().__init__(device, clock)
        self._reader = LineReader(self._options, device.channels)
        self._splitter = sp.Splitter(self._options.terminator)
        self._flow = Flow(PATIENCE)
        self._heard = 0.0
        self._late, self._late_until = b"", 0.0
        """Received part of a late answer, and until when the rest may arrive [s, monotonic]."""
        self._rate = self._options.rate
        self._problem = ""
        self._failure: DeviceError | None = None

    def open(self) -> Identity:
        """Open the port exclusively and wait for one readable line."""
        self.close()
        options = self._options
        settings = {"bytesize": options.data_bits, "parity": options.parity, "stopbits": options.stop_bits}
        self._link = sp.SerialPort(self._device.name, self._device.address, options.baud, self._clock, **settings)
        with self._closed_on_error():
            model = self._ask_identity()
            self._first_line()
        return who("", model or "serial ASCII indicator", clock=COMPUTER)

    def close(self) -> None:
        """Stop reading and close the port."""
        self._cycle.stop(JOIN)
        self._hang_up()

    def start(self, rate: float) -> float:
        """Poll at `rate` [Hz] or the highest allowed rate; an indicator that sends by itself keeps its own rate."""
        self._refuse_rate(rate)
        port = self._opened()
        self.stop()
        self._samples.take()
        self._failure, self._problem, self._heard = None, "", monotonic()
        if self._options.poll:
            self._rate = min(rate, self._options.rate)
            self._cycle.start(self._rate)
        else:
            self._rate, self._splitter = self._options.rate, sp.Splitter(self._options.terminator)
            self._flow = Flow(max(PATIENCE, 5 / self._rate))
            port.listen(self._listen)
        return self._rate

    def collect(self) -> Block:
        """Samples since the last call; raises DeviceError for a wrong unit, a reported fault, or silence."""
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
        """Stop reading; two threads would take each other's bytes."""
        self._cycle.stop(JOIN)
        if self._link is not None:
            self._link.hush()

    # -- polled ---------------------------------------------------------------------------------------------------

    def _tick(self) -> None:
        """Poll once and take the one line of the answer; after a lost answer wait until it can no longer arrive."""
        if self._failure is not None:
            return
        try:
            self._late += self._opened().drain()
            *whole, begun = self._late.split(self._options.terminator)
            if monotonic() < self._late_until and (not whole or begun.strip()):
                return  # half of a late answer: the other half would be taken for the next answer
            asked = self._clock.now()
            lines, rest = self._exchange(self._options.poll, self._options.timeout)
        except DeviceError as error:
            self._failure = error
            return
        answered = self._clock.now()
        self._late, self._late_until = rest, monotonic() + self._options.slowest if rest or not lines else 0.0
        if not lines:
            self._problem = f'"{sp.readable(rest)}" without its end' if rest else "silence"
        elif len(lines) > 1 or rest:
            self._problem = f'more than one answer at a time, from "{sp.readable(lines[0])}" on'
        else:
            self._take(lines[0], (asked + answered) / 2, answered)

    def _exchange(self, question: bytes, timeout: float) -> tuple[list[bytes], bytes]:
        """Send, and receive until a line is complete: the lines, and the bytes after them."""
        port, terminator = self._opened(), self._options.terminator
        port.send(question)
        data = port.receive(lambda got: terminator in got or len(got) > sp.LONGEST_LINE, timeout)
        *lines, rest = data.split(terminator)
        return lines, rest

    # -- as they come ---------------------------------------------------------------------------------------------

    def _listen(self, data: bytes, now: float) -> None:
        """Take bytes that arrived at `now` [s, bench time], on the port's thread."""
        if self._failure is not None:
            return
        wire, lines = 10.0 / self._options.baud, self._splitter.feed(data)
        for index, line in enumerate(lines):
            waiting = (len(lines) - 1 - index) / self._rate  # it has waited in a buffer for the lines after it
            self._take(line, now - waiting - len(line) * wire, now)
            if behind := self._flow.behind(now):
                text = "fewer come than at first: they wait in a converter or on the way, or it was set otherwise"
                self._failure = self._error(f"its lines are {behind:.1f} s late: {text}")
            if (sent := self._flow.rate) > QUICKER * self._rate:
                text = f'sends {sent:.3g} lines a second and "rate" is {self._rate:g} Hz: their times would be wrong'
                self._failure = self._error(f"{text}; set the indicator back, or write the rate that it sends at")

    # -- both -----------------------------------------------------------------------------------------------------

    def _take(self, line: bytes, time: float, host: float) -> None:
        try:
            values = self._reader.values(line)
        except sp.Wrong as error:
            self._failure = self._error(str(error))
            return
        except sp.Unreadable as error:
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
        return sp.readable(lines[0]).strip()

    def _first_line(self) -> None:
        """Check that a line can be read; its sample is dropped."""
        options, port, deadline, last = self._options, self._opened(), monotonic() + OPEN, ""
        splitter = sp.Splitter(options.terminator)
        try:
            while monotonic() < deadline:
                if options.poll:
                    port.drain()
                    lines, rest = self._exchange(options.poll, options.timeout)
                else:
                    rest = port.receive(bool, sp.PIECE)
                    lines = splitter.feed(rest)
                last = f'; it sent "{sp.readable(rest)}"' if rest and not lines else last
                for line in lines:
                    try:
                        self._reader.values(line)
                        return
                    except sp.Unreadable:
                        last = f'; it sent "{sp.readable(line)}", which is not what the pattern says'
        except sp.Wrong as error:
            raise self._error(str(error)) from None
        raise self._error(f"sent no line that can be read within {OPEN:g} s{last}")
