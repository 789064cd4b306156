"""The laser sensor Micro-Epsilon optoNCDT ILD1420: distances with their numbers, over RS422.

Here: options, decoding, lost measurements, the device interface; `emulator`: a sensor on a pseudo-terminal.

Instruction manual optoNCDT 1420, measurement value output over RS422: three bytes a value, marked by their two highest
bits: low byte `00`, middle byte `01`, high byte `10` for the first value of a measurement (the distance) and `11` for
each further one (here the counter); six bits each.
"""

from __future__ import annotations

import math
import re
from contextlib import suppress
from dataclasses import dataclass
from time import monotonic

from pmabench.base.errors import DeviceError
from pmabench.bench.interface import EMULATED, UNPROVEN, DeviceRecord, Identity
from pmabench_drivers.shared.device import Rated
from pmabench_drivers.shared.link import Pace, who
from pmabench_drivers.shared.options import Reader, option
from pmabench_drivers.shared.serial_port import SerialPort, SerialStream

BITS = 60
"""Bits on the line for a distance and its counter, with start and stop bits."""
WRAP = 1 << 18
"""Number of measurements after which the counter restarts at 0."""
FULL = 65520
"""Largest code that is a distance."""
SPANS = (10, 25, 50, 100, 200, 500)
"""Measuring ranges of the sensors [mm]."""
SCENE = {
    262076: "sees no peak",
    262077: "sees a peak before its measuring range",
    262078: "sees a peak behind its measuring range",
    262080: "cannot compute the value",
    262081: "sees a peak that is too large",
}
"""Codes about the target: not a number, however often they occur."""
SETTING = {262075: "sends more than its baud rate can carry", 262082: "has its laser switched off"}
"""Codes for a wrong setting."""
BAUDS = (115200, 230400, 256000, 460800, 691200, 921600, 1000000)
INPUT = "distance"
MARKS = (0, 1, 2, 0, 1, 3)
"""Two highest bits of the bytes of a measurement: low, middle and high byte of the distance, then of the counter."""


class Decoder:
    """Cuts a stream of bytes into measurements.

    After a byte out of place everything up to the end of the second counter is dropped: the part up to the first may
    be made of old bytes and disturbed ones.
    """

    def __init__(self) -> None:
        self._bits: list[int] = []
        """Six bits of each byte of the present measurement so far."""
        self._skip = 0

    def feed(self, data: bytes) -> list[tuple[int, int]]:
        """Measurements that end in `data`: code of the distance and counter, 18 bits each."""
        found = []
        for byte in data:
            mark = byte >> 6
            if self._skip:
                self._skip -= mark == 3
                continue
            if mark != MARKS[len(self._bits)]:
                self._bits, self._skip = [], 2
                continue
            self._bits.append(byte & 0x3F)
            if len(self._bits) == len(MARKS):
                low, middle, high, *counter = self._bits
                found.append((low | middle << 6 | high << 12, counter[0] | counter[1] << 6 | counter[2] << 12))
                self._bits = []
        return found


def encode(code: int, counter: int) -> bytes:
    """A distance and its counter as the sensor sends them."""
    bits = [value >> shift & 0x3F for value in (code, counter) for shift in (0, 6, 12)]
    return bytes(mark << 6 | part for mark, part in zip(MARKS, bits, strict=True))


def distance(code: int, span: int) -> float:
    """Distance from the start of the measuring range of `span` [mm]; NaN if the code is no distance."""
    return math.nan if not 0 <= code <= FULL else 0.01 * (102.0 / FULL * code - 1.0) * span


def code_of(value: float, span: int) -> int:
    """Code that the sensor sends for a distance [mm]; there are other codes for peaks outside the range."""
    code = round((value / (0.01 * span) + 1.0) * FULL / 102.0)
    return 262077 if code < 0 else 262078 if code > FULL else code


def misset(code: int) -> str:
    """The wrong setting that this code indicates; empty if none."""
    if code <= FULL or code in SCENE:
        return ""
    return SETTING.get(code) or f"sends {code}, which is no distance: a master value may be set in it"


