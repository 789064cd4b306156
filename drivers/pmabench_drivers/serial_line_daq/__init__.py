"""A microcontroller board with an open line protocol: samples by its own clock, set-points, valves, its own watchdog.

The protocol is in docs/devices/serial-line-daq.md, the program of the board in `sketch`. Here: encoding of lines, times
of numbered samples, options, the device interface; `emulator`: a board on a pseudo-terminal.

One thread reads every line and passes answers to their callers by number. A request is sent once. Its number is not
used again for a long time, so a late answer never belongs to another request.
"""

from __future__ import annotations

import contextlib
import math
import random
import re
import threading
from binascii import crc_hqx
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from queue import Empty, SimpleQueue
from time import monotonic

from pmabench.base.clock import Clock
from pmabench.base.errors import DeviceError
from pmabench.bench.interface import Block, DeviceRecord, Identity
from pmabench_drivers.shared.device import Led
from pmabench_drivers.shared.link import JOIN, Samples, Still, Unanswered, always, turn, who
from pmabench_drivers.shared.options import BAUDS, Reader, names_in
from pmabench_drivers.shared.serial_port import SerialPort, Splitter, readable

END = b"\n"
PROTOCOL = "line-daq"
VERSION = "1"
MOST = {"a": 6, "d": 6, "o": 4, "v": 4}
"""Largest number of inputs, levels, outputs and valves of a board, by the letter of their names (`a0`, `d0` ...)."""
NAMES = {"a": "count input", "d": "digital input", "o": "output", "v": "valve"}
LETTERS = {"input": "a", "digital input": "d", "output": "o", "valve": "v"}
ARMED, VENTED, LEVELS = 1, 2, 2
"""Bits of the state: watchdog armed, vented by the watchdog; the levels follow from bit 2 on."""
REASONS = {
    "unknown": "does not know the command",
    "range": "says that the value is out of its range",
    "unarmed": "refuses, because its watchdog is not armed",
    "vented": "has vented by itself, because its watchdog heard nothing; it takes nothing until it is armed again",
}
"""Words of a refusal by a board -> message."""
_WHOLE = re.compile(rb"([ -)+-~]{1,114})\*([0-9A-F]{4})")
_COUNT = re.compile(r"-?\d{1,10}")
WRAP = 1 << 32
LONGEST = 10_000_000
"""Largest jump of the clock that counts as a loss; beyond it the sample is invalid [us]."""
DRIFT = 2e-3
"""Largest drift between number and clock over a gap [1]."""
KNOWN_BAUDS = tuple(sorted({*BAUDS, 250_000, 500_000, 1_000_000, 2_000_000}))
BAUD = 500_000
WATCHDOG = (0.05, 1.0)
"""Shortest and longest time of the board's watchdog [s]."""


class NoLine(ValueError):
    """Bytes that are no line of the protocol: cut, disturbed, something else."""


@dataclass(frozen=True)
class Sample:
    """One numbered row of counts."""

    number: int
    """Number of periods since sampling began, including those in which nothing was sent [1], modulo 2^32."""
    micros: int
    """Time of the sample on the board's clock [us], modulo 2^32."""
    state: int
    counts: tuple[int, ...]


def encode(*fields: object) -> bytes:
    """Fields as a line with checksum and end: the CRC-16/IBM-3740 (0x1021 from 0xFFFF) of all before the star."""
    text = ",".join(map(str, fields)).encode("ascii")
    return b"%s*%04X" % (text, crc_hqx(text, 0xFFFF)) + END


def decode(line: bytes) -> list[str]:
    """The fields of a line without its end; raises NoLine."""
    if (found := _WHOLE.fullmatch(line)) is None:
        raise NoLine("a line that is none of the protocol")
    if crc_hqx(found[1], 0xFFFF) != int(found[2], 16):
        raise NoLine("a line whose checksum is wrong")
    return found[1].decode("ascii").split(",")


def read_sample(fields: list[str], inputs: int) -> Sample:
    """The sample in the fields of an `S` line; raises NoLine."""
    if len(fields) != 4 + inputs or not all(_COUNT.fullmatch(text) for text in fields[1:]):
        raise NoLine(f"a sample that has not {inputs} counts")
    number, micros, state, *counts = map(int, fields[1:])
    if not (0 <= number < 1 << 32 and 0 <= micros < 1 << 32 and 0 <= state < 256):
        raise NoLine("a sample with a number out of its range")
    if not all(-(1 << 31) <= count < 1 << 31 for count in counts):
        raise NoLine("a sample with a count of more than 32 bits")
    return Sample(number, micros, state, tuple(counts))


