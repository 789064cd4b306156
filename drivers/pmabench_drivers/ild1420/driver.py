"""The device interface in front of an ILD1420: settings when it is opened, then distances by the sensor's own clock."""

from __future__ import annotations

import re
from time import monotonic

from pmabench.base.errors import DeviceError
from pmabench.bench.interface import EMULATED, UNPROVEN, DeviceRecord, Identity
from pmabench_drivers.ild1420.wire import CounterBroken, Decoder, Numbering, Options, distance, misset, read_options
from pmabench_drivers.shared.options import Reader
from pmabench_drivers.shared.polling import Pace
from pmabench_drivers.shared.serial_port import SerialStream

PROMPT = b"->"
"""Ends each answer; inside a stream of values the two bytes cannot follow each other."""
ANSWER = 0.15
"""Longest wait for an answer [s]."""
LONGEST = 10.0
"""A jump of the counter over more than this is no loss [s]."""
SLIP = 0.3
"""More than this the measurements of a whole second may not be later than they were: the rate is another [s]."""
_ERROR = re.compile(rb"E\d{2,3}[^\r\n]*")
_FIELD = re.compile(r"^[\s>-]*([A-Za-z][A-Za-z -]*?) *: *([^\r\n/]*?) *(?://.*)?$", re.MULTILINE)


class Ild1420(SerialStream):
    """A laser sensor: its one input is `distance` [mm], from the begin of the measuring range."""

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

    @classmethod
    def fastest(cls, device: DeviceRecord) -> float:
        """The rate at which it measures [Hz]."""
        return float(cls.read_options(device, Reader()).rate)

    def _greet(self) -> Identity:
        """Quiet the sensor, see that it is the right one, and set what a true record needs."""
        self._silence()
        fields = self._ask("GETINFO").decode("ascii", "replace").replace("\r", "\n")
        identity = self._identity(dict(_FIELD.findall(fields)))
        self._ask(f"MEASRATE {self._options.rate / 1000:g}")
        for setting in ("OUTREDUCECOUNT 1", "OUTHOLD NONE", "OUTADD_RS422 COUNTER"):
            self._ask(setting)
        return identity

    def start(self, rate: float) -> float:
        """Begin to measure, at the sensor's own rate whatever is asked for [Hz]."""
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
        """Measurements that never came, by the counter; each is a gap in the times."""
        return self._numbering.lost

    # -- the stream -------------------------------------------------------------------------------------------------

    def _take(self, data: bytes, now: float) -> None:
        """Bytes that came at `now` [s, bench time]."""
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
        values = [distance(code, self._options.span)] * len(self._device.channels)
        self._samples.append(round(taken * 1e9), values, round(now * 1e9))

    # -- questions --------------------------------------------------------------------------------------------------

    def _quiet(self) -> None:
        """End the stream."""
        self._ask("OUTPUT NONE")

    def _silence(self) -> None:
        """End a stream that somebody left behind; its bytes may drown one answer."""
        for last in (False, False, True):
            try:
                self._quiet()
                break
            except DeviceError:
                if last:
                    raise

    def _ask(self, command: str, *, rest: bool = False) -> bytes:
        """The answer to a command, or what follows its prompt; an error is the sensor's own."""
        port = self._opened()
        port.drain()
        port.send(command.encode("ascii") + b"\n")
        data = port.receive(lambda got: PROMPT in got, ANSWER)
        answer, prompt, behind = data.partition(PROMPT)
        if not prompt:
            heard = f"{len(data)} bytes without the end of an answer" if data else "nothing"
            raise DeviceError(self._device.name, f'sent {heard} when it was asked "{command}"')
        refused = _ERROR.search(answer) if command != "OUTPUT NONE" else None
        if refused:
            text = refused[0].decode("ascii", "replace").strip()
            raise DeviceError(self._device.name, f'refuses "{command}": {text}')
        return behind if rest else answer

    def _identity(self, fields: dict[str, str]) -> Identity:
        name, expected = fields.get("Name", ""), self._options.span
        if not name.removeprefix(UNPROVEN).removeprefix(EMULATED).startswith("ILD1420"):
            raise DeviceError(self._device.name, f'is "{name[:40]}" and no ILD1420')
        span = re.fullmatch(r"(\d+(?:\.\d+)?) *mm", fields.get("Measuring range", ""))
        if span is None or float(span[1]) != expected:
            has = fields.get("Measuring range", "")[:20] or "without a range that it reports"
            raise DeviceError(self._device.name, f"is a sensor of {has}, and the bench file says {expected} mm")
        model = name[:60]
        return Identity(
            "Micro-Epsilon",
            model,
            fields.get("Serial", "")[:40],
            fields.get("Version", "")[:40],
            simulated=model.startswith(EMULATED),
        )