class CounterBroken(Exception):
    """The counter has jumped: the number of this measurement is unknown."""


class Numbering:
    """Numbers measurements from 0 on.

    A measurement is accepted if its counter follows that of the last accepted one, or of the one before it. So the
    first one after a gap is dropped: its bytes may belong to two measurements. A disturbed counter makes no false gap.
    """

    def __init__(self, longest: int) -> None:
        self._longest = longest
        self._last: int | None = None
        self._before: int | None = None
        self._number = 0
        self.lost = 0
        """Measurements that did not arrive, or were dropped."""

    def place(self, counter: int) -> int | None:
        """The number of a measurement; None if it is not accepted. Raises CounterBroken."""
        follows = [(before + 1) % WRAP for before in (self._last, self._before) if before is not None]
        self._before = counter
        if counter not in follows:
            return None
        ahead = 0 if self._last is None else (counter - self._last) % WRAP
        if ahead > self._longest:
            raise CounterBroken
        self._number += ahead
        self.lost += max(0, ahead - 1)
        self._last = counter
        return self._number


@dataclass(frozen=True)
class Options:
    """Options of a sensor."""

    range: int = option(Reader.mapped, {f"{span} mm": span for span in SPANS}, "100 mm")
    """Measuring range [mm]."""
    rate: float = option(Reader.quantity, "frequency", 1000.0, 100.0, 4000.0)
    """Measuring rate that the sensor is set to [Hz]."""
    baud: int = option(Reader.one_of, BAUDS, 921600)


def read_options(device: DeviceRecord, reader: Reader) -> Options:
    """Options of a device; also checks the inputs that its channels use."""
    place = ("options",)
    options, _ = reader.options(Options, device.options, place, needed=("range", "rate"))
    reader.port(device, "/dev/ttyUSB0")
    rate = options.rate
    if rate * BITS > options.baud:
        reader.fault((*place, "rate"), f"{rate:g} distances a second with their counter need {rate * BITS:g} baud")
    reader.measures_only(device, "the sensor", "mm")
    for channel in device.channels:
        reader.known(("channels", channel.name, "input"), "the sensor has no input", channel.input, [INPUT])
    return options


PROMPT = b"->"
"""End of each answer; the two bytes cannot follow each other in a stream of values."""
ANSWER = 0.15
"""Longest wait for an answer [s]."""
LONGEST = 10.0
"""Largest jump of the counter that counts as a loss [s]."""
SLIP = 0.3
"""Largest increase of the delay of all measurements of a second; beyond it the rate differs [s]."""
_ERROR = re.compile(rb"E\d{2,3}[^\r\n]*")
_FIELD = re.compile(r"^[\s>-]*([A-Za-z][A-Za-z -]*?) *: *([^\r\n/]*?) *(?://.*)?$", re.MULTILINE)


class Refused(DeviceError):
    """The sensor says that it does not carry a command out."""