def index_of(name: str, letter: str) -> int | None:
    """The number in a name like `a0`; None for any other name."""
    found = re.fullmatch(rf"{letter}(\d)", name)
    return int(found[1]) if found and int(found[1]) < MOST[letter] else None


class Timeline:
    """Times of samples; counts lost ones by their numbers.

    Number and clock carry the same information: a sample whose two disagree is not accepted.
    """

    def __init__(self, period: int, before: Timeline | None = None) -> None:
        self._period = period
        self._last: Sample | None = None
        self._time = 0
        self.ahead: float | None = before.ahead if before is not None else None
        """Lead of the board's clock over bench time, wraps counted [us]; times continue where `before` ended."""
        self.lost = 0
        """Samples whose numbers did not arrive."""
        self.misfits = 0
        """Consecutive samples that were not accepted."""

    def place(self, sample: Sample, host: float) -> int | None:
        """Time on the board's clock [us] of a sample that arrived at `host` [s, bench time]; None if not accepted."""
        if (last := self._last) is None:
            if self.ahead is None:
                self.ahead = sample.micros - host * 1e6
            self._time = sample.micros + WRAP * round((host * 1e6 + self.ahead - sample.micros) / WRAP)
        else:
            ahead, passed = (sample.number - last.number) % WRAP, (sample.micros - last.micros) % WRAP
            expected = ahead * self._period
            if not 0 < expected <= LONGEST or abs(passed - expected) >= self._period + DRIFT * expected:
                self.misfits += 1
                return None
            self.lost += ahead - 1
            self._time += passed
        self._last, self.misfits = sample, 0
        return self._time


def read_options(device: DeviceRecord, reader: Reader) -> int:
    """The baud rate; `reader` gets a fault for everything in the device's record that the board cannot do."""
    given = reader.keys(device.options, ("options",), ("baud",))
    reader.port(device, "/dev/ttyACM0")
    baud = reader.one_of(given, "baud", ("options",), KNOWN_BAUDS, BAUD)
    for kind, place, name in names_in(device):
        letter = LETTERS[kind]
        if index_of(name, letter) is None:
            known = f"{letter}0 to {letter}{MOST[letter] - 1}"
            reader.fault(place, f'a {NAMES[letter]} of the board is expected, {known}, not "{name}"')
    for output in device.outputs:
        place = "outputs", output.name
        if output.resolution < 1 or output.resolution != round(output.resolution):
            reader.fault(place, 'the board takes whole counts: "resolution: 1 count" is expected')
        if abs(float(output.scale.to_raw(output.safe))) > 1e-6:
            reader.fault(place, "the board vents to 0 counts: the scale must have the safe value there")
    for valve in device.valves:
        if valve.energised == valve.safe:
            message = f'the board vents with its valves off: "{valve.name}" must be {valve.safe} without power'
            reader.fault(("outputs", valve.name, "energised"), message)
    shortest, longest = WATCHDOG
    if (device.outputs or device.valves) and not device.watchdog:
        remedy = f'add "watchdog: 500 ms" (at most {longest:g} s)'
        reader.fault((), f"outputs work only under the watchdog of the board: {remedy}")
    elif device.watchdog and not shortest <= device.watchdog <= longest:
        reader.fault(("watchdog",), f"the board's watchdog takes {shortest * 1e3:g} ms to {longest:g} s")
    return baud


CALL = 0.17
"""Longest time of a call [s]."""
ANSWER = 0.08
"""Longest wait for an answer before the value that the board holds is read [s]."""
OPEN = 1.9
ASK = 0.2
"""Interval for requests of the identity at `open`: an Arduino restarts when its port is opened [s]."""
PATIENCE = 0.25
"""Time, and at least three periods, without samples or steps after which `collect` raises an error [s]."""
MISFITS = 3
"""Number of consecutive samples whose number and clock disagree that is an error."""


