"""An emulated CPX-E: process data on the plant, data system table, time-out, names, faults on demand.

Stricter than a terminal may be: only documented registers can be read; process data needs function 16, and the time-out
function 6. When its time-out ends it sets every output to 0 and closes every connection.
"""

from __future__ import annotations

import contextlib
import socket
from time import monotonic

from pmabench.bench.interface import DeviceRecord
from pmabench_drivers.emulator import modbus_server as frames
from pmabench_drivers.emulator.faults import CommandLog
from pmabench_drivers.emulator.modbus_server import WATCH, NamedDevice
from pmabench_drivers.emulator.plant import RealPlant, Wiring
from pmabench_drivers.festo_cpx_e import terminal as t
from pmabench_drivers.shared.options import options_of

CYCLE = 0.003
"""Delay until a written value appears in the modules' inputs and in the data system table [s]."""
DEFAULTS = {
    "16di": {0: 0x01, 1: 0x51},
    "8do": {0: 0x06, 1: 0x00},
    "4ai-ui": {0: 0x81, 1: 0x01, 6: 0xE0},
    "4ao-ui": {0: 0x86, 1: 0x0A, 6: 0x20},
}
"""Parameters of a module and their factory values, as Festo's client library describes each bit."""
FACTORY = 100
"""Factory time-out [ms]."""


def serve(device: DeviceRecord, plant: RealPlant, log: CommandLog) -> CpxDevice:
    """Emulated terminal for a device of the driver `festo-cpx-e`, on this machine."""
    return CpxDevice(EmulatedTerminal(device, options_of(device, t.read_options).terminal, plant, log), log)