class Ild1420(Rated[SerialPort], SerialStream):
    """A laser sensor: its one input is `distance` [mm], from the start of the measuring range."""

    emulator = "pmabench_drivers.ild1420.emulator"

    read_options = staticmethod(read_options)
    _options: Options

    def _forget(self) -> None:
        super()._forget()
        self._decoder = Decoder()
        self._numbering = Numbering(int(LONGEST * self._options.rate))
        self._pace = Pace(SLIP)
        self._origin: float | None = None
        self._newest = 0.0
        self._problem = ""

    def _greet(self) -> Identity:
        """Quiet the sensor, see that it is the right one, and set what a true record needs."""
        self._ask("OUTPUT NONE", tries=3)
        fields = self._ask("GETINFO").decode("ascii", "replace").replace("\r", "\n")
        identity = self._identity(dict(_FIELD.findall(fields)))
        self._ask(f"MEASRATE {self._options.rate / 1000:g}")
        for setting in ("OUTREDUCECOUNT 1", "OUTHOLD NONE", "OUTADD_RS422 COUNTER"):
            self._ask(setting)
        with suppress(Refused):  # its key sets zero; a sensor that cannot lock it measures all the same
            self._ask("KEYLOCK ACTIVE")
        return identity

    def start(self, rate: float) -> float:
        """Start measuring at the sensor's own rate, whatever rate [Hz] is requested."""
        port = self._ready(rate)
        self._forget()
        answer = self._ask("OUTPUT RS422", rest=True)
        self._heard = monotonic()
        if answer:
            self._take(answer, self._clock.now())
        port.listen(self._take)
        return self._options.rate

    def _missing(self) -> str:
        return self._problem or "sends no measurement that can be read"

    @property
    def lost(self) -> int:
        """Measurements that did not arrive, by the counter; each is a gap in the times."""
        return self._numbering.lost

    # -- the stream -------------------------------------------------------------------------------------------------

    def _take(self, data: bytes, now: float) -> None:
        """Take bytes that arrived at `now` [s, bench time]."""
        if self._failure:
            return
        for code, counter in self._decoder.feed(data):
            try:
                number = self._numbering.place(counter)
            except CounterBroken:
                self._failure = "its counter has jumped: it was restarted or reset"
                return
            if number is not None:
                self._keep(number, code, now)
        behind = self._pace.behind(self._newest, now) if self._origin is not None else 0.0
        if behind:
            rate = self._options.rate
            self._failure = f"measures {'slower' if behind > 0 else 'faster'} than the {rate:g} Hz that it was set to"

    def _keep(self, number: int, code: int, now: float) -> None:
        rate = self._options.rate
        if self._origin is None:
            self._origin = now - number / rate
        taken = self._origin + number / rate
        self._problem = misset(code)
        if not self._problem:
            self._heard = monotonic()
        self._newest = taken
        values = [distance(code, self._options.range)] * len(self._device.channels)
        self._samples.append(round(taken * 1e9), values, round(now * 1e9))

    # -- questions --------------------------------------------------------------------------------------------------

    def _quiet(self) -> None:
        """End the stream."""
        self._ask("OUTPUT NONE")

    def _ask(self, command: str, *, rest: bool = False, tries: int = 2) -> bytes:
        """The answer to a command, or what follows its prompt; an error is the sensor's own.

        A command says the same when it is repeated. Bytes of a stream that somebody left behind may drown an answer.
        """
        port = self._opened()
        for again in range(tries):
            port.drain()
            port.send(command.encode("ascii") + b"\n")
            data = port.receive(lambda got: PROMPT in got, ANSWER)
            answer, prompt, behind = data.partition(PROMPT)
            if prompt:
                if again and not rest and PROMPT not in behind:  # the other answer must not be the next command's
                    port.receive(lambda got: PROMPT in got, ANSWER)
                break
        else:
            heard = f"{len(data)} bytes without the end of an answer" if data else "nothing"
            raise self._error(f'sent {heard} when it was asked "{command}"')
        refused = _ERROR.search(answer) if command != "OUTPUT NONE" else None
        if refused:
            text = refused[0].decode("ascii", "replace").strip()
            raise Refused(self._device.name, f'refuses "{command}": {text}')
        return behind if rest else answer

    def _identity(self, fields: dict[str, str]) -> Identity:
        name, expected = fields.get("Name", ""), self._options.range
        if not name.removeprefix(UNPROVEN).removeprefix(EMULATED).startswith("ILD1420"):
            raise self._error(f'is "{name[:40]}" and no ILD1420')
        span = re.fullmatch(r"(\d+(?:\.\d+)?) *mm", fields.get("Measuring range", ""))
        if span is None or float(span[1]) != expected:
            has = fields.get("Measuring range", "")[:20] or "without a range that it reports"
            raise self._error(f"is a sensor of {has}, and the bench file says {expected} mm")
        serial, version = (fields.get(key, "")[:40] for key in ("Serial", "Version"))
        return who("Micro-Epsilon", name[:60], serial, version)
