"""An emulated T7, T8 or T4: its registers, DACs, digital lines and watchdog in front of the simulated muscle."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from time import monotonic

from pmabench.base.errors import UsageError
from pmabench.bench.interface import DeviceRecord
from pmabench_drivers.emulator.faults import EXPIRY, RESTART, SETPOINT, SKEW, WATCHDOG_OFF, Faults
from pmabench_drivers.emulator.frames import ADDRESS, Refused, Request
from pmabench_drivers.emulator.log import CommandLog
from pmabench_drivers.emulator.modbus_server import KINDS, TcpDevice
from pmabench_drivers.emulator.plant import RealPlant
from pmabench_drivers.emulator.ports import host_of
from pmabench_drivers.labjack import registers as r
from pmabench_drivers.labjack.calibration import COUNT, FLASH
from pmabench_drivers.labjack.emulated_stream import FAULTS, Streamer
from pmabench_drivers.labjack.options import Options, read_options
from pmabench_drivers.options import Reader

FAILED = 4
"""Exception code of whatever LabJack has a code of its own for."""
SLOPES = ((3.1592e-4, -3.1571e-4, 33511.0), (3.1590e-5, -3.1575e-5, 33498.5))
"""Constants of this device, unlike those of any other: slopes and centre for 10 V and 1 V."""
DAC_END = 0.993
"""Share of its full voltage that a DAC reaches."""
BUFFER = 2 * 4096
FLASHED = (r.WATCHDOG_ENABLE, r.WATCHDOG_ENABLE + 100)
"""Registers that power-on does not change."""
POWER_ON = 1
"""Bit 0 of the cause of the last restart."""


def constants() -> list[float]:
    """The calibration in its flash, 41 numbers."""
    found: list[float] = []
    for gain in range(4):
        positive, negative, center = SLOPES[min(gain, 1)]
        shrink = 10.0 ** (max(gain, 1) - 1)
        found += [positive / shrink, negative / shrink, center, -positive / shrink * center]
    return found + [0.0] * (COUNT - len(found))


def counts(volts: float, gain: int) -> int:
    """What its converter gives for a voltage."""
    positive, negative, center = constants()[4 * gain : 4 * gain + 3]
    raw = center + volts / positive if volts >= 0 else center - volts / negative
    return min(max(round(raw), 0), 65535)


def serve(device: DeviceRecord, plant: RealPlant, log: CommandLog) -> EmulatedT7:
    """What a device of the driver `labjack` talks to."""
    reader = Reader()
    options = read_options(device, reader)
    reader.refuse(device.name)
    return EmulatedT7(device, options, plant, log, options.port, options.stream_port)


class _Faults(Faults):
    """Faults of the link, and those of the stream."""

    def __init__(self, stream: Streamer) -> None:
        super().__init__(*KINDS, SKEW, EXPIRY, WATCHDOG_OFF, RESTART, SETPOINT, FAULTS)
        self._stream = stream

    def set(self, kind: str, value: float | None = None, count: int = -1) -> None:
        """Of the stream: once; else as for any link."""
        if kind in FAULTS:
            self._stream.fault(kind, FAULTS[kind].usual if value is None else value)
        else:
            super().set(kind, value, count)


class EmulatedT7(TcpDevice):
    """Commands on one port, the stream on another; port 0 takes free ones."""

    def __init__(
        self, device: DeviceRecord, options: Options, plant: RealPlant, log: CommandLog, port: int, stream_port: int
    ) -> None:
        self.stream = Streamer(device.name, host_of(device.address), stream_port, log)
        try:
            self.t7 = T7(device, options, plant, log, self.stream)
            super().__init__(self.t7, 1, log, port)
        except UsageError:
            self.stream.close()
            raise
        self.stream_port = self.stream.port
        self.faults = self.stream.faults = _Faults(self.stream)

    def start(self) -> None:
        """Begin to serve."""
        super().start()
        self.stream.start()

    def close(self) -> None:
        """Hang up."""
        super().close()
        self.stream.close()


class T7:
    """The registers of a model, kept as words by their addresses."""

    def __init__(
        self, device: DeviceRecord, options: Options, plant: RealPlant, log: CommandLog, stream: Streamer
    ) -> None:
        self.device, self._plant, self._log, self._stream = device, plant, log, stream
        self._model = options.model
        self._inputs = 2 * len(self._model.inputs)
        """Registers of its analogue inputs."""
        self._lock = threading.RLock()
        self._channels = {options.inputs[channel.name].number: channel for channel in device.channels}
        self._outputs = {output.output: output for output in device.outputs}
        self._valves = {r.line_of(valve.output): valve for valve in device.valves}
        self._locks = {r.line_of(lock.input): lock for lock in device.interlocks}
        self._words: dict[int, int] = {}
        self._last_error = 0
        self._levels = self._directions = 0
        self._cleared, self._started, self._bitten = monotonic(), monotonic(), False
        self.sample: Callable[[int], list[int]] | None = None
        """What stands in for the plant in tests of the stream: the counts of a scan by its number."""
        self._defaults()

    def _defaults(self) -> None:
        for number in range(14):
            self._store(r.AIN_RANGE + 2 * number, r.f32(0.0))
            self._words[r.AIN_NEGATIVE + number] = r.SINGLE_ENDED
        for index in range(2):
            self._store(r.DAC + 2 * index, r.f32(0.0))
        for first, last in ((r.STREAM_SCANRATE, 4030), (r.STREAM_SCANLIST, 4356), (r.WATCHDOG_ENABLE, 61608)):
            for address in range(first, last):
                self._words[address] = 0
        for first, size in ((r.WATCHDOG_STRICT, 6), (r.WATCHDOG_RESET, 2), (r.WATCHDOG_DIO_ENABLE, 8)):
            self._store(first, [0] * size)
        for first in r.WATCHDOG_DAC_ENABLE:
            self._store(first, [0] * 4)
        self._store(r.STREAM_ENABLE, [0, 0])
        self._store(r.FLASH_POINTER, [0, 0])
        self._store(r.TEST, r.u32(0x00112233))
        self._store(r.PRODUCT_ID, r.f32(self._model.product))
        if self._model.captures:
            self._store(r.CAPTURE, [0] * self._inputs)
        self._store(r.FIRMWARE_VERSION, r.f32(1.0331))
        self._store(r.SERIAL_NUMBER, r.u32(0))
        self._store(r.RESET_CAUSE, r.u32(POWER_ON))
        self._store(r.RTC_TIME, r.u32(0))

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
        """What is read, or nothing; `Refused` where the device says no."""
        with self._lock:
            if not self._u32(r.WATCHDOG_STRICT):
                self._clear()
            if request.table not in {"holding", "input"}:
                raise Refused(ADDRESS)
            if request.values:
                self._write(request.address, list(request.values), connection, ignore=ignore)
                return []
            return self._read(request.address, request.count)

    def _read(self, address: int, count: int) -> list[int]:
        if r.DIO <= address < r.DIO + 23 and address + count <= r.DIO + 23:
            return [self._read_line(line) for line in range(address - r.DIO, address - r.DIO + count)]
        if (address, count) == (r.LAST_ERR_DETAIL, 1):
            return [self._last_error]
        if (address, count) == (r.DIO_STATE, 2):
            return r.u32(sum(self._terminal(line) << line for line in range(23)))
        if (address, count) == (r.DIO_DIRECTION, 2):
            return r.u32(self._directions)
        if address == r.FLASH_READ:
            return self._read_flash(count)
        if address < self._inputs and address + count <= self._inputs:
            return self._read_inputs(address, count)
        if address == r.RTC_TIME:
            self._store(address, r.u32(int(monotonic() - self._started)))
        if address == r.STREAM_SCANRATE and count >= 2:  # what it will really use
            self._store(address, r.f32(self._actual_rate()))
        if not all(address + offset in self._words for offset in range(count)):
            raise Refused(ADDRESS)
        return [self._words[address + offset] for offset in range(count)]

    def _read_inputs(self, address: int, count: int) -> list[int]:
        """Volts of some inputs; a model that captures takes all of them at this moment."""
        if self._stream.running:
            self._refuse(2605)
        quantities = self._plant.quantities()
        words = r.f32(*(self._volts(number, quantities) for number in range(self._inputs // 2)))
        if self._model.captures:
            self._store(r.CAPTURE, words)
        return words[address : address + count]

    def _read_flash(self, count: int) -> list[int]:
        first = (self._u32(r.FLASH_POINTER) - FLASH) // 4
        wanted = constants()[first : first + count // 2] if first >= 0 else []
        if count % 2 or len(wanted) != count // 2:
            self._refuse(2315)
        return r.f32(*wanted)

    def _write(self, address: int, words: list[int], connection: int, *, ignore: bool) -> None:
        last = address + len(words)
        line = r.DIO <= address and last <= r.DIO + 23
        clear = (address, len(words)) == (r.WATCHDOG_CLEAR, 2)
        if not line and not all(place in self._words for place in range(address, last)):
            raise Refused(ADDRESS)
        if not line and not r.AIN_NEGATIVE <= address < r.AIN_NEGATIVE + 14 and len(words) % 2:
            self._refuse(2315)
        if r.WATCHDOG_ENABLE < address < r.WATCHDOG_ENABLE + 100 and not clear and self._u32(r.WATCHDOG_ENABLE):
            self._refuse(2671)
        if self._stream.running and (4002 <= address < 4990 or r.AIN_RANGE <= address < r.AIN_RANGE + 1100):
            self._refuse(2605)
        if ignore:
            return
        if line:
            for offset, word in enumerate(words):
                self._set_line(address - r.DIO + offset, high=word != 0, connection=connection)
            return
        if clear:
            if not self._u32(r.WATCHDOG_STRICT) or r.from_u32(words) == [self._u32(r.WATCHDOG_KEY)]:
                self._clear()
            return
        if address == r.STREAM_ENABLE:
            self._enable_stream(on=words[1] != 0)
            return
        if address == r.WATCHDOG_ENABLE and words[1] and self._u32(r.WATCHDOG_TIMEOUT) < 1:
            self._refuse(2670)
        self._store(address, words)
        if address == r.WATCHDOG_ENABLE:
            self._clear()
            self._log.note("watchdog-register", self.device.name, raw=words[1], connection=connection)
        for index, name in enumerate(r.DACS):
            if r.DAC + 2 * index in range(address, last):
                self._set_dac(name, self._f32(r.DAC + 2 * index), connection)

    # -- terminals ------------------------------------------------------------------------------------------------

    def _set_dac(self, name: str, volts: float, connection: int) -> None:
        output = self._outputs.get(name)
        if output is None:
            return
        step = self._model.dac_step
        reached = round(min(max(volts, 0.0), DAC_END * self._model.dac_full) / step) * step
        si = float(output.scale.to_si(volts))
        note = {"output": output.name, "raw": volts, "si": si, "connection": connection}
        self._log.note("set", self.device.name, **note)
        if output.quantity == "pressure":
            self._plant.command(float(output.scale.to_si(reached)))

    def _set_line(self, line: int, *, high: bool, connection: int) -> None:
        self._directions |= 1 << line
        self._levels = self._levels | 1 << line if high else self._levels & ~(1 << line)
        self._valve_follows(line)
        valve = self._valves.get(line)
        if valve is not None:
            self._log.note("switch", self.device.name, valve=valve.name, on=high, connection=connection)

    def _valve_follows(self, line: int) -> None:
        """A relay in front of the valve: energised while the line is an output and high."""
        valve = self._valves.get(line)
        if valve is not None:
            on = bool(self._levels & self._directions & 1 << line)
            self._plant.switch(on=on == (valve.energised == "closed"))

    def _read_line(self, line: int) -> int:
        """Reading a line makes it an input."""
        self._directions &= ~(1 << line)
        self._valve_follows(line)
        return int(self._terminal(line))

    def _terminal(self, line: int) -> bool:
        """The level at the terminal; what nothing drives is pulled up."""
        if self._directions >> line & 1:
            return bool(self._levels >> line & 1)
        lock = self._locks.get(line)
        if lock is None:
            return line not in self._valves
        closed = self._plant.e_stop_high() if "stop" in lock.name else True
        return closed == (lock.safe == "high")

    def _volts(self, number: int, quantities: Mapping[str, float]) -> float:
        channel = self._channels.get(number)
        if channel is None:
            return 0.0
        return float(channel.calibrated.to_raw(quantities.get(channel.name, 0.0)))

    def _gain(self, number: int) -> int:
        """The gain of an input's range; 0 is that of 10 V too."""
        held = self._f32(r.AIN_RANGE + 2 * number)
        return next((gain for gain, span in r.RANGES.values() if abs(held - span) < 0.01 * span), 0)

    # -- stream ---------------------------------------------------------------------------------------------------

    def _actual_rate(self) -> float:
        """The rate with an interval of whole 100 ns."""
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
            found = []
            for number, gain in zip(numbers, gains, strict=True):
                channel = self._channels.get(number)
                si = 0.0 if channel is None else quantities.get(channel.name, 0.0)
                found.append(counts(0.0 if channel is None else float(channel.calibrated.to_raw(si)), gain))
            return found

        self._store(r.STREAM_ENABLE, [0, 1])
        self._stream.begin(rate, addresses, per_packet, size // 2, self.sample or sample)

    # -- the device's watchdog ------------------------------------------------------------------------------------

    def _clear(self) -> None:
        self._cleared, self._bitten = monotonic(), False

    def switch_off_watchdog(self) -> bool:
        """Another program switches it off; whether it was on."""
        with self._lock:
            was_on = bool(self._u32(r.WATCHDOG_ENABLE))
            self._store(r.WATCHDOG_ENABLE, r.u32(0))
            return was_on

    def restart(self) -> None:
        """Power off and on: DACs at 0 V, lines as inputs, no stream; what is in flash, the watchdog's settings, stays.

        T-series datasheet, 23.0 Watchdog: settings are defaults at power-on, and the watchdog starts again by itself.
        """
        with self._lock:
            self._stream.end()
            kept = {address: word for address, word in self._words.items() if FLASHED[0] <= address < FLASHED[1]}
            self._words.clear()
            self._defaults()
            self._words |= kept
            self._cleared, self._started, self._bitten = monotonic(), monotonic(), False
            self._levels = self._directions = 0
            for line in self._valves:
                self._valve_follows(line or 0)
            for output in self._outputs.values():
                if output.quantity == "pressure":
                    self._plant.command(float(output.scale.to_si(0.0)))

    def change_set_point(self, value: float) -> bool:
        """Another program commands the first DAC of the bench [V]; whether there is one."""
        with self._lock:
            for name in list(self._outputs)[:1]:
                self._store(r.DAC + 2 * r.DACS.index(name), r.f32(value))
                self._set_dac(name, value, 0)
            return bool(self._outputs)

    def look_at_watchdog(self) -> None:
        """Set DACs and lines where nobody has cleared it for its time."""
        if monotonic() - self._cleared > self._u32(r.WATCHDOG_TIMEOUT):
            self.expire_watchdog()

    def expire_watchdog(self) -> bool:
        """Do it now; whether the watchdog was armed."""
        with self._lock:
            silent = monotonic() - self._cleared
            if not self._u32(r.WATCHDOG_ENABLE) or self._bitten:
                return False
            self._bitten = True
            self._log.note("watchdog", self.device.name, silent=silent)
            for index, name in enumerate(r.DACS):
                if self._u32(r.WATCHDOG_DAC_ENABLE[index]):
                    volts = self._f32(r.WATCHDOG_DAC[index])
                    self._store(r.DAC + 2 * index, r.f32(volts))
                    output = self._outputs.get(name)
                    if output is not None and output.quantity == "pressure":
                        self._plant.command(float(output.scale.to_si(volts)))
            if self._u32(r.WATCHDOG_DIO_ENABLE):
                touched = ~self._u32(r.WATCHDOG_DIO_INHIBIT) & r.ALL_LINES
                state, direction = self._u32(r.WATCHDOG_DIO_STATE), self._u32(r.WATCHDOG_DIO_DIRECTION)
                self._levels = self._levels & ~touched | state & touched
                self._directions = self._directions & ~touched | direction & touched
                for line in range(23):
                    self._valve_follows(line)
            return True
