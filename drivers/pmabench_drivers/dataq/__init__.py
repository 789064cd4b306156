"""DATAQ DI-2108, DI-4108 and DI-1110: analogue inputs sampled by the device's own clock, over a serial port (USB CDC).

Here: options, scans as bytes, the device interface; `emulator`: a device on a pseudo-terminal.

Source: Data Acquisition Instrument Command Protocol, DATAQ Instruments, 2019. A scan has one word of two bytes for each
entry of the scan list, low byte first, and no synchronisation mark. So the digital inputs are the last entry of each
scan: their low byte holds D1 and D0 complemented, their high byte D6 to D0, and this word is constant while nothing
is switched; a change means that bytes were lost.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from time import monotonic

from pmabench.base.clock import Clock
from pmabench.bench.interface import EMULATED, UNPROVEN, DeviceRecord, Identity
from pmabench_drivers.shared.link import Pace, who
from pmabench_drivers.shared.options import Reader, option
from pmabench_drivers.shared.serial_port import STREAM_PATIENCE, SerialStream

INPUTS = tuple(f"a{number}" for number in range(8))
DIGITAL = 8
"""Entry of the scan list for the digital inputs."""
DIVIDEND = 60_000_000
"""Frequency that is divided by `srate` [Hz]."""
SLOWEST = 65535
"""Largest `srate`."""
FASTEST = 6000
"""Smallest `srate` used here: 10 kHz for each input."""
MOST_DEC = 512
OVERRUN = b"stop 01"
"""Last bytes sent when the device's buffer has overrun."""
LATENCY = 0.02
"""Largest time to fill a USB packet, if the smallest packet allows it [s]."""
FILTERS = {"last": 0, "average": 1}


@dataclass(frozen=True)
class Model:
    """Properties of one kind of device."""

    name: str
    ranges: tuple[str, ...]
    """Ranges (+-) in the order of their codes in the scan list."""
    shift: int = 0
    """Number of low bits without data."""
    decimates: bool = True


MODELS = {
    model.name: model
    for model in (
        Model("DI-2108", ("10 V",)),
        Model("DI-4108", ("10 V", "5 V", "2 V", "1 V", "0.5 V", "0.2 V")),
        Model("DI-1110", ("10 V",), shift=4, decimates=False),
    )
}


def divisors(model: Model, rate: float, dividend: int) -> tuple[int, int]:
    """`srate` and `dec` for the possible rate nearest to `rate` [Hz]; without `dec` at least 915.5 Hz."""
    wanted = dividend / rate

    def off(dec: int) -> tuple[float, int]:
        return abs(_srate(wanted, dec) * dec - wanted), -dec

    dec = min(range(1, MOST_DEC + 1 if model.decimates else 2), key=off)
    return _srate(wanted, dec), dec


def _srate(wanted: float, dec: int) -> int:
    return min(max(round(wanted / dec), FASTEST), SLOWEST)


def packet(bytes_per_second: float) -> int:
    """The largest `ps` whose packet of 16 << ps bytes fills within `LATENCY`; 0 if none does."""
    return max((n for n in range(8) if 16 << n <= LATENCY * bytes_per_second), default=0)


def volts(model: Model, span: float, raw: int) -> float:
    """Analogue word [signed counts] in volts, for a range of +-`span` [V]."""
    return span * (raw >> model.shift) / (32768 >> model.shift)


def counts(model: Model, span: float, value: float) -> int:
    """Volts as an analogue word of the device."""
    full = 32768 >> model.shift
    return min(max(round(value / span * full), -full), full - 1) << model.shift


def plausible(word: int) -> bool:
    """Whether a word can be that of the digital inputs: D1 and D0 are in it twice, and there is no D7."""
    low, high = word & 0xFF, word >> 8 & 0xFF
    return high < 0x80 and low & 3 == ~high & 3


class Lost(Exception):
    """Bytes are missing or surplus: the following scans cannot be separated."""


class Scans:
    """Splits a stream into scans of `inputs` words and the digital inputs; raises Lost at the first broken scan.

    The complete scans before it are in `whole` in that case, too.
    """

    def __init__(self, inputs: int) -> None:
        self._words = struct.Struct(f"<{inputs}hH")
        self._rest = b""
        self._digital: int | None = None
        self.whole: list[tuple[int, ...]] = []

    def feed(self, data: bytes) -> list[tuple[int, ...]]:
        """Analogue words of the scans that are completed by `data`."""
        self.whole = []
        self._rest += data
        size, at = self._words.size, 0
        while at + size <= len(self._rest):
            *analog, digital = self._words.unpack_from(self._rest, at)
            if self._digital is None and plausible(digital):
                self._digital = digital
            if digital != self._digital:
                two = self._rest[at : at + 2 * size]
                if self._likely(digital) and len(two) < 2 * size:
                    break  # the next scan decides
                if not self._switched(two):
                    self._rest = b""
                    raise Lost
                self._digital = digital
            at += size
            self.whole.append(tuple(analog))
        self._rest = self._rest[at:]
        if self._rest.endswith(OVERRUN):
            raise Lost
        return self.whole

    def _likely(self, word: int) -> bool:
        """Whether another word can be that of the digital inputs as well: no bit without an input has changed."""
        return self._digital is not None and plausible(word) and not (word ^ self._digital) & 0xFC

    def _switched(self, two: bytes) -> bool:
        """Whether inputs were switched where these two scans are; in shifted ones the word before is elsewhere."""
        size, before = self._words.size, (self._digital or 0).to_bytes(2, "little")
        return all(self._likely(int.from_bytes(two[end - 2 : end], "little")) for end in (size, 2 * size)) and all(
            two[at : at + 2] != before for at in range(len(two)) if (at + 2) % size
        )