class Link(SerialPort):
    """An open port; its thread calls `on_sample` with the fields of each `S` line and its bench time [s]."""

    def __init__(
        self, device: str, address: str, baud: int, clock: Clock, on_sample: Callable[[list[str], float], None]
    ) -> None:
        super().__init__(device, address, baud, clock)
        self._on_sample = on_sample
        self._turn, self._sending = threading.Lock(), threading.Lock()
        self._waiting: dict[int, SimpleQueue[list[str]]] = {}
        self._number = random.randrange(1 << 20)
        self._splitter = Splitter(END, whole=True)  # an incomplete line has a wrong checksum
        self.last = ""
        """The last unreadable line."""
        self.listen(self._read)

    def ask(self, deadline: float, letter: str, *values: int, still: Still = always, aside: bool = False) -> list[str]:
        """The board's answer before `deadline` [s, monotonic]; nothing is sent if `still()` is false by then.

        One request is in progress at a time: a board has little memory for incoming bytes. With `aside` a request does
        not wait for its turn. Raises DeviceError if the board refuses, Unanswered if no answer comes.
        """
        asked = monotonic()
        busy = f"has not answered yet what was asked before; the question {letter} was not sent"
        with contextlib.nullcontext() if aside else turn(self._turn, deadline, self._device, busy=busy):
            answer = SimpleQueue[list[str]]()
            with self._sending:
                if not still():
                    return []
                if self.gone:
                    raise DeviceError(self._device, self.gone)
                self._number = number = self._number % 999_999_999 + 1
                self._waiting[number] = answer
                self.send(encode(letter, number, *values))
            try:
                kind, *fields = answer.get(timeout=max(0.0, deadline - monotonic()))
            except Empty:
                why = self.gone or f"did not answer within {max(0.0, deadline - asked):.2g} s"
                raise Unanswered(self._device, why) from None
            finally:
                self._waiting.pop(number, None)
        if kind == "E":
            word = fields[0] if fields else ""
            raise DeviceError(self._device, REASONS.get(word, f'refuses with "{word}"'))
        return fields

    def _read(self, data: bytes, now: float) -> None:
        for line in self._splitter.feed(data):
            try:
                self._take(decode(line.rstrip(b"\r")), now)
            except NoLine as error:
                self.last = f'{error}: "{readable(line)}"'

    def _take(self, fields: list[str], now: float) -> None:
        if fields[0] == "S":
            self._on_sample(fields, now)
            return
        if fields[0] not in {"A", "E"} or len(fields) < 2 or not fields[1].isdecimal():
            raise NoLine("a line of no known kind")
        if (waiting := self._waiting.get(int(fields[1]))) is not None:
            waiting.put([fields[0], *fields[2:]])


