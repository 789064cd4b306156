"""An emulated T7, T8 or T4: its registers, DACs, digital lines and watchdog on the simulated muscle."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from math import isfinite
from time import monotonic

from pmabench.base.errors import UsageError
from pmabench.bench.interface import DeviceRecord
from pmabench_drivers.emulator.faults import EXPIRY, RESTART, SETPOINT, SKEW, WATCHDOG_OFF, CommandLog, Faults
from pmabench_drivers.emulator.modbus_server import ADDRESS, FUNCTION, KINDS, VALUE, Refused, Request, TcpDevice
from pmabench_drivers.emulator.plant import RealPlant, Wiring
from pmabench_drivers.emulator.ports import host_of
from pmabench_drivers.labjack import emulated_map as m
from pmabench_drivers.labjack import registers as r
from pmabench_drivers.labjack.registers import Options, read_options
from pmabench_drivers.labjack.stream import COUNT, FLASH
from pmabench_drivers.shared.options import options_of

FAILED = 4
"""Exception code of all errors that have a code of LabJack's."""
SLOPES = ((3.1592e-4, -3.1571e-4, 33511.0), (3.1590e-5, -3.1575e-5, 33498.5))
"""Calibration constants of this device, different from the nominal ones: slopes and centre for 10 V and 1 V."""
DAC_END = 0.993
"""Fraction of its full voltage that a DAC reaches."""
BUFFER = 2 * 4096
FLASHED = (r.WATCHDOG_ENABLE, r.WATCHDOG_ENABLE + 100)
"""Registers that keep their value at power-on."""
POWER_ON = 1
"""Bit 0 of the cause of the last restart."""
FIRMWARE = 1.0331


def constants() -> list[float]:
    """The calibration in its flash, 41 numbers."""
    found: list[float] = []
    for gain in range(4):
        positive, negative, center = SLOPES[min(gain, 1)]
        shrink = 10.0 ** (max(gain, 1) - 1)
        found += [positive / shrink, negative / shrink, center, -positive / shrink * center]
    return found + [0.0] * (COUNT - len(found))


def counts(volts: float, gain: int) -> int:
    """Count of its converter for a voltage."""
    positive, negative, center = constants()[4 * gain : 4 * gain + 3]
    raw = center + volts / positive if volts >= 0 else center - volts / negative
    return min(max(round(raw), 0), 65535)


def serve(device: DeviceRecord, plant: RealPlant, log: CommandLog) -> EmulatedT7:
    """Emulated device for a device of the driver `labjack`."""
    options = options_of(device, read_options)
    stream_port = options.stream_port if options.kind.streams else 0
    return EmulatedT7(device, options, plant, log, options.port, stream_port)


class _Faults(Faults):
    """Faults of the link, and those of the stream."""

    def __init__(self, stream: m.Streamer) -> None:
        super().__init__(*KINDS, SKEW, EXPIRY, WATCHDOG_OFF, RESTART, SETPOINT, m.FAULTS)
        self._stream = stream

    def set(self, kind: str, value: float | None = None, count: int = -1) -> None:
        """Faults of the stream occur once; others as for any link."""
        if kind in m.FAULTS:
            self._stream.fault(kind, m.FAULTS[kind].usual if value is None else value)
        else:
            super().set(kind, value, count)


class EmulatedT7(TcpDevice):
    """Commands on one port, the stream on another; port 0 takes free ones."""

    def __init__(
        self, device: DeviceRecord, options: Options, plant: RealPlant, log: CommandLog, port: int, stream_port: int
    ) -> None:
        self.stream = m.Streamer(device.name, host_of(device.address), stream_port, log)
        try:
            self.t7 = T7(device, options, plant, log, self.stream)
            super().__init__(self.t7, 1, log, port)
        except UsageError:
            self.stream.close()
            raise
        self.stream_port = self.stream.port
        self.faults = self.stream.faults = _Faults(self.stream)

    def start(self) -> None:
        """Start serving."""
        super().start()
        self.stream.start()

    def close(self) -> None:
        """Stop serving."""
        super().close()
        self.stream.close()