@dataclass(frozen=True)
class Options:
    """Options of a device."""

    model: Model = option(Reader.mapped, MODELS, "DI-2108")
    ranges: Mapping[str, int] = field(default_factory=dict)
    """Code of each input's range, if it is not the widest."""
    baud: int = 115200
    """Without effect on USB."""
    filter: int = option(Reader.mapped, FILTERS, "last")
    """Treatment of conversions between two samples: 0: only the last one is used, 1: they are averaged."""

    def span(self, source: str) -> float:
        """Range of an input, in both directions [V]."""
        return float(self.model.ranges[self.ranges.get(source, 0)].removesuffix(" V"))


def read_options(device: DeviceRecord, reader: Reader) -> Options:
    """Options of a device; also checks the inputs that its channels use."""
    place = ("options",)
    options, given = reader.options(Options, device.options, place, ("ranges",), ("model",))
    reader.port(device, "/dev/ttyACM0")
    model = options.model
    ranges = reader.keys(given.get("ranges", {}), (*place, "ranges"), INPUTS)
    codes = {
        source: model.ranges.index(reader.choice(ranges, source, (*place, "ranges"), model.ranges, model.ranges[0]))
        for source in ranges
        if source in INPUTS
    }
    if options.filter and not model.decimates:
        reader.fault((*place, "filter"), f"a {model.name} has nothing to average: it samples no faster than it sends")
    reader.measures_only(device, "the device", "V")
    for channel in device.channels:
        reader.known(("channels", channel.name, "input"), "the device has no input", channel.input, INPUTS)
    return replace(options, ranges=codes)


def scan_inputs(device: DeviceRecord) -> list[str]:
    """Scanned inputs, each once, in the order of the scan list."""
    used = {channel.input for channel in device.channels}
    return [source for source in INPUTS if source in used]


END = b"\r"
STOP = b"stop\r"
ANSWER = 0.1
"""Longest wait for the echo of a command [s]."""
LOSSES, WITHIN = 3, 5.0
"""More losses than `LOSSES` within this time [s] are an error."""
SLIP = 0.1
"""Delay of the scans of a whole second above which scans must be missing [s]."""