class EmulatedTerminal(frames.NamedRegisters):
    """Registers of one terminal."""

    def __init__(self, device: DeviceRecord, terminal: t.Terminal, plant: RealPlant, log: CommandLog) -> None:
        super().__init__(device, "CPX-E-EP", plant.model("CPX-E"))
        self._terminal, self._plant, self._log = terminal, plant, log
        self._wiring = Wiring(device, plant, log)
        self._inputs, self._written = terminal.inputs(), terminal.outputs()
        self.statuses: dict[int, int] = {}
        """Address of a module's status -> its value; 0 if missing."""
        self.faults = self.status = 0
        """Bits of modules with faults, and the status of the terminal."""
        self.parameters: dict[int, int] = {}
        """Function number -> value."""
        for name, code in terminal.ranges.items():
            number, shift = terminal.module_of(name).range_of(int(name.partition(".")[2]))
            self.parameters[number] = self.parameters.get(number, 0) | code << shift
        for module in terminal.modules:
            for number, value in DEFAULTS[module.name].items():
                self.parameters[module.parameter(number)] = value
        self._words = {t.CONTROL: 0}
        self._words.update({register.address: 0 for register in self._written.values()})
        self._shown = dict.fromkeys(self._words, (0, 0, 0.0))
        self._read = 0
        self.timeout = FACTORY
        """Time without communication after which the outputs are set to 0 [ms]; 0: never."""
        self._fired = self._expire = False

    # -- requests -------------------------------------------------------------------------------------------------

    def hear(self) -> None:
        """Note any communication."""
        with self._lock:
            self._heard, self._fired = monotonic(), False

    def _cells(self) -> dict[int, int]:
        present = (1 << len(self._terminal.modules) + 1) - 1
        cells = {t.FIRST_INPUT + offset: 0 for offset in range(self._terminal.width)}
        for first, bits in ((t.PRESENT, present), (t.FAULTS, self.faults)):
            cells.update({first + i: bits >> 16 * i & 0xFFFF for i in range(3)})
        ready = self._show(t.CONTROL) & t.DONE
        cells.update({t.STATUS: self.status, t.READY: ready, t.VALUE_OUT: self._read, t.TIMEOUT.address: self.timeout})
        quantities = self._plant.quantities()
        for name, register in self._inputs.items():
            if (output := self._written.get(name)) is not None:
                word = self._show(output.address)
                cells[register.address] = word & 0xFF if register.bit >= 0 else word
            elif register.bit >= 0:
                cells[register.address] |= int(self._wiring.level(name)) << register.bit
            else:
                raw = round(self._wiring.raw(name, quantities))
                cells[register.address] = min(max(raw, -32768), 32767)
        cells.update(self.statuses)
        return cells

    def _write(self, request: frames.Request, connection: int, *, ignore: bool) -> None:
        if request.function != (6 if request.address == t.TIMEOUT.address else 16):
            raise frames.Refused(frames.VALUE)
        addresses = [request.address + offset for offset in range(request.count)]
        if not {*addresses} <= {*self._words, t.TIMEOUT.address}:
            raise frames.Refused(frames.ADDRESS)
        if ignore:
            return
        for address, word in zip(addresses, request.values, strict=True):
            if address == t.TIMEOUT.address:
                if 0 < word < FACTORY:
                    raise frames.Refused(frames.VALUE)
                self.timeout = word
                self._log.note("watchdog-register", self.device.name, raw=word, connection=connection)
                continue
            self._put(address, word)
            if address == t.CONTROL and word & t.DONE:
                self._table(word & 0x1FFF)
            elif address >= t.FIRST_OUTPUT:
                self._put_out(address, connection)

    def _table(self, number: int) -> None:
        self._read = self.parameters.get(number, 0)

    def _put(self, address: int, word: int) -> None:
        self._shown[address] = (self._show(address), word, monotonic() + CYCLE)
        self._words[address] = word

    def _show(self, address: int) -> int:
        """The value of a register as the module shows it: one cycle after it was written."""
        before, after, at = self._shown[address]
        return after if monotonic() >= at else before

    def _put_out(self, address: int, connection: int) -> None:
        """Apply a written register to the plant."""
        word = self._words[address]
        for name, register in self._written.items():
            if register.address != address:
                continue
            if register.bit < 0:
                self._wiring.set(name, word - (word >> 15 << 16), connection=connection)
            else:
                self._wiring.switch(name, on=bool(word >> register.bit & 1), connection=connection)

    # -- the time-out ---------------------------------------------------------------------------------------------

    def look_at_watchdog(self) -> None:
        """Do nothing: the connection checks the time-out by `fire`, and ends with it."""

    def expire_watchdog(self) -> bool:
        """Let the time-out end at the next check; returns whether it has one."""
        self._expire = self.timeout > 0
        return self._expire

    # -- what happens to it from outside --------------------------------------------------------------------------

    def restart(self) -> None:
        """Reset to power-on: all outputs 0, and the factory time-out."""
        with self._lock:
            self._drop_outputs()
            self._words = dict.fromkeys(self._words, 0)
            self._shown = dict.fromkeys(self._words, (0, 0, 0.0))
            self.timeout, self._read = FACTORY, 0
            self._heard, self._fired = monotonic(), False
            self._log.note("restart", self.device.name)

    def change_set_point(self, value: float) -> bool:
        """Write the first analogue output [count], as another program would; returns whether there is one."""
        with self._lock:
            if name := self._wiring.first_output:
                address = self._written[name].address
                self._put(address, round(value) & 0xFFFF)
                self._put_out(address, 0)
            return bool(name)

    # -- the end of the time-out ----------------------------------------------------------------------------------

    def fire(self) -> bool:
        """Whether the time-out ends now; then sets every output to 0."""
        with self._lock:
            silent = monotonic() - self._heard
            ends = self._expire or silent > self.timeout / 1e3
            if not self.timeout or self._fired or not ends:
                return False
            self._fired, self._expire = True, False
            if self._put_out_now():
                self._log.note("watchdog", self.device.name, silent=silent)
            self._drop_outputs()
            return True

    def _put_out_now(self) -> list[int]:
        """Addresses of outputs that are not 0."""
        return [address for address in self._words if address >= t.FIRST_OUTPUT and self._words[address]]

    def _drop_outputs(self) -> None:
        """Set every output to 0."""
        for address in self._put_out_now():
            self._put(address, 0)
            self._put_out(address, 0)


class CpxDevice(NamedDevice):
    """A terminal at its address; closes its connections when its time-out ends."""

    registers: EmulatedTerminal

    def _watch(self) -> None:
        while not self._ended.wait(WATCH):
            if self.registers.fire():
                for connection in list(self._open):
                    with contextlib.suppress(OSError):
                        connection.shutdown(socket.SHUT_RDWR)
