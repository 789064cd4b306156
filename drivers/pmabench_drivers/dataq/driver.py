"""The device interface in front of a DATAQ device: settings as text, then scans; begins again after a loss."""

from __future__ import annotations

import math
from time import monotonic

from pmabench.base.clock import Clock
from pmabench.base.errors import DeviceError
from pmabench.bench.interface import EMULATED, UNPROVEN, DeviceRecord, Identity
from pmabench_drivers.dataq import wire as w
from pmabench_drivers.shared.polling import Pace
from pmabench_drivers.shared.serial_port import STREAM_PATIENCE, SerialStream

END = b"\r"
STOP = b"stop\r"
ANSWER = 0.1
"""Longest wait for the echo of a command [s]."""
LOSSES, WITHIN = 3, 5.0
"""More losses than this within so many seconds are an error."""
SLIP = 0.1
"""More than this the scans of a whole second may not be later than they were: scans are missing [s]."""


class Dataq(SerialStream):
    """A DATAQ device: its inputs are `a0` to `a7` [V], all taken at the device's own rate."""

    emulator = "pmabench_drivers.dataq.emulator"
    read_options = staticmethod(w.read_options)
    _options: w.Options

    def __init__(self, device: DeviceRecord, clock: Clock) -> None:
        self._inputs = w.scan_inputs(device)
        super().__init__(device, clock)
        self._spans = [self._options.span(source) for source in self._inputs]
        self._columns = [self._inputs.index(channel.input) for channel in device.channels]
        self._dividend, self._rate = w.DIVIDEND, 0.0

    def _forget(self) -> None:
        super()._forget()
        self._losses: list[float] = []
        self.lost = 0
        """How often the stream broke and was begun again; each is a gap in the times."""
        self._newest = -1.0
        self._begin_scans()

    def _begin_scans(self) -> None:
        self._scans = w.Scans(len(self._inputs))
        self._number = 0
        self._origin = math.nan
        self._echo: bytes | None = None
        self._pace = Pace(SLIP)

    def _greet(self) -> Identity:
        """Stop what is under way, see that it is the right device, and give it the scan list."""
        self._quiet()
        identity = self._identity()
        self._ask("encode 0")
        for position, source in enumerate(self._inputs):
            number = int(source.removeprefix("a"))
            self._ask(f"slist {position} {self._options.ranges.get(source, 0) << 8 | number}")
            if self._options.model.decimates:
                self._ask(f"filter {number} {self._options.filter}")
        self._ask(f"slist {len(self._inputs)} {w.DIGITAL}")
        if self._options.model.decimates:
            self._ask("deca 1")
        return identity

    def start(self, rate: float) -> float:
        """Scan at the rate nearest to `rate` [Hz] that the device can divide; returns it."""
        port = self._ready(rate)
        srate, dec = w.divisors(self._options.model, rate, self._dividend)
        self._rate = self._dividend / (srate * dec)
        self._forget()
        self._ask(f"srate {srate}")
        if self._options.model.decimates:
            self._ask(f"dec {dec}")
        self._ask(f"ps {w.packet(2 * (len(self._inputs) + 1) * self._rate)}")
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
        """Bytes that came at `now` [s, bench time]."""
        if self._failure:
            return
        if self._echo is not None:
            self._wait_for_echo(data)
            return
        try:
            whole = self._scans.feed(data)
            broken = False
        except w.Lost:
            whole, broken = self._scans.whole, True
        if whole:
            self._keep(whole, now)
        if broken:
            self._begin_again()

    def _keep(self, whole: list[tuple[int, ...]], now: float) -> None:
        if self._number == 0:
            # what came before this piece is older by as many periods; behind a loss time stays ahead of what was
            self._origin = max(now - (len(whole) - 1) / self._rate, self._newest + 2 / self._rate)
        self._heard = monotonic()
        model, spans = self._options.model, self._spans
        for words in whole:
            values = [w.volts(model, span, raw) for span, raw in zip(spans, words, strict=True)]
            self._newest = self._origin + self._number / self._rate
            self._number += 1
            self._samples.append(
                round(self._newest * 1e9), [values[column] for column in self._columns], round(now * 1e9)
            )
        # scans have no numbers: that some never came shows in that all that follow seem to come late
        behind = self._pace.behind(self._newest, now)
        if behind > 0:
            self._failure = f"is {behind:.2f} s behind its clock: scans are lost, or it is slower than it says"
        elif behind < 0:
            self._failure = f"sends more scans than {self._rate:g} a second"

    def _begin_again(self) -> None:
        """Stop after lost bytes, since nothing shows where a scan begins; start again after the echo of the stop."""
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

    # -- questions --------------------------------------------------------------------------------------------------

    def _quiet(self) -> None:
        """Stop a scan that may be under way: its bytes come before the echo."""
        port = self._opened()
        for _ in range(2):
            port.drain()
            port.send(STOP)
            if port.receive(lambda got: got.endswith(STOP), ANSWER).endswith(STOP):
                return
        raise DeviceError(self._device.name, 'did not answer "stop": is it in its CDC mode?')

    def _ask(self, command: str) -> str:
        """Send a command; the answer without the echo of the command."""
        port = self._opened()
        port.drain()
        port.send(command.encode("ascii") + END)
        data = port.receive(lambda got: END in got, ANSWER)
        line, end, _ = data.partition(END)
        text = line.decode("ascii", "replace").strip()
        if not end or not (text == command or text.startswith(f"{command} ")):
            heard = f'"{text[:40]}"' if data else "nothing"
            raise DeviceError(self._device.name, f'answered {heard} to "{command}"')
        return text.removeprefix(command).strip()

    def _identity(self) -> Identity:
        maker, model = self._ask("info 0"), self._ask("info 1")
        expected = self._options.model.name
        shown = model.removeprefix(UNPROVEN).removeprefix(EMULATED).removeprefix("DI-")
        if maker != "DATAQ" or shown != expected.removeprefix("DI-"):
            raise DeviceError(self._device.name, f'is "{maker[:20]} {model[:30]}", and the bench file says {expected}')
        firmware, serial, dividend = self._ask("info 2"), self._ask("info 6"), self._ask("info 9")
        if not dividend.isdecimal() or not 1_000_000 <= int(dividend) <= 1_000_000_000:
            raise DeviceError(self._device.name, f'reports "{dividend[:20]}" as the clock that its rate divides')
        self._dividend = int(dividend)
        return Identity("DATAQ", model, serial[:40], firmware[:40], simulated=model.startswith(EMULATED))
