"""LabJack T7, T8 and T4: analogue inputs (a T7 streams them), DACs, digital lines, watchdog, over Ethernet.

`registers`: addresses, words, and options; `stream`: packets, volts and their connection; here: the device interface;
`emulated`, `emulated_map`: the device for `pmabench emulate`.

Commands are those of the Modbus driver with LabJack's own registers; stream, digital lines and watchdog are separate.
During a stream a T7 does not answer reads of its analogue inputs, and all samples come from the stream. A T8 and a T4
are read for each sample; on a T8 reading one input captures all of them at that moment.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from time import monotonic, sleep
from typing import TYPE_CHECKING

from pmabench.base.clock import Clock
from pmabench.base.errors import DeviceError
from pmabench.bench.interface import EMULATED, UNPROVEN, Block, DeviceRecord, Identity
from pmabench_drivers.labjack import registers as r
from pmabench_drivers.labjack.registers import Options, read_options
from pmabench_drivers.labjack.stream import COUNT, FLASH, Gain, StreamLink, gains
from pmabench_drivers.modbus import CALL, OPEN, ModbusDevice
from pmabench_drivers.modbus.registers import Register
from pmabench_drivers.shared.link import Unanswered
from pmabench_drivers.shared.options import Reader

if TYPE_CHECKING:
    from pmabench_drivers.modbus.adapter import Line

LATENCY = 0.01
"""Time that a packet of the stream covers [s]."""
BLOCK = 13
"""Constants that are read from the flash at once."""
FIRMWARE_STEP = 5e-5
"""Half a step between two versions of the firmware."""
KEY = 0x504D4142
"""Value that feeds the watchdog."""
AGAIN = 0.005
"""Interval for writing a line again during a vent over a second connection [s]."""


class LabJack(ModbusDevice):
    """A T7, T8 or T4 on Ethernet, according to `options.model`.

    Raw values are volts at the terminals; `DAC0` and `DAC1` take volts.
    """

    emulator = "pmabench_drivers.labjack.emulated"
    read_options = staticmethod(read_options)
    _options: Options

    def __init__(self, device: DeviceRecord, clock: Clock) -> None:
        super().__init__(device, clock)
        self._model = self._options.kind
        self._lines = {valve.output: r.line_of(valve.output) or 0 for valve in device.valves}
        self._tables: dict[int, array[float]] = {}
        self._stream: StreamLink | None = None
        self._firmware = 0.0

    @classmethod
    def fastest(cls, device: DeviceRecord) -> float:
        """Highest rate of its stream with all channels, or of reading it [Hz]."""
        options = read_options(device, Reader())
        return r.FASTEST / max(1, len(device.channels)) if options.kind.streams else options.rate

    # -- life -----------------------------------------------------------------------------------------------------

    def open(self) -> Identity:
        """Connect, check the order of words, identify, and read the constants that convert counts to volts."""
        super().open()
        deadline = monotonic() + OPEN
        with self._closed_on_error():
            try:
                return self._identify_model(deadline)
            except Unanswered:
                return self._identify_model(deadline)  # reading twice moves nothing

    def _identify_model(self, deadline: float) -> Identity:
        self._prove_words(deadline)
        name, wanted = self._options.model, self._model.product
        [product] = r.from_f32(self.get(r.PRODUCT_ID, 2, deadline, "product"))
        if product != wanted:
            known = {model.product: name for name, model in r.MODELS.items()}
            found = f"is a {known[product]}" if product in known else f"has the product number {product:g}"
            raise self._error(f"{found}, and the bench file says {name}: options.model")
        [firmware] = r.from_f32(self.get(r.FIRMWARE_VERSION, 2, deadline, "firmware"))
        self._firmware = firmware
        [serial] = r.from_u32(self.get(r.SERIAL_NUMBER, 2, deadline, "serial number"))
        if self._model.streams:
            gains_ = self._read_gains(deadline)
            self._tables = {item.gain: gains_[item.gain].table() for item in self._options.inputs.values()}
        begins = {r.EMULATED: EMULATED, r.UNPROVEN: UNPROVEN}.get(serial, "")
        return Identity("LabJack", f"{begins}{name}", str(serial), f"{firmware:.4f}", simulated=bool(begins))

    def close(self) -> None:
        """End stream and stepping and close the connections."""
        self._end_stream()
        super().close()

    def _prove_words(self, deadline: float) -> None:
        """Check the order of words with a constant register."""
        words = self.get(r.TEST, 2, deadline, "test register")
        if r.from_u32(words) != [r.TEST_VALUE]:
            message = f"its test register gives {words[0]:04x} {words[1]:04x} instead of 0011 2233: no LabJack, or "
            raise self._error(message + "something between that changes the order of words")

    def _read_gains(self, deadline: float) -> tuple[Gain, ...]:
        constants: list[float] = []
        for first in range(0, COUNT, BLOCK):
            count = min(BLOCK, COUNT - first)
            self.put(r.FLASH_POINTER, r.u32(FLASH + 4 * first), deadline, "calibration")
            constants += r.from_f32(self.get(r.FLASH_READ, 2 * count, deadline, "calibration"))
        try:
            return gains(constants)
        except ValueError as error:
            raise self._error(f"holds {error}: its flash is damaged") from None

    # -- samples --------------------------------------------------------------------------------------------------

    def start(self, rate: float) -> float:
        """Stream all channels together at `rate` [Hz], or read them; returns the rate used."""
        options, inputs = self._options, list(self._options.inputs.values())
        if not self._model.streams:
            deadline = monotonic() + CALL
            for item in inputs if self._model.ranges else ():
                self._set_range(item, deadline)
            return super().start(rate)
        if not 0 < rate < math.inf or not inputs:
            raise self._error(f"cannot sample {len(inputs)} channels at {rate} Hz")
        if rate * len(inputs) > r.FASTEST:
            message = f"cannot take {rate * len(inputs):g} samples a second: a T7 takes at most {r.FASTEST:g}"
            raise self._error(f"{message}, over all channels")
        self._end_stream()
        deadline = monotonic() + CALL
        if r.from_u32(self.get(r.STREAM_ENABLE, 2, deadline, "stream")) != [0]:
            self.put(r.STREAM_ENABLE, r.u32(0), deadline, "stream")  # left over from before
        for item in inputs:
            self._set_range(item, deadline)
            self.put(r.AIN_NEGATIVE + item.number, [item.negative], deadline, f"AIN{item.number}")
        scans = max(1, min(r.MOST_SAMPLES // len(inputs), round(rate * LATENCY)))
        names, address = [channel.name for channel in self._device.channels], (options.host, options.stream_port)
        link = StreamLink(self._device.name, names, address, deadline - monotonic(), self._clock)
        try:
            used = self._configure(rate, scans, deadline)
            link.begin(used, scans, [self._tables[item.gain] for item in inputs])
            self.put(r.STREAM_ENABLE, r.u32(1), deadline, "stream")
        except DeviceError:
            link.close()
            raise
        self._stream = link
        return used

    def _set_range(self, item: r.Input, deadline: float) -> None:
        self.put(r.AIN_RANGE + 2 * item.number, r.f32(item.span), deadline, f"AIN{item.number}")

    def _configure(self, rate: float, scans: int, deadline: float) -> float:
        """Write scan list and settings and read them back; returns the rate that the device will use [Hz]."""
        options, inputs = self._options, list(self._options.inputs.values())
        sizes = r.u32(len(inputs), len(inputs) * scans)
        rest = [*r.f32(1e6 * options.settling), *r.u32(options.resolution_index, r.STREAM_BUFFER, 0)]
        addresses = r.u32(*(2 * item.number for item in inputs))
        self.put(r.STREAM_SCANRATE, [*r.f32(rate), *sizes, *rest], deadline, "stream")
        self.put(r.STREAM_AUTO_TARGET, r.u32(r.TO_ETHERNET, 0, 0), deadline, "stream")
        self.put(r.STREAM_SCANLIST, addresses, deadline, "stream")
        held = self.get(r.STREAM_SCANRATE, 2 * len(r.STREAM_CONFIGURATION), deadline, "stream")
        [used] = r.from_f32(held[:2])
        wrong = [
            what
            for index, what in enumerate(r.STREAM_CONFIGURATION)
            if what in {"addresses", "samples a packet", "resolution", "buffer", "clock"}
            and held[2 * index : 2 * index + 2] != [*r.f32(rate), *sizes, *rest][2 * index : 2 * index + 2]
        ]
        if self.get(r.STREAM_SCANLIST, len(addresses), deadline, "stream") != addresses:
            wrong.append("scan list")
        if wrong or not math.isfinite(used) or not abs(used / rate - 1) < 0.1:
            message = f"does not hold what was written for its stream: {', '.join(wrong) or f'a rate of {used:g} Hz'}"
            raise self._error(message)
        return used

    def collect(self) -> Block:
        """Every scan since the last call; raises DeviceError once the stream, or stepping, has failed."""
        asked = super().collect()
        if not self._model.streams:
            return asked
        return Block([], {name: [] for name in asked.columns}) if self._stream is None else self._stream.collect()

    def stop(self) -> None:
        """End the stream; a ramp in progress continues."""
        self._end_stream()
        super().stop()

    def _end_stream(self) -> None:
        """Stop the device and close the connection; if it does not answer, the next start stops it."""
        link, self._stream = self._stream, None
        if link is None:
            return
        link.close()
        with suppress(DeviceError):
            self.put(r.STREAM_ENABLE, r.u32(0), monotonic() + CALL / 2, "stream")

    @property
    def lost(self) -> int:
        """Scans of this stream that did not arrive; each is a gap in the samples."""
        return 0 if self._stream is None else self._stream.lost

    # -- digital lines --------------------------------------------------------------------------------------------

    def _get(self, register: Register, deadline: float = 0.0) -> float:
        """For a valve's line, whether it drives its terminal high: reading its own register would make it an input."""
        if (line := self._lines.get(register.name)) is None:
            return super()._get(register, deadline)
        until = deadline or monotonic() + CALL
        [state] = r.from_u32(self.get(r.DIO_STATE, 2, until, register.name))
        [direction] = r.from_u32(self.get(r.DIO_DIRECTION, 2, until, register.name))
        return state >> line & direction >> line & 1

    def _overrule(self, second: Line, register: Register, value: float, deadline: float, watch: float) -> None:
        """Write a valve's line repeatedly: reading its own register would make it an input."""
        if register.name not in self._lines:
            super()._overrule(second, register, value, deadline, watch)
            return
        words, enough = self._words(register, value), monotonic() + watch
        second.write(self._function(register), register.address, words, deadline, register.name)
        while monotonic() < enough:
            sleep(AGAIN)
            with suppress(DeviceError):
                second.write(self._function(register), register.address, words, deadline, register.name)

    def _shows(self, register: Register, held: float) -> str:
        """State of a valve's terminal, or value of another register."""
        valve = register.name in self._lines
        return f"its terminal is {'high' if held else 'low'}" if valve else super()._shows(register, held)

    # -- the device's watchdog ------------------------------------------------------------------------------------
    #
    # Strict: only its key feeds it, so that neither a stream nor another program keeps it quiet. On time-out it sets
    # the DACs and the valve lines to their safe values. It counts whole seconds. Its settings are kept in flash.

    def arm_watchdog(self, seconds: float) -> float:
        """Set whole seconds and the safe values of DACs and valves, and start it; returns the time it holds [s]."""
        if not 1.0 <= seconds < math.inf:
            raise self._error(f"counts whole seconds: a watchdog of {seconds:g} s cannot be set", "watchdog")
        deadline = monotonic() + CALL
        self.put(r.WATCHDOG_ENABLE, r.u32(0), deadline, "watchdog")
        for address, words in watchdog_settings(self._device, math.floor(seconds + 1e-6)):
            if self.get(address, len(words), deadline, "watchdog") == words:
                continue  # already there: flash is slow and wears out
            self.put(address, words, deadline, "watchdog")
            if (held := self.get(address, len(words), deadline, "watchdog")) != words:
                raise self._error(f"register {address} holds {held} after {words} was written", "watchdog")
        self.put(r.WATCHDOG_CLEAR, r.u32(KEY), deadline, "watchdog")
        self.put(r.WATCHDOG_ENABLE, r.u32(1), deadline, "watchdog")
        enabled, _advanced, held_time, _delay = r.from_u32(self.get(r.WATCHDOG_ENABLE, 8, deadline, "watchdog"))
        if enabled != 1:
            raise self._error("does not say that it is on", "watchdog")
        return float(held_time)

    def feed_watchdog(self) -> None:
        """Write its key."""
        self.put(r.WATCHDOG_CLEAR, r.u32(KEY), monotonic() + CALL, "watchdog")

    def disarm_watchdog(self) -> None:
        """Switch it off; outputs stay, and the settings in flash have no effect."""
        deadline = monotonic() + CALL
        self.put(r.WATCHDOG_ENABLE, r.u32(0), deadline, "watchdog")
        if r.from_u32(self.get(r.WATCHDOG_ENABLE, 2, deadline, "watchdog")) != [0]:
            raise self._error("is still on", "watchdog")

    def _watchdog_held(self, deadline: float) -> dict[str, float | str]:
        """Its present time [s], 0 if it is off; and its actions, as one text."""
        enabled, advanced, seconds, _delay = r.from_u32(self.get(r.WATCHDOG_ENABLE, 8, deadline, "watchdog"))
        does = [f"61602={advanced:08x}"]
        for address, words in watchdog_settings(self._device, int(seconds))[1:]:
            held = self.get(address, len(words), deadline, "watchdog")
            does.append(f"{address}={''.join(f'{word:04x}' for word in held)}")
        return {"watchdog": float(seconds) if enabled == 1 else 0.0, "registers of the watchdog": " ".join(does)}

    def held(self) -> Mapping[str, float | str]:
        """Watchdog with its actions, serial number, ranges; with newer firmware: cause of the last restart, uptime.

        The uptime is the device's clock, which starts at 0 at power-on. If a device sets its clock over the
        network, it is the time of day, and left out.
        """
        deadline = monotonic() + CALL
        found = self._watchdog_held(deadline)
        [serial] = r.from_u32(self.get(r.SERIAL_NUMBER, 2, deadline, "serial number"))
        found["serial"] = str(serial)
        if self._model.ranges and self._inputs:  # a stream has its own
            numbers = [item.number for item in self._options.inputs.values()]
            first, count = min(numbers), max(numbers) - min(numbers) + 1
            spans = r.from_f32(self.get(r.AIN_RANGE + 2 * first, 2 * count, deadline, "ranges"))
            found["ranges"] = ", ".join(f"AIN{number} {spans[number - first]:.3g} V" for number in sorted(numbers))
        if self._firmware >= self._model.restart_cause_from - FIRMWARE_STEP:
            [cause] = r.from_u32(self.get(r.RESET_CAUSE, 2, deadline, "cause of the last restart"))
            [clock] = r.from_u32(self.get(r.RTC_TIME, 2, deadline, "uptime"))
            found["cause of the last restart"] = float(cause)
            if clock < r.TIME_OF_DAY:
                found["uptime"] = float(clock)
        return found

    # -- registers ------------------------------------------------------------------------------------------------

    def get(self, address: int, count: int, deadline: float, what: str) -> list[int]:
        """Read registers from an address on; raises LabJack's own reason if refused."""
        with self._explained(deadline, what):
            return self._opened().read("holding", address, count, deadline, what)

    def put(self, address: int, words: Sequence[int], deadline: float, what: str) -> None:
        """Write registers once; raises LabJack's own reason if refused."""
        with self._explained(deadline, what):
            self._opened().write(16, address, words, deadline, what)

    @contextmanager
    def _explained(self, deadline: float, what: str) -> Iterator[None]:
        """Add the device's code of its last error to a refusal."""
        try:
            yield
        except DeviceError as error:
            if not error.message.startswith("answers with exception"):
                raise
            with suppress(DeviceError):
                [code] = self._opened().read("holding", r.LAST_ERR_DETAIL, 1, deadline, what)
                detail = ": ".join([f"its error {code}", *([r.ERRORS[code]] if code in r.ERRORS else [])])
                error = self._error(f"{error.message}; {detail}", what)
            raise error from None


def watchdog_settings(device: DeviceRecord, seconds: int) -> list[tuple[int, list[int]]]:
    """First address and words of each group of registers except enable: all that makes the device safe by itself."""
    dacs = {output.output: float(output.scale.to_raw(output.safe)) for output in device.outputs}
    lines = {r.line_of(valve.output) or 0: valve.safe == valve.energised for valve in device.valves}
    mask = sum(1 << line for line in lines)
    state = sum(1 << line for line, high in lines.items() if high)
    groups = [
        (r.WATCHDOG_ADVANCED, r.u32(0, seconds, 0)),
        (r.WATCHDOG_STRICT, r.u32(1, KEY)),
        (r.WATCHDOG_RESET, r.u32(0)),
        (r.WATCHDOG_DIO_ENABLE, r.u32(int(bool(lines)), state, mask, r.ALL_LINES & ~mask)),
    ]
    for name, enable in zip(r.DACS, r.WATCHDOG_DAC_ENABLE, strict=True):
        groups.append((enable, [*r.u32(int(name in dacs)), *r.f32(dacs.get(name, 0.0))]))
    return groups
