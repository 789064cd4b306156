"""An emulated ILD1420 on a pseudo-terminal, looking at the plant, with faults on demand."""

from __future__ import annotations

import random
import threading
import time
from time import monotonic

from pmabench.bench.interface import EMULATED, DeviceRecord
from pmabench_drivers.emulator.faults import Fault, Faults
from pmabench_drivers.emulator.log import CommandLog
from pmabench_drivers.emulator.plant import RealPlant
from pmabench_drivers.emulator.ports import Terminal
from pmabench_drivers.ild1420.options import Options, read_options
from pmabench_drivers.ild1420.wire import WRAP, code_of, encode
from pmabench_drivers.options import Reader

GARBAGE = b"\x8f\xff\x15"
TICK = 0.004
"""What falls due within this is sent together, from one look at the plant [s]."""
RATES = (0.25, 0.5, 1.0, 2.0, 4.0)
"""Measuring rates that it takes [kHz]."""


def serve(device: DeviceRecord, plant: RealPlant, _log: CommandLog) -> Sensor:
    """The sensor that a device of the driver `ild1420` talks to."""
    reader = Reader()
    options = read_options(device, reader)
    reader.refuse(device.name)
    return Sensor(device, options, plant)


class Sensor:
    """One sensor; `counter` may be set, to look at where it begins again."""

    def __init__(self, device: DeviceRecord, options: Options, plant: RealPlant) -> None:
        self._device, self._options, self._plant = device, options, plant
        self.address, self.faults = device.address, Faults()
        self._terminal = Terminal(device.address)
        self._ended = threading.Event()
        self._streaming = False
        self._rate = options.rate
        self._due = 0.0
        self.counter = 0
        self._thread = threading.Thread(target=self._serve, name=f"emulated {device.name}", daemon=True)

    def start(self) -> None:
        """Begin to serve."""
        self._thread.start()

    def close(self) -> None:
        """Hang up."""
        self._ended.set()
        self._terminal.close()

    def _serve(self) -> None:
        asked = b""
        while not self._ended.is_set():
            wait = min(max(TICK, self._due - monotonic()), 0.05) if self._streaming else 0.05
            received = self._terminal.read(wait)
            if received is None:
                return
            *lines, asked = (asked + received).replace(b"\r", b"\n").split(b"\n")
            asked = asked[-200:]
            try:
                for line in lines:
                    if line.strip():
                        self._command(line.decode("ascii", "replace").strip())
                if self._streaming:
                    self._measure_what_is_due()
            except ConnectionAbortedError:
                self._terminal.close()
                return
            except OSError:
                return

    def _command(self, line: str) -> None:
        fault = self._fault()
        if fault.kind == "deaf":
            return
        if fault.kind == "slow":
            time.sleep(fault.value)
        word, _, value = line.partition(" ")
        answer = f"E{int(fault.value):03d} refused" if fault.kind == "exception" else self._carry_out(word, value)
        data = f"{line} {answer}".strip().encode() + b"\r\n->"
        if fault.kind != "mute":
            self._terminal.write(data[: len(data) - int(fault.value)] if fault.kind == "cut" else data)

    def _carry_out(self, word: str, value: str) -> str:
        if word == "GETINFO":
            span = self._options.span
            return (
                f"\r\nName: {EMULATED}ILD1420-{span}\r\nSerial: 1\r\nOption: 000\r\nMeasuring range: {span}.00mm\r\n"
                "Version: 001.000"
            )
        if word == "OUTPUT" and value in {"NONE", "RS422"}:
            self._streaming = value == "RS422"
            self._due = monotonic()
        elif word == "MEASRATE" and value in {f"{rate:g}" for rate in RATES}:
            self._rate = float(value) * 1000.0
        elif f"{word} {value}" not in {"OUTREDUCECOUNT 1", "OUTHOLD NONE", "OUTADD_RS422 COUNTER"}:
            return "E220 unknown command or value"
        return "ok"

    def _measure_what_is_due(self) -> None:
        quantities, now, data = self._plant.quantities(), monotonic(), b""
        while self._due <= now:
            self._due += 1.0 / self._rate
            data += self._measure(quantities)
        if data:
            self._terminal.write(data)

    def _measure(self, quantities: dict[str, float]) -> bytes:
        """One measurement, with the fault of the moment; the counter counts also what is lost on the wire."""
        fault = self._fault()
        counter, self.counter = self.counter, (self.counter + 1) % WRAP
        if fault.kind in {"deaf", "mute"}:
            return b""
        if fault.kind == "slow":
            time.sleep(fault.value)
        raw = 0.0
        for channel in self._device.channels[:1]:
            raw = float(channel.scale.to_raw(quantities.get(channel.name, 0.0)))
        if fault.kind == "noise":
            raw += random.uniform(-fault.value, fault.value)
        code = code_of(raw, self._options.span)
        if fault.kind == "over":
            code = 262078
        elif fault.kind == "exception":
            code = int(fault.value)
        data = encode(code, counter)
        if fault.kind == "cut":
            data = data[: max(0, len(data) - int(fault.value))]
        elif fault.kind == "garbage":
            data = GARBAGE + data
        elif fault.kind == "double":
            data *= 2
        return data

    def _fault(self) -> Fault:
        fault = self.faults.next()
        if fault.kind in {"drop", "reset"}:
            raise ConnectionAbortedError
        return fault
