"""An emulated serial indicator: sends lines of text about the plant, when asked or by itself, with faults on demand."""

from __future__ import annotations

import random
import threading

from pmabench.bench.interface import DeviceRecord
from pmabench_drivers.emulator.faults import LINK, NOISE, OVER, SKEW, STUCK, UNIT, DeviceClock, Faults, Outgoing
from pmabench_drivers.emulator.log import CommandLog
from pmabench_drivers.emulator.plant import RealPlant
from pmabench_drivers.emulator.ports import Terminal
from pmabench_drivers.options import Reader
from pmabench_drivers.serial_ascii.options import Options, read_options

OTHER_UNITS = {"N": "kg", "kN": "kg", "kg": "lb", "mm": "in", "cm": "in", "um": "mil", "kPa": "bar", "bar": "psi"}
GARBAGE = b"\x00\x7f@#"
KINDS = (LINK, STUCK, NOISE, OVER, UNIT)


def serve(device: DeviceRecord, plant: RealPlant, log: CommandLog) -> Indicator:
    """The indicator that a device of the driver `serial-ascii` talks to."""
    reader = Reader()
    options = read_options(device, reader)
    reader.refuse(device.name)
    return Indicator(device, options, plant, log)


class Indicator:
    """One indicator on a pseudo-terminal; the line is the option `emulate`, its number the first channel's."""

    def __init__(self, device: DeviceRecord, options: Options, plant: RealPlant, log: CommandLog) -> None:
        self._device, self._options, self._plant = device, options, plant
        self.address, self.faults = device.address, Faults(*KINDS, *(() if options.poll else (SKEW,)))
        self._terminal, self._outgoing = Terminal(device.address, log.tap(device.name)), Outgoing(GARBAGE)
        self._ended = threading.Event()
        target = self._serve if options.poll else self._send_by_itself
        self._thread = threading.Thread(target=target, name=f"emulated {device.name}", daemon=True)

    def start(self) -> None:
        """Begin to serve."""
        self._thread.start()

    def close(self) -> None:
        """Hang up."""
        self._ended.set()
        self._terminal.close()

    def _serve(self) -> None:
        asked, poll, identity = b"", self._options.poll, self._options.ask_identity
        while not self._ended.is_set():
            received = self._terminal.read(0.05)
            if received is None:
                return
            asked = (asked + received)[-100:]
            if identity and identity in asked:
                asked = asked.split(identity, 1)[1]
                self._write(self._plant.model(self._device.name).encode() + self._options.terminator)
            while poll in asked:
                asked = asked.split(poll, 1)[1]
                if not self._send():
                    return

    def _send_by_itself(self) -> None:
        clock, due, period = DeviceClock(self.faults), 0.0, 1.0 / self._options.rate
        while not self._ended.wait(max(0.0, due - clock.now())):
            due += period
            if not self._send():
                return

    def _send(self) -> bool:
        """One line, with the fault of the moment; whether there is anybody to send to."""
        fault = self.faults.next()
        if fault.kind in {"hang-up", "reset"}:
            self._terminal.close()
            return False
        line = self._line(fault.kind, fault.value)
        return self._write(self._outgoing.of(line.encode("ascii", "replace"), fault))

    def _line(self, fault: str, size: float) -> str:
        end = self._options.terminator.decode("ascii")
        if fault == "over":
            return (self._options.over_range or ("OL",))[0] + end
        quantities = self._plant.quantities()
        channel = self._device.channels[0]
        raw = float(channel.scale.to_raw(quantities.get(channel.name, 0.0)))
        line = self._options.emulate % (raw + random.uniform(-size, size) if fault == "noise" else raw)
        if fault == "unit":
            unit = self._options.unit or channel.raw_unit
            line = line.replace(unit, OTHER_UNITS.get(unit, "XX"))
        return line

    def _write(self, data: bytes) -> bool:
        try:
            self._terminal.write(data)
        except OSError:
            return False
        return True