class SerialLineDaq(Led[Link]):
    """A board with the program of `sketch`, or another with its protocol; its only option is `baud`.

    Inputs are `a0` to `a5` (counts) and `d0` to `d5` (levels), outputs `o0` to `o3` (counts) and `v0` to `v3` (valves).
    Time is the board's own. Only `feed_watchdog` feeds its watchdog. `disarm_watchdog` also vents.
    """

    verified = "emulator and compiled sketch, no board"
    drift = 1e-2
    """A Uno has a ceramic resonator: within 5e-3 when new, 1e-2 with temperature and age."""
    emulator = "pmabench_drivers.serial_line_daq.emulator"
    read_options = staticmethod(read_options)
    _options: int
    """Its baud rate."""

    def __init__(self, device: DeviceRecord, clock: Clock) -> None:
        super().__init__(device, clock)
        self._columns = [index_of(channel.input, "a") or 0 for channel in device.channels]
        self._samples = Samples([channel.name for channel in device.channels])
        self._has = dict.fromkeys(NAMES, 0)
        self._full_scale, self._shortest = 0, 1
        self._timeline: Timeline | None = None
        self._before: Timeline | None = None
        self._period = self._armed = 0.0
        self._heard = 0.0
        self._reported_vent = False
        self._failure: DeviceError | None = None

    # -- life -----------------------------------------------------------------------------------------------------

    def open(self) -> Identity:
        """Open the port exclusively, identify the board, and stop sampling; outputs stay as they are."""
        self.close()
        link = self._link = Link(self._device.name, self._device.address, self._options, self._clock, self._take)
        with self._closed_on_error():
            identity = self._identify(link, monotonic() + OPEN)
            link.ask(monotonic() + CALL, "G", 0)
        return identity

    def close(self) -> None:
        """Stop stepping and close the port; the board keeps sampling, and its watchdog stays as it is."""
        self._following.clear()
        self._steps.stop(JOIN)
        self._timeline, self._armed, self._failure = None, 0.0, None
        self._steps.note(None)
        self._before, self._samples = None, Samples([channel.name for channel in self._device.channels])
        self._hang_up()

    def _identify(self, link: Link, deadline: float) -> Identity:
        while True:
            try:
                answer = link.ask(min(deadline, monotonic() + ASK), "I")
                break
            except Unanswered:
                if link.gone or monotonic() >= deadline:
                    heard = f"; the last thing heard was {link.last}" if link.last else ""
                    message = f"did not say who it is within {OPEN:g} s at {self._options} baud{heard}"
                    raise self._error(message) from None
        if answer[:2] != [PROTOCOL, VERSION] or len(answer) != 10 or not all(map(str.isdecimal, answer[4:])):
            raise self._error(f'is no "{PROTOCOL}" of version {VERSION}: "{",".join(answer)[:60]}"')
        _protocol, version, model, serial, *numbers = answer
        *counts, self._full_scale, self._shortest = map(int, numbers)
        self._has = dict(zip(NAMES, counts, strict=True))
        for kind, _place, name in names_in(self._device):
            self._index(name, LETTERS[kind])
        if not 0 < self._shortest <= 10_000_000:
            raise self._error(f"says that its shortest period is {self._shortest} us")
        return who("", model, serial, f"{PROTOCOL} {version}")

    # -- samples --------------------------------------------------------------------------------------------------

    def start(self, rate: float) -> float:
        """Let the board sample at `rate` [Hz], in whole microseconds, or as fast as it can if that is less."""
        self._refuse_rate(rate)
        period = min(max(round(1e6 / rate), self._shortest), 10_000_000)
        self.stop()
        self._samples.take()
        self._failure = None
        if (used := self._ask("G", period)) != period:
            raise self._error(f"samples each {used} us where {period} us were asked for")
        self._period, self._heard = period * 1e-6, monotonic()
        self._before = self._timeline = Timeline(period, self._before)
        return 1e6 / period

    def collect(self) -> Block:
        """Samples since the last call; raises DeviceError for silence, and once for any other failure."""
        failure, self._failure = self._failure, None
        if failure is not None:
            raise failure
        self._steps.refuse(self._device.name, "stepping", once=True)
        block = self._samples.take()
        if len(block.time):
            return block
        link = self._opened()
        if link.gone:
            raise self._error(link.gone)
        if self._timeline is not None and monotonic() - self._heard > max(PATIENCE, 3 * self._period):
            last = f"; the last thing heard was {link.last}" if link.last else ""
            raise self._error(f"no sample for {PATIENCE:g} s{last}")
        return block

    def stop(self) -> None:
        """Stop sampling; a ramp in progress continues."""
        if self._timeline is not None and self._link is not None:
            self._timeline = None
            self._ask("G", 0)

    @property
    def missed(self) -> int:
        """Samples that the board counted and that did not arrive."""
        return self._timeline.lost if self._timeline is not None else 0

    def _take(self, fields: list[str], now: float) -> None:
        """Take one `S` line that arrived at `now` [s, bench time], in the reading thread."""
        timeline = self._timeline
        sample = read_sample(fields, self._has["a"])
        if timeline is None:
            return  # left over: another program started the sampling
        if (micros := timeline.place(sample, now)) is None:
            if timeline.misfits == MISFITS:
                why = "it has started again, or is no such board"
                self._failure = self._error(f"the number of its samples and its clock do not fit: {why}")
            return
        self._heard = monotonic()
        self._samples.append(micros * 1000, [float(sample.counts[i]) for i in self._columns], round(now * 1e9))
        if sample.state & VENTED and self._armed and not self._reported_vent:
            self._reported_vent = True
            message = f"has vented by itself: its watchdog heard nothing for {self._armed:g} s"
            self._failure = self._error(message)

    # -- commands -------------------------------------------------------------------------------------------------

    def write(self, output: str, value: float) -> None:
        """Command a whole number of counts once; if no answer comes, the value that the board holds decides."""
        self._output(output)
        self._following.pop(output, None)
        self._put("W", self._index(output, "o"), self._whole(output, value))

    def read_back(self, output: str) -> float:
        """The counts that the board holds."""
        self._output(output)
        return float(self._ask("W", self._index(output, "o")))

    def switch(self, output: str, *, on: bool) -> None:
        """Switch a valve's output."""
        self._put("V", self._index(output, "v"), int(on))

    def is_on(self, output: str) -> bool:
        """Whether a valve's output is on."""
        return self._ask("V", self._index(output, "v")) != 0

    def level(self, name: str) -> bool:
        """Whether a digital input is high."""
        index = self._index(name, "d")
        return bool(self._ask("D") >> LEVELS + index & 1)

    def rescue(self, output: str, value: float) -> None:
        """Send on the same line without waiting for a turn; the answer is identified by its number."""
        self._following.pop(output, None)
        if output in self._outputs:
            self._put("W", self._index(output, "o"), self._whole(output, value), aside=True)
        else:
            self._put("V", self._index(output, "v"), int(value != 0), aside=True)

    # -- ramps and sines ------------------------------------------------------------------------------------------

    def _refuse_value(self, output: str, value: float) -> None:
        self._whole(output, value)

    def _send_step(self, output: str, value: float, still: Still, *, last: bool) -> None:
        self._put("W", self._index(output, "o"), self._whole(output, value), still=still)

    # -- the board's watchdog -------------------------------------------------------------------------------------

    def arm_watchdog(self, seconds: float) -> float:
        """Set it and start it; returns the time that the board holds [s]."""
        if not 0 < seconds < math.inf:
            raise self._error(f"a watchdog of {seconds} s cannot be set", "watchdog")
        until = monotonic() + CALL
        self._ask("T", math.floor(seconds * 1e3 + 1e-6), until=until)
        if (held := self._ask("T", until=until)) <= 0:
            raise self._error("holds a watchdog time of 0, which is none", "watchdog")
        self._armed, self._reported_vent = held * 1e-3, False
        return self._armed

    def feed_watchdog(self) -> None:
        """Feed it; raises DeviceError if the board is no longer armed."""
        if not self._ask("F") & ARMED:
            raise self._error("took a sign of life and is not armed", "watchdog")

    def disarm_watchdog(self) -> None:
        """Stop it. The board vents: no output stays on without a watchdog."""
        self._armed = 0.0
        self._ask("T", 0)

    def held(self) -> Mapping[str, float | str]:
        """The time of its watchdog [s], 0 if it is off, has fired, or the board has restarted; and its identity."""
        until = monotonic() + CALL
        seconds, about = self._ask("T", until=until) * 1e-3, self._opened().ask(until, "I")
        return {"watchdog": seconds, **dict(zip(("model", "serial"), about[2:4], strict=False))}

    # -- questions ------------------------------------------------------------------------------------------------

    def _ask(self, letter: str, *values: int, until: float = 0.0) -> int:
        """The number in the board's answer."""
        return self._number(self._opened().ask(until or monotonic() + CALL, letter, *values))

    def _number(self, answer: list[str]) -> int:
        if len(answer) != 1 or not answer[0].isdecimal():
            raise self._error(f'answers "{",".join(answer)[:40]}" where a number is expected')
        return int(answer[0])

    def _put(self, letter: str, index: int, value: int, *, still: Still = always, aside: bool = False) -> None:
        """Send once; the answer is the value that the board holds. If it is lost, the value is read instead."""
        link, until = self._opened(), monotonic() + CALL
        lost = ""
        try:
            answer = link.ask(until - CALL + ANSWER, letter, index, value, still=still, aside=aside)
            if not answer:
                return  # overtaken by a newer command
        except Unanswered:
            lost = "did not answer to the command"
            try:
                answer = link.ask(until, letter, index, aside=aside)
            except Unanswered:
                message = f"did not answer within {CALL:g} s; whether it took {value} is not known"
                raise Unanswered(self._device.name, message, f"{'o' if letter == 'W' else 'v'}{index}") from None
        if (held := self._number(answer)) != value:
            name = f"{'o' if letter == 'W' else 'v'}{index}"
            raise self._error(f"{lost or 'was commanded'} {value} and holds {held}", name)

    def _index(self, name: str, letter: str) -> int:
        index, count = index_of(name, letter), self._has[letter]
        if index is None or (self._link is not None and index >= count):
            raise self._error(f'the board has {count} {NAMES[letter]}(s), and "{name}" is none', name)
        return index

    def _whole(self, output: str, value: float) -> int:
        """A value as whole counts within the board's range."""
        if not math.isfinite(value) or not -0.5 <= value < self._full_scale + 0.5:
            raise self._error(f"cannot be set to {value:g}; 0 to {self._full_scale} counts", output)
        return round(value)
