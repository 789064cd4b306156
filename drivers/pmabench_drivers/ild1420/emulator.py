"""An emulated ILD1420 on a pseudo-terminal, which measures the plant, with faults on demand."""

from __future__ import annotations

import random
from time import monotonic

from pmabench.bench.interface import DeviceRecord
from pmabench_drivers.emulator.faults import EXCEPTION, NOISE, OVER, CommandLog
from pmabench_drivers.emulator.plant import RealPlant, Wiring
from pmabench_drivers.emulator.ports import Streaming
from pmabench_drivers.ild1420 import INPUT, WRAP, code_of, encode, read_options
from pmabench_drivers.shared.options import options_of

GARBAGE = b"\x8f\xff\x15"
RATES = (0.25, 0.5, 1.0, 2.0, 4.0)
"""Measuring rates that it accepts [kHz]."""


class Sensor(Streaming):
    """One sensor; `counter` may be set, to test its restart at 0."""

    def __init__(self, device: DeviceRecord, plant: RealPlant, log: CommandLog) -> None:
        self._options, self._plant, self._wiring = options_of(device, read_options), plant, Wiring(device, plant, log)
        super().__init__(device, log, EXCEPTION, NOISE, OVER, garbage=GARBAGE)
        self._rate = self._options.rate
        self.counter = 0
        self.locked = False
        """Whether its key does nothing."""

    def command(self, line: str) -> None:
        """Answer as a sensor does; each answer ends with the prompt."""
        fault = self.next_fault()
        if fault.kind == "silence":
            return
        word, _, value = line.partition(" ")
        answer = f"E{int(fault.value):03d} refused" if fault.kind == "exception" else self._carry_out(word, value)
        self.terminal.write(self.outgoing(f"{line} {answer}".strip().encode() + b"\r\n->", fault))

    def _carry_out(self, word: str, value: str) -> str:
        if word == "GETINFO":
            span, name = self._options.range, self._plant.model("ILD1420")
            about = f"\r\nName: {name}-{span}\r\nSerial: 1\r\nOption: 000\r\nMeasuring range: {span}.00mm"
            return f"{about}\r\nVersion: 001.000"
        if word == "OUTPUT" and value in {"NONE", "RS422"}:
            self.streaming = value == "RS422"
            self.due = monotonic()
        elif word == "MEASRATE" and value in {f"{rate:g}" for rate in RATES}:
            self._rate = float(value) * 1000.0
        elif f"{word} {value}" == "KEYLOCK ACTIVE":
            self.locked = True
        elif f"{word} {value}" not in {"OUTREDUCECOUNT 1", "OUTHOLD NONE", "OUTADD_RS422 COUNTER"}:
            return "E220 unknown command or value"
        return "ok"

    def send_what_is_due(self) -> None:
        """Send all measurements up to now."""
        now, data = monotonic(), b""
        while self.due <= now:
            quantities = self._plant.at(self.due)
            self.due += self.seconds(1.0 / self._rate)
            data += self._measure(quantities)
        if data:
            self.terminal.write(data)

    def _measure(self, quantities: dict[str, float]) -> bytes:
        """One measurement, with the present fault; the counter also counts measurements lost on the line."""
        fault = self.next_fault()
        counter, self.counter = self.counter, (self.counter + 1) % WRAP
        raw = self._wiring.raw(INPUT, quantities)
        if fault.kind == "noise":
            raw += random.uniform(-fault.value, fault.value)
        code = code_of(raw, self._options.range)
        if fault.kind == "over":
            code = 262078
        elif fault.kind == "exception":
            code = int(fault.value)
        return self.outgoing(encode(code, counter), fault)


serve = Sensor
"""Emulated sensor for a device of the driver `ild1420`."""
