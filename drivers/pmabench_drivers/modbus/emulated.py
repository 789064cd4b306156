"""An emulated Modbus device: registers read from the plant, effects of writes on it, and its watchdog.

Served according to the device's own register map; addresses outside the map answer with exception 2.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable
from time import monotonic

from pmabench.bench.interface import DeviceRecord
from pmabench_drivers.emulator.faults import CommandLog
from pmabench_drivers.emulator.modbus_server import ADDRESS, VALUE, Refused, Request, RtuDevice, TcpDevice
from pmabench_drivers.emulator.plant import RealPlant, Wiring
from pmabench_drivers.modbus.registers import TYPES, Mapped, Register, WatchdogRegisters, decode, encode, read_options
from pmabench_drivers.shared.options import options_of


def serve(device: DeviceRecord, plant: RealPlant, log: CommandLog) -> TcpDevice | RtuDevice:
    """Emulated device for a device of the driver `modbus`: TCP, or RTU on a pseudo-terminal."""
    options = options_of(device, read_options)
    registers = Registers(device, options, plant, log)
    if device.address.startswith("/"):
        return RtuDevice(registers, options.map.unit_id, log, device.address)
    return TcpDevice(registers, options.map.unit_id, log, int(device.address.rpartition(":")[2]))


class Registers:
    """One device on the plant."""

    def __init__(self, device: DeviceRecord, options: Mapped, plant: RealPlant, log: CommandLog) -> None:
        self.device, self._map, self._plant, self._log = device, options.map, plant, log
        self._lock = threading.Lock()
        self._held: dict[tuple[str, int], int] = {}
        self._wiring = Wiring(device, plant, log)
        watchdog = self._map.watchdog
        own = [r for r in (watchdog.timeout, watchdog.trigger, watchdog.heartbeat) if r] if watchdog else []
        self._written = [*self._map.outputs.values(), *own]
        for item in self._map.identity.values():
            if isinstance(item, Register):
                self._store(item, self._identity(item))
        self._power_on()

    def _power_on(self) -> None:
        """Reset every written register to power-on: outputs safe, watchdog off."""
        self._started = self._heard = monotonic()
        self._fired = False
        for register in self._written:
            self._store(register, [0] * register.count)
        self._vent()

    # -- requests -------------------------------------------------------------------------------------------------

    def carry_out(self, request: Request, connection: int, *, ignore: bool = False) -> list[int]:
        """Registers read, or an empty list for a write; raises `Refused`."""
        with self._lock:
            watchdog = self._map.watchdog
            if watchdog is None or watchdog.heartbeat is None:
                self._heard = monotonic()
            if request.values:
                self._write(request, connection, ignore=ignore)
                return []
            return self._read(request)

    def _read(self, request: Request) -> list[int]:
        cells = dict(self._held)
        if (uptime := self._map.uptime) is not None:
            seconds = int(monotonic() - self._started) % (1 << 16 * uptime.count)
            cells |= {(uptime.table, uptime.address + i): word for i, word in enumerate(encode(uptime, seconds))}
        wanted = [(request.table, request.address + offset) for offset in range(request.count)]
        shown = [
            register
            for register in self._map.inputs.values()
            if (register.table, register.address) not in self._held  # else it shows the commanded value
            and any((register.table, register.address + offset) in wanted for offset in range(register.count))
        ]
        quantities = self._plant.quantities() if shown else {}  # computing the plant takes time
        for register in shown:
            for offset, word in enumerate(self._input(register, quantities)):
                key = register.table, register.address + offset
                merged = register.bit >= 0 and key in cells
                cells[key] = cells[key] | word if merged else word
        if any(key not in cells for key in wanted):
            raise Refused(ADDRESS)
        return [cells[key] for key in wanted]

    def _write(self, request: Request, connection: int, *, ignore: bool) -> None:
        keys = [(request.table, request.address + offset) for offset in range(request.count)]
        touched = [r for r in self._written if any((r.table, r.address + i) in keys for i in range(r.count))]
        known = {(r.table, r.address + i) for r in touched for i in range(r.count)}
        if not set(keys) <= known:
            raise Refused(ADDRESS)
        if not known <= set(keys):
            raise Refused(VALUE)  # half of a 32-bit value
        if ignore:
            return
        self._held.update(zip(keys, request.values, strict=True))
        for register in touched:
            self._written_to(register, connection)

    # -- what registers mean --------------------------------------------------------------------------------------

    def _input(self, register: Register, quantities: dict[str, float]) -> Iterable[int]:
        if register.name in self._wiring.channels:
            raw = self._wiring.raw(register.name, quantities)
            if register.type != "float32" and not register.is_bit:
                low, high = _range(register.type)
                raw = min(max(round(raw), low), high)
            return encode(register, raw)
        level = self._wiring.level(register.name)
        if register.bit >= 0:
            return [int(level) << register.bit] if register.count == 1 else [0] * register.count
        return encode(register, float(level))

    def _identity(self, register: Register) -> list[int]:
        if register.type == "text":
            text = self._plant.model(self.device.name).encode("ascii", "replace")[: 2 * register.length]
            text = text.ljust(2 * register.length, b"\0")
            return [int.from_bytes(text[i : i + 2], "big") for i in range(0, len(text), 2)]
        return encode(register, 1.0 if register.expect is None else register.expect)

    def _store(self, register: Register, words: Iterable[int]) -> None:
        for offset, word in enumerate(words):
            self._held[register.table, register.address + offset] = word

    def _value(self, register: Register) -> float:
        return decode(register, [self._held[register.table, register.address + i] for i in range(register.count)])

    def _written_to(self, register: Register, connection: int) -> None:
        raw, watchdog, name = self._value(register), self._map.watchdog, register.name
        if watchdog is not None and register in {watchdog.timeout, watchdog.trigger, watchdog.heartbeat}:
            self._heard = monotonic()
            if register == watchdog.trigger or (register == watchdog.timeout and watchdog.trigger is None):
                self._fired = False
            self._log.note("watchdog-register", self.device.name, register=name, raw=raw, connection=connection)
            return
        self._wiring.set(name, raw, connection=connection, held=self._fired)
        self._wiring.switch(name, on=raw != 0, connection=connection, held=self._fired)

    # -- the device's watchdog ------------------------------------------------------------------------------------

    def look_at_watchdog(self) -> None:
        """Vent by itself if the watchdog is armed and nothing was received for its time."""
        watchdog = self._map.watchdog
        with self._lock:
            if watchdog is not None:
                timeout = self._value(watchdog.timeout) * watchdog.resolution
                if monotonic() - self._heard > timeout and self._armed(watchdog):
                    self._fire(watchdog)

    def expire_watchdog(self) -> bool:
        """Vent by itself now; returns whether the watchdog was armed."""
        return self._end_watchdog(self._fire)

    def switch_off_watchdog(self) -> bool:
        """Switch the watchdog off, as another program would; returns whether it was armed."""
        return self._end_watchdog(self._store_off)

    def _end_watchdog(self, act: Callable[[WatchdogRegisters], None]) -> bool:
        with self._lock:
            watchdog = self._map.watchdog
            if watchdog is None or not self._armed(watchdog):
                return False
            act(watchdog)
            return True

    def _store_off(self, watchdog: WatchdogRegisters) -> None:
        """Set the registers of a stopped watchdog."""
        if watchdog.trigger is None:
            self._store(watchdog.timeout, [0] * watchdog.timeout.count)
        else:
            self._store(watchdog.trigger, encode(watchdog.trigger, watchdog.off))

    # -- what happens to it from outside --------------------------------------------------------------------------

    def restart(self) -> None:
        """Reset to power-on."""
        with self._lock:
            self._power_on()

    def change_set_point(self, value: float) -> bool:
        """Command the first output [register], as another program would; returns whether there is one."""
        with self._lock:
            for output in self.device.outputs[:1]:
                register = self._map.outputs[output.output]
                self._store(register, encode(register, value))
                self._plant.command(float(output.scale.to_si(value)))
            return bool(self.device.outputs)

    def _armed(self, watchdog: WatchdogRegisters) -> bool:
        triggered = watchdog.trigger is None or self._value(watchdog.trigger) == watchdog.on
        return triggered and self._value(watchdog.timeout) > 0 and not self._fired

    def _fire(self, watchdog: WatchdogRegisters) -> None:
        self._fired = True
        self._store_off(watchdog)
        self._vent()
        self._log.note("watchdog", self.device.name, silent=monotonic() - self._heard)

    def _vent(self) -> None:
        for output in self.device.outputs:
            register = self._map.outputs[output.output]
            self._store(register, encode(register, float(output.scale.to_raw(output.safe))))
            self._plant.command(output.safe)
        for valve in self.device.valves:
            self._store(self._map.outputs[valve.output], [0] * self._map.outputs[valve.output].count)
            self._plant.switch(on=valve.energised != "closed")


def _range(kind: str) -> tuple[int, int]:
    bits = 16 * TYPES[kind][1]
    return (-(1 << bits - 1), (1 << bits - 1) - 1) if kind.startswith("int") else (0, (1 << bits) - 1)
