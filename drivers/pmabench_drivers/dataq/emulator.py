"""An emulated DATAQ device on a pseudo-terminal, wired to the plant, with faults on demand."""

from __future__ import annotations

import random
import struct
from time import monotonic

from pmabench.bench.interface import DeviceRecord
from pmabench_drivers.dataq import DIGITAL, DIVIDEND, OVERRUN, counts, read_options
from pmabench_drivers.emulator.faults import NOISE, OVER, CommandLog, Fault
from pmabench_drivers.emulator.plant import RealPlant, Wiring
from pmabench_drivers.emulator.ports import Streaming
from pmabench_drivers.shared.options import options_of

GARBAGE = b"\x00\x7f\x15"
LEVELS = 0x7F00
"""The digital inputs without wires: all high."""
SET = {"encode": (0, 0), "ps": (0, 7), "srate": (375, 65535), "dec": (1, 512), "deca": (1, 40000)}


class Daq(Streaming):
    """One device; an input without a channel reads 0 V."""

    def __init__(self, device: DeviceRecord, plant: RealPlant, log: CommandLog) -> None:
        self._options, self._plant, self._name = options_of(device, read_options), plant, device.name
        super().__init__(device, log, NOISE, OVER, garbage=GARBAGE)
        self._wiring = Wiring(device, plant, log)
        self._list: list[int] = []
        self._set = {"encode": 0, "ps": 0, "srate": 6000, "dec": 1, "deca": 1}
        self._packet = b""

    def command(self, line: str) -> None:
        """Answer a command: the echo of the line, followed by the result."""
        if self.streaming and line != "stop":
            return  # it accepts no other command while it scans
        fault = self.next_fault() if not self.streaming else Fault()
        if fault.kind == "silence":
            return
        word, *numbers = line.split(" ")
        if word == "start":
            self.streaming, self.due, self._packet = True, monotonic(), b""
            return
        answer = self._carry_out(word, [int(number) for number in numbers if number.isdecimal()])
        self.terminal.write(self.outgoing(f"{line} {answer}".strip().encode() + b"\r", fault))

    def _carry_out(self, word: str, numbers: list[int]) -> str:
        if word == "stop":
            self.streaming = False
        elif word == "info" and len(numbers) == 1:
            answers = {0: "DATAQ", 1: self._plant.model(self._options.model.name.removeprefix("DI-")), 2: "65", 6: "1"}
            return {**answers, 9: str(DIVIDEND)}.get(numbers[0], "")
        elif word == "slist" and len(numbers) == 2 and numbers[0] <= (len(self._list) if numbers[0] else 0):
            self._list = [*self._list[: numbers[0]], numbers[1]]
        elif word in SET and len(numbers) == 1 and SET[word][0] <= numbers[0] <= SET[word][1]:
            self._set[word] = numbers[0]
        elif word != "filter" or len(numbers) != 2:
            return "?"
        return ""

    def send_what_is_due(self) -> None:
        """Send all scans up to now, in whole packets."""
        now = monotonic()
        period = self._set["srate"] * self._set["dec"] * self._set["deca"] / DIVIDEND
        while self.streaming and self.due <= now:
            quantities = self._plant.at(self.due)
            self.due += self.seconds(period)
            self._scan(quantities)

    def _scan(self, quantities: dict[str, float]) -> None:
        fault = self.next_fault()
        if fault.kind == "over":
            self.streaming = False
            self.terminal.write(OVERRUN)
            return
        data = b"".join(self._word(entry, quantities, fault) for entry in self._list)
        self._packet += self.outgoing(data, fault)
        size = 16 << self._set["ps"]
        while len(self._packet) >= size:
            self.terminal.write(self._packet[:size])
            self._packet = self._packet[size:]

    def _word(self, entry: int, quantities: dict[str, float], fault: Fault) -> bytes:
        if (number := entry & 0xF) == DIGITAL:
            return struct.pack("<H", LEVELS)
        value = self._wiring.raw(f"a{number}", quantities)
        if fault.kind == "noise":
            value += random.uniform(-fault.value, fault.value)
        span = float(self._options.model.ranges[entry >> 8].removesuffix(" V"))
        return struct.pack("<h", counts(self._options.model, span, value))


serve = Daq
"""Emulated device for the driver `dataq`."""