class T7:
    """Registers of a model, stored as words by address."""

    def __init__(
        self, device: DeviceRecord, options: Options, plant: RealPlant, log: CommandLog, stream: m.Streamer
    ) -> None:
        self.device, self._plant, self._log, self._stream = device, plant, log, stream
        self._model = options.kind
        self._inputs = 2 * len(self._model.inputs)
        """Number of registers of its analogue inputs."""
        self._lock = threading.RLock()
        self._wiring = Wiring(device, plant, log)
        self._inputs_by_number = {options.inputs[channel.name].number: channel.input for channel in device.channels}
        self._valves = {r.line_of(valve.output): valve.output for valve in device.valves}
        self._locks = {r.line_of(lock.input): lock.input for lock in device.interlocks}
        self._words: dict[int, int] = {}
        self._values = m.values_of(options.kind)
        self._shown = self._show()
        self._last_error = 0
        self._levels = self._directions = 0
        self._cleared, self._started, self._fired = monotonic(), monotonic(), False
        self.sample: Callable[[int], list[int]] | None = None
        """Replaces the plant in tests of the stream: returns the counts of a scan by its number."""
        self._defaults()

    def _defaults(self) -> None:
        self._words.clear()
        for address, value in self._values.items():
            self._store(address, value.words)
        self._store(r.PRODUCT_ID, r.f32(self._model.product))
        self._store(r.FIRMWARE_VERSION, r.f32(FIRMWARE))
        self._store(r.SERIAL_NUMBER, r.u32(r.EMULATED if self._plant.proven else r.UNPROVEN))
        self._store(r.RESET_CAUSE, r.u32(POWER_ON))

    def _store(self, address: int, words: list[int]) -> None:
        for offset, word in enumerate(words):
            self._words[address + offset] = word

    def _u32(self, address: int) -> int:
        return self._words[address] << 16 | self._words[address + 1]

    def _f32(self, address: int) -> float:
        return r.from_f32([self._words[address], self._words[address + 1]])[0]

    def _refuse(self, code: int) -> None:
        self._last_error = code
        raise Refused(FAILED)

    # -- requests -------------------------------------------------------------------------------------------------

    def carry_out(self, request: Request, connection: int, *, ignore: bool = False) -> list[int]:
        """Registers read, or an empty list for a write; raises `Refused`."""
        with self._lock:
            if not self._u32(r.WATCHDOG_STRICT):
                self._cleared, self._fired = monotonic(), False
            if request.table not in {"holding", "input"}:
                raise Refused(FUNCTION)
            if request.values:
                self._write(request.address, list(request.values), connection, ignore=ignore)
                return []
            return self._read(request.address, request.count)

    def _whole(self, address: int, count: int, access: str) -> list[tuple[int, m.Value]]:
        try:
            return list(m.whole(self._values, address, count, access))
        except m.Unknown:
            raise Refused(ADDRESS) from None
        except m.Cut:
            self._refuse(2315)
            raise

    def _read(self, address: int, count: int) -> list[int]:
        asked = self._whole(address, count, "R")
        if any(at < self._inputs for at, _value in asked):
            self._read_inputs()
        for at, _value in asked:
            if at in self._shown:
                self._store(at, self._shown[at]())
            elif r.DIO <= at < r.DIO + len(r.LINES):
                self._words[at] = self._read_line(at - r.DIO)
        if address == r.FLASH_READ:
            return self._read_flash(count)
        return [self._words[address + offset] for offset in range(count)]

    def _show(self) -> dict[int, Callable[[], list[int]]]:
        """Registers that are computed when read: address -> function that returns their words."""
        return {
            r.LAST_ERR_DETAIL: lambda: [self._last_error],
            r.STREAM_SCANRATE: lambda: r.f32(self._actual_rate()),
            r.RTC_TIME: lambda: r.u32(int(monotonic() - self._started)),
            r.DIO_STATE: lambda: r.u32(sum(self._terminal(line) << line for line in range(len(r.LINES)))),
            r.DIO_DIRECTION: lambda: r.u32(self._directions),
        }

    def _read_inputs(self) -> None:
        """Store the volts of all inputs; a model that captures takes all of them at this moment."""
        if self._stream.running:
            self._refuse(2605)
        quantities = self._plant.quantities()
        words = r.f32(*(self._volts(number, quantities) for number in range(self._inputs // 2)))
        self._store(0, words)
        if self._model.captures:
            self._store(r.CAPTURE, words)

    def _read_flash(self, count: int) -> list[int]:
        first = (self._u32(r.FLASH_POINTER) - FLASH) // 4
        wanted = constants()[first : first + count // 2] if first >= 0 else []
        if count % 2 or len(wanted) != count // 2:
            self._refuse(2315)
        return r.f32(*wanted)

    def _write(self, address: int, words: list[int], connection: int, *, ignore: bool) -> None:
        asked = self._whole(address, len(words), "W")
        given = {at: words[at - address : at - address + m.WORDS[value.type]] for at, value in asked}
        self._refuse_wrong(given)
        if ignore:
            return
        for at, part in given.items():
            self._take(at, part, connection)

    def _refuse_wrong(self, given: dict[int, list[int]]) -> None:
        """Raise LabJack's own error for an invalid value, or one that is impossible in the present state."""
        for at, part in given.items():
            if self._u32(r.WATCHDOG_ENABLE) and r.WATCHDOG_ENABLE < at < FLASHED[1] and at != r.WATCHDOG_CLEAR:
                self._refuse(2671)
            if self._stream.running and (r.STREAM_SCANRATE <= at < r.STREAM_ENABLE or r.AIN_RANGE <= at < 41100):
                self._refuse(2605)
            if self._values[at].type == m.F32 and not isfinite(r.from_f32(part)[0]):
                raise Refused(VALUE)
            if at == r.WATCHDOG_ENABLE and part[1] and self._u32(r.WATCHDOG_TIMEOUT) < 1:
                self._refuse(2670)
            self._refuse_wrong_input(at, part)

    def _refuse_wrong_input(self, at: int, part: list[int]) -> None:
        """The same for settings of the analogue inputs."""
        count = len(self._model.inputs)
        if r.AIN_RANGE <= at < r.AIN_RANGE + 2 * count and self._model.ranges:
            [span] = r.from_f32(part)
            if span and not any(abs(span - known) < 0.01 * known for _gain, known in self._model.ranges.values()):
                self._refuse(2370)
        number = at - r.AIN_NEGATIVE
        if 0 <= number < count and part[0] != r.SINGLE_ENDED and (number % 2 or part[0] != number + 1):
            self._refuse(2373)

    def _take(self, at: int, part: list[int], connection: int) -> None:
        """Carry out the write of one value."""
        if r.DIO <= at < r.DIO + len(r.LINES):
            self._set_line(at - r.DIO, high=part[0] != 0, connection=connection)
        elif at == r.WATCHDOG_CLEAR:
            if not self._u32(r.WATCHDOG_STRICT) or r.from_u32(part) == [self._u32(r.WATCHDOG_KEY)]:
                self._cleared, self._fired = monotonic(), False
        elif at == r.STREAM_ENABLE:
            self._enable_stream(on=part[1] != 0)
        elif at in {r.DAC, r.DAC + 2}:
            self._set_dac(at, r.from_f32(part)[0], connection)
        else:
            self._store(at, part)
        if at == r.WATCHDOG_ENABLE:
            self._cleared, self._fired = monotonic(), False
            self._log.note("watchdog-register", self.device.name, raw=part[1], connection=connection)

    # -- terminals ------------------------------------------------------------------------------------------------

    def _set_dac(self, at: int, volts: float, connection: int) -> None:
        """Output a voltage within the DAC's range; beyond it, the limit is read back (datasheet, 15.0 DAC)."""
        volts = min(max(volts, 0.0), DAC_END * self._model.dac_full)
        self._store(at, r.f32(volts))
        step = self._model.dac_step
        name, reached = r.DACS[(at - r.DAC) // 2], round(volts / step) * step
        self._wiring.set(name, volts, reached=reached, connection=connection)

    def _set_line(self, line: int, *, high: bool, connection: int) -> None:
        self._directions |= 1 << line
        self._levels = self._levels | 1 << line if high else self._levels & ~(1 << line)
        self._valve_follows(line, connection)

    def _valve_follows(self, line: int, connection: int = 0) -> None:
        """Switch a valve's relay, energised while the line is an output and high; `connection` 0: not commanded."""
        name, on = self._valves.get(line, ""), bool(self._levels & self._directions & 1 << line)
        if connection:
            self._wiring.switch(name, on=on, connection=connection)
        else:
            self._wiring.drive(name, on=on)

    def _read_line(self, line: int) -> int:
        """Read a line, which makes it an input."""
        self._directions &= ~(1 << line)
        self._valve_follows(line)
        return int(self._terminal(line))

    def _terminal(self, line: int) -> bool:
        """Level at the terminal; undriven terminals are pulled up."""
        if self._directions >> line & 1:
            return bool(self._levels >> line & 1)
        return self._wiring.level(self._locks[line]) if line in self._locks else line not in self._valves

    def _volts(self, number: int, quantities: Mapping[str, float]) -> float:
        return self._wiring.raw(self._inputs_by_number.get(number, ""), quantities, calibrated=True)

    def _gain(self, number: int) -> int:
        """Gain of an input's range; 0 if there is none, as for 10 V."""
        held = self._f32(r.AIN_RANGE + 2 * number)
        return next((gain for gain, span in r.RANGES.values() if abs(held - span) < 0.01 * span), 0)

    # -- stream ---------------------------------------------------------------------------------------------------

    def _actual_rate(self) -> float:
        """The rate, with an interval of a whole number of 100 ns."""
        wanted = self._f32(r.STREAM_SCANRATE)
        return 1e7 / max(1, round(1e7 / wanted)) if wanted > 0 else 0.0

    def _enable_stream(self, *, on: bool) -> None:
        if not on:
            self._stream.end()
            self._store(r.STREAM_ENABLE, [0, 0])
            return
        if self._stream.running or not self._model.streams:
            self._refuse(2605 if self._stream.running else 2606)
        _rate, addresses, per_packet, _settling, resolution, buffer, clock = (
            self._u32(r.STREAM_SCANRATE + 2 * index) for index in range(7)
        )
        rate, size = self._actual_rate(), buffer or BUFFER
        listed = [self._u32(r.STREAM_SCANLIST + 2 * index) for index in range(min(addresses, 128))]
        for code, wrong in (
            (2600, not 1 <= addresses <= 128),
            (2618, not 1 <= per_packet <= r.MOST_SAMPLES),
            (2615, size & size - 1 or not 1024 <= size <= r.STREAM_BUFFER),
            (2608, not 0 < rate * addresses <= r.FASTEST),
            (2375, resolution > 8),
            (2606, clock),
            (2611, self._u32(4018)),
            (2612, self._u32(r.STREAM_AUTO_TARGET) != 1),
            (2625, any(address % 2 or address >= 28 for address in listed)),
        ):
            if wrong:
                self._refuse(code)
        numbers = [address // 2 for address in listed]
        gains = [self._gain(number) for number in numbers]

        def sample(_number: int) -> list[int]:
            quantities = self._plant.at(self._stream.moment)
            return [counts(self._volts(number, quantities), gain) for number, gain in zip(numbers, gains, strict=True)]

        self._store(r.STREAM_ENABLE, [0, 1])
        self._stream.begin(rate, addresses, per_packet, size // 2, self.sample or sample)

    # -- the device's watchdog ------------------------------------------------------------------------------------

    def switch_off_watchdog(self) -> bool:
        """Switch it off, as another program would; returns whether it was on."""
        with self._lock:
            was_on = bool(self._u32(r.WATCHDOG_ENABLE))
            self._store(r.WATCHDOG_ENABLE, r.u32(0))
            return was_on

    def restart(self) -> None:
        """Reset to power-on: DACs at 0 V, lines as inputs, no stream; the watchdog's settings, in flash, are kept.

        T-series datasheet, 23.0 Watchdog: settings are defaults at power-on, and the watchdog starts again by itself.
        """
        with self._lock:
            self._stream.end()
            kept = {address: word for address, word in self._words.items() if FLASHED[0] <= address < FLASHED[1]}
            self._defaults()
            self._words |= kept
            self._cleared, self._started, self._fired = monotonic(), monotonic(), False
            self._levels = self._directions = 0
            for line in self._valves:
                self._valve_follows(line or 0)
            for name in self._wiring.outputs:
                self._wiring.give(name, 0.0)

    def change_set_point(self, value: float) -> bool:
        """Command the first DAC of the bench [V], as another program would; returns whether there is one."""
        with self._lock:
            if name := self._wiring.first_output:
                self._set_dac(r.DAC + 2 * r.DACS.index(name), value, 0)
            return bool(name)

    def look_at_watchdog(self) -> None:
        """Set DACs and lines if the watchdog was not cleared within its time."""
        if monotonic() - self._cleared > self._u32(r.WATCHDOG_TIMEOUT):
            self.expire_watchdog()

    def expire_watchdog(self) -> bool:
        """Let the watchdog run out now; returns whether it was armed."""
        with self._lock:
            silent = monotonic() - self._cleared
            if not self._u32(r.WATCHDOG_ENABLE):
                return False
            if not self._fired:
                self._log.note("watchdog", self.device.name, silent=silent)
            self._fired, self._cleared = True, monotonic()  # it counts again, and acts again after its time
            for index, name in enumerate(r.DACS):
                if self._u32(r.WATCHDOG_DAC_ENABLE[index]):
                    volts = self._f32(r.WATCHDOG_DAC[index])
                    self._store(r.DAC + 2 * index, r.f32(volts))
                    self._wiring.give(name, volts)
            if self._u32(r.WATCHDOG_DIO_ENABLE):
                touched = ~self._u32(r.WATCHDOG_DIO_INHIBIT) & r.ALL_LINES
                state, direction = self._u32(r.WATCHDOG_DIO_STATE), self._u32(r.WATCHDOG_DIO_DIRECTION)
                self._levels = self._levels & ~touched | state & touched
                self._directions = self._directions & ~touched | direction & touched
                for line in range(23):
                    self._valve_follows(line)
            return True