class Dataq(SerialStream):
    """A DATAQ device: its inputs are `a0` to `a7` [V], all sampled at the device's own rate."""

    emulator = "pmabench_drivers.dataq.emulator"
    read_options = staticmethod(read_options)
    _options: Options

    def __init__(self, device: DeviceRecord, clock: Clock) -> None:
        self._inputs = scan_inputs(device)
        super().__init__(device, clock)
        self._spans = [self._options.span(source) for source in self._inputs]
        self._columns = [self._inputs.index(channel.input) for channel in device.channels]
        self._dividend, self._rate = DIVIDEND, 0.0

    def _forget(self) -> None:
        super()._forget()
        self._losses: list[float] = []
        self.lost = 0
        """How often the stream broke and was restarted; each is a gap in the times."""
        self._newest = -1.0
        self._begin_scans()

    def _begin_scans(self) -> None:
        self._scans = Scans(len(self._inputs))
        self._number = 0
        self._origin = math.nan
        self._echo: bytes | None = None
        self._pace = Pace(SLIP)

    def _greet(self) -> Identity:
        """Stop any scan in progress, check the model, and write the scan list."""
        self._quiet()
        identity = self._identity()
        self._ask("encode 0")
        for position, source in enumerate(self._inputs):
            number = int(source.removeprefix("a"))
            self._ask(f"slist {position} {self._options.ranges.get(source, 0) << 8 | number}")
            if self._options.model.decimates:
                self._ask(f"filter {number} {self._options.filter}")
        self._ask(f"slist {len(self._inputs)} {DIGITAL}")
        if self._options.model.decimates:
            self._ask("deca 1")
        return identity

    def start(self, rate: float) -> float:
        """Scan at the possible rate nearest to `rate` [Hz]; returns it."""
        port = self._ready(rate)
        srate, dec = divisors(self._options.model, rate, self._dividend)
        self._rate = self._dividend / (srate * dec)
        self._forget()
        self._ask(f"srate {srate}")
        if self._options.model.decimates:
            self._ask(f"dec {dec}")
        self._ask(f"ps {packet(2 * (len(self._inputs) + 1) * self._rate)}")
        port.send(b"start 0\r")
        self._heard = monotonic()
        port.listen(self._take)
        return self._rate

    @property
    def _patience(self) -> float:
        return max(STREAM_PATIENCE, 3 / self._rate)

    def _missing(self) -> str:
        return "has sent no scan"

    # -- the stream -------------------------------------------------------------------------------------------------

    def _take(self, data: bytes, now: float) -> None:
        """Process bytes that arrived at `now` [s, bench time]."""
        if self._failure:
            return
        if self._echo is not None:
            self._wait_for_echo(data)
            return
        broken = False
        try:
            self._scans.feed(data)
        except Lost:
            broken = True
        if whole := self._scans.whole:
            self._keep(whole, now)
        if broken:
            self._begin_again()

    def _keep(self, whole: list[tuple[int, ...]], now: float) -> None:
        if self._number == 0:
            # the scans before the last of this piece are older by one period each; after a loss, times still increase
            self._origin = max(now - (len(whole) - 1) / self._rate, self._newest + 2 / self._rate)
        self._heard = monotonic()
        model, spans = self._options.model, self._spans
        for words in whole:
            values = [volts(model, span, raw) for span, raw in zip(spans, words, strict=True)]
            self._newest = self._origin + self._number / self._rate
            self._number += 1
            row = [values[column] for column in self._columns]
            self._samples.append(round(self._newest * 1e9), row, round(now * 1e9))
        # scans are not numbered: missing ones make all that follow appear to be late
        if (behind := self._pace.behind(self._newest, now)) > 0:
            self._failure = f"is {behind:.2f} s behind its clock: scans are lost, or it is slower than it says"
        elif behind < 0:
            self._failure = f"sends more scans than {self._rate:g} a second"

    def _begin_again(self) -> None:
        """Stop after lost bytes, since the start of a scan cannot be found; start again after the echo of the stop."""
        now = monotonic()
        self.lost += 1
        self._losses = [moment for moment in self._losses if now - moment < WITHIN] + [now]
        if len(self._losses) > LOSSES:
            self._failure = f"lost bytes or ran over {len(self._losses)} times within {WITHIN:g} s"
            return
        self._echo = b""
        self._opened().send(STOP)

    def _wait_for_echo(self, data: bytes) -> None:
        self._echo = ((self._echo or b"") + data)[-len(STOP) :]
        if self._echo == STOP:
            self._begin_scans()
            self._opened().send(b"start 0\r")

    # -- requests ---------------------------------------------------------------------------------------------------

    def _quiet(self) -> None:
        """Stop a scan that may be in progress: its bytes arrive before the echo."""
        port = self._opened()
        for _ in range(2):
            port.drain()
            port.send(STOP)
            if port.receive(lambda got: got.endswith(STOP), ANSWER).endswith(STOP):
                return
        raise self._error('did not answer "stop": is it in its CDC mode?')

    def _ask(self, command: str) -> str:
        """Send a command, once more where no echo of it comes; the answer without the echo.

        Each command says the same when it is repeated; what the first one brings late is passed over.
        """
        port = self._opened()

        def answer(got: bytes) -> str | None:
            lines = [line.decode("ascii", "replace").strip() for line in got.split(END)[:-1]]
            return next((line for line in lines if line == command or line.startswith(f"{command} ")), None)

        data = b""
        for _ in range(2):
            port.drain()
            port.send(command.encode("ascii") + END)
            data = port.receive(lambda got: answer(got) is not None, ANSWER) or data
            if (line := answer(data)) is not None:
                return line.removeprefix(command).strip()
        text = data.decode("ascii", "replace").strip()
        heard = f'"{text[:40]}"' if data else "nothing"
        raise self._error(f'answered {heard} to "{command}"')

    def _identity(self) -> Identity:
        maker, model = self._ask("info 0"), self._ask("info 1")
        expected = self._options.model.name
        shown = model.removeprefix(UNPROVEN).removeprefix(EMULATED).removeprefix("DI-")
        if maker != "DATAQ" or shown != expected.removeprefix("DI-"):
            raise self._error(f'is "{maker[:20]} {model[:30]}", and the bench file says {expected}')
        firmware, serial, dividend = self._ask("info 2"), self._ask("info 6"), self._ask("info 9")
        if not dividend.isdecimal() or not 1_000_000 <= int(dividend) <= 1_000_000_000:
            raise self._error(f'reports "{dividend[:20]}" as the clock that its rate divides')
        self._dividend = int(dividend)
        return who("DATAQ", model, serial[:40], firmware[:40])
